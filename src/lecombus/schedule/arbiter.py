"""Chooses by priority, by the shares of the lower classes and by what watchdogs need.

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
"""

from __future__ import annotations

from collections.abc import Mapping

from lecombus.schedule.polling import Polling
from lecombus.schedule.request import DispatchReason, Priority, Request
from lecombus.schedule.shares import CLASS_SHARES, Probes, Shares
from lecombus.schedule.waiting import Waiting
from lecombus.schedule.watchdog_arbiter import WatchdogArbiter

__all__ = ["Arbiter", "to_feed"]


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
        feed = self._feed(bool(heads), now_s)
        if feed is not None:
            return feed
        self._fed_last = False
        if not heads:
            return None, False
        return self._by_class(heads[entitled or top], entitled not in (None, top), now_s)

    def took(self, request: Request, costs_s: Mapping[Priority, float], *, ahead: bool) -> None:
        """Record a choice that was made beforehand (lookahead.py).

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
        """Find what waited while the drive of the first request was left alone for one like it."""
        kept = self._waiting.kept_by(top, now_s) if top is not None else set()
        if top is None or not kept:
            return None
        names = top.members or (top.drive,)
        kept = {one for one in kept if one in heads and heads[one].drive in names}
        found = self._shares.least_recent(kept)
        return None if found is None else heads[found]

    def _feed(self, others: bool, now_s: float) -> tuple[Request, bool] | None:
        """Find the feed that goes now, if it is its turn."""
        begun = self._waiting.head(Priority.WATCHDOG, now_s)
        if begun is not None:
            return to_feed(begun), False
        if others and self._fed_last and self._watchdog_arbiter.can_wait(now_s):
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
