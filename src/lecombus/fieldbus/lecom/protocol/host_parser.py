"""The parser for the other direction: what a host sends, telegram after telegram.

For traces, tests and simulated drives, which see every telegram on the line and must do with an
interrupted one what a drive does: drop it. Strategy as in `parser`: by position, one character at
a time, nothing raises on bytes, every buffer is bounded. Speed does not matter here.
"""

from __future__ import annotations

from typing import Final

from lecombus.fieldbus.lecom.protocol.controls import ENQ, EOT, STX, bcc
from lecombus.fieldbus.lecom.protocol.telegrams import (
    BadRequest,
    HostRequest,
    ReadRequest,
    TelegramFault,
    TelegramText,
    WriteRequest,
)
from lecombus.parameters import Value, ValueFormatError

__all__ = ["RequestParser"]

_DIGITS: Final = frozenset(b"0123456789")


class RequestParser:
    """Reads what a host sends, telegram after telegram: for traces, tests and simulated drives.

    An EOT begins a new telegram wherever it stands, except as a BCC: after ETX it is the BCC if it
    is the right one, and otherwise a new telegram after a bad one. After a bad telegram and
    between telegrams everything up to the next EOT is skipped, and reported once.

    Args:
        parity: As for `AnswerParser`.
    """

    __slots__ = ("_address", "_parity", "_raw", "_skipping", "_text", "_writing")

    def __init__(self, *, parity: bool = False) -> None:
        self._parity = parity
        self._raw = bytearray()
        self._text = TelegramText()
        self._address: int | None = None
        self._writing = False
        self._skipping = False

    @property
    def pending(self) -> bytes:
        """The bytes of the telegram that is not complete yet."""
        return bytes(self._raw)

    def feed(self, data: bytes) -> list[HostRequest]:
        """Take the next bytes; return every telegram that became complete or bad by them."""
        events: list[HostRequest] = []
        for byte in data:
            self._take(byte, events)
        return events

    def _take(self, byte: int, events: list[HostRequest]) -> None:
        char = byte & 0x7F
        sound = not (byte.bit_count() & 1 if self._parity else byte > 0x7F)
        if char == EOT and sound and not (self._text.ended and bcc(self._text.body) == EOT):
            self._restart(byte, events)
            return
        if self._skipping:
            return
        self._raw.append(byte)
        if not sound:
            self._bad(TelegramFault.PARITY, events)
        elif len(self._raw) == 1:
            self._bad(TelegramFault.UNEXPECTED, events)
        elif len(self._raw) <= 3:
            self._take_address(char, events)
        else:
            self._take_text(char, events)

    def _restart(self, byte: int, events: list[HostRequest]) -> None:
        if self._text.ended:
            self._bad(TelegramFault.BCC, events)
        elif len(self._raw) > 1:  # a bare EOT is not a telegram and cuts none
            self._bad(TelegramFault.INTERRUPTED, events)
        self._clear()
        self._raw.append(byte)

    def _take_address(self, char: int, events: list[HostRequest]) -> None:
        if char not in _DIGITS:
            self._bad(TelegramFault.UNEXPECTED, events)
        elif len(self._raw) == 3:
            self._address = (self._raw[1] & 0x0F) * 10 + (char & 0x0F)

    def _take_text(self, char: int, events: list[HostRequest]) -> None:
        text = self._text
        if not self._writing and not text.body and char == STX:
            self._writing = True
        elif text.ended:
            self._finish(char, events)
        elif not self._writing and text.at_value():
            if char == ENQ:
                self._good(ReadRequest(self._addressee(), text.field), events)
            else:
                self._bad(TelegramFault.UNEXPECTED, events)
        elif fault := text.take(char):
            self._bad(fault, events)

    def _finish(self, got: int, events: list[HostRequest]) -> None:
        text = self._text
        if got != bcc(text.body):
            self._bad(TelegramFault.BCC, events)
            return
        try:
            value = Value.parse(text.value)
        except ValueFormatError:
            self._bad(TelegramFault.FORMAT, events)
            return
        self._good(WriteRequest(self._addressee(), text.field, value), events)

    def _addressee(self) -> int:
        assert self._address is not None, "a text begins after the address"
        return self._address

    def _good(self, request: HostRequest, events: list[HostRequest]) -> None:
        events.append(request)
        self._clear()

    def _bad(self, fault: TelegramFault, events: list[HostRequest]) -> None:
        events.append(BadRequest(fault, bytes(self._raw), self._address))
        self._clear()
        self._skipping = True

    def _clear(self) -> None:
        self._raw.clear()
        self._text.clear()
        self._address = None
        self._writing = False
        self._skipping = False
