"""What share of a line is used, which cycles follow, and what would change that.

The load is the cyclic reads plus the feeds that they do not stand for: a drive that is read often
enough is fed by that. Above all of the line every period is stretched by the same factor, which is
how the schedule's cadence treats it; reads that come seldomer by that leave more to feed, which
stretches again, until both agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final

from lecombus.capacity.exchange_costs import (
    feed_times,
    line_timing,
    read_times,
    watched_s,
    with_slow_adapter,
)
from lecombus.capacity.watchdog_demand import demand_of, least_time_s
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.protocols import find
from lecombus.roster import DriveEntry, Roster
from lecombus.schedule.shares import BACKOFF_MOST_S, LISTEN_EVERY_S, LISTEN_S
from lecombus.schedule.watchdog_deadline import HARD_PART, SOFT_PART, SPARE_ATTEMPTS

__all__ = [
    "AbsentEffect",
    "AdapterEffect",
    "BaudEffect",
    "Load",
    "absent_effects",
    "adapter_effect",
    "baud_effects",
    "load_on",
]

ABSENT: Final = (1, 3, 10)
MOST_ROUNDS: Final = 100
ROUNDING: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Load:
    """What is asked of a line all the time, as shares of its time.

    Args:
        cyclic: The cyclic reads.
        feeding: The feeds beside them that must be; a line that has time feeds more.
        probing: The probes of absent drives, and listening for ones that are merely very slow.
    """

    cyclic: float
    feeding: float
    probing: float = 0.0

    @property
    def total(self) -> float:
        """All that must be; above 1 the cycles are stretched."""
        return self.cyclic + self.feeding + self.probing

    @property
    def stretch(self) -> float:
        """The factor by which cyclic periods grow; 1: they are kept."""
        return max(1.0, self.cyclic / max(1.0 - self.feeding - self.probing, 0.01))

    def as_json(self) -> dict[str, float]:
        """Give it for `--json`, to a millionth of the line."""
        found = asdict(self) | {"total": self.total, "stretch": self.stretch}
        return {name: round(value, 6) for name, value in found.items()}


@dataclass(frozen=True, slots=True)
class BaudEffect:
    """The line at another baud rate.

    Args:
        baud: The rate, bit/s.
        load: What would be asked of it.
        held: All watchdogs of the roster can be held.
        least_s: The least time that all watchdogs could have together; None: none will do, or
            nothing is fed.
    """

    baud: int
    load: Load
    held: bool
    least_s: float | None


@dataclass(frozen=True, slots=True)
class AdapterEffect:
    """The line if its adapter adds all that it may to every answer.

    Args:
        latency_s: What it may add.
        load: What is asked of the line then.
        held: All watchdogs of the roster can be held then.
        least_s: The least time to which shorter watchdogs would have to be raised for that; None:
            none will do, or nothing is fed.
    """

    latency_s: float
    load: Load
    held: bool
    least_s: float | None


@dataclass(frozen=True, slots=True)
class AbsentEffect:
    """The line while drives are away.

    Args:
        absent: How many.
        load: What is asked of it then.
        cycle_rate: The others' cycles, relative to those with none absent; 1: the same.
    """

    absent: int
    load: Load
    cycle_rate: float


def load_on(drives: Sequence[DriveEntry], timing: LineTiming, probing: float = 0.0) -> Load:
    """Calculate the load of drives that all answer.

    Args:
        drives: The drives.
        timing: The line's times.
        probing: The share that looking for others takes.
    """
    parts = [_part(drive, timing) for drive in drives]
    cyclic = sum(one.cyclic for one in parts)
    load = Load(cyclic, _needed(parts, 1.0), probing)
    for _ in range(MOST_ROUNDS if load.stretch > 1.0 else 0):
        stretched = Load(cyclic, _needed(parts, load.stretch), probing)
        if stretched.stretch <= load.stretch * (1.0 + ROUNDING):
            break
        load = stretched
    return load


@dataclass(frozen=True, slots=True)
class _Part:
    """What one drive asks of the line.

    Args:
        cyclic: The share of its cyclic reads.
        rate: How many of them there are, 1/s.
        shortest_s: The shortest of their periods; infinite: there are none.
        feed_s: What one feed costs.
        worst_s: What one costs that is not answered.
        watched_s: Its watchdog time; infinite: it is not watched.
    """

    cyclic: float
    rate: float
    shortest_s: float
    feed_s: float
    worst_s: float
    watched_s: float

    def apart_s(self, stretch: float) -> float:
        """How far apart its feeds must be, or, where reads wait for them, are."""
        hard_s = HARD_PART * self.watched_s
        if stretch <= 1.0 or math.isinf(hard_s):
            return hard_s
        return max(SOFT_PART * self.watched_s, hard_s - SPARE_ATTEMPTS * self.worst_s)

    def feeds(self, stretch: float) -> float:
        """How many feeds it needs that its reads do not stand for, 1/s.

        Several codes may be due together and then leave a gap as long as the shortest period: where
        that is longer than feeds may be apart, the other codes cannot be counted on.
        """
        apart_s = self.apart_s(stretch)
        shortest_s = self.shortest_s * stretch
        rate = self.rate / stretch if shortest_s <= apart_s else 1.0 / shortest_s
        return max(0.0, 1.0 / apart_s - rate)


def _part(drive: DriveEntry, timing: LineTiming) -> _Part:
    costs = [read_times(drive, entry.code, timing).usual_s for entry in drive.cyclic]
    periods = [entry.every_s for entry in drive.cyclic]
    feed = feed_times(drive, timing)
    return _Part(
        cyclic=sum(cost / every_s for cost, every_s in zip(costs, periods, strict=True)),
        rate=sum(1.0 / every_s for every_s in periods),
        shortest_s=min(periods, default=math.inf),
        feed_s=feed.usual_s,
        worst_s=feed.worst_s,
        watched_s=watched_s(drive) or math.inf,
    )


def _needed(parts: Sequence[_Part], stretch: float) -> float:
    """Give the share of the feeds that reads with stretched periods do not stand for."""
    return sum(one.feeds(stretch) * one.feed_s for one in parts)


def baud_effects(roster: Roster) -> list[BaudEffect]:
    """Calculate the load and the watchdogs at every baud rate."""
    effects = []
    for baud in find(roster.line.protocol).bauds:
        timing = line_timing(roster.line.model_copy(update={"baud": baud}))
        feeding = demand_of(roster, timing)
        least_s = least_time_s(feeding, all_alike=True)
        effects.append(BaudEffect(baud, load_on(roster.drives, timing), feeding.holds(), least_s))
    return effects


def adapter_effect(roster: Roster, timing: LineTiming) -> AdapterEffect:
    """Calculate the load and the watchdogs with an adapter that is as slow as it may be."""
    slow = with_slow_adapter(timing)
    feeding = demand_of(roster, slow)
    return AdapterEffect(
        timing.adapter_latency_s,
        load_on(roster.drives, slow),
        feeding.holds(),
        least_time_s(feeding),
    )


def absent_effects(roster: Roster, timing: LineTiming) -> list[AbsentEffect]:
    """Calculate the load while drives are away: the last ones of the roster."""
    whole = load_on(roster.drives, timing)
    effects = []
    for absent in (count for count in ABSENT if count < len(roster.drives)):
        gone = roster.drives[-absent:]
        probes = sum(feed_times(drive, timing).worst_s for drive in gone) / BACKOFF_MOST_S
        probing = min(probes, roster.line.absent_share) + LISTEN_S / LISTEN_EVERY_S
        load = load_on(roster.drives[:-absent], timing, probing)
        effects.append(AbsentEffect(absent, load, whole.stretch / load.stretch))
    return effects
