"""The next choice, made beforehand while an answer is still being received.

A choice takes longer than a character on the wire, and it would delay the next telegram. So it is
made beforehand, for the time at which the answer is expected and on the assumption that the drive
answers. It is used if nothing has changed by then.

Only the simple case is planned: a stop, or the head of a class while no feed is near to urgent. All
other cases (a feed due or urgent, a probe, a request delayed by a watchdog's deadline, something
that joins, expires or comes back at that time) are decided when the line becomes free; that choice
is always right. A planned choice is valid between two times that are kept with it: from when its
slot is due until something could become due, expire, or run short of slack.

Each change of the schedule invalidates the planned choice. Planning changes nothing: no request is
begun and no credit booked. The tests compare planned choices with those made when the line is free.

Pure: the times are arguments.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from lecombus.schedule.polling import Polling, PollingEntry
from lecombus.schedule.request import Priority, Request
from lecombus.schedule.shares import CLASS_SHARES, Probe, Probes, Shares
from lecombus.schedule.waiting import QueuedDrive, Waiting
from lecombus.schedule.watchdog_set import WatchdogSet

__all__ = ["Lookahead", "PlannedChoice"]


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
