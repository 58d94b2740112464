"""How long a drive takes to answer, where that is longer than its manual says.

Of every code that is read or written the last eight attempts are kept: answered in the documented
time, answered clearly later, or not answered. A code is slow if two answers or more came late, and
late and missing ones together are more than the others. So a few answers that a disturbance delays
change nothing, a code that has become slow is found after some five attempts, and it is no longer
slow when it is answered in time again. Late ones more than a minute old are dropped at the first
answer in time: a code that is seldom read must not wait for eight of them.

The time used for a slow code is the median of the late ones, in steps of a quarter. It is never
less than the documented time and never more than ten times that (or half a second, if that is more)
or one second: a stop waits for the time-out of the exchange in progress, and that is twice as long.
For a code that is not slow costs and time-outs are exactly those of the manual.

A drive of which every measured code is slow is slow as a whole: for codes not yet measured the
least of the ratios found is used, except where the manual gives a limit.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from lecombus.parameters import Code

from .family import Family

__all__ = ["AnswerRow", "MeasuredTimes", "SlowAnswers", "manual_s", "slow_from_s"]

LATENESS_S: Final = 0.020
"""How late this computer may be: timers up to 4 ms when idle, 20 ms and more on a full box."""
ATTEMPTS: Final = 8
"""So many attempts at a code are remembered."""
LATE_LEAST: Final = 2
"""Once may be anything."""
FADE_S: Final = 60.0
"""What was late longer ago is forgotten when an answer comes in time."""
KEPT_S: Final = 7200.0
"""A code that was not asked for in so long is forgotten while the drive answers others."""
RECENT_S: Final = 10.0
JUDGED_EVERY_S: Final = 600.0
SLOW_JUDGED_EVERY_S: Final = 10.0
MOST_CODES: Final = 16
"""Codes of one drive that are remembered: of more, the slowest."""
WHOLE_CODES: Final = 2
"""So many codes, all slow, make a drive slow as a whole."""
SLOW_FACTOR: Final = 1.25
MOST_FACTOR: Final = 10.0
MOST_LEAST_S: Final = 0.5
"""So much may be reckoned with however quick the manual says a drive is: it is waited for twice as
long, and what begins to answer within a second is heard."""
MOST_S: Final = 1.0
STEP: Final = 1.25


@dataclass(frozen=True, slots=True)
class SlowAnswers:
    """What of one drive answers later than its manual says.

    Args:
        reads: Time to reckon with by code that is read, seconds.
        writes: The same by code that is written.
        ratio: What is not measured takes so many times the manual's time.
    """

    reads: Mapping[Code, float] = field(default_factory=dict)
    writes: Mapping[Code, float] = field(default_factory=dict)
    ratio: float = 1.0

    def time_s(
        self, family: Family, code: Code, *, write: bool, answer_time_s: float | None
    ) -> float | None:
        """Return the answer time to reckon with, as `read_cost` and `write_cost` take it.

        Args:
            family: The drive's family.
            code: The code.
            write: A write rather than a read.
            answer_time_s: The roster's word, seconds, which stands where nothing slower is known.
        """
        if not self.reads and not self.writes:
            return answer_time_s
        known_s = (self.writes if write else self.reads).get(code)
        times = family.answer_times.get(code.number, family.other_answer_time)
        if known_s is None and self.ratio > 1.0 and not times.is_limit:
            documented_s = manual_s(family, code, write=write, answer_time_s=answer_time_s)
            known_s = bounded(self.ratio * documented_s, documented_s)
        return answer_time_s if known_s is None else known_s


@dataclass(frozen=True, slots=True)
class AnswerRow:
    """One code of one drive: documented and measured.

    Args:
        code: The code.
        write: A write rather than a read.
        manual_s: The longest by manual or roster, seconds.
        measured_s: How long it takes, as far as measured.
        slow: It is reckoned with.
    """

    code: Code
    write: bool
    manual_s: float
    measured_s: float
    slow: bool


class _Attempts:
    """The last attempts at one code: when, and after how long it was answered."""

    __slots__ = ("_from_s", "_last", "_untimely", "_usual_s", "last_s", "manual_s")

    def __init__(self, manual_s: float, now_s: float) -> None:
        self._last: deque[tuple[float, float]] = deque(maxlen=ATTEMPTS)  # inf: not answered
        self._untimely = False  # late or missing ones are among them
        self._usual_s = 0.0  # of the answers in time, about the mean of the last
        self.last_s = now_s
        self.take_manual(manual_s)

    def take_manual(self, manual_s: float) -> None:
        """Compare with another time from now on: roster or family changed."""
        self.manual_s = manual_s
        self._from_s = slow_from_s(manual_s)

    def note(self, time_s: float, now_s: float) -> bool:
        """Take an answer; say whether that may have changed what counts."""
        self.last_s = now_s
        self._last.append((now_s, time_s))
        if time_s > self._from_s:
            self._untimely = True
            return True
        share = 1.0 / ATTEMPTS if self._usual_s else 1.0
        self._usual_s += share * (time_s - self._usual_s)
        if not self._untimely:
            return len(self._last) <= LATE_LEAST
        kept = [one for one in self._last if one[1] <= self._from_s or one[0] >= now_s - FADE_S]
        self._last = deque(kept, maxlen=ATTEMPTS)
        self._untimely = any(one[1] > self._from_s for one in self._last)
        return True

    def note_missing(self, now_s: float) -> None:
        """Take an attempt without an answer; it takes the place of no late one."""
        last = self._last
        if len(last) == ATTEMPTS:
            given_up = next((one for one in last if not self._from_s < one[1] < math.inf), None)
            if given_up is None:
                return
            last.remove(given_up)
        last.append((now_s, math.inf))
        self._untimely = True

    def withdraw_missing(self) -> None:
        """Forget that the last attempt was not answered: its answer has come late."""
        if self._last and self._last[-1][1] == math.inf:
            self._last.pop()

    def is_past(self, now_s: float, *, recovered: bool) -> bool:
        """Return whether the code was not used for a while, and its slowness is probably over.

        That is so if the last answer came in time, or if another code that was slow has `recovered`
        just now: as a rule they were late together. One slow by itself is soon learnt again.
        """
        in_time = self._last[-1][1] <= self._from_s
        return now_s - self.last_s > RECENT_S and (in_time or recovered)

    @property
    def answers(self) -> int:
        """How many of them were answered."""
        count = len(self._last)
        if not self._untimely:  # a missing answer is untimely; most drives miss none
            return count
        return count - [time_s for _, time_s in self._last].count(math.inf)

    @property
    def is_slow(self) -> bool:
        """Return whether it takes clearly more than the manual's time, as a rule."""
        untimely = [time_s for _, time_s in self._last if time_s > self._from_s]
        late = len(untimely) - untimely.count(math.inf)
        return late >= LATE_LEAST and 2 * len(untimely) > len(self._last)

    @property
    def time_s(self) -> float:
        """How long it takes: the median of what was late, if it is slow; 0: never answered."""
        if not self.is_slow:
            return self._usual_s
        untimely = sorted(time_s for _, time_s in self._last if time_s > self._from_s)
        late = [time_s for time_s in untimely if time_s < math.inf]
        return late[min((len(untimely) - 1) // 2, len(late) - 1)]


class MeasuredTimes:
    """The answer times of one drive.

    Args:
        latency_s: What the adapter may add to an answer, seconds: it is taken off.
    """

    def __init__(self, latency_s: float = 0.0) -> None:
        self.slow = SlowAnswers()
        self._latency_s = latency_s
        self._codes: dict[tuple[Code, bool], _Attempts] = {}
        self._judge_at_s = 0.0

    def note(
        self, code: Code, documented_s: float, thought_s: float, now_s: float, *, write: bool
    ) -> None:
        """Take the time from the end of a request to the first byte of its answer.

        Args:
            code: The code.
            documented_s: The longest by manual or roster, seconds (`manual_s`).
            thought_s: The time measured, seconds.
            now_s: When that was.
            write: A write rather than a read.
        """
        attempts = self._codes.get((code, write))
        time_s = max(thought_s - self._latency_s, 0.0)
        if attempts is None:
            if not self._has_room(time_s / documented_s):
                return
            attempts = self._codes[code, write] = _Attempts(documented_s, now_s)
        elif attempts.manual_s != documented_s:
            attempts.take_manual(documented_s)
        if attempts.note(time_s, now_s) or now_s > self._judge_at_s:
            self._judge(now_s)

    def missed(self, code: Code, now_s: float, *, write: bool) -> None:
        """Record that a code was not answered: no byte came."""
        attempts = self._codes.get((code, write))
        if attempts is not None:
            attempts.note_missing(now_s)
            self._judge(now_s)

    def answered_s(self, code: Code) -> float | None:
        """Return when a read of a code was last answered; None: not remembered."""
        attempts = self._codes.get((code, False))
        return None if attempts is None else attempts.last_s

    def note_late(self, code: Code, documented_s: float, thought_s: float, now_s: float) -> None:
        """Take a read's answer that came after it was given up: it was too slow in any case."""
        least_s = 1.001 * slow_from_s(documented_s) + self._latency_s
        attempts = self._codes.get((code, False))
        if attempts is not None:
            attempts.withdraw_missing()
        self.note(code, documented_s, max(thought_s, least_s), now_s, write=False)

    def forget(self) -> None:
        """Forget all that was measured."""
        self._codes.clear()
        self.slow = SlowAnswers()

    def rows(self) -> list[AnswerRow]:
        """Return what was measured, the slowest first."""
        rows = [
            AnswerRow(code, write, one.manual_s, one.time_s, one.is_slow)
            for (code, write), one in self._codes.items()
            if one.time_s > 0.0
        ]
        return sorted(rows, key=lambda row: row.manual_s / row.measured_s)

    def _has_room(self, ratio: float) -> bool:
        """Make room for a code if it is slower than the quickest of those that are remembered."""
        if len(self._codes) < MOST_CODES:
            return True
        quickest = min(self._codes, key=lambda key: _ratio(self._codes[key]))
        if _ratio(self._codes[quickest]) >= ratio:
            return False
        del self._codes[quickest]
        return True

    def _judge(self, now_s: float) -> None:
        for key in [key for key, one in self._codes.items() if now_s - one.last_s > KEPT_S]:
            del self._codes[key]
        measured = {key: one for key, one in self._codes.items() if one.answers >= LATE_LEAST}
        slow = {key: one for key, one in measured.items() if one.is_slow}
        self._judge_at_s = now_s + JUDGED_EVERY_S
        if not slow and not self.slow.reads and not self.slow.writes:
            return
        was_slow = {(code, False) for code in self.slow.reads}
        recovered = any(key in was_slow and key not in slow for key in measured)
        for key in [key for key, one in slow.items() if one.is_past(now_s, recovered=recovered)]:
            del slow[key], measured[key], self._codes[key]
        whole = len(slow) == len(measured) >= WHOLE_CODES
        found = SlowAnswers(
            reads={code: _used_s(one) for (code, write), one in slow.items() if not write},
            writes={code: _used_s(one) for (code, write), one in slow.items() if write},
            ratio=min(map(_ratio, slow.values())) if whole else 1.0,
        )
        if found != self.slow:
            self.slow = found
        if slow:
            self._judge_at_s = now_s + SLOW_JUDGED_EVERY_S


def manual_s(family: Family, code: Code, *, write: bool, answer_time_s: float | None) -> float:
    """Return the longest answer time by manual and roster, seconds."""
    own = code.number in family.answer_times
    if answer_time_s is not None and not own:
        return answer_time_s
    return max(family.longest_answer_time_s(code, write=write), answer_time_s or 0.0)


def slow_from_s(documented_s: float) -> float:
    """Return from when on an answer is clearly later than documented, seconds."""
    return SLOW_FACTOR * documented_s + LATENESS_S


def bounded(time_s: float, documented_s: float) -> float:
    """Round a time up by steps; limit it to the documented time and the most, seconds."""
    steps = math.ceil(round(math.log(max(time_s, 0.001) / 0.001, STEP), 6))
    most_s = max(documented_s, min(max(MOST_FACTOR * documented_s, MOST_LEAST_S), MOST_S))
    return float(min(max(round(0.001 * STEP**steps, 6), documented_s), most_s))


def _used_s(one: _Attempts) -> float:
    return bounded(one.time_s, one.manual_s)


def _ratio(one: _Attempts) -> float:
    return one.time_s / one.manual_s
