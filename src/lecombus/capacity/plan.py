"""A plan: everything that a line promises, calculated from its roster alone, as data.

Put together from the other modules of this room; `cli.line_plan` shows it. Times are seconds,
shares are fractions, and a promise that cannot be given is None (JSON knows no infinity).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from lecombus.capacity.exchange_costs import (
    Times,
    feed_times,
    line_timing,
    read_times,
    stop_s,
    watched_s,
)
from lecombus.capacity.lease_bounds import LeaseBound, lease_bounds
from lecombus.capacity.load import (
    AbsentEffect,
    AdapterEffect,
    BaudEffect,
    Load,
    absent_effects,
    adapter_effect,
    baud_effects,
    load_on,
)
from lecombus.capacity.waits import ClassWait, SilentStop, class_waits, silent_stop
from lecombus.capacity.watchdog_feasibility import WatchdogPlan, watchdog_plans
from lecombus.capacity.work_ahead import Room, work_ahead_on
from lecombus.fieldbus.costs import LineTiming
from lecombus.roster import DriveEntry, Roster

__all__ = ["LinePlan", "PlannedExchange", "Promises", "make_plan", "make_promises"]


@dataclass(frozen=True, slots=True)
class PlannedExchange:
    """One thing a line does again and again.

    Args:
        drive: With whom.
        what: The code read, or `feed`.
        every_s: How often the roster asks for it; for a feed, its watchdog time.
        times: Its line time.
        most_s: The longest it can take, all repetitions failing.
        cycle_s: The period that is reached; for a feed, the same as `every_s`.
    """

    drive: str
    what: str
    every_s: float
    times: Times
    most_s: float
    cycle_s: float


@dataclass(frozen=True, slots=True)
class Promises:
    """How long requests wait at most on a line: the part of its plan that a run must keep.

    Args:
        load: What is asked of the line all the time.
        waits: How long each class waits at most.
        room: What it takes to make room for an exchange beside the feeds.
        silent_stop: What a stop of a drive that does not answer is promised.
        stretch: The factor by which cyclic periods grow when the schedule is run.
    """

    load: Load
    waits: tuple[ClassWait, ...]
    room: Room
    silent_stop: SilentStop
    stretch: float

    def wait(self, name: str) -> ClassWait:
        """Give the promise to a class, such as `stop`."""
        return next(one for one in self.waits if one.name == name)


@dataclass(frozen=True, slots=True)
class LinePlan:
    """What a line promises.

    Args:
        line: Its name.
        baud: Its baud rate.
        load: What is asked of it all the time.
        exchanges: What it does again and again.
        waits: How long each class waits at most.
        room: What it takes to make room for an exchange beside the feeds.
        silent_stop: What a stop of a drive that does not answer is promised.
        watchdogs: Each watched drive's, and how short it could be.
        bauds: The same line at every baud rate.
        adapter: The same line with an adapter that is as slow as it may be.
        absent: The same line while drives are away.
        leases: How soon drives that need a lease are stopped.
        stretch: The factor by which cyclic periods grow when the schedule is run: more than that
            of the load where feeds that keep room for lost answers take turns with the reads.
    """

    line: str
    baud: int
    load: Load
    exchanges: tuple[PlannedExchange, ...]
    waits: tuple[ClassWait, ...]
    room: Room
    silent_stop: SilentStop
    watchdogs: tuple[WatchdogPlan, ...]
    bauds: tuple[BaudEffect, ...]
    adapter: AdapterEffect
    absent: tuple[AbsentEffect, ...]
    leases: tuple[LeaseBound, ...] = ()
    stretch: float = 1.0

    def wait(self, name: str) -> ClassWait:
        """Give the promise to a class, such as `stop`."""
        return next(one for one in self.waits if one.name == name)

    def as_json(self) -> dict[str, Any]:
        """Give the plan for `--json`."""
        found = _finite(dataclasses.asdict(self))
        assert isinstance(found, dict)
        found["load"] = self.load.as_json()
        found["room"]["sure_s"] = _finite(self.room.sure_s)
        found["adapter"]["load"] = self.adapter.load.as_json()
        for name in ("bauds", "absent"):
            for effect, row in zip(getattr(self, name), found[name], strict=True):
                row["load"] = effect.load.as_json()
        for one, row in zip(self.watchdogs, found["watchdogs"], strict=True):
            row["verdict"] = one.verdict
        if not self.leases:
            del found["leases"]
        return found


def make_plan(roster: Roster, timing: LineTiming | None = None) -> LinePlan:
    """Plan a line.

    Args:
        roster: The line and its drives.
        timing: The line's times; None: the roster's.
    """
    timing = timing or line_timing(roster.line)
    promises = make_promises(roster, timing)
    return LinePlan(
        line=roster.line.name,
        baud=timing.baud,
        load=promises.load,
        exchanges=tuple(
            exchange
            for drive in roster.drives
            for exchange in _exchanges(drive, roster, timing, promises.stretch)
        ),
        waits=promises.waits,
        room=promises.room,
        silent_stop=promises.silent_stop,
        watchdogs=tuple(watchdog_plans(roster, timing)),
        bauds=tuple(baud_effects(roster)),
        adapter=adapter_effect(roster, timing),
        absent=tuple(absent_effects(roster, timing)),
        leases=tuple(lease_bounds(roster, timing, promises.wait("stop").loaded_s)),
        stretch=promises.stretch,
    )


def make_promises(roster: Roster, timing: LineTiming | None = None) -> Promises:
    """Make the part of a plan that says how long everything waits; arguments as for `make_plan`."""
    timing = timing or line_timing(roster.line)
    ahead = work_ahead_on(roster, timing)
    longest_stop_s = max((stop_s(drive, timing) for drive in roster.drives), default=0.0)
    return Promises(
        load_on(roster.drives, timing),
        tuple(class_waits(roster, timing, ahead, longest_stop_s)),
        ahead.room,
        silent_stop(roster, timing, ahead),
        ahead.stretch,
    )


def _exchanges(
    drive: DriveEntry, roster: Roster, timing: LineTiming, stretch: float
) -> list[PlannedExchange]:
    attempts = roster.line.retries + 1
    found = []
    for entry in drive.cyclic:
        times = read_times(drive, entry.code, timing)
        reached_s = entry.every_s * stretch
        found.append(
            PlannedExchange(drive.name, str(entry.code), entry.every_s, times,
                            attempts * times.worst_s, reached_s)
        )  # fmt: skip
    time_s = watched_s(drive)
    if time_s is not None:
        times = feed_times(drive, timing)
        most_s = attempts * times.worst_s
        found.append(PlannedExchange(drive.name, "feed", time_s, times, most_s, time_s))
    return found


def _finite(found: object) -> object:
    if isinstance(found, float):
        return None if math.isinf(found) else round(found, 6)
    if isinstance(found, dict):
        return {key: _finite(value) for key, value in found.items()}
    if isinstance(found, list | tuple):
        return [_finite(value) for value in found]
    return found
