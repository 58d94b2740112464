"""How long each class of requests waits at most on one line.

Method: non-preemptive response-time analysis for fixed priorities (`demand_bound`, with its
papers): a request waits for the exchange under way and for the work that goes before it, and the
smallest fixed point of that sum bounds its wait. What goes before it follows from the schedule's
own rules (`schedule.arbiter`, `schedule.shares`), class by class:

* *Stop*: the exchange under way, until its answer is given up.
* *Control and interactive*: the exchange under way, and feeds; the lost answer may also be that of
  a feed behind the exchange under way. A single request lets no share go first. Feeds go before it
  where the watchdogs' slack is short: all of those that may be due together, each as often as its
  watchdog needs it within the wait; for control none at all where the spare outlasts a lost answer.
  An interactive request also takes turns with one feed more.
* *Cyclic*: slots go in the order in which they are due, so one waits for the exchange under way and
  for every other slot once, all due together, and for the feeds that reads do not replace. (In
  that order the backlog is greatest at the first instant at which all are due; a load below
  the line's time lets it only shrink afterwards.)
* *Background*: after all cyclic reads and feeds that come while it waits, or, if that is sooner,
  until its share has been earned.

Three bounds are given. *Quiet*: one request at a time, no other requests, no drive being audited,
no status word to be read after a command.
*Loaded*: lower classes are full, and the exchange under way is the longest that the drives'
descriptions know, such as a module's own codes. *Crowded*, for the classes below control: all
classes are full all the time, the higher ones too. Requests of the same class are additional: how
many there are depends on the clients.

The crowded bound adds up what the schedule's rules let go before the first request of a class
(`_crowded`). The line time in which its share is earned, independent of other requests; the
exchange under way when it begins, lost, and the one when it is earned. From then on no class goes
first by its priority twice in a row, so these go before it at most: one exchange by credit of
each of the other two classes, and one by priority before each of these three. Where drives are
left alone after writes, what waited for that may go once more before each by priority. Each
exchange may have to wait until feeds have made room for it (`_rooms_s`); feeds that only press
take turns with the exchanges, one with each.

The bounds hold while the drives answer and at most the exchange under way is lost, and count the
time in which the daemon runs: pauses of the computer are additional.

A stop of a drive that does not answer (`silent_stop`): its first telegram waits as every stop does,
unless the drive is known to be offline. Every other telegram waits until the watchdogs can be fed
in time besides; before it go feeds for as long as a round of the line and a drive that goes away
take at most, and nothing else (`schedule.silent_stops`). So the bound is an addition: the exchange
under way, that round, the attempts, the last feed begun, and the time for which a drive is left
alone after a write. It also holds while other drives fail to answer; their stops are additional.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from lecombus.capacity.demand_bound import FULL, Stream, load_of, response_s
from lecombus.capacity.exchange_costs import dearest_feed_times, stop_attempt_s, watched_s
from lecombus.capacity.work_ahead import Blocking, Longest, WorkAhead
from lecombus.drives import family
from lecombus.drives.stops import LEAST_STOP_ATTEMPTS, STOP_PATIENCE_S, STOP_PAUSE_S
from lecombus.fieldbus.costs import LineTiming
from lecombus.roster import Roster
from lecombus.schedule import Priority
from lecombus.schedule.schedule import ROOMS_PER_FEED
from lecombus.schedule.shares import CLASS_SHARES, CREDIT_EXCHANGES
from lecombus.schedule.waiting import KEPT_AFTER_S
from lecombus.schedule.watchdog_deadline import HARD_PART, SPARE_ATTEMPTS

__all__ = ["LATENESS_S", "ClassWait", "SilentStop", "class_waits", "silent_stop"]

LATENESS_S: Final = 0.002
"""What an idle machine adds to one wait, p99."""

BACKGROUND_SHARE: Final = CLASS_SHARES[Priority.BACKGROUND]


@dataclass(frozen=True, slots=True)
class ClassWait:
    """What one class is promised; infinite where nothing can be promised.

    Args:
        name: The class.
        quiet_s: From a request until its telegram begins, without other requests.
        loaded_s: The same with every lower class full and drives being audited.
        own_s: What its own exchange then takes at most; infinite: none is ever begun.
        share: The part of the line that the class gets if it wants it, under any load;
            None: it waits for no share.
        crowded_s: From when a request is the first of its class until its telegram begins,
            under any load; infinite: feeding alone takes all of the line; None: no bound
            of this kind, as it waits for no share.
        counts: What the bounds consist of, in words.
    """

    name: str
    quiet_s: float
    loaded_s: float
    own_s: float
    counts: str
    share: float | None = None
    crowded_s: float | None = None


def class_waits(
    roster: Roster, timing: LineTiming, ahead: WorkAhead, stop_line_s: float
) -> list[ClassWait]:
    """Give the promise to every class, the highest first.

    Args:
        roster: The line.
        timing: Its times.
        ahead: What can go before a request on it.
        stop_line_s: The line time of one stop with its proof, seconds.
    """
    return [
        _stop(ahead, timing, stop_line_s),
        _control(ahead),
        _watchdog(roster),
        _interactive(ahead),
        _cyclic(ahead),
        _background(ahead),
    ]


def _stop(ahead: WorkAhead, timing: LineTiming, stop_line_s: float) -> ClassWait:
    more_s = timing.turnaround_s + LATENESS_S
    longest = max(ahead.own, ahead.read, ahead.write, key=lambda one: one.times.given_up_s)
    return ClassWait(
        "stop", ahead.own.times.given_up_s + more_s, longest.times.given_up_s + more_s, stop_line_s,
        f"the exchange under way until it is given up (at most {longest.what}); other drives' "
        "stops that came before add theirs, and a computer that does not run the daemon its pause",
    )  # fmt: skip


def _control(ahead: WorkAhead) -> ClassWait:
    own_s = ahead.control.takes_s
    text = "the exchange under way, not answered, and no feed: the watchdogs' spare outlasts it"
    if not ahead.feeds:
        text = "the exchange under way, not answered"
    quiet_s = ahead.own.times.worst_s
    if not _spare_outlasts(ahead, quiet_s + own_s):
        quiet_s = response_s(0.0, _lost_s(ahead, ahead.own), _pressing(ahead, quiet_s + own_s))
        text = "the exchange under way, not answered, and feeds that may be due just then"
    loaded_s = response_s(0.0, _lost_s(ahead, ahead.any_exchange), ahead.feeds)
    room_s = _unsure_room_s(ahead, ahead.control)
    quiet_s, loaded_s = max(quiet_s, room_s), max(loaded_s, room_s)
    return ClassWait("control", quiet_s + LATENESS_S, loaded_s + LATENESS_S, own_s, text)


def _interactive(ahead: WorkAhead) -> ClassWait:
    turn_s = max((one.cost_s for one in ahead.feeds), default=0.0)
    once_s = _lost_s(ahead, ahead.own) + turn_s
    quiet_s = response_s(0.0, once_s, _pressing(ahead, once_s + ahead.read.times.worst_s))
    loaded_s = response_s(0.0, _lost_s(ahead, ahead.any_exchange) + turn_s, ahead.feeds)
    room_s = _unsure_room_s(ahead, ahead.read)
    quiet_s, loaded_s = max(quiet_s, room_s), max(loaded_s, room_s)
    return ClassWait(
        "interactive", quiet_s + LATENESS_S, loaded_s + LATENESS_S, ahead.read.takes_s,
        "the exchange under way, not answered, and feeds that may be due just then"
        if ahead.feeds
        else "the exchange under way, not answered",
        *_guaranteed(ahead, Priority.INTERACTIVE, ahead.read.times.usual_s),
    )  # fmt: skip


def _watchdog(roster: Roster) -> ClassWait:
    """A feed is not a request that waits: its promise is that it is over in time."""
    times = [time_s for drive in roster.drives if (time_s := watched_s(drive))]
    if not times:
        return ClassWait("watchdog", math.inf, math.inf, 0.0, "no watchdog is fed")
    over_s = HARD_PART * min(times)
    text = "a feed is over at nine tenths of its watchdog time; shown is the shortest's"
    return ClassWait("watchdog", over_s, over_s, 0.0, text)


def _cyclic(ahead: WorkAhead) -> ClassWait:
    longest = ahead.any_exchange.times
    saved_s = min(CREDIT_EXCHANGES, float(len(ahead.cyclic))) * longest.usual_s
    quiet_s = _lateness(ahead, ahead.blocking, 0.0)
    loaded_s = _lateness(ahead, [Blocking(longest.worst_s + saved_s, 0.0)], BACKGROUND_SHARE)
    own_s = max((one.worst_s for one in ahead.blocking), default=0.0)
    return ClassWait(
        "cyclic", quiet_s + LATENESS_S, max(quiet_s, loaded_s) + LATENESS_S, own_s,
        "how late a slot may be: the exchange under way, not answered, all other reads once, and "
        "feeds that no cyclic read replaces",
        *_guaranteed(ahead, Priority.CYCLIC, max((one.cost_s for one in ahead.cyclic), default=0)),
    )  # fmt: skip


def _background(ahead: WorkAhead) -> ClassWait:
    coming = [*ahead.cyclic, *ahead.beside]
    usual_s = max((one.cost_s for one in coming), default=0.0)
    lost_s = max((one.worst_s for one in ahead.blocking), default=0.0)
    quiet_s = max(
        (
            response_s(0.0, one.worst_s - one.saved_s - ahead.once_read_s, coming)
            for one in ahead.blocking
        ),
        default=0.0,
    )
    own_s = max(usual_s, ahead.read.times.usual_s)
    quiet_s = min(quiet_s, _until_earned(ahead, own_s, usual_s, lost_s))
    share, crowded_s = _guaranteed(ahead, Priority.BACKGROUND, ahead.read.times.usual_s)
    return ClassWait(
        "background", quiet_s + LATENESS_S, crowded_s, ahead.read.takes_s,
        "all reads and feeds that come while it waits; under load, clients of all classes: until a "
        "twentieth of the line has been earned, and its turn has come",
        share, crowded_s,
    )  # fmt: skip


def _guaranteed(ahead: WorkAhead, which: Priority, usual_s: float) -> tuple[float, float]:
    """Give what a class is guaranteed under any load: its share, and the crowded bound.

    Args:
        ahead: What can go before a request.
        which: The class.
        usual_s: Its longest exchange, answered, seconds.
    """
    return CLASS_SHARES[which], _crowded(ahead, which, usual_s) + LATENESS_S


def _crowded(ahead: WorkAhead, which: Priority, usual_s: float) -> float:
    if load_of(ahead.feeds) > FULL:
        return math.inf
    others = len(CLASS_SHARES) - 1
    turns = 1 + others + (others + 1)  # the one when it is earned, by credit, by right
    if ahead.alone_s:
        turns += others + 1
    longest = (ahead.own, ahead.read, ahead.write)
    one_s = max(one.times.usual_s for one in longest)
    lost_s = _lost_s(ahead, ahead.any_exchange)
    earned_s = usual_s / CLASS_SHARES[which]
    rooms_s = _rooms_s(ahead, turns, one_s, ahead.room.need_s(ahead.any_exchange.times))
    alone_s = KEPT_AFTER_S + 2.0 * ahead.alone_s if ahead.alone_s else 0.0
    return earned_s + lost_s + turns * one_s + rooms_s + alone_s


def _rooms_s(ahead: WorkAhead, turns: int, one_s: float, need_s: float) -> float:
    """Bound what feeds take while so many exchanges go, and one more is to begin.

    Making room takes a round of the line at most where watchdogs are alike, and else, for exchanges
    that need up to half of the room that there ever is, two rounds with all that falls due during
    them (tests/schedule/test_starvation.py tries it). After a round there is room for exchanges
    until the slack is down to the room that the longest needs again: where watchdogs are alike no
    drive is fed twice before that.

    Args:
        ahead: What can go before a request.
        turns: How many exchanges.
        one_s: The longest, answered, seconds.
        need_s: The room that the longest needs (`Room.need_s`), seconds.
    """
    room = ahead.room
    if not ahead.feeds:
        return 0.0
    pressing_s = turns * max(one.cost_s for one in ahead.feeds)
    if not room.alike:
        once_s = 2.0 * response_s(0.0, 0.0, ahead.feeds)
        if need_s > room.sure_s:  # it is put off in the end
            once_s = max(once_s, ROOMS_PER_FEED * room.round_s)
        return (turns + 1) * once_s + pressing_s
    left_s = room.most_s - max(need_s, ahead.spare_s)
    rounds = turns + 1.0
    if left_s > 0.0:
        rounds = min(rounds, 1.0 + math.ceil((turns * one_s + pressing_s) / left_s))
    return rounds * room.round_s + pressing_s


def _unsure_room_s(ahead: WorkAhead, longest: Longest) -> float:
    """Bound what feeds take before one exchange for which a round of them makes no room for sure.

    Args:
        ahead: What can go before a request.
        longest: The exchange.
    """
    need_s = ahead.room.need_s(longest.times)
    return 0.0 if need_s <= ahead.room.sure_s else _rooms_s(ahead, 0, 0.0, need_s)


def _lateness(ahead: WorkAhead, blocking: Sequence[Blocking], share: float) -> float:
    """Bound how late a slot is when all are due together, behind an exchange, beside a share."""
    if ahead.load >= (1.0 - share) * FULL:
        return math.inf
    if not ahead.cyclic:
        return 0.0
    costs_s = sorted(one.cost_s for one in ahead.cyclic)
    # As long as a late answer may come, reads take longer, perhaps more than all line time.
    overrun_s = max(load_of(ahead.cyclic) - 1.0, 0.0) * ahead.late_answer_s
    slower = [Stream(one.name, one.cost_s / (1.0 - share), one.every_s) for one in ahead.beside]
    # One of a drive's slots that are due stands for its first feed.
    overrun_s -= ahead.once_read_s
    found_s = 0.0
    for one in blocking:
        # The slot that is last costs itself nothing; it is another than the one under way.
        last_s = costs_s[1:2] if one.saved_s == costs_s[0] else costs_s[:1]
        # Without an answer a slot may take longer than its period: its own next one is late then.
        once_s = one.worst_s - one.every_s
        if last_s:
            once_s = max(
                once_s,
                one.worst_s - one.saved_s + sum(costs_s) - last_s[0] + overrun_s,
                one.worst_s + _put_off_s(ahead),
            )
        if once_s > 0.0:
            found_s = max(found_s, response_s(0.0, once_s / (1.0 - share), slower))
    return found_s


def _put_off_s(ahead: WorkAhead) -> float:
    """Bound how long reads wait until no late answer may come, and then for each other.

    They keep their place, so that only the exchange that is under way then goes before them.
    """
    if not ahead.one_form:
        return 0.0
    under_way_s = max(one.cost_s for one in ahead.cyclic)
    others_s = max(
        sum(one.cost_s for one in alike) - min(one.cost_s for one in alike)
        for alike in ahead.one_form
    )
    return ahead.late_answer_s + under_way_s + others_s


def _until_earned(ahead: WorkAhead, own_s: float, usual_s: float, blocked_s: float) -> float:
    """Bound the time until a background request goes by its share, all classes being full.

    The credit grows with the line's time. Once it is earned, the exchange under way, the feeds and
    one exchange of each of the other classes that have earned theirs may go first, each of those
    after one of the highest class.

    Args:
        ahead: What can go before a request.
        own_s: The longest background exchange, answered, seconds.
        usual_s: The longest of those that come while it waits, answered, seconds.
        blocked_s: The longest of these, not answered, seconds.
    """
    earned_s = own_s / BACKGROUND_SHARE
    turns_s = 2.0 * (len(CLASS_SHARES) - 1) * usual_s
    return response_s(0.0, earned_s + blocked_s + turns_s, ahead.feeds)


def _pressing(ahead: WorkAhead, wait_s: float) -> tuple[Stream, ...]:
    """Leave out the feeds of drives that their reads feed so often that they never press."""
    feeds_s = sum(one.cost_s for one in ahead.feeds)
    late_s = _lateness(ahead, ahead.blocking, 0.0)

    def presses(one: Stream) -> bool:
        read_s = ahead.reads_s.get(one.name, math.inf)
        return one.every_s - read_s - late_s <= wait_s + 2.0 * feeds_s + ahead.spare_s

    return tuple(one for one in ahead.feeds if presses(one))


def _lost_s(ahead: WorkAhead, under_way: Longest) -> float:
    """Bound what one lost answer costs: that of the exchange under way, or of a feed behind it."""
    lost_feed_s = ahead.lost_feed_s
    behind_s = under_way.times.usual_s + lost_feed_s if lost_feed_s else 0.0
    return max(under_way.times.worst_s, behind_s)


def _spare_outlasts(ahead: WorkAhead, lost_s: float) -> bool:
    """Return whether the slack that feeds keep is enough for a lost answer and the request.

    Feeds press when less than the spare is left, and take turns with the requests of one client
    that asks again and again; each turn takes as long as such a request does when it is answered.
    """
    if not ahead.feeds:
        return True
    turn_s = ahead.control.times.usual_s
    left_s = ahead.spare_s - max(one.cost_s for one in ahead.feeds) - len(ahead.feeds) * turn_s
    return left_s >= lost_s


@dataclass(frozen=True, slots=True)
class SilentStop:
    """What a line promises to a stop of a drive that does not answer.

    Args:
        quiet_s: From when it may be repeated until its telegram begins, without other requests; for
            a drive that is offline already, from its request to the first telegram.
        loaded_s: The same with the longest exchange under way.
        attempt_s: What one telegram without an answer then takes at most.
        telegrams: Least telegrams, within `STOP_PATIENCE_S` or, if they take longer, after it.
        counts: What the bounds consist of, in words.
    """

    quiet_s: float
    loaded_s: float
    attempt_s: float
    telegrams: int
    counts: str


def silent_stop(roster: Roster, timing: LineTiming, ahead: WorkAhead) -> SilentStop:
    """Calculate the promise for a stop of a drive that does not answer.

    Args:
        roster: The line.
        timing: Its times.
        ahead: What can go before a request on it.
    """
    watched = [drive for drive in roster.drives if watched_s(drive) is not None]
    feeds = [dearest_feed_times(drive, timing) for drive in watched]
    last_s = max((feed.worst_s for feed in feeds), default=0.0)
    alone_s = max((family(drive.family).hold_after_write_s for drive in watched), default=0.0)
    lost_s = (SPARE_ATTEMPTS + 1) * last_s
    more_s = sum(feed.usual_s for feed in feeds) + alone_s + lost_s + LATENESS_S
    attempt_s = max(stop_attempt_s(drive, timing) for drive in roster.drives)
    loaded_s = ahead.anything.times.worst_s + more_s
    fitting = int(STOP_PATIENCE_S / (attempt_s + STOP_PAUSE_S + loaded_s))
    telegrams = 1 + max(fitting, LEAST_STOP_ATTEMPTS)  # attempts, and one to read it back
    return SilentStop(
        ahead.own.times.worst_s + more_s, loaded_s, attempt_s, telegrams,
        "as above, and feeds that would come too late, a round of the line at most",
    )  # fmt: skip
