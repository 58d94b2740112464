"""Whether recurring work fits on a line, and how long one piece of it may have to wait.

An exchange cannot be interrupted, so this is non-preemptive scheduling. Two classical results are
used, and nothing of them is simplified:

* *Demand bound.* Streams that each need `cost_s` of line time once in every `every_s`, by the end
  of it, served by earliest deadline and never cut, fit if in every stretch of time t the work that
  must be over within t, and one longer exchange begun just before it, take no longer than t.
  If that is exceeded for some t, no order of telegrams can hold the streams.
  Source: K. Jeffay, D. Stanat, C. Martel: On Non-Preemptive Scheduling of Periodic and Sporadic
  Tasks, RTSS 1991; L. George, N. Rivierre, M. Spuri: Preemptive and Non-Preemptive Real-Time
  Uniprocessor Scheduling, INRIA RR-2966, 1996.
* *Response time.* A piece of work waits for the exchange under way and for all work of higher
  classes that comes while it waits; the smallest fixed point of that sum bounds its wait.
  Source: the same report, section 3; N. Audsley et al.: Applying New Scheduling Theory to Static
  Priority Pre-emptive Scheduling, 1993.

Pure numbers: no drive, no code and no clock here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

__all__ = ["Overload", "Stream", "find_overload", "load_of", "response_s"]

ROUNDING_S: Final = 1e-9
FULL: Final = 1.0 - 1e-9
"""A load this close to all of the line: the stretch to look at would be endless."""
MOST_PIECES: Final = 2000
"""Pieces of one stream looked at: a watchdog of 50 ms beside one of 65 s has 1300."""
OVERLOADED_PERIODS: Final = 50
"""Of the slowest stream: within these an overload of two in a hundred shows."""
LONGEST_S: Final = 86_400.0
"""A wait of a day is not a useful bound."""


@dataclass(frozen=True, slots=True)
class Stream:
    """Work that comes again and again.

    Args:
        name: Whose it is, for messages.
        cost_s: Line time of one piece, seconds, > 0.
        every_s: It is needed once in each stretch of this length, seconds, > 0.
        blocked_s: What may go before it once and is nothing of these streams, seconds.
    """

    name: str
    cost_s: float
    every_s: float
    blocked_s: float = 0.0

    def before(self, t_s: float) -> float:
        """Give the work that must be over within a stretch of this length, seconds."""
        return math.floor((t_s + ROUNDING_S) / self.every_s) * self.cost_s

    def coming(self, t_s: float) -> float:
        """Give the most work that can come within a stretch of this length, seconds."""
        return (math.floor((t_s + ROUNDING_S) / self.every_s) + 1) * self.cost_s


@dataclass(frozen=True, slots=True)
class Overload:
    """A stretch of time that would have to hold more work than it is long.

    Args:
        within_s: Its length, seconds.
        demand_s: The work that must be over within it, seconds.
        blocking_s: The exchange that may have begun just before, seconds.
        whose: The stream whose deadline ends it.
    """

    within_s: float
    demand_s: float
    blocking_s: float
    whose: str


def load_of(streams: Iterable[Stream]) -> float:
    """Give the share of the line that streams take in the long run; above 1 they cannot fit."""
    return sum(stream.cost_s / stream.every_s for stream in streams)


def find_overload(streams: Sequence[Stream], blocking_s: float) -> Overload | None:
    """Find the first stretch of time that would have to hold too much; None: the streams fit.

    Args:
        streams: The work.
        blocking_s: The longest exchange that may be under way when a stretch begins, seconds,
            before any stream, besides what may come before that one alone; an exchange of
            another stream that need not be over yet counts by itself.
    """
    ordered = sorted(streams, key=_every)
    longest_later_s = _longest_later(ordered)
    ends = _ends(ordered, blocking_s)
    demand_s, reached, at, count = 0.0, 0, 0, len(ends)
    while at < count:
        t_s, number = ends[at]
        last = ordered[number]
        while at < count and ends[at][0] <= t_s + ROUNDING_S:  # in any order: all before each
            one = ordered[ends[at][1]]
            demand_s += one.cost_s
            if one.blocked_s > last.blocked_s:
                last = one
            at += 1
        while reached < len(ordered) and ordered[reached].every_s <= t_s + ROUNDING_S:
            reached += 1
        before_s = max(blocking_s + last.blocked_s, longest_later_s[reached])
        if demand_s + before_s > t_s + ROUNDING_S:
            return Overload(t_s, sum(one.before(t_s) for one in ordered), before_s, last.name)
    return None


def _longest_later(ordered: Sequence[Stream]) -> list[float]:
    """Give, for each stream and the end, the longest piece of those from there on."""
    longest_s = [0.0]
    for stream in reversed(ordered):
        longest_s.append(max(longest_s[-1], stream.cost_s))
    return longest_s[::-1]


def _ends(ordered: Sequence[Stream], blocking_s: float) -> list[tuple[float, int]]:
    """Give the end of every piece of every stream in order, as far as a look is needed.

    Beyond the horizon demand grows by less than time does, so a stretch there can hold its work
    if all shorter ones can. Streams that take all of the line have none, and are found out soon.
    """
    load = load_of(ordered)
    most_s = max((stream.blocked_s for stream in ordered), default=0.0)
    blocked_s = max((blocking_s + most_s, *(stream.cost_s for stream in ordered)))
    horizon_s = ordered[-1].every_s if ordered else 0.0
    if load < FULL:
        horizon_s = max(horizon_s, blocked_s / (1.0 - load))
    else:
        horizon_s = horizon_s * OVERLOADED_PERIODS
    found: list[tuple[float, int]] = []
    for number, stream in enumerate(ordered):
        pieces = min(int(horizon_s / stream.every_s) + 1, MOST_PIECES)
        found.extend((stream.every_s * piece, number) for piece in range(1, pieces + 1))
    found.sort()
    return found


def response_s(
    own_s: float, blocking_s: float, above: Sequence[Stream], *, most_s: float = LONGEST_S
) -> float:
    """Bound the time from a request to the end of its exchange, seconds.

    Args:
        own_s: Its own line time.
        blocking_s: What can be under way or go ahead once, of any class; less what of the
            work above does not come the first time.
        above: The work that goes first whenever it is there.
        most_s: Give up beyond this.

    Returns:
        The bound; infinity where the work above leaves no room, or none within `most_s`.
    """
    if load_of(above) > FULL:
        return math.inf
    wait_s = max(blocking_s, 0.0)
    while wait_s <= most_s:
        again_s = blocking_s + sum(stream.coming(wait_s) for stream in above)
        if again_s <= wait_s + ROUNDING_S:
            return again_s + own_s
        wait_s = again_s
    return math.inf


def _every(stream: Stream) -> float:
    return stream.every_s
