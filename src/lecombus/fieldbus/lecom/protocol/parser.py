"""The parser for answers: bytes in, in any split, one event out.

Strategy: parse by position, one character at a time. A telegram's first character decides what it
is, then come a code field of known length, the value, ETX and the BCC; no character is ever
searched for, since `?`, `H`, `O` and `S` begin code fields (C150, C240, C310, C350) as well as
values, and a BCC may look like any control character. Nothing raises on bytes: what is wrong
becomes a `BadAnswer` that says why. Every buffer is bounded.

An answer mostly arrives whole, in one call. `AnswerParser` then checks its fixed positions directly
(`_whole`), which is several times faster. That path decides nothing by itself: it only takes what
`fits_field`, `bcc` and `Value.parse` take, gives up in every doubt, and the tests hold it equal
to the other path for every split. What it made of bytes is kept, since drives answer the same
things again and again, and the same bytes always mean the same.

All bytes handed back (`received`, `pending`, `tail`) are as they came, parity included. When an
answer may begin and when it is too late is not known here: see `exchange`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from lecombus.fieldbus.lecom.protocol.addressing import field_length, is_code_field
from lecombus.fieldbus.lecom.protocol.controls import (
    ACK,
    EOT,
    ETX,
    NAK,
    STX,
    bcc,
    strip_parity,
    with_parity,
)
from lecombus.fieldbus.lecom.protocol.host_parser import RequestParser
from lecombus.fieldbus.lecom.protocol.telegrams import (
    MAX_ANSWER_CHARS,
    AckAnswer,
    Answer,
    BadAnswer,
    NakAnswer,
    TelegramFault,
    TelegramText,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from lecombus.parameters import Value, ValueFormatError

__all__ = ["TAIL_LIMIT", "AnswerParser", "RequestParser", "strip_parity", "with_parity"]

TAIL_LIMIT: Final = 256
"""So many bytes after an answer are kept; later ones are dropped."""

CACHED_ANSWERS: Final = 2048
"""What ninety drives say: a dozen codes each, and of a word that changes the last few states."""

_ACK_ANSWER: Final = AckAnswer()
_NAK_ANSWER: Final = NakAnswer()
_SHORTEST_VALUE_ANSWER: Final = 6  # STX C1 C2 V ETX BCC
_ERROR_MARK: Final = b"?"


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
        self._text = TelegramText()
        self._ended = False

    def reset(self) -> None:
        """Forget everything and expect a new answer."""
        self._ended = False
        if self._raw:
            self._raw.clear()
            self._text.clear()
        if self._tail:
            self._tail.clear()

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
            answer = _whole(data, self._parity) if len(data) <= MAX_ANSWER_CHARS else None
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

    def _take(self, byte: int) -> Answer | None:
        """Take one byte: the rules, in their order."""
        raw = self._raw
        raw.append(byte)
        char = byte & 0x7F
        if byte.bit_count() & 1 if self._parity else byte > 0x7F:
            return BadAnswer(TelegramFault.PARITY, bytes(raw))
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
        return BadAnswer(TelegramFault.UNEXPECTED, bytes(self._raw))

    def _finish(self, got: int) -> Answer:
        text = self._text
        due = bcc(text.body)
        if got != due:
            return BadAnswer(TelegramFault.BCC, bytes(self._raw), expected_bcc=due, got_bcc=got)
        if text.value == _ERROR_MARK:
            return TransmissionErrorAnswer(text.field)
        try:
            return ValueAnswer(text.field, Value.parse(text.value))
        except ValueFormatError:
            return BadAnswer(TelegramFault.FORMAT, bytes(self._raw))


@lru_cache(maxsize=CACHED_ANSWERS)
def _whole(data: bytes, parity: bool) -> Answer | None:
    """Read an answer that is one call's data exactly; None in any doubt."""
    sound = True
    if parity:
        data, sound = strip_parity(data)
    if not sound:
        return None
    if len(data) == 1:
        return _ACK_ANSWER if data[0] == ACK else _NAK_ANSWER if data[0] == NAK else None
    if len(data) < _SHORTEST_VALUE_ANSWER:
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
