"""Which watchdogs of a roster cannot be held, what would help, and how short each could be.

Method: the demand bound of `demand_bound`, over the feeds of `watchdog_demand`; least times are
found by halving, to a millisecond. Every remedy that is offered has been tested: the roster with
that time, at that baud rate or without those reads passes.

For each watchdog two times are given: the least that can be held while `line.tolerate` answers are
lost at the worst moments, and the least that also outlasts a drive that stops answering: it is
asked `AWAY_ATTEMPTS` times before it counts as offline.

A restart after the daemon was killed takes `RESTART_S` until the first telegram, and one exchange
with each drive until all have been fed. A watchdog outlasts that if its drive was fed so shortly
before that the rest of its time is enough.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from lecombus.capacity.demand_bound import Overload
from lecombus.capacity.exchange_costs import feed_times, line_timing, watched_s
from lecombus.capacity.watchdog_demand import (
    LONGEST_S,
    LeftAlone,
    WatchdogDemand,
    demand_of,
    least_time_s,
    longest_stop_s,
    lowest_s,
    smallest,
    under_way_s,
)
from lecombus.durations import format_duration
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.protocols import find
from lecombus.roster import DriveEntry, Roster
from lecombus.schedule.watchdog_deadline import HARD_PART

__all__ = [
    "AWAY_ATTEMPTS",
    "InfeasibleWatchdog",
    "WatchdogPlan",
    "find_infeasible",
    "rounded_up",
    "watchdog_plans",
]


@dataclass(frozen=True, slots=True)
class InfeasibleWatchdog:
    """A watchdog that cannot be held.

    Args:
        drive: The drive.
        what: What is wrong, with the arithmetic.
        right: What would do.
    """

    drive: str
    what: str
    right: str


def find_infeasible(roster: Roster) -> list[InfeasibleWatchdog]:
    """Find the watchdogs that cannot be held; each is named with what would do."""
    demand = demand_of(roster)
    overload = demand.overload()
    if overload is None:
        return list(_too_slow(demand, roster.line.baud))
    least_s = least_time_s(demand)
    right = _remedy(roster, demand, least_s)
    return [
        InfeasibleWatchdog(
            drive.name, _arithmetic(drive, demand, overload, roster.line.baud), right
        )
        for drive in demand.drives
        if least_s is None or (watched_s(drive) or math.inf) < least_s
    ]


def _too_slow(demand: WatchdogDemand, baud: int) -> Iterator[InfeasibleWatchdog]:
    """Find the drives that one exchange of their own keeps from being fed."""
    for drive, stream, own_s in zip(demand.drives, demand.streams, demand.own_s, strict=True):
        if own_s > stream.every_s:
            time_s = format_duration(watched_s(drive) or 0.0)
            yield InfeasibleWatchdog(
                drive.name,
                f"a watchdog of {time_s} cannot be held at {baud} baud: one exchange with this "
                f"drive, such as its stop, takes {_ms(own_s)}, and nothing feeds it in that time",
                f"a time of {rounded_up(own_s / HARD_PART)} or more would do",
            )


def _arithmetic(drive: DriveEntry, demand: WatchdogDemand, overload: Overload, baud: int) -> str:
    time_s = watched_s(drive) or 0.0
    lost = demand.tolerate if demand.overload(lost=0) is None else 0
    said = f" if {_answers(lost)} lost" if lost else ""
    if isinstance(overload, LeftAlone):
        carried = _behind_a_write(overload, lost)
    else:
        carried = _feeds(demand, overload, lost)
    return (
        f"a watchdog of {format_duration(time_s)} cannot be held at {baud} baud{said}: within "
        f"{_ms(overload.within_s)} the line would have to carry {carried}"
    )


def _behind_a_write(found: LeftAlone, lost: int) -> str:
    whose = found.whose
    parts = [f"a write to {whose} with the time for which it is left alone ({_ms(found.alone_s)})"]
    if found.other_s > 0.0:
        parts.append(f"the feed of another drive ({_ms(found.other_s)})")
    if found.stop_s > 0.0:
        answers = f"{_lost_answers(lost)} and " if lost else ""
        parts.append(f"{answers}a stop beyond the last tenth ({_ms(found.stop_s)})")
    return f"{', '.join(parts)} and the feed of {whose} ({_ms(found.demand_s)})"


def _feeds(demand: WatchdogDemand, overload: Overload, lost: int) -> str:
    counted = sum(1 for stream in demand.streams if stream.every_s <= overload.within_s + 1e-9)
    feeds = "1 feed" if counted == 1 else f"the feeds of {counted} drives"
    before = demand.before(overload.whose)
    behind = []
    if lost:
        stop, failed = _ms(demand.faults.stop_s), _ms(demand.faults.stop_failed_s)
        behind = [
            f"{_ms(overload.blocking_s)}: an exchange, {_lost_answers(lost)} "
            f"({_ms(demand.lost_s)} each), and as far as the last tenth of the shortest time does "
            f"not hold them a stop ({stop}, or {failed} without an answer) and the feed before"
        ]
        alone_s = demand.alone(overload.whose)
        if alone_s > 0.0:
            behind.append(f"a write, after which {overload.whose} is left alone ({_ms(alone_s)})")
    elif before:
        behind = [
            f"one exchange that fails ({_ms(under_way_s(before))}) and one stop "
            f"({_ms(longest_stop_s(before))})"
        ]
    after = f" behind {' or '.join(behind)}" if behind else ""
    return f"{feeds} ({_ms(overload.demand_s)}){after}"


def _answers(count: int) -> str:
    return "1 answer is" if count == 1 else f"{count} answers are"


def _lost_answers(count: int) -> str:
    return "1 lost answer" if count == 1 else f"{count} lost answers"


def _remedy(roster: Roster, demand: WatchdogDemand, least_s: float | None) -> str:
    ways: list[str] = []
    if least_s is not None:
        ways.append(f"a time of {rounded_up(least_s)} or more")
    bauds = find(roster.line.protocol).bauds
    baud = next((baud for baud in bauds if baud > roster.line.baud and _holds(roster, baud)), None)
    if baud is not None:
        ways.append(f"baud: {baud}")
    ways.extend(_fewer_reads(demand))
    ways.append("fewer watched drives on this line")
    least = next((one for one in range(demand.tolerate) if demand.holds(lost=one)), None)
    if least is not None:
        ways.append(f"tolerate: {least}")
    return f"{' or '.join(ways)} would do"


def _holds(roster: Roster, baud: int) -> bool:
    line = roster.line.model_copy(update={"baud": baud})
    return demand_of(roster, line_timing(line)).holds()


def _fewer_reads(demand: WatchdogDemand) -> Iterator[str]:
    """Say if it is long cyclic reads that stand in the way."""
    failed_s = max(one.failed_s for one in demand.delays)
    if demand.without_reads(failed_s).overload() is not None:
        return
    long = [what for one in demand.delays for what, time_s in one.reads if time_s > failed_s]
    if long:
        shown = ", ".join(long[:4]) + (" .." if len(long) > 4 else "")
        yield f"not reading {shown} cyclically"


def rounded_up(seconds: float) -> str:
    """Write a time rounded up to 10 ms or, from a second on, to tenths: it must still do."""
    step = 0.01 if seconds < 1.0 else 0.1
    return format_duration(round(math.ceil(round(seconds / step, 6)) * step, 3))


def _ms(seconds: float) -> str:
    return f"{seconds * 1000:.0f}ms"


AWAY_ATTEMPTS: Final = 4
"""Exchanges in a row that a drive fails before it counts as offline."""
MOST_LOST: Final = 9
"""More lost answers than these are not counted."""


RESTART_S: Final = 5.0
"""From the end of a daemon that was killed to the first telegram of the next: 1.0 to 2.7 s were
measured, on a computer with much other work up to 4.9 s."""


@dataclass(frozen=True, slots=True)
class WatchdogPlan:
    """One drive's watchdog.

    Args:
        drive: The drive.
        time_s: What the roster says, seconds.
        feed_s: What one feed costs, seconds.
        least_s: The least time that can be held; None: none.
        outlasts_s: The least time that outlasts a drive that goes away; None: none.
        restart_s: It outlasts a restart of the daemon if the drive was spoken to in so many seconds
            before; 0: it does not.
        lost: So many lost answers within its time, whosever, it outlasts for certain.
    """

    drive: str
    time_s: float
    feed_s: float
    least_s: float | None
    outlasts_s: float | None
    restart_s: float
    lost: int

    @property
    def at_restart(self) -> str:
        """Say what it does while the daemon is started again."""
        if self.restart_s >= HARD_PART * self.time_s:
            return "outlasts it"
        return f"if fed {self.restart_s:.1f} s before" if self.restart_s else "may act"

    @property
    def verdict(self) -> str:
        """Say what the roster's time is good for."""
        if self.outlasts_s is not None and self.time_s >= self.outlasts_s:
            return "held, also when a drive goes away"
        if self.least_s is not None and self.time_s >= self.least_s:
            return "held while no drive goes away"
        return "cannot be held"


def watchdog_plans(roster: Roster, timing: LineTiming) -> list[WatchdogPlan]:
    """Plan every watched drive's watchdog, in the roster's order."""
    demand = demand_of(roster, timing)
    plans, lost = [], _lost(demand)
    restart_s = RESTART_S + sum(feed_times(one, timing).usual_s for one in roster.drives)
    known: dict[tuple[float, ...], tuple[float | None, float | None]] = {}
    for number, drive in enumerate(demand.drives):
        stream = demand.streams[number]
        low_s = max(lowest_s(drive), demand.own_s[number] / HARD_PART)
        alone_s = demand.alone_s[number]
        alike = (stream.cost_s, stream.every_s, stream.blocked_s, low_s, *alone_s)
        if alike not in known:
            known[alike] = (
                _least(demand, number, low_s, None),
                _least(demand, number, low_s, AWAY_ATTEMPTS + 1),
            )
        least_s, outlasts_s = known[alike]
        time_s = watched_s(drive) or 0.0
        left_s = max(time_s - restart_s, 0.0)
        plans.append(
            WatchdogPlan(drive.name, time_s, stream.cost_s, least_s, outlasts_s, left_s, lost)
        )
    return plans


def _lost(demand: WatchdogDemand) -> int:
    """Count the lost answers within a watchdog time that all watchdogs outlast."""
    found = 0
    while found < MOST_LOST and demand.holds(lost=found + 1):
        found += 1
    return found


def _least(demand: WatchdogDemand, number: int, low_s: float, lost: int | None) -> float | None:
    def holds(time_s: float) -> bool:
        return demand.with_time(number, time_s).holds(lost=lost)

    now_s = demand.streams[number].every_s / HARD_PART
    return smallest(holds, low_s, now_s if holds(now_s) else LONGEST_S)
