"""Whether a line can hold the watchdogs of a roster, and what the least times would be.

Every watched drive must have been spoken to within nine tenths of its watchdog time, so its feed
is a stream of work (`schedule.demand`). What stands before a feed once is an exchange with another
drive, and one stop of another one, which goes before everything and waits for nobody. The exchange
counts at its longest, unanswered: the schedule begins none that could make a feed late, so where
that does not fit a drive could not even be asked whether it is there. If the feeds do not fit
behind those, the roster is refused (`unheld`). One in which a further lost answer makes a watchdog
act is worth a warning.

What is said to a drive feeds it, so no drive stands in its own way; that is reckoned for each of
them, not only for the one with the shortest time.

What must not live here: costs (`exchanges`), what is said to people (`unheld`), the schedule's
choices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from lecombus.config.exchanges import (
    feed_times,
    own_longest_s,
    read_times,
    stop_s,
    watched_s,
)
from lecombus.config.models import DriveEntry, Roster
from lecombus.config.timing import line_timing
from lecombus.drives import LineTiming, family
from lecombus.schedule.demand import FULL, Overload, Stream, find_overload, load_of
from lecombus.schedule.feeds import HARD_PART

__all__ = [
    "BAUDS",
    "LONGEST_S",
    "Feeding",
    "Obstacle",
    "feeding_of",
    "least_time_s",
    "longest_stop_s",
    "lowest_s",
    "smallest",
    "under_way_s",
]

BAUDS: Final = (1200, 2400, 4800, 9600, 19200)
LONGEST_S: Final = 65.535
"""The longest watchdog time there is. Source: EDB2102EN 6.3.3 (C1923)."""


@dataclass(frozen=True, slots=True)
class Obstacle:
    """What one drive, watched or not, may put before the feeds of the others once.

    Args:
        drive: The drive.
        failed_s: Its cheapest read, not answered, seconds.
        reads: Its cyclic reads, as usual: what they are, and seconds.
        stop_s: Its stop with the proof, seconds.
    """

    drive: str
    failed_s: float
    reads: tuple[tuple[str, float], ...]
    stop_s: float

    @property
    def under_way_s(self) -> float:
        """The longest exchange with it that may be under way, seconds."""
        return max(self.failed_s, *(time_s for _, time_s in self.reads), 0.0)


@dataclass(frozen=True, slots=True)
class Feeding:
    """What feeding a roster's watchdogs asks of the line.

    Args:
        drives: The watched drives.
        streams: The feed of each, in the same order, with what may stand before it once.
        obstacles: What each drive of the line may put before the others.
        lost_s: What one feed that is not answered costs at most, seconds.
        own_s: For each watched drive, its own longest exchange: meanwhile nothing feeds it.
    """

    drives: tuple[DriveEntry, ...]
    streams: tuple[Stream, ...]
    obstacles: tuple[Obstacle, ...]
    lost_s: float
    own_s: tuple[float, ...]

    @property
    def under_way_s(self) -> float:
        """The longest exchange that may stand before the shortest watchdog's feed, seconds."""
        return under_way_s(self.before(self._tightest))

    def before(self, drive: str) -> tuple[Obstacle, ...]:
        """List what may stand before a drive's feed: all but what is said to itself."""
        return tuple(one for one in self.obstacles if one.drive != drive)

    def overload(self, *, lost: int = 0) -> Overload | None:
        """Find where the feeds do not fit, when so many answers are lost just then."""
        found = find_overload(self.streams, lost * self.lost_s)
        if found is None and load_of(self.streams) > FULL:
            first = min(self.streams, key=_every)
            demand_s = load_of(self.streams) * first.every_s
            return Overload(first.every_s, demand_s, first.blocked_s, first.name)
        return found

    def holds(self, *, lost: int = 0) -> bool:
        """Whether all watchdogs can be held, also beside their own drives' exchanges."""
        fits = all(
            own_s <= one.every_s for own_s, one in zip(self.own_s, self.streams, strict=True)
        )
        return fits and self.overload(lost=lost) is None

    def with_times(self, change: Callable[[float], float]) -> Feeding:
        """Give the same with other watchdog times.

        Args:
            change: Makes the new watchdog time from the old one, seconds.
        """
        streams = tuple(
            replace(one, every_s=HARD_PART * change(one.every_s / HARD_PART))
            for one in self.streams
        )
        return replace(self, streams=streams)

    def with_time(self, number: int, time_s: float) -> Feeding:
        """Give the same with another watchdog time for one drive, by its number."""
        one = replace(self.streams[number], every_s=HARD_PART * time_s)
        return replace(self, streams=(*self.streams[:number], one, *self.streams[number + 1 :]))

    def without_reads(self, longer_than_s: float) -> Feeding:
        """Give the same with the longer cyclic reads in nobody's way."""
        obstacles = tuple(
            replace(one, reads=tuple(read for read in one.reads if read[1] <= longer_than_s))
            for one in self.obstacles
        )
        return _put_together(self.drives, self.streams, obstacles, self.own_s, self.lost_s)

    @property
    def _tightest(self) -> str:
        return min(self.streams, key=_every).name if self.streams else ""


def under_way_s(obstacles: Sequence[Obstacle]) -> float:
    """Give the longest exchange among what may stand in the way, seconds."""
    return max((one.under_way_s for one in obstacles), default=0.0)


def longest_stop_s(obstacles: Sequence[Obstacle]) -> float:
    """Give the longest stop among what may stand in the way, seconds."""
    return max((one.stop_s for one in obstacles), default=0.0)


def feeding_of(roster: Roster, timing: LineTiming | None = None) -> Feeding:
    """Reckon what feeding a roster's watchdogs asks of the line.

    Args:
        roster: The roster.
        timing: The line's times; None: the roster's own.
    """
    timing = timing or line_timing(roster.line)
    watched = [(drive, time_s) for drive in roster.drives if (time_s := watched_s(drive))]
    times = [feed_times(drive, timing) for drive, _ in watched]
    return _put_together(
        tuple(drive for drive, _ in watched),
        tuple(
            Stream(drive.name, one.usual_s, HARD_PART * time_s)
            for (drive, time_s), one in zip(watched, times, strict=True)
        ),
        tuple(_obstacle(drive, timing) for drive in roster.drives),
        tuple(own_longest_s(drive, timing) for drive, _ in watched),
        max((one.worst_s for one in times), default=0.0),
    )


def _obstacle(drive: DriveEntry, timing: LineTiming) -> Obstacle:
    reads = tuple(
        (f"{entry.code} of {drive.name}", read_times(drive, entry.code, timing).usual_s)
        for entry in drive.cyclic
    )
    return Obstacle(drive.name, feed_times(drive, timing).worst_s, reads, stop_s(drive, timing))


def _put_together(
    drives: tuple[DriveEntry, ...],
    streams: tuple[Stream, ...],
    obstacles: tuple[Obstacle, ...],
    own_s: tuple[float, ...],
    lost_s: float,
) -> Feeding:
    """Let each stream know what may stand before it: the longest of all drives but its own."""
    exchanges = _two_longest(obstacles, lambda one: one.under_way_s)
    stops = _two_longest(obstacles, lambda one: one.stop_s)
    blocked = tuple(
        replace(one, blocked_s=_but(one.name, exchanges) + _but(one.name, stops)) for one in streams
    )
    return Feeding(drives, blocked, obstacles, lost_s, own_s)


def _two_longest(
    obstacles: Sequence[Obstacle], of: Callable[[Obstacle], float]
) -> list[tuple[str, float]]:
    ordered = sorted(obstacles, key=of, reverse=True)
    return [(one.drive, of(one)) for one in ordered[:2]]


def _but(drive: str, longest: Sequence[tuple[str, float]]) -> float:
    return next((time_s for name, time_s in longest if name != drive), 0.0)


def least_time_s(feeding: Feeding, *, lost: int = 0, all_alike: bool = False) -> float | None:
    """Give the least time that the watchdogs below it must be raised to so that all are held.

    Args:
        feeding: The feeds as they are.
        lost: So many lost answers in a row are to be outlasted.
        all_alike: All watchdogs shall have that time, also those that are longer.

    Returns:
        The time in seconds, to the millisecond; None if not even the longest will do, or if
        nothing is fed.
    """
    if not feeding.drives:
        return None

    def holds(time_s: float) -> bool:
        def change(old_s: float) -> float:
            return time_s if all_alike else max(old_s, time_s)

        return feeding.with_times(change).holds(lost=lost)

    return smallest(holds, max(lowest_s(drive) for drive in feeding.drives), LONGEST_S)


def lowest_s(drive: DriveEntry) -> float:
    """Give the shortest watchdog time that a drive's family has, seconds."""
    traits = family(drive.family).watchdog
    return traits.low_s if traits else 0.0


def smallest(holds: Callable[[float], bool], low_s: float, high_s: float) -> float | None:
    """Find the smallest whole number of milliseconds that holds; None if the highest does not."""
    low, high = max(round(low_s * 1000), 1), round(high_s * 1000)
    if not holds(high / 1000):
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle / 1000) else (middle + 1, high)
    return high / 1000


def _every(stream: Stream) -> float:
    return stream.every_s
