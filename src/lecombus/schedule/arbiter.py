"""Chooses by priority, by the shares of the lower classes and by what watchdogs need, now or ahead.

In this order:

1. Control. After each control exchange one other may go: the first of a class that has
   earned its share (shares.py), or else an urgent feed. A share goes before an urgent feed: if
   control fills the line, feeds are urgent all the time. What feeds really need goes before both,
   by the slack check.
2. Urgent feeds by hard deadline. A feed is urgent when it is due, or when the slack of all
   watchdogs together is less than the spare kept for failed attempts (watchdog_set.py). While two
   thirds of that spare are left, urgent feeds and lower classes take turns, so that a sweep of
   feeds does not keep a person waiting, and feeds that are due do not take all of the line; below
   that feeds go first.
3. Interactive, cyclic (next steps of cyclic requests, then probes, then slots by cadence),
   background; of these, too, one that has earned its share goes after one of a higher class.
   Within a class first come, first served; what comes back through `again` goes ahead of its class.

A drive may be left alone for a while after a write. What waited for the end of that goes before
the next request of a higher class that would have the drive left alone again.

So a lone control request waits for the exchange under way and for what watchdogs need, and for
nothing else (`capacity.waits` counts it so). A feed that is not urgent yet, but will be soon (twice
the spare), costs no separate telegram: where a cyclic slot would go, it is one of that drive, run
early.

`WatchdogArbiter` chooses what feeds: a feed is a useful telegram, the drive's first waiting control
or interactive request, else its next cyclic slot run early, else the read that its
`WatchdogFeeding` makes. `Arbiter` chooses when the line is free, `Lookahead` beforehand, while an
answer is still being received: the two must choose alike, and the tests compare them.

Pure: the times are arguments.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from lecombus.schedule.polling import Polling, PollingEntry
from lecombus.schedule.queues import QueuedDrive
from lecombus.schedule.request import DispatchReason, Priority, Request
from lecombus.schedule.shares import CLASS_SHARES, Probe, Probes, Shares
from lecombus.schedule.waiting import Waiting, has_expired
from lecombus.schedule.watchdog_deadline import WatchdogDeadline
from lecombus.schedule.watchdog_set import WatchdogSet

__all__ = ["Arbiter", "Lookahead", "PlannedChoice", "WatchdogArbiter", "to_feed"]

TURNS_PART: Final = 2 / 3  # of the spare: with less slack, urgent feeds no longer take turns


class WatchdogArbiter:
    """Chooses the telegram that feeds a drive, and whether one must be fed now.

    Args:
        waiting: What waits.
        watchdogs: The watchdogs.
        polling: The cyclic entries.
    """

    __slots__ = ("_polling", "_waiting", "_watchdogs")

    def __init__(self, waiting: Waiting, watchdogs: WatchdogSet, polling: Polling) -> None:
        self._waiting = waiting
        self._watchdogs = watchdogs
        self._polling = polling

    def can_wait(self, now_s: float) -> bool:
        """Return whether feeds leave time for something else to take its turn with them."""
        watchdogs = self._watchdogs
        return watchdogs.fits(now_s, TURNS_PART * watchdogs.spare_s(), "")

    def early_slot(self, slot: Request, now_s: float) -> Request | None:
        """Find a cyclic slot, to be run in place of another, of a drive to be fed soon.

        There is none while a drive that is late can still be fed: that one goes before any slot.
        """
        polling, entry = self._polling, slot.source
        if type(entry) is not PollingEntry or not polling.may_wait(entry, now_s):
            return None
        feed = self._watchdogs.pressing(now_s, self._watchdogs.soon_s())
        early = polling.early(feed.drive, now_s) if feed and feed.drive != slot.drive else None
        fits = early is not None and feed and self._serves(early.made(), feed, now_s)
        if early is None or not fits or self._watchdogs.late(now_s) is not None:
            return None
        return early.made()

    def urgent(self, now_s: float) -> Request | None:
        """Find the telegram for the feed that goes first, if any is urgent.

        When time is short it is the one with the earliest deadline of all, due or not. A drive
        that never answers may take its longest: it waits until that fits, or, if it never will,
        is tried all the same, at its own slow pace. A drive that lost more answers than are
        tolerated goes behind those that are late and whose watchdogs can still be kept.
        """
        feeds = self._watchdogs
        for feed in feeds.due(now_s):
            fits = feeds.fits(now_s, feed.worst_s, feed.drive)
            behind = feed.failures > feeds.faults.tolerate
            late = feeds.late(now_s, but=(feed.drive,)) if behind else None
            if late is not None:
                return self.telegram(late, now_s)
            if fits:
                return self.telegram(feed, now_s)
            if feed.failures < feeds.faults.gone_from:  # few lost answers: the spare is kept for it
                if not feeds.fits(now_s, feed.cost_s, feed.drive):
                    feed = feeds.first(now_s) or feed
                return self.telegram(feed, now_s)
            if feed.worst_s > feeds.most_s(feed.drive)[0]:
                return self.telegram(feed, now_s)
            other = feeds.room(now_s, feed.worst_s, feed.drive)
            if other is not None:
                return self.telegram(other, now_s)
            feed.retry_at_s = feeds.retry_s(now_s)
        pressing = feeds.pressing(now_s, feeds.spare_s())
        return None if pressing is None else self.telegram(pressing, now_s)

    def telegram(self, feed: WatchdogDeadline, now_s: float) -> Request:
        """Choose the telegram that feeds a drive: one that is wanted anyway, if there is one."""
        for priority in (Priority.CONTROL, Priority.INTERACTIVE):
            request = self._waiting.queues[priority].first_for(feed.drive)
            if request is not None and self._serves(request, feed, now_s):
                return request
        entry = self._polling.early(feed.drive, now_s)
        if entry is not None and self._serves(entry.made(), feed, now_s):
            return entry.made()
        return self.plain(feed)

    def plain(self, feed: WatchdogDeadline) -> Request:
        """Make the read that does nothing but feed a drive."""
        request = feed.made()
        if feed.costs.take(request):
            self._watchdogs.changed()
            request.shorten(feed.worst_s)
        return request

    def _serves(self, request: Request, feed: WatchdogDeadline, now_s: float) -> bool:
        if has_expired(request, now_s):
            return False
        if request.unfed_s <= feed.worst_s and request.cost_s <= feed.cost_s:
            return True
        feeds = self._watchdogs
        if not (feed.outlasts(now_s, request.unfed_s) and feeds.own_holds(request, now_s)):
            return False
        return feeds.fits(now_s, feeds.need_s(request), feed.drive)


class Arbiter:
    """Chooses what is first; stops and the slack check stand above it.

    Args:
        waiting: What waits.
        watchdog_arbiter: Which telegrams feed.
        polling: The cyclic entries.
        probes: The probes.
        shares: The credit of the classes.
    """

    __slots__ = ("_fed_last", "_polling", "_probes", "_shares", "_waiting", "_watchdog_arbiter")

    def __init__(
        self,
        waiting: Waiting,
        watchdog_arbiter: WatchdogArbiter,
        polling: Polling,
        probes: Probes,
        shares: Shares,
    ) -> None:
        self._waiting = waiting
        self._watchdog_arbiter = watchdog_arbiter
        self._polling = polling
        self._probes = probes
        self._shares = shares
        self._fed_last = False  # an urgent feed went last: it is the turn of interactive

    def first(self, now_s: float) -> tuple[Request | None, bool]:
        """Find what is first; return whether it is a feed, which needs no slack check."""
        waiting, queues = self._waiting, self._waiting.queues
        heads: dict[Priority, Request] = {}
        costs_s: dict[Priority, float] = {}
        for priority in CLASS_SHARES:
            head = waiting.head(priority, now_s) if queues[priority].depth else None
            if head is None and priority is Priority.CYCLIC:
                head = self._periodic(now_s)
            if head is not None:
                heads[priority] = head
                costs_s[priority] = head.cost_s
            elif queues[priority].depth:
                costs_s[priority] = 0.0
        depth = queues[Priority.CONTROL].depth
        control = waiting.head(Priority.CONTROL, now_s) if depth else None
        top = Priority.CONTROL if control is not None else next(iter(heads), Priority.BACKGROUND)
        entitled = self._shares.entitled(costs_s, top)
        kept = self._kept(control or heads.get(top), heads, now_s)
        if kept is not None:
            kept.turn = DispatchReason.KEPT
            return kept, False
        if control is not None:
            return self._with_control(control, None if entitled is None else heads[entitled], now_s)
        head = heads.get(entitled or top)
        feed = self._feed(head, now_s)
        if feed is not None:
            return feed
        self._fed_last = False
        if head is None:
            return None, False
        return self._by_class(head, entitled not in (None, top), now_s)

    def took(self, request: Request, costs_s: Mapping[Priority, float], *, ahead: bool) -> None:
        """Record a choice that was made beforehand (`Lookahead`).

        Args:
            request: What was chosen.
            costs_s: The lower classes that have a request that can go, and what their first costs.
            ahead: It goes first by its class's share.
        """
        if request.priority is not Priority.CONTROL:
            self._fed_last = False
        self._shares.note(costs_s)
        request.turn = DispatchReason.CREDIT if ahead else DispatchReason.RIGHT

    def _with_control(
        self, control: Request, entitled: Request | None, now_s: float
    ) -> tuple[Request, bool]:
        """Choose while control waits: after a control exchange, one other may go."""
        if self._shares.had_its_turn(Priority.CONTROL):
            if entitled is not None:
                self._fed_last = False
                return self._by_class(entitled, True, now_s)
            feed = self._watchdog_arbiter.urgent(now_s)
            if feed is not None and feed is not control:
                self._fed_last = True
                return to_feed(feed, DispatchReason.FEED_AHEAD), True
        control.turn = DispatchReason.RIGHT
        return control, False

    def _kept(
        self, top: Request | None, heads: Mapping[Priority, Request], now_s: float
    ) -> Request | None:
        """Find what waited while the drive of the first request was left alone for one like it.

        Before one telegram to several drives it is one exchange, however many of them have kept
        something.
        """
        if top is None or (top.members and top.kept_first):
            return None
        kept = self._waiting.kept_by(top, now_s)
        if not kept:
            return None
        found = {one: heads[one] for one in kept if one in heads and heads[one].drive in kept[one]}
        if Priority.CYCLIC in kept and Priority.CYCLIC not in found:
            name = kept[Priority.CYCLIC][0]
            slot = self._polling.early(name, now_s) if self._polling.is_due(name, now_s) else None
            if slot is not None:  # slots of other drives may be due before it all the time
                found[Priority.CYCLIC] = slot.made()
        first = self._shares.least_recent(found)
        if first is None:
            return None
        top.kept_first = True
        return found[first]

    def _feed(self, other: Request | None, now_s: float) -> tuple[Request, bool] | None:
        """Find the feed that goes now, if it is its turn.

        While room is made for the other request, it is not: those feeds are chosen so that the
        request fits, and urgent feeds between them, by deadline, would undo what they gain.
        """
        begun = self._waiting.head(Priority.WATCHDOG, now_s)
        if begun is not None:
            return to_feed(begun), False
        its_turn = other is not None and (self._fed_last or other.rooms > 0)
        if its_turn and self._watchdog_arbiter.can_wait(now_s):
            return None
        feed = self._watchdog_arbiter.urgent(now_s)
        if feed is None:
            return None
        self._fed_last = True
        return to_feed(feed), True

    def _by_class(self, first: Request, ahead: bool, now_s: float) -> tuple[Request, bool]:
        """Take the first of a class, or a slot in its place that feeds a drive soon in need."""
        early = None if ahead else self._watchdog_arbiter.early_slot(first, now_s)
        chosen = early or first
        chosen.turn = DispatchReason.CREDIT if ahead else DispatchReason.RIGHT
        return chosen, early is not None

    def _periodic(self, now_s: float) -> Request | None:
        """Find the probe or else the cyclic slot that is due."""
        while (probe := self._probes.ready(now_s)) is not None:
            drive = self._waiting.drives[probe.drive]
            if not drive.held:
                return probe.made()
            self._probes.schedule(probe, drive.held_until_s)
        entry = self._polling.head(now_s, self._waiting.drives)
        return entry.made() if entry is not None else None


def to_feed(request: Request, turn: DispatchReason = DispatchReason.FEED) -> Request:
    """Note that a request goes because a watchdog asks for it."""
    request.turn = turn
    return request


@dataclass(slots=True)
class PlannedChoice:
    """A choice made beforehand; it is never changed (not frozen: one is made for each exchange).

    Args:
        request: What goes next. from_s: It holds from this time on. until_s: And until this one.
        ahead: It goes first by its class's share. waiting: The lower classes that have a request
        that can go, and what their first costs, seconds.
    """

    request: Request
    from_s: float
    until_s: float
    ahead: bool = False
    waiting: Mapping[Priority, float] = field(default_factory=dict)


class Lookahead:
    """Makes and keeps the choice made beforehand of one schedule.

    A choice takes longer than a character on the wire, and it would delay the next telegram. So it
    is made beforehand, for the time at which the answer is expected and on the assumption that the
    drive answers. It is used if nothing has changed by then.

    Only the simple case is planned: a stop, or the head of a class while no feed is near to urgent.
    All other cases (a feed due or urgent, a probe, a request delayed by a watchdog's deadline,
    something that joins, expires or comes back at that time) are decided when the line becomes
    free; that choice is always right. A planned choice is valid between two times that are kept
    with it: from when its slot is due until something could become due, expire, or run short of
    slack.

    Each change of the schedule invalidates the planned choice. Planning changes nothing: no request
    is begun and no credit booked.

    Args:
        waiting: What waits.
        watchdogs: The watchdogs.
        polling: The cyclic entries.
        probes: The probes.
        shares: The credit of the classes.
    """

    __slots__ = ("_found", "_polling", "_probes", "_shares", "_waiting", "_watchdogs")

    def __init__(
        self,
        waiting: Waiting,
        watchdogs: WatchdogSet,
        polling: Polling,
        probes: Probes,
        shares: Shares,
    ) -> None:
        self._waiting = waiting
        self._watchdogs = watchdogs
        self._polling = polling
        self._probes = probes
        self._shares = shares
        self._found: PlannedChoice | None = None

    def invalidate(self) -> None:
        """Forget the choice: something changed."""
        self._found = None

    def holding(self, now_s: float) -> PlannedChoice | None:
        """Return the choice if it still holds."""
        found = self._found
        if found is None or not found.from_s <= now_s < found.until_s:
            return None
        return found

    def make(self, under_way: Request | None, started_s: float, at_s: float) -> Request | None:
        """Choose what goes at a time to come.

        Args:
            under_way: The request on the line, which is supposed to be answered; None if none is.
            started_s: When its exchange began.
            at_s: When the line is expected to be free.
        """
        self._found = None
        stop = self._waiting.stop()
        if stop is not None:
            if self._waiting.yields(stop):  # feeds may have to go before it
                return None
            self._found = PlannedChoice(stop, -math.inf, self._settled_until_s())
        elif under_way is None or self._is_plain(under_way):
            self._found = self._choose(under_way, started_s, at_s)
        return None if self._found is None else self._found.request

    def _is_plain(self, under_way: Request) -> bool:
        """Whether its answer changes nothing that is looked at here but credits."""
        if type(under_way.source) is Probe:
            return False
        feed = self._watchdogs.by_drive.get(under_way.drive)
        return feed is None or not feed.left_out

    def _choose(
        self, under_way: Request | None, started_s: float, at_s: float
    ) -> PlannedChoice | None:
        until_s = min(
            self._settled_until_s(), self._watchdogs.calm_until_s, self._probes.not_before_s()
        )
        if (
            at_s >= until_s
            or self._polling.is_joining
            or self._waiting.queues[Priority.WATCHDOG].depth
        ):
            return None
        entry, due_s = self._polling.first()
        if due_s <= at_s and entry is not None and self._drives[entry.cyclic.drive].held:
            return None
        heads = self._heads(at_s, None if due_s > at_s else entry)
        control = self._waiting.head(Priority.CONTROL, at_s)
        if control is None and not heads:
            return None
        highest = control or next(iter(heads.values()))
        if self._waiting.kept_by(highest, started_s, after_s=-math.inf):
            return None
        waiting = {
            priority: heads[priority].cost_s if priority in heads else 0.0
            for priority in CLASS_SHARES
            if priority in heads or self._waiting.queues[priority].depth
        }
        entitled = None
        if len(waiting) + (control is not None) > 1:
            top = Priority.CONTROL if control is not None else next(iter(heads))
            entitled = self._shares.foresee(waiting, top, under_way, at_s - started_s)
        if control is not None and entitled is None:
            chosen, ahead = control, False
        else:
            first = next(iter(heads))
            chosen = heads[first if entitled is None else entitled]
            ahead = entitled is not None and (control is not None or entitled is not first)
        from_s = due_s if entry is not None and chosen is entry.request else -math.inf
        if due_s > at_s:  # from then on its slot waits too
            until_s = min(until_s, due_s)
        until_s = min(until_s, self._slack_until_s(chosen))
        if at_s >= until_s:
            return None
        return PlannedChoice(chosen, from_s, until_s, ahead, waiting)

    def _settled_until_s(self) -> float:
        """Before this time nothing expires or comes back."""
        waiting = self._waiting
        expires_s = waiting.expiries.first_s()
        return min(expires_s, waiting.timers[0][0]) if waiting.timers else expires_s

    def _heads(self, at_s: float, entry: PollingEntry | None) -> dict[Priority, Request]:
        """The first of each lower class, where there is one; `entry` is the slot that is due."""
        heads: dict[Priority, Request] = {}
        waiting = self._waiting
        for priority in CLASS_SHARES:
            head = waiting.head(priority, at_s) if waiting.queues[priority].depth else None
            if head is None and priority is Priority.CYCLIC and entry is not None:
                head = entry.made()
            if head is not None:
                heads[priority] = head
        return heads

    @property
    def _drives(self) -> Mapping[str, QueuedDrive]:
        return self._waiting.drives

    def _slack_until_s(self, chosen: Request) -> float:
        """How long the choice would pass the slack check without anything being fed first."""
        feeds = self._watchdogs
        if not feeds.by_drive:
            return math.inf
        own = feeds.by_drive.get(chosen.drive)
        if own is not None and chosen.unfed_s > own.worst_s:
            return -math.inf
        spare_s = feeds.soon_s() if type(chosen.source) is PollingEntry else feeds.spare_s()
        need_s = feeds.need_s(chosen)
        return feeds.latest_end_s - max(need_s, spare_s)
