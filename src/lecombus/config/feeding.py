"""Whether a line can hold the watchdogs of a roster, and what would do where it cannot.

Every watched drive must have been spoken to within nine tenths of its watchdog time, so its feed
is a stream of work (`schedule.demand`). What stands before the feeds once is an exchange with
another drive, and one stop, which goes before everything and waits for nobody. The exchange counts
at its longest, unanswered: the schedule begins none that could make a feed late, so where that does
not fit a drive could not even be asked whether it is there. If the feeds do not fit behind those,
the roster is refused. One in which a further lost answer makes a watchdog act is worth a warning.

What must not live here: costs (`exchanges`), the schedule's choices.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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
from lecombus.drives import LineTiming
from lecombus.durations import format_duration
from lecombus.schedule.demand import FULL, Overload, Stream, find_overload, load_of
from lecombus.schedule.feeds import HARD_PART

__all__ = [
    "Feeding",
    "Unheld",
    "feeding_of",
    "find_unheld",
    "least_time_s",
    "written_up",
]

BAUDS: Final = (1200, 2400, 4800, 9600, 19200)
LONGEST_S: Final = 65.535
"""The longest watchdog time there is. Source: EDB2102EN 6.3.3 (C1923)."""
STEP_S: Final = 0.001


@dataclass(frozen=True, slots=True)
class Feeding:
    """What feeding a roster's watchdogs asks of the line.

    Args:
        drives: The watched drives.
        streams: The feed of each, in the same order.
        under_way_s: The longest that may be under way with another drive: one of the roster's
            reads, or a feed that is not answered; seconds.
        stop_s: The longest stop of another drive with its proof, seconds.
        lost_s: What one feed that is not answered costs at most, seconds.
        own_s: For each drive, its own longest exchange: meanwhile nothing feeds it, seconds.
    """

    drives: tuple[DriveEntry, ...]
    streams: tuple[Stream, ...]
    under_way_s: float
    stop_s: float
    lost_s: float
    own_s: tuple[float, ...]

    @property
    def blocking_s(self) -> float:
        """What may stand before the feeds once, seconds."""
        return self.under_way_s + self.stop_s

    def overload(self, *, lost: int = 0) -> Overload | None:
        """Find where the feeds do not fit, when so many answers are lost just then."""
        return _overload(self.streams, self.blocking_s + lost * self.lost_s)

    def with_times(self, change: Callable[[float], float]) -> tuple[Stream, ...]:
        """Give the streams with other watchdog times.

        Args:
            change: Makes the new watchdog time from the old one, seconds.
        """
        return tuple(
            Stream(one.name, one.cost_s, HARD_PART * change(one.every_s / HARD_PART))
            for one in self.streams
        )


@dataclass(frozen=True, slots=True)
class Unheld:
    """A watchdog that cannot be held.

    Args:
        drive: The drive.
        what: What is wrong, with the arithmetic.
        right: What would do.
    """

    drive: str
    what: str
    right: str


def feeding_of(roster: Roster, timing: LineTiming | None = None) -> Feeding:
    """Reckon what feeding a roster's watchdogs asks of the line.

    Args:
        roster: The roster.
        timing: The line's times; None: the roster's own.
    """
    timing = timing or line_timing(roster.line)
    watched = [(drive, time_s) for drive in roster.drives if (time_s := watched_s(drive))]
    times = [feed_times(drive, timing) for drive, _ in watched]
    others = _others(roster, watched)
    asked = [
        read_times(drive, entry.code, timing).usual_s for drive in others for entry in drive.cyclic
    ]
    asked.extend(feed_times(drive, timing).worst_s for drive in others)
    return Feeding(
        drives=tuple(drive for drive, _ in watched),
        streams=tuple(
            Stream(drive.name, one.usual_s, HARD_PART * time_s)
            for (drive, time_s), one in zip(watched, times, strict=True)
        ),
        under_way_s=max(asked, default=0.0),
        stop_s=max((stop_s(drive, timing) for drive in others), default=0.0),
        lost_s=max((one.worst_s for one in times), default=0.0),
        own_s=tuple(own_longest_s(drive, timing) for drive, _ in watched),
    )


def _others(roster: Roster, watched: Sequence[tuple[DriveEntry, float]]) -> list[DriveEntry]:
    """List the drives that can stand in the way: all but the one with the shortest watchdog.

    What is said to that one feeds it.
    """
    tightest = min(watched, key=lambda one: one[1])[0] if watched else None
    return [drive for drive in roster.drives if drive is not tightest]


def find_unheld(roster: Roster) -> list[Unheld]:
    """Find the watchdogs that cannot be held; each is named with what would do."""
    feeding = feeding_of(roster)
    overload = feeding.overload()
    if overload is None:
        return list(_too_slow(feeding, roster.line.baud))
    least_s = least_time_s(feeding)
    baud = next((baud for baud in BAUDS if baud > roster.line.baud and _holds(roster, baud)), None)
    return [
        Unheld(drive.name, _arithmetic(drive, feeding, overload, roster.line.baud),
               _remedy(roster, feeding, least_s, baud))
        for drive in feeding.drives
        if least_s is None or (watched_s(drive) or math.inf) < least_s
    ]  # fmt: skip


def _too_slow(feeding: Feeding, baud: int) -> Iterator[Unheld]:
    """Find the drives that one exchange of their own keeps from being fed."""
    for drive, stream, own_s in zip(feeding.drives, feeding.streams, feeding.own_s, strict=True):
        if own_s > stream.every_s:
            time_s = format_duration(watched_s(drive) or 0.0)
            yield Unheld(
                drive.name,
                f"a watchdog of {time_s} cannot be held at {baud} baud: one exchange with this "
                f"drive, such as its stop, takes {_ms(own_s)}, and nothing feeds it meanwhile",
                f"a time of {written_up(own_s / HARD_PART)} or more would do",
            )


def least_time_s(feeding: Feeding, *, lost: int = 0) -> float | None:
    """Give the least time that the watchdogs below it must be raised to so that all are held.

    Args:
        feeding: The feeds as they are.
        lost: So many lost answers in a row are to be outlasted.

    Returns:
        The time in seconds, to the millisecond; None if not even the longest will do.
    """
    blocking_s = feeding.blocking_s + lost * feeding.lost_s

    def holds(time_s: float) -> bool:
        raised = feeding.with_times(lambda old_s: max(old_s, time_s))
        return _overload(raised, blocking_s) is None

    return smallest(holds, STEP_S, LONGEST_S)


def smallest(holds: Callable[[float], bool], low_s: float, high_s: float) -> float | None:
    """Find the smallest whole number of milliseconds that holds; None if the highest does not."""
    low, high = round(low_s * 1000), round(high_s * 1000)
    if not holds(high / 1000):
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle / 1000) else (middle + 1, high)
    return high / 1000


def written_up(seconds: float) -> str:
    """Write a time rounded up to 10 ms or, from a second on, to tenths: it must still do."""
    step = 0.01 if seconds < 1.0 else 0.1
    return format_duration(round(math.ceil(round(seconds / step, 6)) * step, 3))


def _overload(streams: Sequence[Stream], blocking_s: float) -> Overload | None:
    found = find_overload(streams, blocking_s)
    if found is None and load_of(streams) > FULL:
        first = min(streams, key=lambda stream: stream.every_s)
        return Overload(first.every_s, load_of(streams) * first.every_s, blocking_s, first.name)
    return found


def _holds(roster: Roster, baud: int) -> bool:
    line = roster.line.model_copy(update={"baud": baud})
    return feeding_of(roster, line_timing(line)).overload() is None


def _arithmetic(drive: DriveEntry, feeding: Feeding, overload: Overload, baud: int) -> str:
    time_s = watched_s(drive) or 0.0
    counted = sum(1 for stream in feeding.streams if stream.every_s <= overload.within_s + 1e-9)
    feeds = "1 feed" if counted == 1 else f"the feeds of {counted} drives"
    behind = ""
    if feeding.blocking_s:
        behind = (
            f" behind one exchange that fails ({_ms(feeding.under_way_s)}) and one stop "
            f"({_ms(feeding.stop_s)})"
        )
    return (
        f"a watchdog of {format_duration(time_s)} cannot be held at {baud} baud: within "
        f"{_ms(overload.within_s)} the line would have to carry {feeds} ({_ms(overload.demand_s)})"
        f"{behind}"
    )


def _remedy(roster: Roster, feeding: Feeding, least_s: float | None, baud: int | None) -> str:
    ways: list[str] = []
    if least_s is not None:
        ways.append(f"a time of {written_up(least_s)} or more")
    if baud is not None:
        ways.append(f"baud: {baud}")
    ways.extend(_fewer_reads(roster, feeding))
    ways.append("fewer watched drives on this line")
    return f"{' or '.join(ways)} would do"


def _fewer_reads(roster: Roster, feeding: Feeding) -> Iterator[str]:
    """Say if it is one long cyclic read that stands in the way."""
    timing = line_timing(roster.line)
    feed_s = feeding.lost_s
    if _overload(feeding.streams, feed_s + feeding.stop_s) is not None:
        return
    long = [
        f"{entry.code} of {drive.name}"
        for drive in roster.drives
        for entry in drive.cyclic
        if read_times(drive, entry.code, timing).usual_s > feed_s
        and _overload(
            feeding.streams, read_times(drive, entry.code, timing).usual_s + feeding.stop_s
        )
    ]
    if long:
        shown = ", ".join(long[:4]) + (" .." if len(long) > 4 else "")
        yield f"not reading {shown} cyclically"


def _ms(seconds: float) -> str:
    return f"{seconds * 1000:.0f}ms"
