"""What can be sent before a request on one line, in seconds of line time: `waits` adds it up.

* The exchange under way, at its longest: not answered, its answer as slow as possible, and the
  silence kept after it. The schedule begins none that could make a feed late, so one that would
  last longer than the watchdogs leave time for is not among them, unless it is a feed itself.
* Feeds. Those of the drives that their cyclic reads feed often enough never press on a quiet line.
* Cyclic reads. These and the feeds are counted in the dearer addressing form, because after a lost
  answer a late one could pass for one in the usual form, and with the millisecond that an
  adapter adds in its low latency mode.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

from lecombus.capacity.demand_bound import Stream
from lecombus.capacity.exchange_costs import (
    Times,
    dearest_feed_times,
    dearest_read_times,
    read_times,
    watched_s,
    write_times,
)
from lecombus.capacity.load import load_on
from lecombus.capacity.timeline import preview
from lecombus.capacity.watchdog_demand import faults_of
from lecombus.drives import CodeInfo, family, stop_value
from lecombus.fieldbus.costs import LineTiming
from lecombus.parameters import Code, Format, Value
from lecombus.roster import DriveEntry, Roster
from lecombus.schedule import Outcome, Priority, Request, WatchdogFeeding
from lecombus.schedule.watchdog_deadline import (
    HARD_PART,
    SOFT_PART,
    SPARE_ATTEMPTS,
    WatchdogDeadline,
)
from lecombus.schedule.watchdog_set import WatchdogSet

__all__ = ["Blocking", "Longest", "Room", "WorkAhead", "feeds_of", "work_ahead_on"]

LOW_LATENCY_S: Final = 0.001
"""What an adapter in its low latency mode adds to an answer."""


@dataclass(frozen=True, slots=True)
class Longest:
    """The longest exchange of some.

    Args:
        drive: With whom; empty: there is none.
        code: The code read or written, as the drive's keypad names it.
        times: Its line time.
        value: What is written; None: it is a read.
    """

    drive: str
    code: str
    times: Times
    value: Value | None = None

    @property
    def what(self) -> str:
        """Say what it is, such as `C1923 of feeder`."""
        return f"{self.code} of {self.drive}"

    @property
    def takes_s(self) -> float:
        """How long it holds the line at most, seconds; infinite: no promise, as there is none."""
        return self.times.worst_s if self.drive else math.inf


NO_EXCHANGE: Final = Longest("", "", Times(0.0, 0.0, 0.0))


@dataclass(frozen=True, slots=True)
class Blocking:
    """An exchange that the line makes by itself, under way when something else is due.

    Args:
        worst_s: How long it holds the line when it is not answered, seconds.
        saved_s: So much less is due behind it: nothing where it must be repeated because a
            watchdog asks for it, seconds.
        every_s: It is due again after that, seconds; infinite: a feed.
    """

    worst_s: float
    saved_s: float
    every_s: float = math.inf


@dataclass(frozen=True, slots=True)
class Room:
    """What it takes to make room for an exchange beside the feeds.

    Args:
        most_s: The longest exchange that there is ever room for, seconds; infinite: no feeds.
        round_s: Feeding every drive once, seconds.
        alike: All watchdogs have the same time: one round makes room for the longest.
        answered_s: The longest exchange, answered, that leaves room for a stop with a lost answer;
            one that takes longer is not begun.
        failed_s: The longest exchange, not answered, that leaves room for a stop; likewise.
        behind_answered_s: So much room is waited for behind an exchange that is answered, for what
            may be lost then, seconds.
        behind_failed_s: And behind one that is not answered, seconds.
    """

    most_s: float
    round_s: float
    alike: bool
    answered_s: float = math.inf
    failed_s: float = math.inf
    behind_answered_s: float = 0.0
    behind_failed_s: float = 0.0

    def need_s(self, times: Times) -> float:
        """Return for how much room the schedule waits before it begins an exchange, seconds.

        It is more than its own lost answer takes: what may be lost behind it has room, too.
        """
        answered_s = times.usual_s + self.behind_answered_s
        return max(answered_s, times.worst_s + self.behind_failed_s)

    @property
    def sure_s(self) -> float:
        """The most room that is made within a known time, seconds.

        Where watchdogs differ, short ones come round again while the long ones are fed.
        """
        return self.most_s if self.alike else self.most_s / 2.0


@dataclass(frozen=True, slots=True)
class WorkAhead:
    """What can go before a request.

    Args:
        own: The longest exchange of those the line makes by itself: cyclic reads and feeds.
        read: The longest read that the drives' descriptions know.
        write: The longest write.
        control: The longest write that is a setpoint, a control word or a stop.
        anything: The longest of all, also of those that the watchdogs of the others leave no time
            for: while these are late or away, such a one is begun.
        feeds: All feeds; each has to be over once in `every_s`, counted from its last one.
        beside: Those that the cyclic reads of the same drive do not stand for; they are due again
            after `every_s`.
        cyclic: The cyclic reads.
        blocking: Each of the cyclic reads and of the feeds beside them as the exchange under way.
        reads_s: By watched drive that is read cyclically: its shortest period, seconds.
        lost_feed_s: How long a feed that is not answered holds the line at most, seconds.
        spare_s: The slack at which feeds press.
        late_answer_s: For so long after a lost exchange a late answer may come, seconds.
        one_form: The cyclic reads of each code that several drives are asked for, in one form
            only: when one of them is lost the others wait until no late answer may come.
        load: The share of the line that reads and feeds take in the long run.
        stretch: The factor by which cyclic periods grow then.
        room: What it takes to make room for an exchange beside the feeds.
        alone_s: The longest that a drive is left alone after a write, seconds.
    """

    own: Longest
    read: Longest
    write: Longest
    control: Longest
    anything: Longest
    feeds: tuple[Stream, ...]
    beside: tuple[Stream, ...]
    cyclic: tuple[Stream, ...]
    blocking: tuple[Blocking, ...]
    reads_s: Mapping[str, float]
    lost_feed_s: float
    spare_s: float
    late_answer_s: float
    one_form: tuple[tuple[Stream, ...], ...]
    load: float
    stretch: float
    room: Room
    alone_s: float

    @property
    def once_read_s(self) -> float:
        """Sum of one feed of each drive that needs feeds besides its cyclic reads."""
        return sum(one.cost_s for one in self.beside if one.name in self.reads_s)

    @property
    def any_exchange(self) -> Longest:
        """The longest exchange that any client can ask for."""
        return max(self.own, self.read, self.write, key=_worst)


def work_ahead_on(roster: Roster, timing: LineTiming) -> WorkAhead:
    """Gather what can go before a request on a line."""
    feeds = feeds_of(roster, timing)
    drives = roster.drives
    by_drive = [
        (list(_own(drive, timing)), list(_reads(drive, timing)), list(_writes(drive, timing)))
        for drive in drives
    ]
    own, reads, writes = (
        [one for found in column for one in found] for column in zip(*by_drive, strict=True)
    )
    families = {drive.name: family(drive.family) for drive in drives}
    moves = [one for one in writes if (info := families[one.drive].info(one.code)) and info.motion]
    is_read = any(drive.cyclic for drive in drives)
    stretch = preview(roster, timing).stretch if is_read else 1.0
    everything = (one for found in by_drive for column in found for one in column)
    return WorkAhead(
        own=max([_longest(feeds, own), *_fed(roster, timing)], key=_worst),
        read=_longest(feeds, reads),
        write=_longest(feeds, writes),
        control=_longest(feeds, moves),
        anything=max(everything, key=_given_up),
        feeds=tuple(_streams(roster, timing)),
        beside=tuple(_beside(roster, timing)),
        cyclic=tuple(_cyclic(roster, timing)),
        blocking=tuple(_blocking(roster, timing)),
        reads_s={
            drive.name: min(entry.every_s for entry in drive.cyclic)
            for drive in drives
            if drive.cyclic and watched_s(drive)
        },
        lost_feed_s=max((one.worst_s for one in feeds.by_drive.values()), default=0.0),
        spare_s=feeds.spare_s(),
        late_answer_s=max(roster.line.late_answer_s - timing.quarantine_s, 0.0),
        one_form=tuple(_one_form(roster, timing)),
        load=load_on(drives, timing).total if stretch <= 1.0 else 1.0,
        stretch=stretch,
        room=_room(feeds),
        alone_s=max((family(drive.family).hold_after_write_s for drive in drives), default=0.0),
    )


def _longest(feeds: WatchdogSet, found: Iterable[Longest]) -> Longest:
    """Find the longest exchange that is ever begun: there is room for it, or it goes as a feed."""
    most_s: dict[str, float] = {}
    begun = []
    for one in found:
        if one.drive not in most_s:
            most_s[one.drive] = feeds.most_s(one.drive)[0]
        room_s = feeds.least_room_s(one.times.usual_s, one.times.worst_s)
        if room_s <= most_s[one.drive] or _is_feed(feeds, one):
            begun.append(one)
    return max(begun, key=_worst, default=NO_EXCHANGE)


def _is_feed(feeds: WatchdogSet, one: Longest) -> bool:
    """Whether it stands for a feed of its drive, for which no room is asked."""
    feed = feeds.by_drive.get(one.drive)
    longest_s = (0.0, 0.0) if feed is None else (feed.cost_s, feed.worst_s)
    return one.times.usual_s <= longest_s[0] and one.times.worst_s <= longest_s[1]


def feeds_of(roster: Roster, timing: LineTiming) -> WatchdogSet:
    """Put the watchdogs into the schedule's own sums."""
    feeds = WatchdogSet(faults_of(roster, timing))
    for drive in roster.drives:
        time_s = watched_s(drive)
        if time_s is not None:
            times = dearest_feed_times(drive, timing)
            request = Request(
                drive.name, Priority.WATCHDOG, times.usual_s, times.worst_s, _never_ended
            )
            feeds.by_drive[drive.name] = WatchdogDeadline(
                drive.name, WatchdogFeeding(time_s, partial(_same, request)), 0.0
            )
    return feeds


def _room(feeds: WatchdogSet) -> Room:
    times = {feed.time_s for feed in feeds.by_drive.values()}
    most_s = feeds.most_s("")[0]
    answered_s = most_s - feeds.least_room_s(0.0, 0.0)
    failed_s = most_s - feeds.least_room_s(-math.inf, 0.0)
    return Room(
        most_s, feeds.round_s(), len(times) < 2, answered_s, failed_s,
        *feeds.behind_s(),
    )  # fmt: skip


def _own(drive: DriveEntry, timing: LineTiming) -> Iterator[Longest]:
    of = family(drive.family)
    feed = of.feed_code
    codes = {entry.code for entry in drive.cyclic}
    if watched_s(drive) is not None:
        codes.add(feed)
    for code in codes or {feed}:
        yield Longest(drive.name, of.spoken(code), read_times(drive, code, timing))


def _fed(roster: Roster, timing: LineTiming) -> Iterator[Longest]:
    """Give the feeds: they are begun even where there is never enough time for them."""
    for drive in roster.drives:
        if watched_s(drive) is not None:
            of = family(drive.family)
            yield Longest(drive.name, of.spoken(of.feed_code), dearest_feed_times(drive, timing))


def _reads(drive: DriveEntry, timing: LineTiming) -> Iterator[Longest]:
    of = family(drive.family)
    for info in of.described():
        if info.readable and _is_said(drive, info.code):
            times = read_times(drive, info.code, timing)
            yield Longest(drive.name, of.spoken(info.code), times)


def _writes(drive: DriveEntry, timing: LineTiming) -> Iterator[Longest]:
    of = family(drive.family)
    for info in of.described():
        if info.writable and _is_said(drive, info.code):
            value = _longest_value(info)
            times = write_times(drive, info.code, value, timing)
            yield Longest(drive.name, of.spoken(info.code), times, value)
    for action in of.stops:
        code, value = stop_value(of, action, 0)
        times = write_times(drive, code, value, timing)
        yield Longest(drive.name, of.spoken(code), times, value)


def _is_said(drive: DriveEntry, code: Code) -> bool:
    return any(form.carries(code) for form in drive.forms)


def _longest_value(info: CodeInfo) -> Value:
    """Make a value as long as those of a code usually are."""
    if info.hex_digits is not None:
        return Value.parse("H" + "0" * info.hex_digits)
    if info.format is Format.VS:
        return Value.parse("S" + "0" * max(info.chars - 1, 1))
    whole = "1" * min(info.chars, 6)
    return Value.parse(whole if info.chars <= 6 else f"-{'1' * (info.chars - 6)}.1111")


def _streams(roster: Roster, timing: LineTiming) -> Iterator[Stream]:
    for drive in roster.drives:
        time_s = watched_s(drive)
        if time_s is not None:
            yield Stream(drive.name, _feed_s(drive, timing), HARD_PART * time_s)


def _beside(roster: Roster, timing: LineTiming) -> Iterator[Stream]:
    for drive in roster.drives:
        time_s = watched_s(drive)
        if time_s is not None and _needs_feeds(drive, time_s):
            spare_s = SPARE_ATTEMPTS * dearest_feed_times(drive, timing).worst_s
            due_s = max(SOFT_PART * time_s, HARD_PART * time_s - spare_s)
            yield Stream(drive.name, _feed_s(drive, timing), due_s)


def _needs_feeds(drive: DriveEntry, time_s: float) -> bool:
    """Whether its reads alone may feed it too seldom: all of them may be due together."""
    return HARD_PART * time_s < min((entry.every_s for entry in drive.cyclic), default=math.inf)


def _cyclic(roster: Roster, timing: LineTiming) -> Iterator[Stream]:
    for drive in roster.drives:
        for entry in drive.cyclic:
            cost_s = _read_s(drive, entry.code, timing)
            yield Stream(_said(drive, entry.code), cost_s, entry.every_s)


def _said(drive: DriveEntry, code: Code) -> str:
    return f"{family(drive.family).spoken(code)} of {drive.name}"


def _one_form(roster: Roster, timing: LineTiming) -> Iterable[tuple[Stream, ...]]:
    found: dict[Code, list[Stream]] = {}
    for drive in roster.drives:
        for entry in drive.cyclic:
            if sum(form.carries(entry.code) for form in drive.forms) < 2:
                cost_s = _read_s(drive, entry.code, timing)
                one = Stream(_said(drive, entry.code), cost_s, entry.every_s)
                found.setdefault(entry.code, []).append(one)
    return (tuple(alike) for alike in found.values() if len(alike) > 1)


def _blocking(roster: Roster, timing: LineTiming) -> Iterator[Blocking]:
    for drive in roster.drives:
        codes = [(entry.code, entry.every_s) for entry in drive.cyclic]
        time_s = watched_s(drive)
        if time_s is not None and _needs_feeds(drive, time_s):
            codes.append((family(drive.family).feed_code, math.inf))
        for code, every_s in codes:
            saved_s = _read_s(drive, code, timing) if time_s is None else 0.0
            yield Blocking(read_times(drive, code, timing).worst_s, saved_s, every_s)


def _feed_s(drive: DriveEntry, timing: LineTiming) -> float:
    return _read_s(drive, family(drive.family).feed_code, timing)


def _read_s(drive: DriveEntry, code: Code, timing: LineTiming) -> float:
    adapter_s = min(timing.adapter_latency_s, LOW_LATENCY_S)
    return dearest_read_times(drive, code, timing).usual_s + adapter_s


def _same(request: Request) -> Request:
    return request


def _given_up(one: Longest) -> float:
    return one.times.given_up_s


def _worst(one: Longest) -> float:
    return one.times.worst_s


def _never_ended(outcome: Outcome, reason: str) -> None:
    """Ignore it: this request is never sent."""
