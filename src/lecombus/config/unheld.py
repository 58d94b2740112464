"""Rosters whose watchdogs a line cannot hold: which, by what arithmetic, and what would do.

Every remedy that is offered has been tried: the roster with that time, at that baud rate or
without those reads passes the same test (`feeding`).

What must not live here: the test itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from lecombus.config.exchanges import watched_s
from lecombus.config.feeding import (
    BAUDS,
    Feeding,
    feeding_of,
    least_time_s,
    longest_stop_s,
    under_way_s,
)
from lecombus.config.models import DriveEntry, Roster
from lecombus.config.timing import line_timing
from lecombus.durations import format_duration
from lecombus.schedule.demand import Overload
from lecombus.schedule.feed import HARD_PART

__all__ = ["Unheld", "find_unheld", "written_up"]


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


def find_unheld(roster: Roster) -> list[Unheld]:
    """Find the watchdogs that cannot be held; each is named with what would do."""
    feeding = feeding_of(roster)
    overload = feeding.overload()
    if overload is None:
        return list(_too_slow(feeding, roster.line.baud))
    least_s = least_time_s(feeding)
    right = _remedy(roster, feeding, least_s)
    return [
        Unheld(drive.name, _arithmetic(drive, feeding, overload, roster.line.baud), right)
        for drive in feeding.drives
        if least_s is None or (watched_s(drive) or math.inf) < least_s
    ]


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


def _arithmetic(drive: DriveEntry, feeding: Feeding, overload: Overload, baud: int) -> str:
    time_s = watched_s(drive) or 0.0
    counted = sum(1 for stream in feeding.streams if stream.every_s <= overload.within_s + 1e-9)
    feeds = "1 feed" if counted == 1 else f"the feeds of {counted} drives"
    before = feeding.before(overload.whose)
    behind, lost = "", ""
    if feeding.overload(lost=0) is None:
        lost = f" if {_answers(feeding.tolerate)} lost"
        stop = _ms(longest_stop_s(before))
        behind = (
            f" behind {_ms(overload.blocking_s)}: an exchange, {feeding.tolerate} times "
            f"{_ms(feeding.lost_s)} for a lost answer, a stop ({stop}) as far as the last tenth of "
            "the time does not hold it"
        )
    elif before:
        behind = (
            f" behind one exchange that fails ({_ms(under_way_s(before))}) and one stop "
            f"({_ms(longest_stop_s(before))})"
        )
    return (
        f"a watchdog of {format_duration(time_s)} cannot be held at {baud} baud{lost}: within "
        f"{_ms(overload.within_s)} the line would have to carry {feeds} ({_ms(overload.demand_s)})"
        f"{behind}"
    )


def _answers(count: int) -> str:
    return "1 answer is" if count == 1 else f"{count} answers are"


def _remedy(roster: Roster, feeding: Feeding, least_s: float | None) -> str:
    ways: list[str] = []
    if least_s is not None:
        ways.append(f"a time of {written_up(least_s)} or more")
    baud = next((baud for baud in BAUDS if baud > roster.line.baud and _holds(roster, baud)), None)
    if baud is not None:
        ways.append(f"baud: {baud}")
    ways.extend(_fewer_reads(feeding))
    ways.append("fewer watched drives on this line")
    least = next((one for one in range(feeding.tolerate) if feeding.holds(lost=one)), None)
    if least is not None:
        ways.append(f"tolerate: {least}")
    return f"{' or '.join(ways)} would do"


def _holds(roster: Roster, baud: int) -> bool:
    line = roster.line.model_copy(update={"baud": baud})
    return feeding_of(roster, line_timing(line)).holds()


def _fewer_reads(feeding: Feeding) -> Iterator[str]:
    """Say if it is long cyclic reads that stand in the way."""
    failed_s = max(one.failed_s for one in feeding.obstacles)
    if feeding.without_reads(failed_s).overload() is not None:
        return
    long = [what for one in feeding.obstacles for what, time_s in one.reads if time_s > failed_s]
    if long:
        shown = ", ".join(long[:4]) + (" .." if len(long) > 4 else "")
        yield f"not reading {shown} cyclically"


def written_up(seconds: float) -> str:
    """Write a time rounded up to 10 ms or, from a second on, to tenths: it must still do."""
    step = 0.01 if seconds < 1.0 else 0.1
    return format_duration(round(math.ceil(round(seconds / step, 6)) * step, 3))


def _ms(seconds: float) -> str:
    return f"{seconds * 1000:.0f}ms"
