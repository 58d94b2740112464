"""What the 82XX series shares: operating mode, setpoints, parameter sets, words.

All that moves the motor is read from the active parameter set, which bit 12 of C0135
chooses; a write to another set is acknowledged and changes nothing now (EDB2102EN 7).

Source: EDB2102EN 3.4, 6.1, 6.2.1, 6.3, 6.5, 8.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

from lecombus.fieldbus.lecom.simulator.families.module2102 import RFG_STOP, RFG_ZERO, Module2102
from lecombus.fieldbus.lecom.simulator.families.table2102 import FAULTS_82XX
from lecombus.fieldbus.lecom.simulator.model import (
    INHIBIT,
    JOG_BITS,
    QSP,
    REVERSE,
    tens_digit,
    word_of,
)
from lecombus.fieldbus.lecom.simulator.parameters import CommError, ExtendedError, Refusal, Spec
from lecombus.fieldbus.lecom.simulator.troubles import Kind

__all__ = ["Drive82XX"]

_SECOND_SET: Final = 0x1000
_OVERVOLTAGE: Final = 1020


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
