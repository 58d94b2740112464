"""Bytes received outside an exchange: late answers, noise, another device on the line.

They are never used as values. A complete read answer that was pending ends that wait: a request
with the same answer may be sent again. If it was the only pending one, it also measures how slow
its drive is (`drives.measured`).
"""

from __future__ import annotations

from collections.abc import Callable

from ..protocol.exchange import ACK_FIELD
from ..protocol.parser import AnswerParser
from ..protocol.telegrams import (
    BadAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from ..protocol.timing import MAX_ANSWER_CHARS
from .late_replies import PendingLateReplies, UnansweredRead

__all__ = ["UnsolicitedBytes"]


class UnsolicitedBytes:
    """Listens between exchanges.

    Args:
        late_replies: Is updated when a late answer has come.
        second: Called with the code field and time of an answer that is not missing.
    """

    def __init__(
        self,
        late_replies: PendingLateReplies,
        second: Callable[[bytes, float], None] = lambda field, now_s: None,
    ) -> None:
        self._late_replies = late_replies
        self._second = second
        self._parser = AnswerParser(parity=True)
        self._parity = True
        self.awaited: tuple[bytes, UnansweredRead] | None = (
            None  # asked last, and listened for since
        )
        self.bytes_total = 0
        self._begun_at = 0

    @property
    def parity(self) -> bool:
        """Whether bytes carry even parity in bit 7."""
        return self._parity

    @parity.setter
    def parity(self, value: bool) -> None:
        self._parity = value
        self._parser = AnswerParser(parity=value)

    def begin(self) -> None:
        """Start again: an exchange has just been given up."""
        self._begun_at = self.bytes_total
        self._parser.reset()

    @property
    def is_endless(self) -> bool:
        """Whether more has come since an exchange was given up than any answer is long."""
        return self.bytes_total - self._begun_at > MAX_ANSWER_CHARS

    def feed(self, data: bytes, now_s: float) -> bool:
        """Process unsolicited bytes.

        Args:
            data: The bytes, parity bits included.
            now_s: When they came.

        Returns:
            Whether they completed a whole old answer.
        """
        self.bytes_total += len(data)
        answer = self._parser.feed(data)
        if answer is None:
            return False
        self._parser.reset()
        if isinstance(answer, BadAnswer):
            return False
        if isinstance(answer, ValueAnswer | UnknownCodeAnswer | TransmissionErrorAnswer):
            self._measure(answer.field, now_s)
            if not self._late_replies.resolve(answer.field):
                self._second(answer.field, now_s)
        elif self._late_replies.blocked_until_s(ACK_FIELD, now_s) <= now_s:
            self._second(ACK_FIELD, now_s)
        return True

    def _measure(self, field: bytes, now_s: float) -> None:
        """Let a drive know its own slowness, where it is certain whose answer this is.

        The end of the answer is taken for its beginning: a time-out may rather be too long.
        """
        asked = self._late_replies.sole(field, now_s)
        if self.awaited is not None:  # nothing was sent since, however long ago that was
            asked = self.awaited[1] if self.awaited[0] == field else None
        if asked is not None:
            station, code = asked.station, asked.code
            late_s = now_s - asked.said_s
            station.measured.note_late(code, station.documented_s(code), late_s, now_s)
