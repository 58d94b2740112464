"""Late answers that may still come, and how the next request avoids being answered by one.

An answer carries no address and an acknowledgement carries nothing at all, so an answer that
comes after the master has given up on it could pass for the answer to the next question. After
every exchange that ended without its answer, the answer it would have had may still come for
`late_answer`. Until then:

* no read is sent whose answer would look the same: the other addressing form is used where the
  drive knows both (its answer repeats the form), else the read waits;
* no write is sent while an acknowledgement may still come, except a stop: it is sent
  immediately, but its acknowledgement is then not trusted;
* a NAK is not taken for a read's answer while a NAK to anything else may still come.

This module only keeps the pending answers and decides; it sends nothing and waits for nothing.
Source: EDB2102EN 8.3 (telegrams without address in the answer), 8.3.5 (time monitoring).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lecombus.fieldbus.station import Station
from lecombus.parameters import Code

from ..protocol.exchange import ACK_FIELD

__all__ = ["PendingLateReplies", "UnansweredRead"]


@dataclass(frozen=True, slots=True)
class UnansweredRead:
    """A read whose answer did not come in time.

    Args:
        station: Who was asked.
        code: For what.
        said_s: When the request had been sent.
    """

    station: Station
    code: Code
    said_s: float


class PendingLateReplies:
    """The answers that may still arrive from exchanges given up.

    Args:
        window_s: How long after giving up an answer may still come, seconds (0: none is
            ever pending; only for tests of what this module prevents).
    """

    def __init__(self, window_s: float) -> None:
        self.window_s = window_s
        self._until_s: dict[bytes, float] = {}
        self._asked: dict[bytes, UnansweredRead] = {}
        self._nak_until_s = -math.inf

    def add(self, field: bytes, now_s: float, asked: UnansweredRead | None = None) -> None:
        """Note that the answer with this code field (or `ACK_FIELD`) did not come in time."""
        if self.window_s > 0.0 and field:
            again = self.blocked_until_s(field, now_s) > now_s
            self._until_s[field] = self._nak_until_s = now_s + self.window_s
            self._asked.pop(field, None)
            if asked is not None and not again:
                self._asked[field] = asked

    def refused(self, field: bytes, now_s: float) -> None:
        """Note that a read was answered by NAK: noise may have made it, so its value may come."""
        if self.window_s > 0.0 and field != ACK_FIELD:
            self._until_s[field] = now_s + self.window_s

    def nak_may_come(self, now_s: float) -> bool:
        """Say whether an exchange given up may still be answered by NAK."""
        return now_s < self._nak_until_s

    def sole(self, field: bytes, now_s: float) -> UnansweredRead | None:
        """Return the read that a late answer belongs to, if only that one may still come.

        For measuring how late it came, and for nothing else: its value is never used.
        """
        if not self.any(now_s) or len(self._until_s) != 1 or field not in self._until_s:
            return None
        return self._asked.get(field)

    def asked(self, field: bytes, now_s: float) -> UnansweredRead | None:
        """Return the read that a late answer with this code field belongs to; None: not certain."""
        return self._asked.get(field) if self.blocked_until_s(field, now_s) > now_s else None

    def answered(self, field: bytes, now_s: float) -> None:
        """Note that an answer came: an acknowledgement may be the old, late one."""
        if field == ACK_FIELD and self.blocked_until_s(field, now_s) > now_s:
            self.add(field, now_s)

    def any(self, now_s: float) -> bool:
        """Say whether any answer may still come; those that no longer may are forgotten."""
        for field, until_s in list(self._until_s.items()):
            if until_s <= now_s:
                del self._until_s[field]
        return bool(self._until_s)

    def resolve(self, field: bytes) -> bool:
        """Note that the late answer to a read has come after all.

        An acknowledgement is never taken as resolved: noise makes a single byte too easily.

        Returns:
            Whether it could still have come.
        """
        return field != ACK_FIELD and self._until_s.pop(field, None) is not None

    def blocked_until_s(self, field: bytes, now_s: float) -> float:
        """Return when a request with this answer may be sent; `now_s` or earlier: now."""
        until = self._until_s.get(field)
        if until is None:
            return now_s
        if until <= now_s:
            del self._until_s[field]
        return until

    def __len__(self) -> int:
        return len(self._until_s)
