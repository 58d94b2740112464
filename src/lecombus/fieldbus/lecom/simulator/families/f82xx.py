"""The 82XX families: 820X with its peculiarities, 821X, 822X, 824X and the 8200 vector.

All that moves the motor is read from the active parameter set, which bit 12 of C0135
chooses; a write to another set is acknowledged and changes nothing now (EDB2102EN 7).

Source: EDB2102EN 3.4, 5, 6, 8.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

from ..model import INHIBIT, JOG_BITS, QSP, REVERSE, Restart, tens_digit, word_of
from ..parameters import CommError, ExtendedError, Kept, Refusal, Spec, d, h, s
from ..troubles import Kind, kinds
from .module2102 import MODULE_SPECS, RFG_STOP, RFG_ZERO, Module2102

__all__ = ["Drive82XX", "Drive820X", "Drive821X", "Drive822X", "Drive824X", "Vector8200"]

_SECOND_SET: Final = 0x1000
_OVERVOLTAGE: Final = 1020

SPECS_82XX: Final[tuple[Spec, ...]] = (
    *MODULE_SPECS,
    d(1, "0", (0, 3), sets=True),
    d(2, "0", (0, 5)),
    d(4, "50", (0, 255)),
    d(9, "1", (1, 99)),
    d(10, "0", (0, 480), decimals=2, sets=True),
    d(11, "50", ("7.5", 480), decimals=2, sets=True),
    d(12, "5", (0, 1300), decimals=2, sets=True),
    d(13, "5", (0, 1300), decimals=2, sets=True),
    d(14, "2", (0, 4), sets=True),
    d(15, "50", ("7.5", 960), decimals=2, sets=True),
    d(16, "3", (0, 40), decimals=2, sets=True),
    d(17, "0", (0, 480), decimals=2, sets=True),
    d(18, "1", (0, 6), sets=True),
    d(19, "0", (0, 5), decimals=2, sets=True),
    d(21, "0", (0, 50), decimals=1, sets=True),
    d(22, "150", (30, 150), sets=True),
    d(23, "80", (30, 110), sets=True),
    d(37, "20", (0, 480), decimals=2, sets=True),
    d(38, "30", (0, 480), decimals=2, sets=True),
    d(39, "40", (0, 480), decimals=2, sets=True),
    d(40, "0", (0, 1), kept=Kept.PROCESS),
    d(43, "0", (0, 0), kept=Kept.PROCESS),
    d(46, "0", (0, 480), decimals=2, kept=Kept.PROCESS),
    d(50, "0"),
    d(52, "0"),
    d(53, "320"),
    d(54, "0"),
    d(56, "0"),
    d(61, "34"),
    h(68, "H0000"),
    d(93, "222"),
    d(99, "21"),
    d(105, "5", (0, 1300), decimals=2, sets=True),
    d(120, "0", (0, 100)),
    d(125, "0", (0, 4)),
    d(127, "0", (0, 1)),
    h(135, "H0000", writable=True),
    d(141, "0", (-100, 100), decimals=2, kept=Kept.PROCESS),
    h(150, "H0000"),
    d(161, "0"),
    d(162, "0"),
    d(163, "0"),
    d(164, "0"),
    d(178, "1234"),
    d(179, "5678"),
    s(201, "1999-03-17"),
    d(500, "2000", (1, 25000)),
    d(501, "10", (1, 25000)),
)

FAULTS_82XX: Final = kinds(
    trips=(
        *(11, 12, 13, 14, 15, 16, 32, 50, 53, 61, 62, 63, 64, 65, 66, 71, 72, 73, 75, 76, 77, 78),
        *(81, 85, 91, 105, 140),
    ),
    messages=(1020, 1030),
    warnings=(203,),
)
"""LECOM fault numbers of C0161..C0164. Source: EDB2102EN 8.2."""


class Drive82XX(Module2102):
    """What 820X, 821X, 822X, 824X and 8200 vector share.

    Attributes:
        shortened_s: How long the module must be left alone after a shortened response.
        terminal_hz: The setpoint at the analog terminal, for operating modes that follow it.
        choice_in_sets: C0127 stands in each parameter set; else in the first for all of them. No
            manual says which (8.2 prints it without the star of codes of set 1).
    """

    shortened_s: ClassVar[float] = 0.050
    set_count: ClassVar[int] = 2
    fault_kinds: ClassVar[Mapping[int, Kind]] = FAULTS_82XX
    commissioned: ClassVar[Mapping[int, str]] = {1: "3"}
    terminal_hz = 0.0
    choice_in_sets = False

    def _install(self) -> None:
        super()._install()
        self.readers |= {
            50: lambda _: self.frequency_text(abs(self.motor.output)),
            52: lambda _: self.frequency_text(abs(self.motor.output) * 8.0, 0),
            54: lambda _: "1.4" if self.motor.output else "0",
            56: lambda _: "35" if self.motor.output else "0",
        }
        for place in range(1, 5):
            self.readers[160 + place] = lambda _, n=place: str(self.troubles.newest(n))  # type: ignore[misc]

    def start_word(self) -> int:
        """Quick stop is only for operating mode 3. Source: EDB2102EN 5, 6.3.1."""
        word = super().start_word()
        return word if word == INHIBIT or self.mode() == 3 else 0

    def mode(self) -> int:
        """C0001 of set 1: who writes control word and setpoint. Source: EDB2102EN 6.2.1."""
        return int(self.params.text(1))

    def active_set(self) -> int:
        """The parameter set in use, from 0. Source: EDB2102EN 8.2, C0135 bit 12."""
        return 1 if self.control & _SECOND_SET else 0

    def active(self, number: int) -> float:
        """A number from the active parameter set."""
        return self.params.number(number + 2000 * self.active_set())

    def may_write(self, spec: Spec, text: str) -> None:
        """C0046 and C0135 want C0001 = 3. Source: EDB2102EN 5, 6.2.1, 7."""
        if spec.number not in (46, 135):
            return
        if self.mode() != 3 and not (self.mode() == 1 and spec.number == 46):
            raise Refusal(CommError.NO_ACCESS, ExtendedError.OPERATING_MODE)
        if spec.number == 46 and self.normalized():
            raise Refusal(CommError.NO_ACCESS, ExtendedError.READ_ONLY)

    def normalized(self) -> bool:
        """C0127: the setpoint is C0141 in % of C0011. Source: EDB2102EN 6.5."""
        number = 127 + 2000 * self.active_set() if self.choice_in_sets else 127
        return self.params.text(number) == "1"

    def put_choice_in_sets(self) -> None:
        """Be a drive with a C0127 in each parameter set."""
        self.choice_in_sets = True
        self.params.put_in_sets(127)

    def ramp_generator(self) -> bool:
        """Whether bits 4 and 5 of C0135 act on the ramp; an 820X has them reserved."""
        return True

    def setpoint(self) -> float:
        """JOG, C0141, C0046 or the terminal. Source: EDB2102EN 8.2, C0001, C0135."""
        jog = self.control & JOG_BITS
        if self.ramp_generator() and self.control & RFG_STOP:
            return self.motor.speed
        if self.ramp_generator() and self.control & RFG_ZERO:
            return 0.0
        if self.mode() in (0, 2):
            value = self.terminal_hz
        elif jog:
            value = self.active(36 + jog)
        elif self.normalized():
            value = self.params.number(141) / 100.0 * self.active(11)
        else:
            value = self.params.number(46)
        return -value if self.control & REVERSE else value

    def ramp(self) -> tuple[float, float, float, float]:
        """C0011, C0012, C0013, C0105 of the active set."""
        return self.active(11), self.active(12), self.active(13), self.active(105)

    def think_s(self, number: int, *, write: bool, now_s: float) -> float:
        """Source: EDB2102EN 3.4 (table "Processing time in the controller"), 6.3."""
        if 1920 <= number <= 1923:
            return 0.500
        if number == 68:
            return 0.030
        right_after = write and now_s - self._last_write_s < 0.100 and number not in (46, 135)
        return 0.050 if right_after else 0.020

    # Words

    def below_threshold(self) -> bool:
        """Qmin: the actual frequency is at or below C0017."""
        return abs(self.motor.output) <= self.active(17)

    def operating_status(self) -> int:
        """C0068. Source: EDB2102EN 8.2."""
        bits = tens_digit(self.fault) | int(self.comm_error) << 4
        flags = {
            8: not self.inhibited(),
            9: self.below_threshold(),
            10: self.reverse(),
            11: not self.pulses_off(),
            12: bool(self.control & QSP),
            14: self.at_setpoint(),
            15: bool(self.fault),
        }
        return bits | word_of(flags)

    def shown_message(self) -> bool:
        """Bit 13 of C0150: the DC bus has too much voltage."""
        return self.troubles.message == _OVERVOLTAGE

    def shown_warning(self) -> bool:
        """Bit 12 of C0150: the heat sink is nearly too hot; no fault number stands for it."""
        return False

    def status_word(self) -> int:
        """C0150 of 821X, 822X, 8200 vector. Source: EDB2102EN 8.2."""
        flags = {
            0: self.active_set() == 1,
            1: self.pulses_off(),
            3: self.at_setpoint(),
            4: self.at_setpoint(),
            5: self.below_threshold(),
            6: self.motor.output == 0.0,
            7: self.inhibited(),
            12: self.shown_warning(),
            13: self.shown_message(),
            14: self.reverse(),
            15: not (self.fault or self.troubles.message),
        }
        return self.controller_state() << 8 | word_of(flags)


_FREE_820X = frozenset((40, 46, 135, 141, 248, 249, 1920, 1921, 1922, 1923))


class Drive820X(Drive82XX):
    """An 820X: slow, keeps parameters only while inhibited, restarts on a TRIP reset."""

    family: ClassVar[str] = "820x"
    shortened_s: ClassVar[float] = 0.230

    def __init__(self) -> None:
        # C0120 is not available in V1.2, and C0181 comes with it. Source: EDB2102EN 6.4.1, 6.4.2.
        specs = (spec for spec in SPECS_82XX if spec.number not in (43, 120, 127, 141))
        own = (
            d(141, "0", (0, 100), decimals=2, kept=Kept.PROCESS),
            d(181, "0", (0, 80), kept=Kept.MODULE),
            s(200, "33S8201E_12000"),
        )
        super().__init__((*specs, *own))

    def _install(self) -> None:
        super()._install()
        del self.readers[43], self.writers[43]
        self.writers[141] = self._take_relative

    def _take_relative(self, text: str) -> None:
        """C0141 in % of C0011 of set 1 becomes the setpoint. Source: EDB2102EN 6.4.1."""
        hertz = float(text) / 100.0 * self.params.number(11)
        self.params.set(46, self.frequency_text(hertz, 2))

    def normalized(self) -> bool:
        """There is no C0127 here: C0141 and C0046 stand side by side."""
        return False

    def ramp_generator(self) -> bool:
        """Bits 4 and 5 of C0135 are reserved."""
        return False

    def think_s(self, number: int, *, write: bool, now_s: float) -> float:
        """Source: EDB2102EN 3.4, note 1 for C0001 = 1."""
        if 1920 <= number <= 1923:
            return 0.500
        if number == 46 and write and self.params.text(1) == "1":
            return 0.070
        if number in (46, 50, 135, 150):
            return 0.035
        if number == 68:
            return 0.070
        return 0.230 if write else 0.055

    def stores(self, spec: Spec) -> bool:
        """Parameters are acknowledged while enabled, but not saved. Source: EDB2102EN 6.4."""
        return spec.number in _FREE_820X or self.inhibited()

    def take_inhibit(self, text: str) -> None:
        """C0040; inhibit followed by enable resets a TRIP by a restart. Source: EDB2102EN 6.4."""
        before = self.control
        super().take_inhibit(text)
        self._restart_on_enable(before)

    def take_control_word(self, text: str) -> None:
        """C0135; bit 11 is reserved on an 820X."""
        before, self.control = self.control, int(text[1:], 16)
        self._restart_on_enable(before)

    def _restart_on_enable(self, before: int) -> None:
        if self.fault and before & INHIBIT and not self.control & INHIBIT:
            raise Restart

    def controller_state(self) -> int:
        """Bits 8..11: 0 no error, 1 error."""
        return 1 if self.fault else 0

    def status_word(self) -> int:
        """C0150 of an 820X: bits 0 and 3 are reserved. Source: EDB2102EN 8.2."""
        return super().status_word() & ~0x0009


class Drive821X(Drive82XX):
    """An 821X."""

    family: ClassVar[str] = "821x"
    software: ClassVar[str] = "33S8211E_20000"

    def __init__(self) -> None:
        super().__init__((*SPECS_82XX, s(200, self.software)))


class Drive822X(Drive821X):
    """An 822X."""

    family: ClassVar[str] = "822x"
    software: ClassVar[str] = "33S8221E_11000"


class Drive824X(Drive821X):
    """An 824X."""

    family: ClassVar[str] = "824x"
    software: ClassVar[str] = "33S8241E_10000"


class Vector8200(Drive82XX):
    """An 8200 vector: four parameter sets, arrays, a freely configured status word."""

    family: ClassVar[str] = "8200vector"
    set_count: ClassVar[int] = 4

    def __init__(self) -> None:
        arrays = (
            *(d(39, "40", (0, 650), subcode=n, decimals=2, sets=True) for n in range(1, 4)),
            *(d(357, "3000", (0, 65000), subcode=n) for n in range(1, 4)),
            d(370, "0", (0, 255)),
            d(599, "5", (1, 50)),
            *(d(410, "255", (0, 255), subcode=n) for n in range(1, 33)),
            *(d(412, "255", (0, 255), subcode=n) for n in range(1, 10)),
            *(d(417, "0", (0, 255), subcode=n) for n in range(1, 17)),
            *(d(421, "0", (0, 255), subcode=n) for n in range(1, 11)),
        )
        # C0127 and the setpoint C0141 are of the 821X, 822X and 824X. Source: EDB2102EN 6.5.
        specs = (spec for spec in SPECS_82XX if spec.number not in (127, 141))
        super().__init__((*specs, *arrays, s(200, "82S8212V_30000")))

    def normalized(self) -> bool:
        """There is no C0127: the setpoint is C0046."""
        return False

    def shown_message(self) -> bool:
        """Bit 13 of C0150: any message."""
        return bool(self.troubles.message)

    def shown_warning(self) -> bool:
        """Bit 12 of C0150: any warning."""
        return bool(self.troubles.warning)

    def operating_status(self) -> int:
        """C0068: bits 10 and 12 are reserved. Source: EDB2102EN 8.2."""
        return super().operating_status() & ~0x1400
