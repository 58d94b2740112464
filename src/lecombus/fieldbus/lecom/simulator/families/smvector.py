"""The SMVector with its RS-485 LECOM module: parameter Pnnn is code 1000 + nnn.

Strategy: the network may write once a terminal enables it and P100 allows it, and then as far as
P420 says; stops are always accepted. P425 and P426 are its watchdog and survive a power cycle,
since they are drive parameters. The manual names VH for C0068, C0135 and C0150 and VS for C0200 and
C0201; all else is a decimal number. It mentions further parameters without their limits (P100,
P103, ..): these have what such a drive commonly has.

Source: CMVLC401A 4.1, 4.2, 7.2, 7.3, 8.1 (table 9), 9.1..9.4, 10.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from typing import ClassVar, Final

from ..model import INHIBIT, JOG_BITS, QSP, REVERSE, Model, tens_digit, word_of, word_text
from ..parameters import CommError, ExtendedError, Kept, Refusal, Spec, d, h, s
from ..troubles import Kind, kinds

__all__ = ["F_NF1", "SMVector"]

F_NF1: Final = 36
"""Network time-out, F.nF1. Source: CMVLC401A 9.1."""

_OVERHEATED, _OVERVOLTAGE = 4, 6
"""F.AF and F.HF, which have bits of their own in C0150. Source: CMVLC401A 9.1, table 9."""

_LECOM: Final = "7"
_ONLINE: Final = "3"
"""P402 while module and drive talk. Source: CMVLC401A 4.1."""
_NET_ENABLE: Final = "9"
_INPUTS: Final = range(1121, 1125)
"""P121..P124: what the terminals TB-13A..D do."""

_NET: Final = Kept.PROCESS

SPECS_SMV: Final[tuple[Spec, ...]] = (
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
    d(249, "0", (0, 7), kept=_NET),
    d(1050, "0", (0, 1536), kept=_NET),
    d(1055, "0", (0, 100), decimals=1, kept=_NET),
    d(1060, "20", (0, 500), decimals=1, kept=_NET),
    d(1061, "0", (0, 500), decimals=1, kept=_NET),
    *(d(number, "0") for number in range(1070, 1075)),
    d(1080, "100", (0, 400), decimals=1, kept=_NET),
    d(1081, "0", (0, 400), decimals=1, kept=_NET),
    d(1099, "4.1"),
    d(1100, "0", (0, 6)),
    d(1101, "0", (0, 6)),
    d(1102, "0", (0, 500), decimals=1),
    d(1103, "60", ("7.5", 500), decimals=1),
    d(1104, "20", (0, 3600), decimals=1),
    d(1105, "20", (0, 3600), decimals=1),
    d(1111, "0", (0, 3)),
    d(1112, "0", (0, 1)),
    *(d(number, "0", (0, 25)) for number in range(1121, 1125)),
    d(1131, "20", (0, 500), decimals=1),
    d(1140, "0", (0, 25)),
    d(1142, "0", (0, 25)),
    d(1150, "0", (0, 9)),
    d(1194, "0"),
    d(1400, "0", (0, 7)),
    d(1401, "1.2"),
    d(1402, "0"),
    d(1403, "0", (0, 1), kept=_NET),
    d(1404, "3", (0, 3)),
    d(1405, "0"),
    d(1406, "0"),
    d(1410, "1", (1, 99)),
    d(1411, "0", (0, 4)),
    d(1420, "0", (0, 4)),
    d(1424, "0", (0, 1)),
    d(1425, "50", (0, 65000)),
    d(1426, "0", (0, 3)),
    d(1427, "0"),
    d(1494, "1.20"),
    d(1495, "0"),
    d(1498, "0"),
    d(1499, "0"),
    *(d(1500, "0", subcode=n) for n in range(9)),
    d(1501, "410"),
    d(1502, "25"),
    d(1505, "320"),
    d(1506, "230"),
    d(1507, "40"),
    d(1508, "0"),
    d(1527, "0"),
    d(1530, "0"),
    d(1531, "0"),
    d(1540, "1204"),
    d(1541, "5321"),
)

FAULTS_SMV: Final = kinds(trips=tuple(range(1, 37)))
"""Numbers of P500. Source: CMVLC401A 9.1."""

LECOM_NUMBERS: Final = {
    2: 11, 3: 12, 4: 50, 6: 1020, 7: 1030, 8: 16, 13: 91, 14: 72, 34: 61, 36: 61,
}  # fmt: skip
"""What P500's faults would be as LECOM fault numbers: short circuit, earth fault, overheating,
overvoltage, undervoltage, motor overload, external fault, memory, communication; no others.

Only 50 stands in the drive's own manual (CMVLC401A table 9, C0068), the rest are like faults of
EDB2102EN 8.2.
"""


class SMVector(Model):
    """An SMVector.

    Attributes:
        messages: P427: valid network messages, 0..9999, then from 0 again.
        network_enabled: Whether the contact at the terminal for "network enable" is closed.
        digit_of: Which number C0068 shows the tens digit of: "lecom", that of the LECOM fault
            number, as table 9 says, whose list is missing; "p500", that of P500's number; "none".
        history_form: How P500 reads: "number", as 9.1 lists it; "place", with its place in the
            history before the point, such as 1.36: 9.1 does not say that it is a whole number.
    """

    family: ClassVar[str] = "smvector"
    address_code: ClassVar[int] = 1410
    baud_code: ClassVar[int] = 1411
    start_code: ClassVar[int | None] = 1424
    watchdog_codes: ClassVar[tuple[int, ...]] = (1425, 1426)
    fault_kinds: ClassVar[Mapping[int, Kind]] = FAULTS_SMV
    commissioned: ClassVar[Mapping[int, str]] = {1121: _NET_ENABLE, 1400: _LECOM, 1420: "3"}
    kept_in_reset: ClassVar[tuple[int, ...]] = (*_INPUTS, 1400, 1420)

    def __init__(self) -> None:
        self.messages = 0
        self.network_enabled = True
        self.history_form = "number"
        super().__init__(SPECS_SMV)

    def _install(self) -> None:
        self.readers |= {
            40: lambda _: "0" if self.inhibited() else "1",
            43: lambda _: "0",
            46: lambda _: self.frequency_text(self.setpoint()),
            50: lambda _: self.frequency_text(abs(self.motor.output)),
            68: lambda _: word_text(self.operating_status()),
            135: lambda _: self.read_control_word(),
            150: lambda _: word_text(self.status_word()),
            1402: lambda _: _ONLINE,
            1405: lambda _: "1" if self.fault == F_NF1 else "0",
            1427: lambda _: str(self.messages),
            1500: self._history,
            1508: lambda _: "1.8" if self.motor.output else "0",
            1527: lambda _: self.frequency_text(abs(self.motor.output)),
            1530: lambda _: str(self._terminals()),
        }
        self.writers |= {
            40: self.take_inhibit,
            43: lambda text: self.reset_fault() if text == "1" else None,
            135: self.write_control_word,
            140: lambda text: self._command(140, 1061, text),
            1061: lambda text: self._command(1061, 140, text),
            1403: self._reset_module,
        }

    def start_word(self) -> int:
        """P424; the message counter starts from 0."""
        self.messages = 0
        return super().start_word()

    def feed(self, now_s: float) -> None:
        """A valid message feeds the watchdog and counts. Source: CMVLC401A 4.2, 7.3."""
        super().feed(now_s)
        self.messages = (self.messages + 1) % 10000

    def _command(self, number: int, other: int, text: str) -> None:
        """C0140 and C1061 both command the frequency: the one written last acts."""
        self.params.set(other, text)
        if number == 140 and text == "0" and self.params.text(1420) == "4":
            self.control |= QSP

    def take_control_word(self, text: str) -> None:
        """C0135; where the network may not control, only its stop bits count."""
        if self.level() >= 3 and self.under_network():
            super().take_control_word(text)
        else:
            self.control |= int(text[1:], 16) & (QSP | INHIBIT)

    def set_terminal(self, *, high: bool) -> None:
        """Close or open the contact at the network enable terminal. Source: CMVLC401A 7.2."""
        self.network_enabled = high

    def _history(self, subcode: int) -> str:
        """P500: without a subcode the newest. Source: CMVLC401A 9.1."""
        number = self.troubles.newest(subcode)
        return f"{max(1, subcode)}.{number}" if self.history_form == "place" else str(number)

    def _reset_module(self, text: str) -> None:
        """P403: P401..P499 back to their defaults, address and P420 too. Source: CMVLC401A 4.1."""
        if text == "1":
            others = {number for number, _ in self.params.specs if not 1401 <= number <= 1499}
            self.params.factory_reset(others)
        self.params.set(1403, "0")

    def _terminals(self) -> int:
        """P530: bits 6, 7, 8, 0 are TB-13A..D. Source: CMVLC401A 9.3."""
        places = (6, 7, 8, 0)
        closed = zip(_INPUTS, places, strict=True)
        return sum(1 << bit for number, bit in closed if self._enables(number))

    def _enables(self, number: int) -> bool:
        return self.network_enabled and self.params.text(number) == _NET_ENABLE

    def listens(self) -> bool:
        """P400: another protocol than LECOM, and nothing is heard. Source: CMVLC401A 7.1."""
        return self.params.text(1400) == _LECOM

    def expire(self, action: int) -> None:
        """As other drives, and 3 is a trip F.nF1. Source: CMVLC401A 7.3.3."""
        if action == 3:
            self.trip(F_NF1)
        else:
            super().expire(action)

    def may_write(self, spec: Spec, text: str) -> None:
        """What the network may write, and within which limits. Source: CMVLC401A 4.2, 7.2."""
        if self._stops(spec.number, text):
            return
        if self.level() < self._needed(spec.number) or not self.under_network():
            raise Refusal(CommError.NO_ACCESS, ExtendedError.OPERATING_MODE)
        if spec.number in (1060, 1061):
            self._check_speed(Decimal(text))

    def level(self) -> int:
        """P420: 0 monitor, 1 parameters, 2 setpoints too, 3 and 4 control too."""
        return int(self.params.text(1420))

    def _needed(self, number: int) -> int:
        # The two codes of addressing change nothing in the drive.
        # P420 itself can be raised only at the keypad: with level 0 nothing may be programmed.
        if number in (248, 249):
            return 0
        if number in (40, 43, 135):
            return 3
        return 2 if number in (140, 1061, 1071, 1081) else 1

    def under_network(self) -> bool:
        """A terminal enables the network, and P100 leaves control to it. Source: CMVLC401A 7.2."""
        enabled = any(self._enables(number) for number in _INPUTS)
        return enabled and self.params.text(1100) not in ("2", "5")

    def _check_speed(self, value: Decimal) -> None:
        """C1060 and C1061 lie between P102 and P103. Source: CMVLC401A table 9."""
        low, high = Decimal(self.params.text(1102)), Decimal(self.params.text(1103))
        if not low <= value <= high:
            raise Refusal(CommError.INVALID_VALUE, ExtendedError.VALUE_RANGE)

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

    def fault_digit(self) -> int:
        """Bits 0..3 of C0068: a tens digit, of a number that the manual leaves open."""
        if self.digit_of == "none":
            return 0
        number = LECOM_NUMBERS.get(self.fault, 0) if self.digit_of == "lecom" else self.fault
        return tens_digit(number)

    def operating_status(self) -> int:
        """C0068. Source: CMVLC401A table 9."""
        bits = self.fault_digit() | int(self.comm_error) << 4
        flags = {
            8: self.level() >= 3 and self.under_network(),
            9: self.motor.output != 0.0,
            10: self.reverse(),
            11: self.motor.powered,
            12: bool(self.control & QSP),
            14: self.at_setpoint(),
            15: bool(self.fault),
        }
        return bits | word_of(flags)

    def status_word(self) -> int:
        """C0150; bit 1 as the LECOM manual has it, "energised". Source: CMVLC401A table 9."""
        flags = {
            1: self.motor.powered,
            4: self.at_setpoint(),
            5: self.motor.output != 0.0,
            6: self.motor.output == 0.0,
            7: self.inhibited(),
            8: bool(self.fault),
            12: self.fault == _OVERHEATED,
            13: self.fault == _OVERVOLTAGE,
            14: self.reverse(),
            15: not self.fault,
        }
        return word_of(flags)
