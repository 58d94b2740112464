"""What share of a line is asked for, what cycles follow, and what would change it.

The load is the cyclic reads plus the feeds that they do not stand for: a drive that is read often
enough is fed by that. Above all of the line every period is stretched by the same factor, which is
how the schedule's cadence treats it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final

from lecombus.config import DriveEntry, Roster, line_timing
from lecombus.config.exchanges import feed_times, read_times, watched_s
from lecombus.config.feeding import BAUDS, feeding_of, least_time_s
from lecombus.config.timing import with_slow_adapter
from lecombus.drives import LineTiming
from lecombus.schedule.feeds import HARD_PART, SOFT_PART
from lecombus.schedule.shares import BACKOFF_MOST_S

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


@dataclass(frozen=True, slots=True)
class Load:
    """What is asked of a line all the time, as shares of its time.

    Args:
        cyclic: The cyclic reads.
        feeding: The feeds beside them that must be.
        probing: The probes of absent drives.
        feeding_most: The feeds beside them at most, where the line has time to feed early.
    """

    cyclic: float
    feeding: float
    probing: float = 0.0
    feeding_most: float = 0.0

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
        least_s: The least time that all watchdogs could have at once; None: none will do, or
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


def load_on(drives: Sequence[DriveEntry], timing: LineTiming) -> Load:
    """Reckon what drives that are all there ask of the line."""
    cyclic = feeding = most = 0.0
    for drive in drives:
        rate = 0.0
        for entry in drive.cyclic:
            cyclic += read_times(drive, entry.code, timing).usual_s / entry.every_s
            rate += 1.0 / entry.every_s
        time_s = watched_s(drive)
        if time_s is not None:
            missing = max(0.0, 1.0 / (HARD_PART * time_s) - rate)
            feed_s = feed_times(drive, timing).usual_s
            feeding += missing * feed_s
            most += max(missing, _early_rate(drive, time_s)) * feed_s
    return Load(cyclic, feeding, feeding_most=most)


def _early_rate(drive: DriveEntry, time_s: float) -> float:
    """Give how often a drive is fed beside its reads at most, 1/s.

    The schedule feeds from half the watchdog time on if the line has nothing better to do; a code
    that is read more often than that leaves it nothing.
    """
    shortest_s = min((entry.every_s for entry in drive.cyclic), default=math.inf)
    return 0.0 if shortest_s <= SOFT_PART * time_s else 1.0 / (SOFT_PART * time_s)


def baud_effects(roster: Roster) -> list[BaudEffect]:
    """Reckon the line at every baud rate there is."""
    effects = []
    for baud in BAUDS:
        timing = line_timing(roster.line.model_copy(update={"baud": baud}))
        feeding = feeding_of(roster, timing)
        least_s = least_time_s(feeding, all_alike=True)
        effects.append(BaudEffect(baud, load_on(roster.drives, timing), feeding.holds(), least_s))
    return effects


def adapter_effect(roster: Roster, timing: LineTiming) -> AdapterEffect:
    """Reckon the line with an adapter that is as slow as it may be."""
    slow = with_slow_adapter(timing)
    feeding = feeding_of(roster, slow)
    return AdapterEffect(
        timing.adapter_latency_s,
        load_on(roster.drives, slow),
        feeding.holds(),
        least_time_s(feeding),
    )


def absent_effects(roster: Roster, timing: LineTiming) -> list[AbsentEffect]:
    """Reckon the line while drives are away: the last ones of the roster."""
    whole = load_on(roster.drives, timing)
    effects = []
    for absent in (count for count in ABSENT if count < len(roster.drives)):
        gone = roster.drives[-absent:]
        probes = sum(feed_times(drive, timing).worst_s for drive in gone) / BACKOFF_MOST_S
        left = load_on(roster.drives[:-absent], timing)
        load = replace(left, probing=min(probes, roster.line.absent_share))
        effects.append(AbsentEffect(absent, load, whole.stretch / load.stretch))
    return effects
