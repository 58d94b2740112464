"""Answers that come late or twice, and how none is taken for the answer to another request.

An answer carries no address and an acknowledgement carries nothing at all, so an answer that
comes after the master has given up on it could pass for the answer to the next question. After
every exchange that ended without its answer, the answer it would have had may still come for
`late_answer`. Until then:

* no read is sent whose answer would look the same: the other addressing form is used where the
  drive knows both (its answer repeats the form), else the read waits;
* no write is sent while an acknowledgement may still come, except a stop: it is sent
  immediately, but its acknowledgement is then not trusted;
* a NAK is not taken for a read's answer while a NAK to anything else may still come.

Time without a port does not count: a device server may hold an answer back while nobody is
connected, and deliver it after the next connection.

A second answer is not missing, and nothing waits for it. Where answers are delivered twice, or two
drives have one address, it comes when another drive may have been asked for the same, and passes
for its own. It is only known that such answers come, and how long ago another drive was asked for
an answer that looks the same (`Duplicates`); `read_back_proof` derives from both how many answers a
verification needs.

Where answers come later than `late_answer`, what verifies a stop or a write waits for them as long
as for a second answer (`Duplicates.late_until_s`). Before the first of them has come nothing waits:
it takes more answers than other drives have left out (`Duplicates.left_out`).

This module only keeps the answers and decides; it sends nothing and waits for nothing.
Source: EDB2102EN 8.3 (telegrams without address in the answer), 8.3.5 (time monitoring).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from lecombus.fieldbus.loop_interface import SecondAnswerCount
from lecombus.fieldbus.requests import Station
from lecombus.parameters import Code

from ..protocol.exchange import ACK_FIELD

__all__ = ["COPY_S", "DOUBTED_S", "Duplicates", "PendingLateAnswers", "UnansweredRead"]


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


class PendingLateAnswers:
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

    def port_lost(self, now_s: float) -> None:
        """Keep all that may still come until a port is open again."""
        if self.any(now_s):
            self._until_s = dict.fromkeys(self._until_s, math.inf)
        if self.nak_may_come(now_s):
            self._nak_until_s = math.inf
        self._asked.clear()  # how late they come then says nothing about a drive

    def port_opened(self, now_s: float) -> None:
        """Begin the time of what was kept since the port was lost."""
        until_s = now_s + self.window_s
        self._until_s = {field: min(at_s, until_s) for field, at_s in self._until_s.items()}
        self._nak_until_s = min(self._nak_until_s, until_s)

    def any(self, now_s: float) -> bool:
        """Say whether any answer may still come; those that no longer may are forgotten."""
        for field, until_s in list(self._until_s.items()):
            if until_s <= now_s:
                del self._until_s[field]
        return bool(self._until_s)

    def resolve(self, field: bytes, now_s: float) -> bool:
        """Note that the late answer to a read has come after all.

        An acknowledgement is never taken as resolved: noise makes a single byte too easily.

        Returns:
            Whether it could still have come.
        """
        return field != ACK_FIELD and self._until_s.pop(field, now_s) > now_s

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


COPY_S: Final = 3.0
"""A second answer may come so long after the first, and a late one after its time-out, seconds."""

LATE_MARGIN_S: Final = 1.0
"""Whether an answer is late or second is judged with so much more, seconds."""

MOST_MORE: Final = 20
"""So many answers of one kind decide that the next are of this kind: each of the other kind counts
one less."""

DOUBTED_S: Final = 50.0
"""For this long after a second answer, a single answer does not verify anything, seconds. A minute
after a disturbance writes take no longer than before it; its last second answer may come late."""

COUNTED_S: Final = 60.0
"""For this long second answers are counted, seconds."""

LATELY_S: Final = 0.3
LATELY_CHARS: Final = 40
"""So long after the question the second of two drives at one address has answered, at most: seconds
and characters."""


class Duplicates:
    """Keeps from which drive each answer was requested, and the answers without a request.

    Answers are distinguished by their code field (`protocol.exchange.Ask.field`).

    Args:
        char_s: The time of a character, seconds.

    Attributes:
        came_once: A second answer has come on this line at any time.
    """

    def __init__(self, char_s: float = 0.0) -> None:
        self.came_once = False
        self._lately_s = LATELY_S + LATELY_CHARS * char_s
        self._last: dict[bytes, tuple[str, float]] = {}
        self._other: dict[bytes, float] = {}  # when it was asked last of another than `_last`
        self._ended: dict[bytes, float] = {}  # when the last such exchange ended
        self._other_ended: dict[bytes, float] = {}
        self._lately: deque[tuple[float, bytes, str]] = deque()
        self._unanswered: deque[tuple[float, bytes, str]] = deque()  # for `COPY_S`
        self._now_s = -math.inf
        self._told_apart_from_s = -math.inf
        self._late_more = 0  # how many more came that may be late than second ones
        self._late_s = -math.inf  # when one came last that is later than `late_answer`
        self._second: deque[tuple[float, Collection[str]]] = deque(maxlen=1000)
        self._asked_s: dict[str, float] = {}  # by drive that answers: when it was asked last

    def asked(self, field: bytes, drive: str, at_s: float) -> None:
        """Note that a drive is asked for an answer that looks like this."""
        self._now_s = at_s
        last = self._last.get(field)
        if last is not None and last[0] != drive:
            self._other[field] = last[1]
            self._other_ended[field] = self._ended.get(field, last[1])
        self._last[field] = (drive, at_s)
        self._asked_s[drive] = at_s
        self._lately.append((at_s, field, drive))
        while self._lately[0][0] < at_s - self._lately_s:
            self._lately.popleft()
        while self._unanswered and self._unanswered[0][0] < at_s - COPY_S - LATE_MARGIN_S:
            self._unanswered.popleft()

    def ended(self, field: bytes, at_s: float) -> None:
        """Note that the exchange with the drive that was asked last for this has ended.

        Needed once a second answer has come.
        """
        self._ended[field] = at_s

    def unanswered(self, field: bytes, drive: str, at_s: float) -> None:
        """Note that a drive's answer that looks like this did not come in time."""
        self._now_s = at_s
        self._asked_s.pop(drive, None)
        self._unanswered.append((at_s, field, drive))

    def late_came(self, field: bytes) -> None:
        """Note that a late answer has come.

        Where several drives have not answered, it is not known whose it is: all stay missing.
        """
        missing = [one for one in self._unanswered if one[1] == field]
        if len({name for _, _, name in missing}) == 1:
            self._unanswered.remove(missing[0])

    @property
    def answers_late(self) -> bool:
        """Whether an answer came later than `late_answer` within `DOUBTED_S`."""
        return self._now_s - self._late_s < DOUBTED_S

    def late_until_s(self, field: bytes, drive: str) -> float:
        """Return until when another drive's late answer may look like this; minus infinity: none.

        The time is that of the last thing noted. None may where none came late for `DOUBTED_S`.
        """
        if not self.answers_late:
            return -math.inf
        of_others = [at_s for at_s, one, name in self._unanswered if one == field and name != drive]
        until_s = max(of_others, default=-math.inf) + COPY_S
        return until_s if until_s > self._now_s else -math.inf

    def left_out(self, field: bytes, drive: str) -> int:
        """Count the answers that look like this and that other drives owe, `COPY_S` back.

        Each may still come once. The time is that of the last thing noted. None are counted where
        it is known that answers come late, or twice: what verifies anything is chosen otherwise
        then.
        """
        if not self._unanswered or (self._late_more and self.is_doubtful):
            return 0
        since_s = self._now_s - COPY_S
        return sum(one == field and name != drive and at_s > since_s
                   for at_s, one, name in self._unanswered)  # fmt: skip

    def opened(self, now_s: float) -> None:
        """A port was opened: what comes soon may be late, though nothing was asked for."""
        self._told_apart_from_s = now_s + COPY_S + LATE_MARGIN_S

    def other_ended_s(self, field: bytes, drive: str) -> float:
        """Return when an exchange of another drive with such an answer ended; minus infinity: none.

        No such exchange may be under way.
        """
        last = self._last.get(field)
        ended = self._ended if last is not None and last[0] != drive else self._other_ended
        return max(ended.get(field, float("-inf")), self.other_s(field, drive))

    def other_s(self, field: bytes, drive: str) -> float:
        """Return when another drive was last asked for such an answer; minus infinity: never."""
        last = self._last.get(field)
        if last is not None and last[0] != drive:
            return last[1]
        return self._other.get(field, float("-inf"))

    def may_be_anothers(self, field: bytes, drive: str, asked_s: float) -> bool:
        """Whether an answer that a drive was asked for may be the second one of another drive."""
        return self.doubtful(asked_s) and asked_s - self.other_s(field, drive) < COPY_S

    def came(self, field: bytes, at_s: float) -> None:
        """Record an answer without an open request.

        It is a second one if all drives have answered. If one has not, it may be late, and is taken
        for that where more such ones come than second ones.
        """
        self.came_once = True
        whose = {name for asked_s, one, name in self._lately
                 if one == field and asked_s >= at_s - self._lately_s}  # fmt: skip
        if not self.doubtful(at_s):
            self._late_more = 0
        if at_s >= self._told_apart_from_s:
            self._tell_apart(field, at_s)
        self._second.append((at_s, whose))

    def _tell_apart(self, field: bytes, at_s: float) -> None:
        """Judge whether late answers come, or second ones: whichever are more."""
        since_s = at_s - COPY_S - LATE_MARGIN_S
        missing = any(one == field and one_s > since_s for one_s, one, _ in self._unanswered)
        more = self._late_more + (1 if missing else -1)
        self._late_more = max(-MOST_MORE, min(MOST_MORE, more))
        if missing:
            self._now_s = self._late_s = at_s
            self.late_came(field)
        if self._late_more <= 0:
            self._late_s = -math.inf

    def doubtful(self, now_s: float) -> bool:
        """Whether a single answer may be another drive's: a second answer came lately."""
        return bool(self._second) and now_s - self._second[-1][0] < DOUBTED_S

    @property
    def is_doubtful(self) -> bool:
        """`doubtful` at the time of the last thing noted."""
        return self.doubtful(self._now_s)

    def found(self, now_s: float) -> SecondAnswerCount:
        """Count the second answers of the last minute."""
        while self._second and now_s - self._second[0][0] >= COUNTED_S:
            self._second.popleft()
        drives = sum(now_s - at_s < COUNTED_S for at_s in self._asked_s.values())
        return SecondAnswerCount([whose for _, whose in self._second], drives)
