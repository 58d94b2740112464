"""The 93XX behind a 2102 module: a servo that counts in rotations and keeps its sets in RAM.

Strategy: speeds are min-1, C0011 is the greatest; the setpoint is C0141 in %, the free control code
(basic configuration C0005 = 1001). Parameters live in RAM until C0003 saves them.

Source: EDB2102EN 3.4, 6.1.3, 8.2.

Must not live here: the 82XX words.
"""

from __future__ import annotations

from typing import ClassVar, Final

from lecombus.simulator.families.module2102 import MODULE_SPECS, Module2102
from lecombus.simulator.model import INHIBIT, JOG_BITS
from lecombus.simulator.parameters import (
    CommError,
    ExtendedFault,
    Kept,
    Refusal,
    Spec,
    d,
    h,
    s,
)

__all__ = ["Drive93XX"]

_RAM: Final = Kept.MEMORY

_SPECS: Final[tuple[Spec, ...]] = (
    *MODULE_SPECS,
    d(3, "0", (0, 4), kept=Kept.PROCESS),
    d(5, "1001", (0, 72000), kept=_RAM),
    d(9, "1", (1, 99)),
    d(11, "3000", (500, 16000), kept=_RAM),
    d(12, "2", (0, 9999), decimals=3, kept=_RAM),
    d(13, "2", (0, 9999), decimals=3, kept=_RAM),
    *(d(39, "10", (-200, 200), subcode=n, decimals=2, kept=_RAM) for n in range(1, 16)),
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
    *(d(102, "2", (0, 9999), subcode=n, decimals=3, kept=_RAM) for n in range(1, 4)),
    *(d(103, "2", (0, 9999), subcode=n, decimals=3, kept=_RAM) for n in range(1, 4)),
    d(105, "2", (0, 9999), decimals=3, kept=_RAM),
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


class Drive93XX(Module2102):
    """A 9300 servo inverter."""

    family: ClassVar[str] = "93xx"

    def __init__(self) -> None:
        super().__init__(_SPECS)

    def _install(self) -> None:
        super()._install()
        self.readers |= {
            46: lambda _: self.params.text(141),
            50: lambda _: self.frequency_text(self.motor.output / self.params.number(11) * 100, 2),
            51: lambda _: self.frequency_text(self.motor.speed, 0),
            54: lambda _: "2.1" if self.motor.output else "0",
            67: self._fault_memory,
            161: self._fault_memory,
            168: self._fault_memory,
        }
        self.writers[3] = lambda text: self.params.save() if text != "0" else None

    def _fault_memory(self, subcode: int) -> str:
        """Subcode 1 is the active fault, 2 and up the history; 0 stands for 1."""
        if subcode <= 1:
            return str(self.fault)
        return str(self.faults[subcode - 2]) if subcode - 2 < len(self.faults) else "0"

    def may_write(self, spec: Spec, text: str) -> None:
        """C0005 is written only while inhibited."""
        if spec.number == 5 and not self.control & INHIBIT:
            raise Refusal(CommError.NO_ACCESS, ExtendedFault.OPERATING_STATE)

    def setpoint(self) -> float:
        """JOG or C0141, in min-1. Source: EDB2102EN 8.2, C0135, C0141."""
        jog = self.control & JOG_BITS
        percent = self.params.number(39, jog) if jog else self.params.number(141)
        return percent / 100.0 * self.params.number(11)

    def ramp(self) -> tuple[float, float, float, float]:
        """C0011 in min-1, C0012, C0013, C0105."""
        number = self.params.number
        return number(11), number(12), number(13), number(105)

    def think_s(self, number: int, *, write: bool, now_s: float) -> float:
        """Source: EDB2102EN 3.4."""
        return 0.030 if number == 68 else 0.020

    def operating_status(self) -> int:
        """C0068. Source: EDB2102EN 8.2."""
        enabled = not self.control & INHIBIT and not self.fault
        bits = (self.fault // 10 & 0xF) | int(self.comm_error) << 4
        flags = {
            8: not self.control & INHIBIT,
            11: enabled,
            14: self.motor.powered and self.motor.speed == self.motor.target,
            15: bool(self.fault),
        }
        return bits | sum(1 << bit for bit, on in flags.items() if on)

    def status_word(self) -> int:
        """C0150 of C0005 = 1xx1. Source: EDB2102EN 8.2."""
        state = 8 if self.fault else 3 if self.control & INHIBIT else 6
        flags = {
            0: True,
            1: bool(self.control & INHIBIT or self.fault),
            4: self.motor.powered and self.motor.speed == self.motor.target,
            5: abs(self.motor.speed) <= 50.0,
            6: self.motor.speed == 0.0,
            7: bool(self.control & INHIBIT),
            15: not self.fault,
        }
        return state << 8 | sum(1 << bit for bit, on in flags.items() if on)
