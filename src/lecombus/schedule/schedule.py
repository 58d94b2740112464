"""Decides which request is sent next on a line.

Theory of operation. `next` returns which request goes now, and marks it as under way; `finished`
books the exchange. Both are O(log n). A stop always goes, in every state of its drive
(what else a stop does: waiting.py), but feeds may go before one of a silent drive
(silent_stops.py). Then come, in strict order, control, urgent feeds, interactive, cyclic and
background, each letting others go first as arbiter.py says. Which drives there are, and how each is
doing, stands in drive_table.py.

Each choice except a stop must pass the slack check (watchdog_set.py): it is begun only if every
watchdog can still be fed in time should it take its longest. If it does not, the feed that stands
in its way runs first, due or not. If it never could, it is refused, with the figures.

Which telegram feeds a drive stands in arbiter.py, too. While an answer is coming in the choice can
be made beforehand (`arbiter.Lookahead`); each change of the schedule invalidates it.

Deferred requests, holds and slots put off share one heap of times. Expired requests are
ended in batches, so that a hundred thousand of them do not block the line; one that comes to the
head of its class before its batch is ended there, never sent.

Pure: no clock, no I/O; `now_s` is monotonic seconds. What the requests say is not looked at here.
`settle` callbacks may call back into the schedule.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Final

from lecombus.schedule.arbiter import Arbiter, Lookahead, PlannedChoice, WatchdogArbiter, to_feed
from lecombus.schedule.drive_table import DriveTable
from lecombus.schedule.polling import Polling, PollingEntry
from lecombus.schedule.request import (
    OUT,
    QUEUED,
    UNDER_WAY,
    DispatchReason,
    Outcome,
    Priority,
    Request,
)
from lecombus.schedule.shares import Probe, Shares
from lecombus.schedule.silent_stops import SilentStops
from lecombus.schedule.stats import ScheduleStats, snapshot
from lecombus.schedule.watchdog_set import WatchdogSet

__all__ = ["Schedule"]

REFUSE_BATCH: Final = 16  # requests refused per choice for want of slack
# Feeds run to let one request fit, per fed drive, before it is put off for a while.
ROOMS_PER_FEED: Final = 4
# Feeds run before one exchange because its own drive's watchdog does not outlast it, and, per fed
# drive, because one is late. Where feeds take much of the watchdog time that is always so: without
# a bound the exchange would never begin.
FEEDS_FIRST: Final = 2
# Of the longest that ever fits: so long an exchange with a drive that was measured may be.
MEASURED_PART: Final = 0.5
# An idle line looks no sooner again for a feed that could not go, seconds.
LOOK_AGAIN_S: Final = 0.01
PRESSING: Final = (Priority.CONTROL, Priority.WATCHDOG, Priority.INTERACTIVE)
BY_MANUAL_PART: Final = 0.5  # of the shortest watchdog time: see `_admit_by_manual`


class Schedule(DriveTable):
    """Everything that waits for one line.

    Args:
        limits: Most waiting requests by class; classes not named keep their default (control
            1000, interactive 2000, background 10000). Stops have no limit.
        absent_share: The part of line time that probes of absent drives may take, 0..1.
    """

    def __init__(
        self, *, limits: Mapping[Priority, int] | None = None, absent_share: float = 0.10
    ) -> None:
        super().__init__(limits, absent_share)
        self._shares = Shares()
        self._watchdog_arbiter = WatchdogArbiter(self._waiting, self._watchdogs, self._polling)
        self._arbiter = Arbiter(
            self._waiting, self._watchdog_arbiter, self._polling, self._probes, self._shares
        )
        self._silent_stops = SilentStops(self._waiting, self._watchdogs, self._watchdog_arbiter)
        self._lookahead = Lookahead(
            self._waiting, self._watchdogs, self._polling, self._probes, self._shares
        )
        self._speaking_to: str | None = None
        self._reaching: tuple[str, ...] = ()  # by the telegram under way, if it is a multicast
        self._by_manual_from_s = -math.inf
        self._more = False  # the last choice stopped early: there is more to do immediately

    def _invalidate(self) -> None:
        self._lookahead.invalidate()

    # -- what can be seen of it -------------------------------------------------------------------

    @property
    def watchdogs(self) -> WatchdogSet:
        """The watchdogs of all drives."""
        return self._watchdogs

    @property
    def polling(self) -> Polling:
        """The cyclic requests of all drives."""
        return self._polling

    @property
    def silent(self) -> frozenset[str]:
        """The drives that did not answer a stop, or are offline: their stops wait for feeds."""
        return frozenset(self._waiting.silent)

    def is_held(self, drive: str) -> bool:
        """Return whether a drive is not used now, because of a write just now."""
        return self._drives[drive].held

    def feed_by_s(self, drive: str) -> float:
        """Return by when a drive's watchdog must be fed, monotonic seconds; infinite: never."""
        feed = self._watchdogs.by_drive.get(drive)
        return feed.hard_s if feed is not None and feed.active else math.inf

    def stops(self) -> list[Request]:
        """Return the stops that wait."""
        return self._waiting.queues[Priority.STOP].waiting()

    def never(self, request: Request) -> str:
        """Return why a request would never be begun beside the watchdogs; empty: it would."""
        return self._watchdogs.never(request)

    def never_beside_roster(self, request: Request, away: Collection[str]) -> str:
        """Return why it would never be begun beside what the roster names; empty: it would.

        Args:
            request: What would be sent.
            away: Drives that do not count.
        """
        return self._by_roster.never_beside(request, away)

    # -- requests coming in -----------------------------------------------------------------------

    def submit(self, request: Request, now_s: float) -> None:
        """Take a request.

        A request for a parked drive ends as refused before this returns; a stop does not.

        Raises:
            QueueFullError: Its class is full; the request has not been taken.
        """
        self._lookahead.invalidate()
        self._waiting.submit(request, now_s)

    def again(
        self, request: Request, now_s: float, not_before_s: float = 0.0, *, behind: bool = False
    ) -> None:
        """Take a request back for its next step, ahead of its class or `behind` it.

        Call it directly after `finished`. It is ended instead if a stop, a later request or
        parking came since. Its expiry no longer counts: it has begun.
        """
        self._lookahead.invalidate()
        self._waiting.place(request, behind=behind)
        self._waiting.take_back(request, not_before_s, now_s)

    def defer(self, request: Request, until_s: float, now_s: float) -> None:
        """Take back, to its old place, a request that may not be sent before a time."""
        self._speaking_to = None
        self._lookahead.invalidate()
        self._waiting.take_back(request, until_s, now_s)

    def is_speaking_to(self, drive: str) -> bool:
        """Whether an exchange with a drive is under way, or a stop of it waits."""
        stops = any(
            one.priority is Priority.STOP and (one.drive == drive or drive in one.members)
            for one in self._waiting.listed(stops=True)
        )
        under_way = self._speaking_to is not None and drive in self._reaching
        return stops or under_way or self._speaking_to == drive

    def join(self, stop: Request, *, yields: bool = False) -> bool:
        """Let a stop that was not yet sent stand for a new one like it; return whether it can."""
        self._lookahead.invalidate()
        return self._waiting.join(stop, yields=yields)

    def yield_no_more(self, stop: Request) -> None:
        """Let a stop that waits go before feeds after all, unless its drive is silent."""
        self._waiting.yield_no_more(stop)

    def withdraw(self, request: Request, outcome: Outcome, reason: str) -> bool:
        """End a request if it still waits; return whether it did."""
        self._lookahead.invalidate()
        return self._waiting.withdraw(request, outcome, reason)

    # -- the choice -------------------------------------------------------------------------------

    def next(self, now_s: float) -> Request | None:
        """Choose what goes now, and mark it as under way; None if nothing may go yet."""
        planned = self._lookahead.holding(now_s)
        self._lookahead.invalidate()
        if planned is not None:
            return self._begin(planned, now_s)
        waiting = self._waiting
        if waiting.timers and waiting.timers[0][0] <= now_s:
            self._run_timers(now_s)
        if waiting.expiries.may_have_expired(now_s):
            waiting.expire(now_s)
        stop = waiting.stop()
        self._more = False
        if stop is not None:
            first = self._silent_stops.turn(stop, now_s)
            return None if first is None else self._start(first, now_s)
        for _ in range(REFUSE_BATCH):
            request, feeding = self._arbiter.first(now_s)
            if request is None:
                return None
            admitted = request if feeding else self._admit(request, now_s)
            if admitted is not None:
                return self._start(admitted, now_s)
        self._more = True
        return None

    def look_ahead(
        self, under_way: Request | None, started_s: float, at_s: float
    ) -> Request | None:
        """Make the next choice beforehand, if it is a plain one: call it while the line is busy.

        Args:
            under_way: What is on the line now; None if nothing is.
            started_s: When that began; now, if nothing is on the line.
            at_s: When the line is expected to be free.

        Returns:
            What `next` will give at that time unless something changes; None: not known.
        """
        found = self._lookahead.make(under_way, started_s, at_s)
        if found is None:
            self._polling.prepare()
        return found

    def stop_goes(self, now_s: float) -> bool:
        """Return whether `next` would give a stop at this moment."""
        if self._waiting.timers and self._waiting.timers[0][0] <= now_s:
            self._lookahead.invalidate()  # another stop may be the first from now on
            self._run_timers(now_s)
        stop = self._waiting.stop()
        return stop is not None and self._silent_stops.goes(stop, now_s)

    def planned(self, now_s: float) -> Request | None:
        """Return what was chosen beforehand, if that still holds."""
        found = self._lookahead.holding(now_s)
        return None if found is None else found.request

    def follow(self, done: Request, started_s: float, ended_s: float, now_s: float) -> None:
        """Book an exchange that was answered, and what was planned as begun directly after it.

        Args:
            done: The request whose exchange it was.
            started_s: When its first character went out.
            ended_s: When its answer was complete.
            now_s: When the request given by `planned` was begun.
        """
        found = self._lookahead.holding(now_s)
        assert found is not None, "nothing was planned"
        self._lookahead.invalidate()
        self.finished(done, started_s, ended_s, reached=True)
        self._begin(found, now_s)

    def _begin(self, found: PlannedChoice, now_s: float) -> Request:
        """Mark what was chosen beforehand as under way."""
        request = found.request
        if request.priority is not Priority.STOP:
            self._more = False
            self._arbiter.took(request, found.waiting, ahead=found.ahead)
        return self._start(request, now_s)

    def _run_timers(self, now_s: float) -> None:
        for what in self._waiting.run_timers(now_s):
            if isinstance(what, PollingEntry):
                self._polling.rejoin(what, now_s)
            elif what.held and what.held_until_s > now_s:  # the hold was extended
                self._waiting.at(what.held_until_s, what)
            elif what.held:
                slots = self._polling.is_due(what.name, now_s)
                self._waiting.keep(what, slots=slots, now_s=now_s)
                self._release(what, now_s)

    def _admit(self, request: Request, now_s: float) -> Request | None:
        """Let a request go if no watchdog can suffer; else run what must go first, or end it."""
        feeds = self._watchdogs
        fits = feeds.fits(now_s, feeds.need_s(request), request.drive)
        late = feeds.late(now_s)
        count = 1 if late is not None and late.drive == request.drive else len(feeds.by_drive)
        late = late if request.late_first < FEEDS_FIRST * count else None
        own = feeds.own_first(now_s, request.unfed_s, request.drive)
        holds = own is not None and feeds.fits(now_s, own.cost_s, request.drive)
        own = own if holds and request.fed_first < FEEDS_FIRST else None
        if late is not None and (own is None or not feeds.lost_too_many(late)):
            request.late_first += 1
            return to_feed(self._watchdog_arbiter.telegram(late, now_s))
        if own is not None:
            request.fed_first += 1
            return to_feed(self._watchdog_arbiter.plain(own))
        fits = fits and feeds.own_holds(request, now_s)
        if fits:
            return request
        return self._make_room(request, now_s)

    def _make_room(self, request: Request, now_s: float) -> Request | None:
        """Run what must go before a request that does not fit now, or end it if it never will."""
        feeds = self._watchdogs
        reason = feeds.never(request)
        if reason and request.documented is not None:
            request.shorten(feeds.most_s(request.drive)[0] * MEASURED_PART)
            reason = feeds.never(request)
        if reason and feeds.is_measured and not feeds.by_manual:
            return self._admit_by_manual(request, now_s)
        if reason:
            self._refuse(request, reason, now_s)
            return None
        if request.rooms < ROOMS_PER_FEED * len(feeds.by_drive):
            need_s = feeds.need_s(request)
            feed = feeds.room(now_s, need_s, request.drive) or feeds.own_room(request, now_s)
            if feed is not None:
                request.rooms += 1
                own = feeds.own_before(now_s, feed, request.drive)
                if own is None:  # it lost an answer, and must not be late for what it wants itself
                    own = feeds.own_late(now_s + feed.cost_s, request.drive)
                    own = None if own is None or own.free_s() > now_s else own
                return to_feed(self._watchdog_arbiter.telegram(own or feed, now_s))
        if request.rooms:
            request.eased += 1
        self._put_off(request, feeds.retry_s(now_s))
        return None

    def _admit_by_manual(self, request: Request, now_s: float) -> Request | None:
        """Let go now and then what fits by the manual, but never by what was measured.

        What was measured may be wrong by now, and must not close the line. If it is right, a
        watchdog may be fed late because of this: so it is one exchange in half the time of the
        shortest watchdog, and no more.
        """
        feeds = self._watchdogs
        if now_s < self._by_manual_from_s:
            self._put_off(request, self._by_manual_from_s)
            return None
        feeds.count_by(manual=True)
        try:
            need_s = feeds.need_s(request)
            if not (feeds.fits(now_s, need_s, request.drive) and feeds.own_holds(request, now_s)):
                return self._make_room(request, now_s)
        finally:
            feeds.count_by(manual=False)
        self._by_manual_from_s = now_s + BY_MANUAL_PART * feeds.shortest_s()
        return request

    def _refuse(self, request: Request, reason: str, now_s: float) -> None:
        if request.state == QUEUED:
            self._waiting.end_waiting(request, Outcome.REFUSED, reason)
            return
        source = request.source
        if isinstance(source, PollingEntry):
            self._polling.drop(source, now_s)
        elif isinstance(source, Probe):
            self._probes.drop(source, now_s)
        self._waiting.end(request, Outcome.REFUSED, reason)

    def _put_off(self, request: Request, until_s: float) -> None:
        """Set aside what cannot go now, so that it does not block its class."""
        request.rooms = 0
        self._shares.passed(request)
        source = request.source
        if request.state == QUEUED:
            self._waiting.put_off(request, until_s)
        elif isinstance(source, PollingEntry):
            self._polling.set_apart(source)
            self._waiting.at(until_s, source)
        elif isinstance(source, Probe):
            self._probes.schedule(source, until_s)

    def _start(self, request: Request, now_s: float) -> Request:
        """Mark a request as under way."""
        if request.state == QUEUED:
            self._waiting.leave(request)
        else:
            self._waiting.number(request)
            request.submitted_at_s = now_s
            source = request.source
            if type(source) is PollingEntry:
                self._polling.take(source, now_s)
            elif type(source) is Probe:
                self._probes.take(source, now_s)
        request.state = UNDER_WAY
        request.fed_first = request.late_first = 0
        request.kept_first = False
        self._speaking_to, self._reaching = request.drive, request.members
        drive = self._drives.get(request.drive)
        if drive is not None and drive.kept:
            drive.kept.pop(request.priority, None)
        return request

    def wake_at_s(self, now_s: float) -> float | None:
        """Return, after `next` gave None, when to ask again; None: when something is submitted."""
        waiting = self._waiting
        if self._more or waiting.expiries.may_have_expired(now_s):
            return now_s
        timer_s = waiting.timers[0][0] if waiting.timers else None
        times: tuple[float | None, ...]
        if waiting.stop() is not None:  # nothing goes before it but feeds, and none can go now
            times = timer_s, self._silent_stops.wake_at_s
        else:
            times = (
                timer_s,
                waiting.expiries.next_s(),
                self._polling.next_s(),
                self._watchdogs.next_s(now_s),
                self._probes.next_s(now_s),
            )
        return min((at_s for at_s in times if at_s is not None), default=None)

    def may_idle(self, now_s: float, for_s: float) -> bool:
        """Whether the line may be left idle for so long: no watchdog suffers, nothing is urgent."""
        return self._watchdogs.fits(now_s, for_s, "") and self.wanted_at_s(now_s) > now_s

    def wanted_at_s(self, now_s: float) -> float:
        """Return when to look again whether anything but cyclic and background work wants the line.

        These may wait while the line is left idle on purpose. All else ends that, also a stop that
        must itself wait for a feed.

        Returns:
            `now_s`: something wants the line. Submitting may make it so at any time.
        """
        waiting = self._waiting
        self._lookahead.invalidate()
        if waiting.timers and waiting.timers[0][0] <= now_s:
            self._run_timers(now_s)
        if waiting.stop() is not None or self._watchdog_arbiter.urgent(now_s) is not None:
            return now_s
        if any(waiting.head(one, now_s) is not None for one in PRESSING):
            return now_s
        timer_s = waiting.timers[0][0] if waiting.timers else math.inf
        feed_s = self._watchdogs.next_s(now_s)
        return min(timer_s, math.inf if feed_s is None else max(feed_s, now_s + LOOK_AGAIN_S))

    # -- what the line reports --------------------------------------------------------------------

    def finished(self, request: Request, started_s: float, now_s: float, reached: bool) -> None:
        """Book an exchange that ended.

        Args:
            request: What `next` gave.
            started_s: When its first character went out.
            now_s: When the line was free again.
            reached: The drive answered: its watchdog counts as fed at `started_s`.
        """
        if not reached:
            self._lookahead.invalidate()
            if request.priority is Priority.STOP and not request.members:
                self._waiting.set_silent(request.drive, silent=True)
        elif self._waiting.silent and self._silent_stops.ends_silence(request):
            self._waiting.set_silent(request.drive, silent=False)
        request.attempts += 1
        request.state = OUT
        self._speaking_to = None
        self._waiting.forget_key(request)
        if request.writes:
            self._waiting.went_out(request)
        duration_s = now_s - started_s
        self._shares.book(request.priority, request.turn, duration_s)
        request.turn = DispatchReason.RIGHT
        if type(request.source) is Probe:
            self._probes.paid(duration_s, now_s)
        feed = self._watchdogs.by_drive.get(request.drive)
        if feed is not None and feed.active and not request.members:
            if not reached:
                self._watchdogs.failed(feed, now_s)
            elif started_s >= feed.fed_at_s:
                feed.reached(started_s)
                if feed.left_out:  # it counts in the slack check again
                    self._watchdogs.changed()

    def stats(self, now_s: float) -> ScheduleStats:
        """Take a snapshot; it begins new measures (see `stats`)."""
        return snapshot(
            self._waiting, self._watchdogs, self._polling, self._probes, self._speaking_to, now_s
        )
