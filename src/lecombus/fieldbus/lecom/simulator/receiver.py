"""What the drives hear: characters of the host turned into requests, by position.

Strategy: one listener for the whole line, since all drives hear the same characters. A new EOT
restarts it anywhere except where a BCC stands, which may look like an EOT. Characters with bad
parity are kept with a mark, because where the damage lies decides what a drive does: a damaged
address or ENQ gets no answer, a damaged code of a read by `?`, a damaged write by NAK
(EDB2102EN 8.3.1, 8.3.2, 8.3.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from functools import lru_cache
from typing import Final

from .wire import ENQ, EOT, ETX, PARITY_TABLE, STX, bcc

__all__ = ["ReceivedRequest", "RequestReceiver"]

_LONGEST: Final = 1 + 7 + 241 + 2
"""STX, an extended code field, 240 characters of value with their letter, ETX and BCC."""


@dataclass(frozen=True, slots=True)
class ReceivedRequest:
    """One request as the drives understood it.

    Attributes:
        address: 0..99; a multiple of ten is a group.
        field: The code field as received, parity stripped.
        text: The value of a write; None for a read.
        damaged: A character had bad parity, or the block check is wrong.
    """

    address: int
    field: bytes
    text: str | None
    damaged: bool


class _Place(Enum):
    IDLE = auto()
    TENS = auto()
    ONES = auto()
    FIRST = auto()
    READ = auto()
    WRITE = auto()
    BCC = auto()


class RequestReceiver:
    """Turns the host's characters into requests.

    Args:
        parity: Whether bytes carry even parity in bit 7; otherwise bit 7 set is damage.
    """

    def __init__(self, *, parity: bool) -> None:
        self._parity = parity
        self._place = _Place.IDLE
        self._address = 0
        self._body = bytearray()
        self._damaged = False
        self.started = False
        """Whether the character fed last was an EOT that began a telegram."""
        self.cut_short: int | None = None
        """The address of an unfinished write that this EOT cut short, if it did."""

    def whole(self, data: bytes) -> ReceivedRequest | None:
        """Say what these characters are if nothing comes between them: one request, or not (None).

        The listener's state is left as it is, which is where a whole request leaves it, too.
        """
        return _whole(data, self._parity) if self._place is _Place.IDLE else None

    def feed(self, byte: int) -> ReceivedRequest | None:
        """Take one character (0..255); give the request it completes, if it does."""
        char = byte & 0x7F
        good = byte == (PARITY_TABLE[char] if self._parity else char)
        self.started = False
        if char == EOT and good and self._place is not _Place.BCC:
            self._start()
            return None
        return self._step(char, good)

    def _start(self) -> None:
        unfinished = self._place is _Place.WRITE
        self.cut_short = self._address if unfinished else None
        self._place = _Place.TENS
        self._address = 0
        self._body.clear()
        self._damaged = False
        self.started = True

    def _step(self, char: int, good: bool) -> ReceivedRequest | None:
        place = self._place
        if place is _Place.IDLE:
            return None
        if place is _Place.TENS or place is _Place.ONES:
            self._take_address(char, good)
            return None
        if place is _Place.FIRST and char == STX:
            self._place = _Place.WRITE
            self._damaged |= not good
            return None
        if place is _Place.BCC:
            return self._end_write(char, good)
        if place is _Place.WRITE:
            self._take_text(char, good)
            return None
        return self._take_code(char, good)

    def _take_address(self, char: int, good: bool) -> None:
        if not (good and 48 <= char <= 57):
            self._place = _Place.IDLE
            return
        self._address = self._address * 10 + char - 48
        self._place = _Place.ONES if self._place is _Place.TENS else _Place.FIRST

    def _take_text(self, char: int, good: bool) -> None:
        self._damaged |= not good
        self._body.append(char)
        if char == ETX:
            self._place = _Place.BCC
        elif len(self._body) > _LONGEST:
            self._place = _Place.IDLE

    def _take_code(self, char: int, good: bool) -> ReceivedRequest | None:
        self._place = _Place.READ
        body = self._body
        wanted = 7 if body[:1] == b"!" else 2
        if len(body) < wanted:
            body.append(char)
            self._damaged |= not good
            return None
        self._place = _Place.IDLE
        if char != ENQ or not good:
            return None
        return ReceivedRequest(self._address, bytes(body), None, self._damaged)

    def _end_write(self, char: int, good: bool) -> ReceivedRequest:
        self._place = _Place.IDLE
        body = bytes(self._body)
        damaged = self._damaged or not good or bcc(body) != char
        length = 7 if body[:1] == b"!" else 2
        text = body[length:-1].decode("ascii")
        return ReceivedRequest(self._address, body[:length], text, damaged)


@lru_cache(maxsize=4096)
def _whole(data: bytes, parity: bool) -> ReceivedRequest | None:
    """Process a telegram in one step: one EOT, in front, and the last byte ends the request."""
    listener = RequestReceiver(parity=parity)
    heard: ReceivedRequest | None = None
    for place, byte in enumerate(data):
        if heard is not None:
            return None
        heard = listener.feed(byte)
        if listener.started != (place == 0):
            return None
    return heard
