"""The SMVector with its RS-485 LECOM module: parameter Pnnn is code 1000 + nnn.

Strategy: P420 decides what the network may do, stops excepted; P425 and P426 are its watchdog and
survive a power cycle, since they are drive parameters.

Source: CMVLC401A 4.1, 4.2, 7.2, 7.3, 8.1 (table 9), 9.1.

Must not live here: anything of the 2102 module.
"""

from __future__ import annotations

from typing import ClassVar, Final

from lecombus.simulator.model import INHIBIT, JOG_BITS, QSP, REVERSE, Model, word_text
from lecombus.simulator.parameters import CommError, ExtendedFault, Kept, Refusal, Spec, d, h, s

__all__ = ["F_NF1", "SMVector"]

F_NF1: Final = 36
"""Network time-out, F.nF1. Source: CMVLC401A 9.1."""

_NET: Final = Kept.PROCESS

_SPECS: Final[tuple[Spec, ...]] = (
    d(37, "20", (0, 500), decimals=1),
    d(38, "30", (0, 500), decimals=1),
    d(39, "40", (0, 500), decimals=1),
    d(40, "0", (0, 1), kept=_NET),
    d(43, "0", (0, 1), kept=_NET),
    d(46, "0"),
    d(50, "0"),
    h(68, "H0000"),
    h(135, "H0000", writable=True),
    d(140, "0", (0, 500), decimals=1, kept=_NET),
    h(150, "H0000"),
    s(200, "33SSSMD-M_14000"),
    s(201, "2008-10-18"),
    d(248, "0", (0, 255), kept=_NET),
    d(249, "0", (0, 24), kept=_NET),
    d(1050, "0", (0, 1), kept=_NET),
    d(1055, "0", (0, 100), decimals=1, kept=_NET),
    d(1060, "20", (0, 500), decimals=1),
    d(1061, "0", (0, 500), decimals=1, kept=_NET),
    *(d(number, "0") for number in range(1070, 1075)),
    d(1080, "100", (0, 400), decimals=1),
    d(1081, "0", (0, 400), decimals=1, kept=_NET),
    d(1099, "4.1"),
    d(1100, "1", (0, 6)),
    d(1101, "0", (0, 6)),
    d(1102, "0", (0, 500), decimals=1),
    d(1103, "60", ("7.5", 500), decimals=1),
    d(1104, "20", (0, 3600), decimals=1),
    d(1105, "20", (0, 3600), decimals=1),
    d(1111, "0", (0, 3)),
    d(1112, "0", (0, 1)),
    d(1131, "20", (0, 500), decimals=1),
    d(1400, "7", (0, 7)),
    d(1401, "1.2"),
    d(1402, "3"),
    d(1403, "0", (0, 1), kept=_NET),
    d(1404, "3", (0, 3)),
    d(1405, "0"),
    d(1410, "1", (1, 99)),
    d(1411, "0", (0, 4)),
    d(1420, "3", (0, 4)),
    d(1424, "0", (0, 1)),
    d(1425, "50", (0, 65000)),
    d(1426, "0", (0, 3)),
    d(1427, "0"),
    d(1494, "1.20"),
    *(d(1500, "0", subcode=n) for n in range(9)),
    d(1501, "410"),
    d(1502, "25"),
    d(1505, "320"),
    d(1506, "230"),
    d(1507, "40"),
    d(1508, "0"),
    d(1527, "0"),
    h(1530, "H0000"),
    d(1540, "1204"),
    d(1541, "5321"),
)


class SMVector(Model):
    """An SMVector.

    Attributes:
        messages: P427: valid network messages, 0..9999, then from 0 again.
    """

    family: ClassVar[str] = "smvector"
    address_code: ClassVar[int] = 1410
    baud_code: ClassVar[int] = 1411

    def __init__(self) -> None:
        self.messages = 0
        super().__init__(_SPECS)

    def _install(self) -> None:
        self.readers |= {
            40: lambda _: "0" if self.control & INHIBIT else "1",
            43: lambda _: "0",
            46: lambda _: self.frequency_text(self.setpoint()),
            50: lambda _: self.frequency_text(abs(self.motor.output)),
            68: lambda _: word_text(self.operating_status()),
            135: lambda _: word_text(self.control),
            150: lambda _: word_text(self.status_word()),
            1405: lambda _: "1" if self.fault == F_NF1 else "0",
            1427: lambda _: str(self.messages),
            1500: self._fault_memory,
            1508: lambda _: "1.8" if self.motor.output else "0",
            1527: lambda _: self.frequency_text(abs(self.motor.output)),
        }
        self.writers |= {
            40: self.take_inhibit,
            43: lambda text: self.reset_fault() if text == "1" else None,
            135: self.take_control_word,
            140: lambda text: self._command(140, 1061, text),
            1061: lambda text: self._command(1061, 140, text),
        }

    def start_word(self) -> int:
        """P424: 0 quick stop, 1 inhibit. Source: CMVLC401A 4.2."""
        self.messages = 0
        return INHIBIT if self.params.text(1424) == "1" else QSP

    def feed(self, now_s: float) -> None:
        """A valid message feeds the watchdog and counts. Source: CMVLC401A 4.2, 7.3."""
        super().feed(now_s)
        self.messages = (self.messages + 1) % 10000

    def power_cycle(self, now_s: float, off_s: float | None = None) -> None:
        """Switch off and on; the message counter starts from 0."""
        super().power_cycle(now_s, off_s)
        self.messages = 0

    def _command(self, number: int, other: int, text: str) -> None:
        """C0140 and C1061 both command the frequency: whichever is written last."""
        self.params.set(other, text)
        if number == 140 and text == "0" and self.params.text(1420) == "4":
            self.control |= QSP

    def _fault_memory(self, subcode: int) -> str:
        """P500, eight faults, newest first; subcode 0 stands for 1. Source: CMVLC401A 9.1."""
        place = max(0, subcode - 1)
        return str(self.faults[place]) if place < len(self.faults) else "0"

    def watchdog_setting(self) -> tuple[float, int]:
        """P425 and P426. Source: CMVLC401A 7.3."""
        return self.params.number(1425) / 1000.0, int(self.params.text(1426))

    def expire(self, action: int) -> None:
        """1 inhibit, 2 quick stop, 3 trip F.nF1. Source: CMVLC401A 7.3.3."""
        if action == 3:
            self.trip(F_NF1)
        else:
            self.control |= INHIBIT if action == 1 else QSP

    def may_write(self, spec: Spec, text: str) -> None:
        """P420: 1 parameters, 2 setpoint, 3 control too; stops always. Source: CMVLC401A 4.2."""
        level = int(self.params.text(1420))
        if spec.number in (40, 43, 135):
            needed = 0 if self._stops(spec.number, text) else 3
        elif spec.number in (140, 1061):
            needed = 2
        else:
            needed = 0 if spec.number in (248, 249) else 1
        # P420 itself can be raised only at the keypad: with level 0 nothing may be programmed.
        if level < needed:
            raise Refusal(CommError.NO_ACCESS, ExtendedFault.OPERATING_MODE)

    def _stops(self, number: int, text: str) -> bool:
        if number == 40:
            return text == "0"
        return number == 135 and bool(int(text[1:], 16) & (QSP | INHIBIT))

    def setpoint(self) -> float:
        """JOG or the network's frequency command. Source: CMVLC401A table 9, C0135."""
        jog = self.control & JOG_BITS
        value = self.params.number(36 + jog) if jog else self.params.number(1061)
        return -value if self.control & REVERSE else value

    def ramp(self) -> tuple[float, float, float, float]:
        """P103, P104, P105; a quick stop uses P105."""
        number = self.params.number
        return number(1103), number(1104), number(1105), number(1105)

    def think_s(self, number: int, *, write: bool, now_s: float) -> float:
        """The manual gives none: 20 ms stands in, as for the other drives of its time."""
        return 0.020

    def operating_status(self) -> int:
        """C0068. Source: CMVLC401A table 9."""
        bits = (self.fault // 10 & 0xF) | int(self.comm_error) << 4
        flags = {
            8: int(self.params.text(1420)) >= 3,
            9: self.motor.output != 0.0,
            10: self.motor.speed < 0 or bool(self.control & REVERSE),
            11: self.motor.powered,
            12: bool(self.control & QSP),
            14: self.motor.powered and self.motor.speed == self.motor.target,
            15: bool(self.fault),
        }
        return bits | sum(1 << bit for bit, on in flags.items() if on)

    def status_word(self) -> int:
        """C0150; bit 1 as the LECOM manual has it, "energised". Source: CMVLC401A table 9."""
        flags = {
            1: self.motor.powered,
            4: self.motor.powered and self.motor.speed == self.motor.target,
            5: self.motor.output != 0.0,
            6: self.motor.output == 0.0,
            7: bool(self.control & INHIBIT),
            8: bool(self.fault),
            14: self.motor.speed < 0 or bool(self.control & REVERSE),
            15: not self.fault,
        }
        return sum(1 << bit for bit, on in flags.items() if on)
