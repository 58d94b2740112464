"""The running schedule over a roster, in no time: who would speak when.

The same `Schedule` that a daemon runs is given the roster's feeds and cyclic reads; every exchange
takes its usual time. So the picture shows what the line does, not what somebody thinks it does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from lecombus.config import Roster
from lecombus.config.exchanges import Times, feed_times, read_times, watched_s
from lecombus.config.feeding import faults_of
from lecombus.drives import LineTiming
from lecombus.planning.loads import load_on
from lecombus.schedule import Cyclic, Feeding, Outcome, Priority, Request, Schedule
from lecombus.schedule.feed import HARD_PART

__all__ = ["Preview", "Span", "hyperperiod_s", "preview"]

LONGEST_S: Final = 10.0
"""More than this is not seen in a picture."""
SHORTEST_S: Final = 1.0
LOOKED_AT_S: Final = 20.0
"""So much is run to say what share of the line is taken: a picture may be too short for a feed."""
SETTLED_S: Final = 5.0
"""After this a line goes its way: the spread of a start is over."""


@dataclass(frozen=True, slots=True)
class Span:
    """One exchange.

    Args:
        drive: With whom.
        kind: `cyclic` or `watchdog`.
        what: The code that is read; for a feed beside the cyclic reads, `feed`.
        start_s: When it begins, seconds from the picture's left.
        end_s: When the line is free again.
    """

    drive: str
    kind: str
    what: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Preview:
    """A stretch of a line's time.

    Args:
        length_s: How long it is: the hyperperiod of the cyclic reads, within bounds.
        whole_s: That hyperperiod itself, stretched as the reads are; 0: nothing is read cyclically.
        stretch: By how much the cyclic periods are stretched; 1: not.
        spans: The exchanges, in order.
        deadlines: For each watched drive, when its feed has to be over.
        cyclic: The share of the line that cyclic reads take, also beyond the picture.
        feeding: The share that feeds beside them take.
    """

    length_s: float
    whole_s: float
    stretch: float
    spans: tuple[Span, ...]
    deadlines: dict[str, tuple[float, ...]]
    cyclic: float
    feeding: float

    @property
    def total(self) -> float:
        """The share of the line that is taken."""
        return self.cyclic + self.feeding

    def as_json(self) -> dict[str, float]:
        """Give what the exchanges take, for `--json`."""
        found = {"cyclic": self.cyclic, "feeding": self.feeding, "total": self.total}
        found |= {"hyperperiod_s": self.whole_s}
        return {name: round(value, 6) for name, value in found.items()}


def preview(roster: Roster, timing: LineTiming) -> Preview:
    """Run the schedule over a roster and write down one hyperperiod."""
    schedule = Schedule(absent_share=roster.line.absent_share)
    schedule.expect(faults_of(roster, timing))
    for drive in roster.drives:
        schedule.add_drive(drive.name)
        for entry in drive.cyclic:
            times = read_times(drive, entry.code, timing)
            make = _maker(drive.name, Priority.CYCLIC, times, str(entry.code))
            schedule.add_cyclic(Cyclic(drive.name, entry.every_s, make), 0.0)
        time_s = watched_s(drive)
        if time_s is not None:
            make = _maker(drive.name, Priority.WATCHDOG, feed_times(drive, timing), "feed")
            schedule.set_feeding(drive.name, Feeding(time_s, make), 0.0)
    stretch = load_on(roster.drives, timing).stretch
    whole_s = hyperperiod_s(roster) * stretch
    length_s = min(max(whole_s, SHORTEST_S), LONGEST_S)
    spans = _run(schedule, SETTLED_S + LOOKED_AT_S)
    run = [_moved(one) for one in spans if one.end_s > SETTLED_S]
    return Preview(
        length_s, whole_s, stretch, tuple(one for one in run if one.start_s < length_s),
        _due(spans, roster, length_s), _share(run, "cyclic"), _share(run, "watchdog"),
    )  # fmt: skip


def _share(spans: list[Span], kind: str) -> float:
    taken_s = sum(min(one.end_s, LOOKED_AT_S) - one.start_s for one in spans if one.kind == kind)
    return taken_s / LOOKED_AT_S


def _maker(drive: str, priority: Priority, times: Times, what: str) -> Callable[[], Request]:
    return lambda: Request(drive, priority, times.usual_s, times.worst_s, _ended, work=what)


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
        spans.append(Span(request.drive, kind, str(request.work), now_s, end_s))
        schedule.finished(request, now_s, end_s, reached=True)
        request.end(Outcome.DONE)
        now_s = end_s
    return spans


def _moved(span: Span) -> Span:
    """Reckon from the picture's left; what was under way then is shown from there on."""
    return replace(span, start_s=max(span.start_s - SETTLED_S, 0.0), end_s=span.end_s - SETTLED_S)


def _due(spans: list[Span], roster: Roster, length_s: float) -> dict[str, tuple[float, ...]]:
    """Find the deadlines that fall into the picture, also those that were set before it."""
    hard_s = {
        drive.name: HARD_PART * time_s for drive in roster.drives if (time_s := watched_s(drive))
    }
    due: dict[str, list[float]] = {}
    for span in spans:
        if span.drive in hard_s:
            at_s = span.start_s + hard_s[span.drive] - SETTLED_S
            if 0.0 <= at_s <= length_s:
                due.setdefault(span.drive, []).append(at_s)
    return {name: tuple(times) for name, times in due.items()}


def hyperperiod_s(roster: Roster) -> float:
    """Give the time after which the cyclic reads come again in the same order; 0: none."""
    periods = {round(entry.every_s * 1000) for drive in roster.drives for entry in drive.cyclic}
    return math.lcm(*periods) / 1000 if periods else 0.0
