"""What feeding the watchdogs of a roster takes of the line, and whether that fits.

Every watched drive must be fed within nine tenths of its watchdog time, so its feed is a stream of
work (`demand_bound`). Before a feed may come, once, an exchange with another drive, and one stop of
another drive, which has priority over everything. The exchange counts at its longest, unanswered:
the schedule begins none that could make a feed late, so where that does not fit a drive could not
even be asked whether it is there. If the feeds do not fit behind those, the roster is refused
(`watchdog_feasibility`).

The fault hypothesis: within any watchdog time at most `line.tolerate` answers are lost, in any
exchanges and at any moments. Each costs additional time before the feeds: the line is held until
the answer is given up and for the silence after it, and the exchange is repeated; a drive's own
feed too, because the failed attempt does not feed it. Everything is counted in the longer
addressing form, which is used while the lost answer may still come. Stops, and the time for which a
lost answer of a stop holds the line longer, may use the last tenth of a watchdog time as well: the
running schedule, which cannot foresee them, keeps room only for what that tenth does not hold
(`schedule.FaultHypothesis`). A roster that does not hold that is refused, too. `check` warns
of one in which one more lost answer makes a watchdog act.
Source: H. Aydin: Exact Fault-Sensitive Feasibility Analysis of Real-Time Tasks, IEEE Trans. on
Computers 56 (10), 2007: recovery from at most k faults, of any tasks, added to the demand of work
by earliest deadline (before for fixed priorities: A. Burns, R. Davis, S. Punnekkat: Feasibility
Analysis of Fault-Tolerant Real-Time Task Sets, Euromicro Workshop on Real-Time Systems 1996). Exact
tests for repetitions that cannot be interrupted are intractable, as he shows; this one is
sufficient: every lost answer costs as much as the longest.

Every telegram to a drive feeds it, so a drive does not delay its own feed. What may come before a
feed is therefore calculated for each drive, not only for the one with the shortest time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from operator import attrgetter, itemgetter
from typing import Final

from lecombus.capacity.demand_bound import (
    FULL,
    ROUNDING_S,
    Overload,
    Stream,
    find_overload,
    load_of,
)
from lecombus.capacity.exchange_costs import (
    dearest_feed_times,
    line_timing,
    own_alone_s,
    own_longest_s,
    read_times,
    stop_attempt_s,
    stop_s,
    watched_s,
)
from lecombus.drives import family
from lecombus.fieldbus.costs import LineTiming
from lecombus.roster import DriveEntry, Roster
from lecombus.schedule.watchdog_deadline import HARD_PART, FaultHypothesis

__all__ = [
    "LONGEST_S",
    "DriveDelay",
    "LeftAlone",
    "WatchdogDemand",
    "demand_of",
    "faults_of",
    "least_time_s",
    "longest_stop_s",
    "lowest_s",
    "smallest",
    "under_way_s",
]

LONGEST_S: Final = 65.535
"""The longest watchdog time there is. Source: EDB2102EN 6.3.3 (C1923)."""


@dataclass(frozen=True, slots=True)
class DriveDelay:
    """How long one drive, watched or not, may delay the feeds of the others once.

    Args:
        drive: The drive.
        failed_s: Its cheapest read, not answered, seconds.
        usual_s: The same, answered, seconds.
        reads: Its cyclic reads, as usual: what they are, and seconds.
        stop_s: Its stop with the proof, seconds.
    """

    drive: str
    failed_s: float
    usual_s: float
    reads: tuple[tuple[str, float], ...]
    stop_s: float

    @property
    def answered_s(self) -> float:
        """The longest exchange with it that is answered, seconds."""
        return max(self.usual_s, *(time_s for _, time_s in self.reads), 0.0)

    @property
    def under_way_s(self) -> float:
        """The longest exchange with it that may be under way, seconds."""
        return max(self.failed_s, *(time_s for _, time_s in self.reads), 0.0)


@dataclass(frozen=True, slots=True)
class OtherDelays:
    """How long all other drives may delay one drive's feed once (see `DriveDelay`).

    Args:
        under_way_s: The longest exchange that may be under way.
        answered_s: The longest that is answered.
        failed_s: The longest of the cheapest reads, not answered.
        stop_s: The longest stop with its proof.
    """

    under_way_s: float
    answered_s: float
    failed_s: float
    stop_s: float


@dataclass(frozen=True, slots=True)
class LeftAlone(Overload):
    """A watchdog that does not outlast a write to its drive and what may come before its next feed.

    Args:
        alone_s: The write and the time for which its drive is left alone after it, seconds.
        other_s: A feed of another drive that may be under way then, seconds.
        stop_s: Lost answers and a stop of another drive, less the last tenth, seconds.
    """

    alone_s: float
    other_s: float
    stop_s: float


@dataclass(frozen=True, slots=True)
class WatchdogDemand:
    """What feeding the watchdogs of a roster takes of the line.

    Args:
        drives: The watched drives.
        streams: The feed of each, in the same order, with what may come before it once.
        others: For each watched drive, how long the others may delay its feed.
        delays: How long each drive of the line may delay the others.
        lost_s: What one feed that is not answered costs at most, seconds.
        own_s: For each watched drive, its own longest exchange: nothing else feeds it then.
        alone_s: For each watched drive, how long it is not fed from the beginning of a write on,
            because it is left alone after that (`own_alone_s`).
        faults: The lost answers within any watchdog time that all watchdogs must outlast, and the
            stops for which the running schedule keeps room.
    """

    drives: tuple[DriveEntry, ...]
    streams: tuple[Stream, ...]
    others: tuple[OtherDelays, ...]
    delays: tuple[DriveDelay, ...]
    lost_s: float
    own_s: tuple[float, ...]
    faults: FaultHypothesis
    alone_s: tuple[tuple[float, float], ...]

    @property
    def tolerate(self) -> int:
        """So many lost answers within any watchdog time must be outlasted."""
        return self.faults.tolerate

    def before(self, drive: str) -> tuple[DriveDelay, ...]:
        """List what may delay a drive's feed: the exchanges with all other drives."""
        return tuple(one for one in self.delays if one.drive != drive)

    def alone(self, drive: str) -> float:
        """Give for how long a drive is not fed from the beginning of a usual write on, seconds."""
        names = [one.name for one in self.streams]
        return self.alone_s[names.index(drive)][0]

    def overload(self, *, lost: int | None = None) -> Overload | None:
        """Find where the feeds do not fit when answers are lost within a watchdog time.

        Args:
            lost: How many are lost; None: as many as must be outlasted.
        """
        lost = self.tolerate if lost is None else lost
        found = find_overload(self.streams, 0.0) or self._left_alone(0)
        if found is None and lost and self.streams:
            found = (
                find_overload(self._behind_lost(lost), 0.0)
                or self._left_alone(lost)
                or self._no_room(lost)
            )
        if found is None and load_of(self.streams) > FULL:
            first = min(self.streams, key=_every)
            demand_s = load_of(self.streams) * first.every_s
            return Overload(first.every_s, demand_s, first.blocked_s, first.name)
        return found

    def _left_alone(self, lost: int) -> LeftAlone | None:
        """Find a drive whose watchdog does not outlast its own write, with another's stop behind.

        The line feeds others while it is left alone after that; one of these feeds may be under way
        when the stop comes. The stop may use the last tenth.
        """
        feeds = {one.name: one.cost_s for one in self.streams}
        for one, others, (_, alone_s) in zip(self.streams, self.others, self.alone_s, strict=True):
            tenth_s = one.every_s * (1.0 - HARD_PART) / HARD_PART
            stop_s = max(others.stop_s - tenth_s, 0.0)
            if lost:
                faults, _ = self._losing(lost)
                stop_s = (lost - 1) * self.lost_s + faults.stop_behind_s(self.lost_s, tenth_s)
            other_s = max((cost_s for name, cost_s in feeds.items() if name != one.name), default=0)
            if alone_s and alone_s + other_s + stop_s + one.cost_s > one.every_s + ROUNDING_S:
                blocking_s = alone_s + other_s + stop_s
                return LeftAlone(
                    one.every_s, one.cost_s, blocking_s, one.name, alone_s, other_s, stop_s
                )
        return None

    def _behind_lost(self, lost: int) -> tuple[Stream, ...]:
        """Give the streams with lost answers, and what else may come before each once.

        A feed counts from its beginning, so the time that the one before took passes as well. The
        last tenth holds that, unless a stop takes it. A write, which feeds its drive, may
        have come before instead, with the time for which the drive is left alone after that.
        """
        faults, tenth_s = self._losing(lost)
        more_s = (lost - 1) * self.lost_s
        stop_s = more_s + faults.stop_behind_s(self.lost_s, tenth_s)
        found = []
        for one, others, (alone_s, _) in zip(self.streams, self.others, self.alone_s, strict=True):
            need_s = faults.need_s(others.answered_s, others.failed_s, self.lost_s, tenth_s)
            behind_s = max(need_s, others.answered_s + stop_s + one.cost_s, alone_s + stop_s)
            found.append(replace(one, blocked_s=behind_s))
        return tuple(found)

    def _no_room(self, lost: int) -> Overload | None:
        """Find a stream that leaves no room for an exchange even after all were fed in one go.

        That is when there is most room (`WatchdogSet.most_s`), and the schedule begins none without
        it. Where watchdog times differ by little the feeds before and behind it have to fit.
        """
        faults, tenth_s = self._losing(lost)
        more_s = (lost - 1) * self.lost_s
        at_s = 0.0
        fed = []
        both = zip(self.streams, self.others, strict=True)
        for stream, others in sorted(both, key=lambda pair: pair[0].every_s, reverse=True):
            fed.append((at_s + stream.every_s, at_s, stream, others))
            at_s += stream.cost_s
        total_s = 0.0
        for hard_s, fed_at_s, stream, others in sorted(fed, key=_first):
            total_s += stream.cost_s
            before_s = more_s + faults.least_room_s(
                others.answered_s, others.failed_s, self.lost_s, tenth_s
            )
            if hard_s - total_s - at_s + ROUNDING_S < before_s:
                demand_s = total_s + at_s - fed_at_s
                return Overload(stream.every_s, demand_s, before_s, stream.name)
        return None

    def behind_s(self) -> float:
        """Give the room that is left at least behind any exchange that is answered, seconds."""
        faults, tenth_s = self._losing(self.tolerate)
        return faults.behind_s(self.lost_s, tenth_s)

    def _losing(self, lost: int) -> tuple[FaultHypothesis, float]:
        """Give what is kept room for with so many lost answers, and the shortest's last tenth."""
        shortest_s = min(one.every_s for one in self.streams)
        faults = replace(self.faults, tolerate=lost)
        if len(self.delays) == 1:  # its own stop, if it is answered, feeds it
            faults = replace(faults, stop_s=0.0)
        return faults, shortest_s * (1.0 - HARD_PART) / HARD_PART

    def holds(self, *, lost: int | None = None) -> bool:
        """Whether all watchdogs can be held, also beside their own drives' exchanges."""
        fits = all(
            own_s <= one.every_s for own_s, one in zip(self.own_s, self.streams, strict=True)
        )
        return fits and self.overload(lost=lost) is None

    def with_times(self, change: Callable[[float], float]) -> WatchdogDemand:
        """Give the same with other watchdog times.

        Args:
            change: Makes the new watchdog time from the old one, seconds.
        """
        streams = tuple(
            replace(one, every_s=HARD_PART * change(one.every_s / HARD_PART))
            for one in self.streams
        )
        return replace(self, streams=streams)

    def with_time(self, number: int, time_s: float) -> WatchdogDemand:
        """Give the same with another watchdog time for one drive, by its number."""
        one = replace(self.streams[number], every_s=HARD_PART * time_s)
        return replace(self, streams=(*self.streams[:number], one, *self.streams[number + 1 :]))

    def without_reads(self, longer_than_s: float) -> WatchdogDemand:
        """Give the same without the longer cyclic reads."""
        delays = tuple(
            replace(one, reads=tuple(read for read in one.reads if read[1] <= longer_than_s))
            for one in self.delays
        )
        return _put_together(
            self.drives, self.streams, delays, self.own_s, self.lost_s, self.faults, self.alone_s
        )


def under_way_s(delays: Sequence[DriveDelay]) -> float:
    """Give the longest exchange among the delays, seconds."""
    return max((one.under_way_s for one in delays), default=0.0)


def longest_stop_s(delays: Sequence[DriveDelay]) -> float:
    """Give the longest stop among the delays, seconds."""
    return max((one.stop_s for one in delays), default=0.0)


def demand_of(roster: Roster, timing: LineTiming | None = None) -> WatchdogDemand:
    """Calculate what feeding the watchdogs of a roster takes of the line.

    Args:
        roster: The roster.
        timing: The line's times; None: the roster's own.
    """
    timing = timing or line_timing(roster.line)
    watched = [(drive, time_s) for drive in roster.drives if (time_s := watched_s(drive))]
    times = [dearest_feed_times(drive, timing) for drive, _ in watched]
    return _put_together(
        tuple(drive for drive, _ in watched),
        tuple(
            Stream(drive.name, one.usual_s, HARD_PART * time_s)
            for (drive, time_s), one in zip(watched, times, strict=True)
        ),
        tuple(_obstacle(drive, timing) for drive in roster.drives),
        tuple(own_longest_s(drive, timing) for drive, _ in watched),
        max((one.worst_s for one in times), default=0.0),
        faults_of(roster, timing),
        tuple(own_alone_s(drive, timing) for drive, _ in watched),
    )


def faults_of(roster: Roster, timing: LineTiming) -> FaultHypothesis:
    """Give the lost answers and stops for which the schedule keeps room, as the test does."""
    return FaultHypothesis(
        roster.line.tolerate,
        max((stop_s(drive, timing) for drive in roster.drives), default=0.0),
        max((stop_attempt_s(drive, timing) for drive in roster.drives), default=0.0),
    )


def _obstacle(drive: DriveEntry, timing: LineTiming) -> DriveDelay:
    of = family(drive.family)
    reads = tuple(
        (f"{of.spoken(entry.code)} of {drive.name}", read_times(drive, entry.code, timing).usual_s)
        for entry in drive.cyclic
    )
    feed = dearest_feed_times(drive, timing)
    return DriveDelay(drive.name, feed.worst_s, feed.usual_s, reads, stop_s(drive, timing))


def _put_together(
    drives: tuple[DriveEntry, ...],
    streams: tuple[Stream, ...],
    delays: tuple[DriveDelay, ...],
    own_s: tuple[float, ...],
    lost_s: float,
    faults: FaultHypothesis,
    alone_s: tuple[tuple[float, float], ...],
) -> WatchdogDemand:
    """Give each stream the longest delay by all drives but its own."""
    others = _others(delays, [one.name for one in streams])
    blocked = tuple(
        replace(one, blocked_s=before.under_way_s + before.stop_s)
        for one, before in zip(streams, others, strict=True)
    )
    return WatchdogDemand(drives, blocked, others, delays, lost_s, own_s, faults, alone_s)


def _others(delays: Sequence[DriveDelay], names: Sequence[str]) -> tuple[OtherDelays, ...]:
    """Give, for each drive, the longest delays by all drives but itself."""
    longest = []
    for what in (field.name for field in fields(OtherDelays)):
        of = attrgetter(what)
        two = sorted(delays, key=of, reverse=True)[:2]
        longest.append([(one.drive, of(one)) for one in two])
    return tuple(
        OtherDelays(*(next((s for drive, s in two if drive != name), 0.0) for two in longest))
        for name in names
    )


def least_time_s(
    demand: WatchdogDemand, *, lost: int | None = None, all_alike: bool = False
) -> float | None:
    """Give the least time that the watchdogs below it must be raised to so that all are held.

    Args:
        demand: The feeds as they are.
        lost: Lost answers to outlast; None: as the roster says.
        all_alike: All watchdogs shall have that time, also those that are longer.

    Returns:
        The time in seconds, to the millisecond; None if not even the longest will do, or if
        nothing is fed.
    """
    if not demand.drives:
        return None

    def holds(time_s: float) -> bool:
        def change(old_s: float) -> float:
            return time_s if all_alike else max(old_s, time_s)

        return demand.with_times(change).holds(lost=lost)

    return smallest(holds, max(lowest_s(drive) for drive in demand.drives), LONGEST_S)


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


_first = itemgetter(0)
