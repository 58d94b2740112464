"""The 93XX behind a 2102 module: a servo that counts in rotations and keeps its sets in RAM.

Strategy: speeds are min-1, C0011 is the greatest; the setpoint is C0141 in %, the free control
code. The signal configuration C0005 says what the bits of the words mean: its thousands digit is
the function, and its last digit must be 1 for the line to control the drive. With another one
C0135 and C0141 are acknowledged, read back as written, and act on nothing; C0040 always acts.
Parameters live in RAM until C0003 saves them.

Source: EDB2102EN 3.4, 5, 6.1.3, 8.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

from ..model import JOG_BITS, QSP, tens_digit, word_of, word_text
from ..parameters import CommError, ExtendedError, Kept, Refusal, Spec, d, h, s
from ..troubles import Kind, kinds
from .module2102 import MODULE_SPECS, RFG_STOP, RFG_ZERO, Module2102

__all__ = ["Drive93XX"]

_SPEED, _TORQUE = 1, 4
_CASCADES: Final = (6, 7)
"""Configurations 6xx1 and 7xx1: slaves of a digital frequency, with fewer functions."""

SPECS_93XX: Final[tuple[Spec, ...]] = (
    *MODULE_SPECS,
    d(3, "0", (0, 4), kept=Kept.PROCESS),
    d(5, "1001", (0, 72000), kept=Kept.MEMORY),
    d(9, "1", (1, 99)),
    d(11, "3000", (500, 16000), kept=Kept.MEMORY),
    d(12, "2", (0, 9999), decimals=3, kept=Kept.MEMORY),
    d(13, "2", (0, 9999), decimals=3, kept=Kept.MEMORY),
    *(d(39, "10", (-200, 200), subcode=n, decimals=2, kept=Kept.MEMORY) for n in range(1, 16)),
    d(40, "0", (0, 1), kept=Kept.PROCESS),
    d(43, "0", (0, 0), kept=Kept.PROCESS),
    d(46, "0"),
    d(50, "0"),
    d(51, "0"),
    d(52, "0"),
    d(53, "540"),
    d(54, "0"),
    d(61, "38"),
    *(d(67, "0", subcode=n) for n in range(9)),
    h(68, "H0000"),
    d(93, "9321"),
    d(99, "20"),
    *(d(102, "2", (0, 9999), subcode=n, decimals=3, kept=Kept.MEMORY) for n in range(1, 4)),
    *(d(103, "2", (0, 9999), subcode=n, decimals=3, kept=Kept.MEMORY) for n in range(1, 4)),
    d(105, "2", (0, 9999), decimals=3, kept=Kept.MEMORY),
    d(125, "0", (0, 4)),
    h(135, "H0000", writable=True),
    d(141, "0", (-200, 200), decimals=2, kept=Kept.PROCESS),
    h(150, "H0000"),
    *(d(161, "0", subcode=n) for n in range(9)),
    *(d(168, "0", subcode=n) for n in range(9)),
    d(178, "1234"),
    d(179, "5678"),
    s(200, "33S9300I_20000"),
    s(201, "Mar 17 1999 10:31"),
)

FAULTS_93XX: Final = kinds(
    trips=(
        *(11, 12, 15, 50, 53, 58, 61, 62, 63, 64, 70, 71, 72, 73, 74, 75, 77, 78, 79, 82, 83, 86),
        *(91, 105, 107, 110, 111, 153, 163, 200),
    ),
    messages=(1020, 1030, 1091),
    warnings=(2054, 2057, 2058, 2061, 2062, 2063, 2064, 2082, 2083, 2086, 2091, 2153),
)
"""LECOM fault numbers of C0168. Source: EDB2102EN 8.2."""


class Drive93XX(Module2102):
    """A 9300 servo inverter.

    Attributes:
        terminal_e1: Whether terminal E1 has a HIGH level; configuration 1011 has quick stop there
            (EDB2102EN 5). `steer` makes a change act.
        terminal_rpm: What its terminals ask for while the line does not control it, min-1.
    """

    family: ClassVar[str] = "93xx"
    fault_kinds: ClassVar[Mapping[int, Kind]] = FAULTS_93XX
    speed_unit: ClassVar[str] = "min-1"
    terminal_e1 = True
    terminal_rpm = 0.0

    def __init__(self) -> None:
        self._unheeded = 0
        super().__init__(SPECS_93XX)

    def _install(self) -> None:
        super()._install()
        self.readers |= {
            46: lambda _: self.params.text(141) if self.follows_line() else "0",
            50: lambda _: self.frequency_text(self.motor.output / self.params.number(11) * 100, 2),
            51: lambda _: self.frequency_text(self.motor.speed, 0),
            54: lambda _: "2.1" if self.motor.output else "0",
            67: self._fault_memory,
            161: self._fault_memory,
            168: self._fault_memory,
        }
        self.writers[3] = lambda text: self.params.save() if text != "0" else None

    def _fault_memory(self, subcode: int) -> str:
        """Subcode 1 is the active fault, 2 and up what was before; 0 stands for 1.

        Only C0168 is said to have subcodes. What C0067 and C0161 hold is not said: the same here.
        """
        return str(self.troubles.shifted(subcode))

    # Control

    def configuration(self) -> int:
        """The function of C0005: 1 speed, 4 torque, 5 master, 6 and 7 slaves."""
        return int(self.params.text(5)) // 1000

    def follows_line(self) -> bool:
        """Whether C0135 and C0141 act. Source: EDB2102EN 5, "Next steps for 93XX"."""
        return int(self.params.text(5)) % 10 == 1

    def may_write(self, spec: Spec, text: str) -> None:
        """C0005 is written only while inhibited."""
        if spec.number == 5 and not self.inhibited():
            raise Refusal(CommError.NO_ACCESS, ExtendedError.OPERATING_STATE)

    def take_control_word(self, text: str) -> None:
        """C0135; without a configuration for the line it is only kept."""
        if self.follows_line():
            super().take_control_word(text)
        else:
            self._unheeded = int(text[1:], 16)

    def read_control_word(self) -> str:
        """C0135; one that is only kept reads as written."""
        return super().read_control_word() if self.follows_line() else word_text(self._unheeded)

    def power_cycle(self, now_s: float, off_s: float | None = None) -> None:
        """Switch off and on; the module has lost the control word too."""
        self._unheeded = 0
        super().power_cycle(now_s, off_s)

    def stop_wanted(self) -> bool:
        """Quick stop by the line, or by terminal E1 where the configuration has it there."""
        by_terminal = self.params.text(5) == "1011" and not self.terminal_e1
        return bool(self.control & QSP) or by_terminal

    def jog(self) -> int:
        """Which fixed setpoint the control word chooses, 0 for none. Source: EDB2102EN 8.2."""
        function = self.configuration()
        if function == _TORQUE:
            return self.control >> 14
        return 0 if function in _CASCADES else self.control & JOG_BITS

    def setpoint(self) -> float:
        """JOG or C0141, in min-1. Source: EDB2102EN 8.2, C0135, C0141."""
        if not self.follows_line():
            return self.terminal_rpm
        if self.control & RFG_STOP:
            return self.motor.speed
        if self.control & RFG_ZERO:
            return 0.0
        greatest = self.params.number(11)
        jog = self.jog()
        if jog:
            return self.params.number(39, jog) / 100.0 * greatest
        percent = self.params.number(141)
        if self.configuration() == _TORQUE:
            # A torque and no load: the motor goes up to its greatest speed.
            return greatest * ((percent > 0) - (percent < 0))
        return percent / 100.0 * greatest

    def ramp(self) -> tuple[float, float, float, float]:
        """C0011 in min-1, C0012 and C0013 or the further ramps that bits choose, C0105."""
        number = self.params.number
        further = self.further_ramp()
        up_s = number(102, further) if further else number(12)
        down_s = number(103, further) if further else number(13)
        return number(11), up_s, down_s, number(105)

    def further_ramp(self) -> int:
        """T_i1.. by bits 14 and 15 of C0135, 0 for C0012 and C0013. Source: EDB2102EN 8.2."""
        function = self.configuration()
        if function in (_TORQUE, *_CASCADES) or not self.follows_line():
            return 0
        return self.control >> 14 if function == _SPEED else self.control >> 15

    def think_s(self, number: int, *, write: bool, now_s: float) -> float:
        """Source: EDB2102EN 3.4."""
        return 0.030 if number == 68 else 0.020

    # Words

    def operating_status(self) -> int:
        """C0068: its free bits show bits of C0150. Source: EDB2102EN 8.2."""
        bits = tens_digit(self.fault) | int(self.comm_error) << 4
        flags = {8: not self.inhibited(), 11: not self.pulses_off(), 14: self.at_setpoint(),
                 15: bool(self.fault)}  # fmt: skip
        return bits | word_of(flags)

    def status_word(self) -> int:
        """C0150 by signal configuration. Source: EDB2102EN 8.2."""
        flags = {
            0: True,
            1: self.pulses_off(),
            4: self.at_setpoint(),
            6: self.motor.speed == 0.0,
            7: self.inhibited(),
            12: bool(self.troubles.warning),
            13: bool(self.troubles.message),
            15: not (self.fault or self.troubles.message),
        }
        if self.configuration() in (_SPEED, _TORQUE):
            flags[5] = abs(self.motor.speed) <= 50.0
        elif self.configuration() in _CASCADES:
            # NOT1-OUT: the torque limit is not reached.
            flags[3] = True
        return self.controller_state() << 8 | word_of(flags)
