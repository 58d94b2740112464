"""How long each class of requests waits at worst on one line.

Method: non-preemptive response-time analysis (`schedule.demand`, with its papers). What counts
against a request is what the schedule may really do before it: the exchange under way with its
time-out and the silence after it; every feed that can come meanwhile, at the shortest distance at
which the schedule repeats feeds; and what other classes may take by their shares, the credit they
have saved up included.

Two bounds are given. *Quiet*: one request at a time, nobody else asking, no drive being audited.
*Loaded*: every lower class is full, and the exchange under way is the longest that the drives'
descriptions know, such as a module's own codes during an audit. Requests of the same class and of
classes above come on top in both: how many there are is up to the clients.

The bounds hold while the drives answer and at most the exchange under way is lost.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from lecombus.config import DriveEntry, Roster
from lecombus.config.exchanges import Times, feed_times, read_times, watched_s
from lecombus.drives import LineTiming, family
from lecombus.protocol.addressing import Code
from lecombus.schedule import Priority
from lecombus.schedule.demand import Stream, response_s
from lecombus.schedule.feeds import HARD_PART, SOFT_PART, SPARE_ATTEMPTS
from lecombus.schedule.shares import CLASS_SHARES, CREDIT_EXCHANGES

__all__ = ["ClassWait", "Longest", "class_waits", "longest_exchange"]

LATENESS_S: Final = 0.002
"""What an idle machine adds between two telegrams, p99."""


@dataclass(frozen=True, slots=True)
class Longest:
    """The longest exchange a line can be asked for.

    Args:
        what: Such as `C1923 of feeder`.
        times: Its line time.
    """

    what: str
    times: Times


@dataclass(frozen=True, slots=True)
class ClassWait:
    """What one class is promised; infinite where nothing can be promised.

    Args:
        name: The class.
        quiet_s: From a request until its telegram begins, nobody else asking.
        loaded_s: The same with every lower class full and drives being audited.
        own_s: What its own exchange then takes at most.
        counts: What the bounds consist of, in words.
    """

    name: str
    quiet_s: float
    loaded_s: float
    own_s: float
    counts: str


@dataclass(frozen=True, slots=True)
class _Ahead:
    """What goes before a class.

    Args:
        above: Streams that go first whenever they are there.
        quiet: Classes that take their share even if no client asks.
        loaded: Classes that take their share when clients ask for more than the line can do.
        counts: In words.
    """

    above: tuple[Stream, ...]
    quiet: tuple[Priority, ...]
    loaded: tuple[Priority, ...]
    counts: str


def longest_exchange(roster: Roster, timing: LineTiming, *, any_code: bool) -> Longest:
    """Find the longest exchange a line can be asked for.

    Args:
        roster: The line.
        timing: Its times.
        any_code: Of all codes the drives are described to have; else of those that the line
            reads and feeds by anyhow.
    """
    found = [
        Longest(f"{code} of {drive.name}", read_times(drive, code, timing))
        for drive in roster.drives
        for code in _codes(drive, any_code)
    ]
    return max(found, key=lambda one: one.times.worst_s)


def _codes(drive: DriveEntry, any_code: bool) -> set[Code]:
    of = family(drive.family)
    codes = {of.feed_code, *(entry.code for entry in drive.cyclic)}
    if any_code:
        codes.update(info.code for info in of.described() if info.readable)
    return {code for code in codes if any(code.knows(form) for form in drive.forms)}


def class_waits(roster: Roster, timing: LineTiming, stop_line_s: float) -> list[ClassWait]:
    """Give the promise to every class, the highest first.

    Args:
        roster: The line.
        timing: Its times.
        stop_line_s: The line time of one stop with its proof, seconds.
    """
    usual = longest_exchange(roster, timing, any_code=False)
    longest = longest_exchange(roster, timing, any_code=True)
    feeds = tuple(_feeds(roster, timing))
    cyclic = (*_cyclic(roster, timing), *_feeds_beside(roster, timing))
    piece_s = max((stream.cost_s for stream in (*feeds, *cyclic)), default=0.0)
    waits = [_stop(usual, longest, timing, stop_line_s)]
    for name, ahead in _ahead(feeds, cyclic).items():
        quiet_s = _wait(usual.times.worst_s, piece_s, ahead.above, ahead.quiet)
        loaded_s = _wait(longest.times.worst_s, piece_s, ahead.above, ahead.loaded)
        waits.append(ClassWait(name, quiet_s, loaded_s, usual.times.worst_s, ahead.counts))
    waits.insert(2, _watchdog(roster))
    return waits


def _ahead(feeds: tuple[Stream, ...], cyclic: tuple[Stream, ...]) -> dict[str, _Ahead]:
    asked, read, idle = Priority.INTERACTIVE, Priority.CYCLIC, Priority.BACKGROUND
    return {
        "control": _Ahead(
            feeds, (read,), (asked, read, idle),
            "the exchange under way, feeds, and what lower classes take by their shares",
        ),
        "interactive": _Ahead(
            feeds, (read,), (read, idle),
            "the exchange under way, feeds, and what lower classes take by their shares",
        ),
        "cyclic": _Ahead(
            cyclic, (), (idle,),
            "how late a slot may be: the exchange under way and all other reads and feeds once",
        ),
        "background": _Ahead(
            cyclic, (), (),
            "as for cyclic; behind clients it has a twentieth of the line",
        ),
    }  # fmt: skip


def _stop(usual: Longest, longest: Longest, timing: LineTiming, stop_line_s: float) -> ClassWait:
    more_s = timing.turnaround_s + LATENESS_S
    return ClassWait(
        "stop", usual.times.given_up_s + more_s, longest.times.given_up_s + more_s, stop_line_s,
        f"the exchange under way until it is given up (at most {longest.what}); other drives' "
        "stops that came before add theirs",
    )  # fmt: skip


def _watchdog(roster: Roster) -> ClassWait:
    """A feed is no request that waits: its promise is that it is over in time."""
    times = [time_s for drive in roster.drives if (time_s := watched_s(drive))]
    if not times:
        return ClassWait("watchdog", math.inf, math.inf, 0.0, "no watchdog is fed")
    over_s = HARD_PART * min(times)
    text = "a feed is over at nine tenths of its watchdog time; shown is the shortest's"
    return ClassWait("watchdog", over_s, over_s, 0.0, text)


def _wait(
    under_way_s: float, piece_s: float, above: Sequence[Stream], sharing: Sequence[Priority]
) -> float:
    """Bound a wait beside classes that take their shares of the line for as long as it lasts."""
    left = 1.0 - sum(CLASS_SHARES[one] for one in sharing)
    once_s = under_way_s + len(sharing) * CREDIT_EXCHANGES * piece_s
    slower = [Stream(one.name, one.cost_s / left, one.every_s) for one in above]
    return response_s(0.0, once_s / left, slower)


def _feeds(roster: Roster, timing: LineTiming) -> Iterator[Stream]:
    """Give the feeds at the shortest distance at which the schedule repeats them."""
    for drive in roster.drives:
        time_s = watched_s(drive)
        if time_s is not None:
            times = feed_times(drive, timing)
            early_s = HARD_PART * time_s - SPARE_ATTEMPTS * times.worst_s
            yield Stream(drive.name, times.usual_s, max(SOFT_PART * time_s, early_s))


def _feeds_beside(roster: Roster, timing: LineTiming) -> Iterator[Stream]:
    """Give the feeds that the cyclic reads of the same drive do not stand for."""
    for drive in roster.drives:
        time_s = watched_s(drive)
        rate = sum(1.0 / entry.every_s for entry in drive.cyclic)
        if time_s is not None and (missing := 1.0 / (HARD_PART * time_s) - rate) > 0.0:
            yield Stream(drive.name, feed_times(drive, timing).usual_s, 1.0 / missing)


def _cyclic(roster: Roster, timing: LineTiming) -> Iterator[Stream]:
    for drive in roster.drives:
        for entry in drive.cyclic:
            usual_s = read_times(drive, entry.code, timing).usual_s
            yield Stream(f"{entry.code} of {drive.name}", usual_s, entry.every_s)
