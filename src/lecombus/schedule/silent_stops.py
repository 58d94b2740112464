"""When a stop is sent to a drive that does not answer, so that it costs no other its watchdog.

A stop goes before everything else. But an exchange without answer feeds no watchdog, and after a
few of them in a row other drives act by their own watchdogs. So:

* The first telegram of a stop does not wait for feeds: the drive probably receives it. This does
  not hold for a drive that is offline or did not answer an earlier stop.
* Once a drive has not answered a stop, and from the beginning where it is offline, every telegram
  of its stops must pass the slack check, with the spare for lost answers left over
  (watchdog_set.py). Until it does, the feed that is in the way goes first: that read alone, nothing
  else. So does the feed of a drive that is late already, whether its watchdog has run out or not:
  the check leaves it out, and it may be the drive that still moves.
* That wait is bounded: by one feed of every watched drive (a round of the line), and the attempts
  that another drive costs which goes offline just then. After that the stop goes even if watchdogs
  expire, because it may be the one telegram that is received. A drive that is left alone for a
  moment (a hold) is waited for if its feed is in the way, and fed.
* The wait must not make the stopped drive's own watchdog act: that drive may be there, and may have
  missed no more than the lost answers that are tolerated (`FaultHypothesis`). Its own feed does
  not go before its stop; if the next feed is due after its own and would make it late, the stop
  goes first. But where the stop would take so long that others act, although answered (an 820X:
  0.2 s) or, while that is tolerated, not answered (half a second), the drive's feed goes in its
  place, and the stop when there is room or after that time.

A drive that answers anything else is no longer silent, and its stop goes first again. Only what is
read for more proof, when it has acknowledged the stop and shown it, waits in the same way: the plan
counts one reading. It waits for the room that a reading needs, and for none that feeds cannot make:
a stop may take far longer (an 820X), and each proof of it would wait a second in vain. Which stops
come before which stands in waiting.py.

Pure: the times are arguments.
"""

from __future__ import annotations

import math

from lecombus.schedule.arbiter import WatchdogArbiter
from lecombus.schedule.request import Request
from lecombus.schedule.waiting import Waiting
from lecombus.schedule.watchdog_deadline import WatchdogDeadline
from lecombus.schedule.watchdog_set import ROUNDING_S, WatchdogSet

__all__ = ["SilentStops"]


class SilentStops:
    """Delays stops of drives that do not answer until other watchdogs are safe.

    Args:
        waiting: Knows who is silent.
        watchdogs: The watchdogs.
        watchdog_arbiter: Makes the telegrams that feed.
    """

    __slots__ = ("_arbiter", "_instead", "_waiting", "_watchdogs", "wake_at_s")

    def __init__(
        self, waiting: Waiting, watchdogs: WatchdogSet, watchdog_arbiter: WatchdogArbiter
    ) -> None:
        self._waiting = waiting
        self._watchdogs = watchdogs
        self._arbiter = watchdog_arbiter
        self._instead: Request | None = None  # the last feed that went in place of a stop
        self.wake_at_s = math.inf  # a stop waits until then for a drive that is left alone

    def held(self, stop: Request) -> bool:
        """Return whether a stop waits for feeds at all."""
        return self._waiting.yields(stop)

    def goes(self, stop: Request, now_s: float) -> bool:
        """Return whether a stop may go now; changes nothing."""
        if not self.held(stop):
            return True
        feeds = self._watchdogs
        fits = feeds.fits(now_s, self._needed_s(stop), stop.drive)
        return fits and self._late(now_s) is None

    def turn(self, stop: Request, now_s: float) -> Request | None:
        """Choose what goes when a stop is the first in the queue.

        Returns:
            The stop, or the feed that goes before it; None: wait until `wake_at_s`.
        """
        self.wake_at_s = math.inf
        if self.goes(stop, now_s):
            return stop
        feeds = self._watchdogs
        if stop.latest_s is None:
            stop.latest_s = now_s + self._longest_wait_s(stop) - ROUNDING_S
        if now_s >= stop.latest_s:
            return stop
        feed = self._late(now_s) or feeds.room(now_s, self._needed_s(stop), stop.drive)
        if feed is not None:
            own = feeds.own_before(now_s, feed, stop.drive)
            if own is not None and feed.outlasts_late(now_s, own.cost_s):
                return self._in_place(own)
            own = feeds.own_late(now_s + feed.cost_s, stop.drive)
            if own is None or feed.hard_s < own.hard_s:
                return self._arbiter.plain(feed)
            return self._own_turn(stop, own, feed, now_s)
        held = feeds.first_held(now_s, stop.drive)
        if held is None or feeds.fits(now_s, stop.worst_s, stop.drive):
            return stop
        if feeds.own_late(held.held_until_s + held.cost_s, stop.drive) is not None:
            return stop
        self.wake_at_s = held.held_until_s
        stop.latest_s = max(stop.latest_s, held.held_until_s + held.cost_s - ROUNDING_S)
        return None

    def _own_turn(
        self, stop: Request, own: WatchdogDeadline, other: WatchdogDeadline, now_s: float
    ) -> Request:
        """Choose what feeds the drive to be stopped: its stop, or its feed where that is shorter.

        A stop that is answered may take long, too: it must leave others the last tenth of theirs,
        also if it is not answered, while that is one of the lost answers that are tolerated. While
        its drive is left alone, the other feed goes.
        """
        feeds = self._watchdogs
        takes_s = min(stop.worst_s, max(stop.cost_s, feeds.faults.stop_s))
        if takes_s <= own.cost_s:
            return stop
        if own.failures < feeds.faults.tolerate:
            takes_s = stop.worst_s
        holds = feeds.fits(now_s, takes_s - feeds.tenth_s(), stop.drive)
        if holds and other.outlasts_late(now_s, takes_s):
            return stop
        if own.held_until_s > now_s:
            return self._arbiter.plain(other)
        return self._in_place(own)

    def _in_place(self, own: WatchdogDeadline) -> Request:
        """Make the feed that goes in place of the stop of its drive."""
        self._instead = self._arbiter.plain(own)
        return self._instead

    def ends_silence(self, request: Request) -> bool:
        """Return whether the answer to a request ends the silence of its drive.

        That to a feed in place of the stop does not: the stop would go before all other feeds.
        """
        return request is not self._instead

    def _late(self, now_s: float) -> WatchdogDeadline | None:
        """Find a drive that is fed too late, if it is not one that stays silent anyhow."""
        return self._watchdogs.late(now_s, lapsed=True, but=self._waiting.silent)

    def _longest_wait_s(self, stop: Request) -> float:
        """Return after how long it goes in any case: a round if no slack will do."""
        feeds = self._watchdogs
        never = stop.worst_s > feeds.most_s(stop.drive)[0]
        return feeds.round_s() + (0.0 if never else feeds.lost_s())

    def _needed_s(self, stop: Request) -> float:
        """Return how much slack it takes: its longest, and what is kept for lost answers.

        Of a drive that answers as much as of any other exchange, if there ever is so much.
        """
        feeds = self._watchdogs
        most_s, _ = feeds.most_s(stop.drive)
        if stop.drive not in self._waiting.silent:
            need_s = feeds.need_s(stop)
            if need_s <= most_s:
                return need_s
        room_s = max(most_s - stop.worst_s, 0.0) / 2
        return stop.worst_s + min(feeds.lost_s(), room_s)
