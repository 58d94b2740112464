"""The running schedule over a roster, in no time: who would speak when.

The same `Schedule` that a daemon runs is given the roster's feeds and cyclic reads; every exchange
takes its usual time. So the picture shows what the line does, not what somebody thinks it does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from lecombus.config import Roster
from lecombus.config.exchanges import Times, feed_times, read_times, watched_s
from lecombus.drives import LineTiming
from lecombus.schedule import Cyclic, Feeding, Outcome, Priority, Request, Schedule
from lecombus.schedule.feeds import HARD_PART

__all__ = ["Preview", "Span", "preview"]

LONGEST_S: Final = 10.0
"""More than this is not seen in a picture."""
SHORTEST_S: Final = 1.0
SETTLED_S: Final = 5.0
"""After this a line goes its way: the spread of a start is over."""


@dataclass(frozen=True, slots=True)
class Span:
    """One exchange.

    Args:
        drive: With whom.
        kind: `cyclic` or `watchdog`.
        start_s: When it begins, seconds from the picture's left.
        end_s: When the line is free again.
    """

    drive: str
    kind: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Preview:
    """A stretch of a line's time.

    Args:
        length_s: How long it is: the hyperperiod of the cyclic reads, within bounds.
        spans: The exchanges, in order.
        deadlines: For each watched drive, when its feed has to be over.
    """

    length_s: float
    spans: tuple[Span, ...]
    deadlines: dict[str, tuple[float, ...]]


def preview(roster: Roster, timing: LineTiming) -> Preview:
    """Run the schedule over a roster and write down one hyperperiod."""
    schedule = Schedule(absent_share=roster.line.absent_share)
    for drive in roster.drives:
        schedule.add_drive(drive.name)
        for entry in drive.cyclic:
            times = read_times(drive, entry.code, timing)
            make = _maker(drive.name, Priority.CYCLIC, times)
            schedule.add_cyclic(Cyclic(drive.name, entry.every_s, make), 0.0)
        time_s = watched_s(drive)
        if time_s is not None:
            make = _maker(drive.name, Priority.WATCHDOG, feed_times(drive, timing))
            schedule.set_feeding(drive.name, Feeding(time_s, make), 0.0)
    length_s = _length_s(roster)
    return _cut(_run(schedule, SETTLED_S + length_s), roster, length_s)


def _maker(drive: str, priority: Priority, times: Times) -> Callable[[], Request]:
    return lambda: Request(drive, priority, times.usual_s, times.worst_s, _ended)


def _ended(outcome: Outcome, reason: str) -> None:
    """Nobody waits for these."""


def _run(schedule: Schedule, until_s: float) -> list[Span]:
    spans: list[Span] = []
    now_s = 0.0
    while now_s < until_s:
        request = schedule.next(now_s)
        if request is None:
            wake_s = schedule.wake_at_s(now_s)
            if wake_s is None:
                break
            now_s = max(wake_s, now_s + 1e-6)
            continue
        end_s = now_s + request.cost_s
        kind = "watchdog" if request.priority is Priority.WATCHDOG else "cyclic"
        spans.append(Span(request.drive, kind, now_s, end_s))
        schedule.finished(request, now_s, end_s, reached=True)
        request.end(Outcome.DONE)
        now_s = end_s
    return spans


def _cut(spans: list[Span], roster: Roster, length_s: float) -> Preview:
    """Take the stretch after the start has settled, and the deadlines that fall into it."""
    deadlines: dict[str, list[float]] = {}
    hard_s = {
        drive.name: HARD_PART * time_s for drive in roster.drives if (time_s := watched_s(drive))
    }
    for span in spans:
        if span.drive in hard_s:
            at_s = span.start_s + hard_s[span.drive] - SETTLED_S
            if 0.0 <= at_s <= length_s:
                deadlines.setdefault(span.drive, []).append(at_s)
    shown = tuple(
        Span(one.drive, one.kind, one.start_s - SETTLED_S, one.end_s - SETTLED_S)
        for one in spans
        if one.start_s >= SETTLED_S
    )
    return Preview(length_s, shown, {name: tuple(times) for name, times in deadlines.items()})


def _length_s(roster: Roster) -> float:
    """The hyperperiod: after it everything comes again in the same order."""
    periods = {round(entry.every_s * 1000) for drive in roster.drives for entry in drive.cyclic}
    whole_ms = math.lcm(*periods) if periods else 0
    return min(max(whole_ms / 1000, SHORTEST_S), LONGEST_S)
