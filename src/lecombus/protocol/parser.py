"""Parsers: bytes in, in any split, events out.

Strategy: parse by position, one character at a time. A telegram's first character decides what it
is, then come a code field of known length, the value, ETX and the BCC; no character is ever
searched for, since `?`, `H`, `O` and `S` begin code fields (C150, C240, C310, C350) as well as
values, and a BCC may look like any control character. Nothing raises on bytes: what is wrong
becomes a `BadAnswer` or `BadRequest` that says why. Every buffer is bounded.

An answer mostly arrives whole, in one call. `AnswerParser` then looks at its fixed places at once
(`_whole`), which is several times faster. That path decides nothing by itself: it only takes what
`fits_field`, `bcc` and `Value.parse` take, gives up in every doubt, and the tests hold it equal
to the other path for every split.

All bytes handed back (`received`, `pending`, `tail`) are as they came, parity included. When an
answer may begin and when it is too late is not known here: see `line`.
"""

from __future__ import annotations

from typing import Final

from lecombus.protocol.addressing import field_length, fits_field, is_code_field
from lecombus.protocol.controls import (
    ACK,
    ENQ,
    EOT,
    ETX,
    NAK,
    STX,
    bcc,
    strip_parity,
    with_parity,
)
from lecombus.protocol.telegrams import (
    AckAnswer,
    Answer,
    BadAnswer,
    BadRequest,
    Fault,
    HostRequest,
    NakAnswer,
    ReadRequest,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
    WriteRequest,
)
from lecombus.protocol.timing import MAX_ANSWER_CHARS
from lecombus.protocol.values import HIGHEST_VALUE_CHARS, Value, ValueFormatError

__all__ = ["TAIL_LIMIT", "AnswerParser", "RequestParser", "strip_parity", "with_parity"]

TAIL_LIMIT: Final = 256
"""So many bytes after an answer are kept; later ones are dropped."""

_ACK_ANSWER: Final = AckAnswer()
_NAK_ANSWER: Final = NakAnswer()
_SHORTEST_VALUE_ANSWER: Final = 6  # STX C1 C2 V ETX BCC
_ERROR_MARK: Final = b"?"
_DIGITS: Final = frozenset(b"0123456789")


class _Text:
    """What stands after STX, in both directions: code field, value, ETX, BCC."""

    __slots__ = ("body", "ended", "field_chars")

    def __init__(self) -> None:
        self.body = bytearray()
        self.field_chars = 0
        self.ended = False

    def clear(self) -> None:
        """Begin a new text."""
        self.body.clear()
        self.field_chars = 0
        self.ended = False

    def take(self, char: int) -> Fault | None:
        """Take the next character before the BCC; tell what is wrong with it."""
        body = self.body
        body.append(char)
        if len(body) == 1:
            self.field_chars = field_length(char)
        if len(body) <= self.field_chars:
            return None if fits_field(body) else Fault.UNEXPECTED
        if char == ETX:
            self.ended = True
            return None
        if not 0x20 <= char < 0x7F:
            return Fault.UNEXPECTED
        return Fault.TOO_LONG if len(body) - self.field_chars > HIGHEST_VALUE_CHARS else None

    def at_value(self) -> bool:
        """Tell whether the code field is complete and no value has begun."""
        return len(self.body) == self.field_chars > 0

    @property
    def field(self) -> bytes:
        """The code field."""
        return bytes(self.body[: self.field_chars])

    @property
    def value(self) -> bytes:
        """The text between code field and ETX."""
        return bytes(self.body[self.field_chars : -1])


class AnswerParser:
    """Reads one answer of a drive, then waits for `reset`.

    Args:
        parity: True: bytes carry even parity in bit 7, which is checked and stripped. False: the
            port frames 7 bits, and a set bit 7 is a PARITY fault.
    """

    __slots__ = ("_ended", "_parity", "_raw", "_tail", "_text")

    def __init__(self, *, parity: bool = False) -> None:
        self._parity = parity
        self._raw = bytearray()
        self._tail = bytearray()
        self._text = _Text()
        self._ended = False

    def reset(self) -> None:
        """Forget everything and expect a new answer."""
        self._raw.clear()
        self._tail.clear()
        self._text.clear()
        self._ended = False

    @property
    def tail(self) -> bytes:
        """The bytes after the answer, the first `TAIL_LIMIT` of them."""
        return bytes(self._tail)

    @property
    def pending(self) -> bytes:
        """The bytes of the answer that is not complete yet; none after an answer."""
        return b"" if self._ended else bytes(self._raw)

    def feed(self, data: bytes) -> Answer | None:
        """Take the next bytes.

        Returns:
            The answer, once; None while more is needed, and for everything after the answer,
            which only extends `tail`.
        """
        if not self._ended and not self._raw:
            answer = self._whole(data)
            if answer is not None:
                self._ended = True
                return answer
        for index, byte in enumerate(data):
            if self._ended:
                self._tail += data[index : index + TAIL_LIMIT - len(self._tail)]
                return None
            answer = self._take(byte)
            if answer is not None:
                self._ended = True
                self._tail += data[index + 1 : index + 1 + TAIL_LIMIT]
                return answer
        return None

    def _whole(self, data: bytes) -> Answer | None:
        """Read an answer that is one call's data exactly; None in any doubt."""
        size = len(data)
        if size == 1:
            text, sound = strip_parity(data) if self._parity else (data, True)
            if not sound:
                return None
            return _ACK_ANSWER if text[0] == ACK else _NAK_ANSWER if text[0] == NAK else None
        if not _SHORTEST_VALUE_ANSWER <= size <= MAX_ANSWER_CHARS:
            return None
        if self._parity:
            data, sound = strip_parity(data)
            if not sound:
                return None
        if data[0] != STX or data[-2] != ETX or bcc(data[1:]):  # the BCC makes the XOR 0
            return None
        value_at = 1 + field_length(data[1])
        field = data[1:value_at]
        if not is_code_field(field):
            return None
        try:
            return ValueAnswer(field, Value.parse(data[value_at:-2]))
        except ValueFormatError:
            return None

    def _take(self, byte: int) -> Answer | None:
        """Take one byte: the rules, in their order."""
        raw = self._raw
        raw.append(byte)
        char = byte & 0x7F
        if byte.bit_count() & 1 if self._parity else byte > 0x7F:
            return BadAnswer(Fault.PARITY, bytes(raw))
        if len(raw) == 1:
            return self._begin(char)
        text = self._text
        if text.ended:
            return self._finish(char)
        if char == EOT and text.at_value():
            return UnknownCodeAnswer(text.field)
        fault = text.take(char)
        return BadAnswer(fault, bytes(raw)) if fault else None

    def _begin(self, char: int) -> Answer | None:
        if char == STX:
            return None
        if char == ACK:
            return _ACK_ANSWER
        if char == NAK:
            return _NAK_ANSWER
        return BadAnswer(Fault.UNEXPECTED, bytes(self._raw))

    def _finish(self, got: int) -> Answer:
        text = self._text
        due = bcc(text.body)
        if got != due:
            return BadAnswer(Fault.BCC, bytes(self._raw), expected_bcc=due, got_bcc=got)
        if text.value == _ERROR_MARK:
            return TransmissionErrorAnswer(text.field)
        try:
            return ValueAnswer(text.field, Value.parse(text.value))
        except ValueFormatError:
            return BadAnswer(Fault.FORMAT, bytes(self._raw))


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
        self._text = _Text()
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
            self._bad(Fault.PARITY, events)
        elif len(self._raw) == 1:
            self._bad(Fault.UNEXPECTED, events)
        elif len(self._raw) <= 3:
            self._take_address(char, events)
        else:
            self._take_text(char, events)

    def _restart(self, byte: int, events: list[HostRequest]) -> None:
        if self._text.ended:
            self._bad(Fault.BCC, events)
        elif len(self._raw) > 1:  # a bare EOT is no telegram and cuts none
            self._bad(Fault.INTERRUPTED, events)
        self._clear()
        self._raw.append(byte)

    def _take_address(self, char: int, events: list[HostRequest]) -> None:
        if char not in _DIGITS:
            self._bad(Fault.UNEXPECTED, events)
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
                self._bad(Fault.UNEXPECTED, events)
        elif fault := text.take(char):
            self._bad(fault, events)

    def _finish(self, got: int, events: list[HostRequest]) -> None:
        text = self._text
        if got != bcc(text.body):
            self._bad(Fault.BCC, events)
            return
        try:
            value = Value.parse(text.value)
        except ValueFormatError:
            self._bad(Fault.FORMAT, events)
            return
        self._good(WriteRequest(self._addressee(), text.field, value), events)

    def _addressee(self) -> int:
        assert self._address is not None, "a text begins after the address"
        return self._address

    def _good(self, request: HostRequest, events: list[HostRequest]) -> None:
        events.append(request)
        self._clear()

    def _bad(self, fault: Fault, events: list[HostRequest]) -> None:
        events.append(BadRequest(fault, bytes(self._raw), self._address))
        self._clear()
        self._skipping = True

    def _clear(self) -> None:
        self._raw.clear()
        self._text.clear()
        self._address = None
        self._writing = False
        self._skipping = False
