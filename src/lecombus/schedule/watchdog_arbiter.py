"""Which telegram feeds a drive, and whether one must be fed now.

A feed is a useful telegram: the drive's first waiting control or interactive request, else its
next cyclic slot run early, else the read that its `WatchdogFeeding` makes. What is
urgent follows from the deadlines (watchdog_set.py); the order of the classes stands in schedule.py.
"""

from __future__ import annotations

from typing import Final

from lecombus.schedule.polling import Polling, PollingEntry
from lecombus.schedule.request import Priority, Request
from lecombus.schedule.waiting import Waiting, has_expired
from lecombus.schedule.watchdog_deadline import SPARE_ATTEMPTS, WatchdogDeadline
from lecombus.schedule.watchdog_set import WatchdogSet

__all__ = ["WatchdogArbiter"]

TURNS_PART: Final = 2 / 3  # of the spare: with less slack, urgent feeds no longer take turns


class WatchdogArbiter:
    """Chooses telegrams that feed.

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
        """Find a cyclic slot, to be run in place of another, of a drive to be fed soon."""
        polling, entry = self._polling, slot.source
        if type(entry) is not PollingEntry or not polling.may_wait(entry, now_s):
            return None
        feed = self._watchdogs.pressing(now_s, self._watchdogs.soon_s())
        early = polling.early(feed.drive, now_s) if feed and feed.drive != slot.drive else None
        fits = early is not None and feed and self._serves(early.made(), feed, now_s)
        return early.made() if early is not None and fits else None

    def urgent(self, now_s: float) -> Request | None:
        """Find the telegram for the feed that goes first, if any is urgent.

        When time is short it is the one with the earliest deadline of all, due or not. A drive
        that never answers may take its longest: it waits until that fits, or, if it never will,
        is tried all the same, at its own slow pace.
        """
        feeds = self._watchdogs
        for feed in feeds.due(now_s):
            if feeds.fits(now_s, feed.worst_s, feed.drive):
                return self.telegram(feed, now_s)
            if feed.failures < SPARE_ATTEMPTS:  # a lost answer or two: the spare is kept for it
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
        if not feed.outlasts(now_s, request.unfed_s):
            return False
        feeds = self._watchdogs
        return feeds.fits(now_s, feeds.need_s(request), feed.drive)
