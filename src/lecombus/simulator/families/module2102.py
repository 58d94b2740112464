"""Drives behind a 2102 fieldbus module: what the module itself adds, and the 82XX words.

Strategy: `Module2102` holds the module's codes and watchdog, `Drive82XX` the control and status
words that the 82XX series shares; the families differ in a few methods.

Source: EDB2102EN 3.4 (processing times), 6.2..6.5, 8.2.

Must not live here: the 93XX, which has its own words.
"""

from __future__ import annotations

from typing import ClassVar, Final

from lecombus.simulator.model import INHIBIT, JOG_BITS, QSP, REVERSE, Model, word_text
from lecombus.simulator.parameters import CommError, ExtendedFault, Kept, Refusal, Spec, d, h, s

__all__ = ["MODULE_SPECS", "SPECS_82XX", "Drive82XX", "Module2102"]

MODULE_SPECS: Final[tuple[Spec, ...]] = (
    d(248, "0", (0, 255), kept=Kept.MODULE),
    d(249, "0", (0, 24), kept=Kept.MODULE),
    s(1810, "33S2102I_10000"),
    s(1811, "2000-05-02"),
    d(1920, "0", (0, 1), kept=Kept.MODULE),
    d(1921, "0", (0, 1), kept=Kept.MODULE),
    d(1922, "0", (0, 2), kept=Kept.MODULE),
    d(1923, "3000", (50, 65535), kept=Kept.MODULE),
    d(1962, "0"),
)
"""The module's own codes. The manual prints no default for C1923; 3000 ms stands in."""

SPECS_82XX: Final[tuple[Spec, ...]] = (
    *MODULE_SPECS,
    d(1, "3", (0, 3), sets=True),
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
)


class Module2102(Model):
    """A drive whose watchdog and start state live in a 2102 module."""

    def start_word(self) -> int:
        """C1920: 0 quick stop, 1 controller inhibit. Source: EDB2102EN 6.3.1."""
        return INHIBIT if self.params.text(1920) == "1" else QSP

    def watchdog_setting(self) -> tuple[float, int]:
        """C1923 and C1922. Source: EDB2102EN 6.3.3."""
        return self.params.number(1923) / 1000.0, int(self.params.text(1922))

    def expire(self, action: int) -> None:
        """1 controller inhibit, 2 quick stop. Source: EDB2102EN 6.3.3."""
        self.control |= INHIBIT if action == 1 else QSP

    def _install(self) -> None:
        self.readers |= {
            40: lambda _: "0" if self.control & INHIBIT else "1",
            43: lambda _: "1" if self.fault else "0",
            68: lambda _: word_text(self.operating_status()),
            135: lambda _: word_text(self.control),
            150: lambda _: word_text(self.status_word()),
            1962: lambda _: str(int(self.extended_fault)),
        }
        self.writers |= {
            40: self.take_inhibit,
            43: lambda _: self.reset_fault(),
            135: self.take_control_word,
        }

    def operating_status(self) -> int:
        """C0068 of the family."""
        raise NotImplementedError

    def status_word(self) -> int:
        """C0150 of the family."""
        raise NotImplementedError

    def shortened(self) -> bool:
        """Whether writes are acknowledged before they are done (C1921)."""
        return self.params.text(1921) == "1"


class Drive82XX(Module2102):
    """What 820X, 821X, 822X, 824X and 8200 vector share.

    Attributes:
        shortened_s: How long the module must be left alone after a shortened response.
    """

    shortened_s: ClassVar[float] = 0.050
    set_count: ClassVar[int] = 2

    def _install(self) -> None:
        super()._install()
        self.readers |= {
            50: lambda _: self.frequency_text(abs(self.motor.output)),
            52: lambda _: self.frequency_text(abs(self.motor.output) * 8.0, 0),
            54: lambda _: "1.4" if self.motor.output else "0",
            56: lambda _: "35" if self.motor.output else "0",
        }
        for place in range(4):
            self.readers[161 + place] = lambda _, n=place: (  # type: ignore[misc]
                str(self.faults[n]) if n < len(self.faults) else "0"
            )

    def may_write(self, spec: Spec, text: str) -> None:
        """C0046 and C0135 want C0001 = 3. Source: EDB2102EN 5, 6.2.1, 7."""
        if spec.number not in (46, 135):
            return
        mode = self.params.text(1)
        if mode != "3" and not (mode == "1" and spec.number == 46):
            raise Refusal(CommError.NO_ACCESS, ExtendedFault.OPERATING_MODE)
        if spec.number == 46 and self.normalized():
            raise Refusal(CommError.NO_ACCESS, ExtendedFault.READ_ONLY)

    def normalized(self) -> bool:
        """C0127: the setpoint is C0141 in % of C0011. Source: EDB2102EN 6.5."""
        return self.params.text(127) == "1"

    def setpoint(self) -> float:
        """JOG, C0141 or C0046 by the control word. Source: EDB2102EN 8.2, C0135."""
        jog = self.control & JOG_BITS
        if jog:
            value = self.params.number(36 + jog)
        elif self.normalized():
            value = self.params.number(141) / 100.0 * self.params.number(11)
        else:
            value = self.params.number(46)
        return -value if self.control & REVERSE else value

    def ramp(self) -> tuple[float, float, float, float]:
        """C0011, C0012, C0013, C0105."""
        number = self.params.number
        return number(11), number(12), number(13), number(105)

    def think_s(self, number: int, *, write: bool, now_s: float) -> float:
        """Source: EDB2102EN 3.4 (table "Processing time in the controller"), 6.3."""
        if 1920 <= number <= 1923:
            return 0.500
        if number == 68:
            return 0.030
        right_after = write and now_s - self._last_write_s < 0.100 and number not in (46, 135)
        return 0.050 if right_after else 0.020

    # Words

    def reached(self) -> bool:
        """Whether the actual frequency is the setpoint."""
        return self.motor.powered and self.motor.speed == self.motor.target

    def below_threshold(self) -> bool:
        """Qmin: the actual frequency is at or below C0017."""
        return abs(self.motor.output) <= self.params.number(17)

    def operating_status(self) -> int:
        """C0068. Source: EDB2102EN 8.2."""
        enabled = not self.control & INHIBIT and not self.fault
        bits = (self.fault // 10 & 0xF) | int(self.comm_error) << 4
        flags = {
            8: not self.control & INHIBIT,
            9: self.below_threshold(),
            10: self.motor.speed < 0 or bool(self.control & REVERSE),
            11: enabled,
            12: bool(self.control & QSP),
            14: self.reached(),
            15: bool(self.fault),
        }
        return bits | sum(1 << bit for bit, on in flags.items() if on)

    def controller_state(self) -> int:
        """Bits 8..11 of C0150 of 821X, 822X, 8200 vector. Source: EDB2102EN 8.2."""
        if self.fault:
            return 8
        return 3 if self.control & INHIBIT else 6

    def status_word(self) -> int:
        """C0150 of 821X, 822X, 8200 vector. Source: EDB2102EN 8.2."""
        flags = {
            1: bool(self.control & INHIBIT or self.fault),
            3: self.reached(),
            4: self.reached(),
            5: self.below_threshold(),
            6: self.motor.output == 0.0,
            7: bool(self.control & INHIBIT),
            14: self.motor.speed < 0 or bool(self.control & REVERSE),
            15: not self.fault,
        }
        return self.controller_state() << 8 | sum(1 << bit for bit, on in flags.items() if on)
