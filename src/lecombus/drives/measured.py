"""How long a drive really thinks, where that is longer than its manual says.

Strategy: of every code that is read or written, the two longest answers of this window and of the
one before are kept, and the second longest counts: once may be this computer. What is not clearly
slower than the manual changes nothing, so that costs and time-outs of ordinary drives are those of
the manual to the digit. What is slower is reckoned with from then on, in steps of a quarter, never
with less than the manual's time and never with more than ten times that (or half a second, if that
is more) or one second: a stop waits for the time-out of what is under way, and that is twice as
long.

A drive of which every code that was measured is slow is slow as a whole: codes not yet measured are
reckoned with by the least of the ratios found, except where the manual tells the most it can be.

What must not live here: where measures come from (`line`), what is said about them (`supervision`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from lecombus.protocol.addressing import Code

from .costs import LATENESS_S
from .family import Family

__all__ = ["AnswerRow", "MeasuredTimes", "SlowAnswers", "manual_s"]

WINDOW_S: Final = 600.0
KEPT_S: Final = 7200.0
"""A code that was not asked for in so long is forgotten while the drive answers others."""
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
        """Give the answer time to reckon with, as `read_cost` and `write_cost` take it.

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
            told_s = manual_s(family, code, write=write, answer_time_s=answer_time_s)
            known_s = bounded(self.ratio * told_s, told_s)
        return answer_time_s if known_s is None else known_s


@dataclass(frozen=True, slots=True)
class AnswerRow:
    """One code of one drive: told and measured.

    Args:
        code: The code.
        write: A write rather than a read.
        manual_s: The longest that manual or roster tell, seconds.
        measured_s: The second longest measured.
        slow: It is reckoned with.
    """

    code: Code
    write: bool
    manual_s: float
    measured_s: float
    slow: bool


class _Longest:
    """The two longest answers of this window and of the one before."""

    __slots__ = ("_before", "_began_s", "_now", "last_s", "manual_s")

    def __init__(self, manual_s: float, now_s: float) -> None:
        self.manual_s = manual_s
        self._began_s = self.last_s = now_s
        self._now = self._before = (0.0, 0.0)

    def note(self, time_s: float, now_s: float) -> bool:
        """Take an answer; say whether that may have changed what counts."""
        self.last_s = now_s
        changed = now_s - self._began_s >= WINDOW_S
        if changed:
            self._before, self._now, self._began_s = self._now, (0.0, 0.0), now_s
        first_s, second_s = self._now
        if time_s > second_s:
            self._now = (time_s, first_s) if time_s > first_s else (first_s, time_s)
            changed = True
        return changed

    @property
    def time_s(self) -> float:
        """The second longest; 0: there were not two yet."""
        return sorted((*self._now, *self._before))[-2]

    @property
    def is_slow(self) -> bool:
        """Whether that is clearly more than the manual's time."""
        return self.time_s > slow_from_s(self.manual_s)


class MeasuredTimes:
    """The answer times of one drive.

    Args:
        latency_s: What the adapter may add to an answer, seconds: it is taken off.
    """

    def __init__(self, latency_s: float = 0.0) -> None:
        self.slow = SlowAnswers()
        self._latency_s = latency_s
        self._codes: dict[tuple[Code, bool], _Longest] = {}

    def note(
        self, code: Code, told_s: float, thought_s: float, now_s: float, *, write: bool
    ) -> None:
        """Take the time from the end of a request to the first byte of its answer.

        Args:
            code: The code.
            told_s: The longest that manual or roster tell, seconds (`manual_s`).
            thought_s: The time measured, seconds.
            now_s: When that was.
            write: A write rather than a read.
        """
        longest = self._codes.get((code, write))
        time_s = max(thought_s - self._latency_s, 0.0)
        if longest is None:
            if not self._has_room(time_s / told_s):
                return
            longest = self._codes[code, write] = _Longest(told_s, now_s)
        elif longest.manual_s != told_s:
            longest.manual_s = told_s
        if longest.note(time_s, now_s):
            self._judge(now_s)

    def answered_s(self, code: Code) -> float | None:
        """Tell when a read of a code was last answered; None: not remembered."""
        longest = self._codes.get((code, False))
        return None if longest is None else longest.last_s

    def note_late(self, code: Code, told_s: float, thought_s: float, now_s: float) -> None:
        """Take a read's answer that came after it was given up: it was too slow in any case."""
        least_s = 1.001 * slow_from_s(told_s) + self._latency_s
        self.note(code, told_s, max(thought_s, least_s), now_s, write=False)

    def rows(self) -> list[AnswerRow]:
        """Give what was measured, the slowest first."""
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
        measured = {key: one for key, one in self._codes.items() if one.time_s > 0.0}
        slow = {key: one for key, one in measured.items() if one.is_slow}
        if not slow and not self.slow.reads and not self.slow.writes:
            return
        whole = len(slow) == len(measured) >= WHOLE_CODES
        found = SlowAnswers(
            reads={code: _used_s(one) for (code, write), one in slow.items() if not write},
            writes={code: _used_s(one) for (code, write), one in slow.items() if write},
            ratio=min(map(_ratio, slow.values())) if whole else 1.0,
        )
        if found != self.slow:
            self.slow = found


def manual_s(family: Family, code: Code, *, write: bool, answer_time_s: float | None) -> float:
    """Give the longest answer time that manual and roster tell, seconds."""
    own = code.number in family.answer_times
    if answer_time_s is not None and not own:
        return answer_time_s
    return max(family.longest_answer_time_s(code, write=write), answer_time_s or 0.0)


def slow_from_s(told_s: float) -> float:
    """Give from when on an answer is clearly later than told, seconds."""
    return SLOW_FACTOR * told_s + LATENESS_S


def bounded(time_s: float, told_s: float) -> float:
    """Round a time up by steps and keep it between what is told and the most, seconds."""
    steps = math.ceil(round(math.log(max(time_s, 0.001) / 0.001, STEP), 6))
    most_s = max(told_s, min(max(MOST_FACTOR * told_s, MOST_LEAST_S), MOST_S))
    return float(min(max(round(0.001 * STEP**steps, 6), told_s), most_s))


def _used_s(one: _Longest) -> float:
    return bounded(one.time_s, one.manual_s)


def _ratio(one: _Longest) -> float:
    return one.time_s / one.manual_s
