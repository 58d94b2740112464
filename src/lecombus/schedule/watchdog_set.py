"""Watchdog deadlines: which drive needs a telegram by when, and what may run before that.

A drive's watchdog runs from the last exchange it answered, counted from that exchange's start. A
feed must be over at nine tenths of the watchdog time (the hard deadline); the rest is kept for
clocks, operating systems and the wire. It is due while three failed attempts would still fit
before that, but not before half the watchdog time: fed earlier than needed, a full line has time
for little else, because most drives are fed by what is due anyhow, if that is waited for.

The slack check. With the feeds sorted by hard deadline, an exchange that can hold the line for w
seconds may start only if for every feed i: now + w + (cost of feeds 1..i) <= hard_i. So there is a
latest moment L = min over i of (hard_i - cost of 1..i) at which the line must be free for feeding,
and the check is now + w <= L. Feeding a drive moves its deadline back and never brings L forward:
for the fed drive, the sum at its new place equals the old sum of the feed before it, and its
deadline is later than that one's. An L once computed thus stays a safe bound, and the usual check
is one comparison; it is computed again, O(n log n), only when the bound is reached.

An exchange feeds its own drive from its start, so that drive's bound does not count; its feed goes
first where a lost answer would make it late. But one that takes longer, answered, than that feed
does in vain (a module's own codes) must fit into its own drive's time as well: it goes directly
behind a feed, and what never fits is refused (`own_holds`).

The spare. Costs are those of answered exchanges, and a lost answer holds the line for longer. So
feeding begins while L is still further away than three failed attempts, though never further than
half of what it is at best, so that short watchdogs do not take the whole line (`spare_s`), but in
any case while the lost answers that are tolerated would still fit, and a stop with one of them.
What was measured of slow drives counts in all of this, unless it leaves no room for a single failed
feed: it may be wrong, and could not be held if it were right. Then the manual counts.

A feed that can no longer be in time is left out of L: waiting for it would cost the others
theirs. A drive that does not answer is tried again after half the time that is left, or sooner if
else its spare attempts would not fit, so that it cannot keep the line for itself; once its
watchdog has fired and those are used up, it is tried every half watchdog time.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from operator import attrgetter, itemgetter
from typing import Final

from lecombus.schedule.request import Request
from lecombus.schedule.watchdog_deadline import (
    HARD_PART,
    SOFT_PART,
    SPARE_ATTEMPTS,
    FaultHypothesis,
    WatchdogDeadline,
)

__all__ = ["WatchdogSet"]

ROUNDING_S: Final = 1e-9  # a feed that is just in time must not be late by a rounding error
WAKE_S: Final = 1e-6
_hard, _held_until, _time = map(attrgetter, ("hard_s", "held_until_s", "time_s"))
_first = itemgetter(0)
SOON: Final = 2.0  # times the slack kept for attempts: with less, cyclic slots are chosen to feed
EASED_PART: Final = 0.75  # of the room that was made in vain: see `_waited_for_s`
SPARE_PART: Final = 0.5  # of the best slack: more is not kept for failed attempts


class WatchdogSet:
    """The watchdogs of all drives of a line."""

    __slots__ = (
        "_due_from_s", "_latest_end_s", "_left_out", "_lost", "_measured", "_most", "_spare_s",
        "by_drive", "by_manual", "faults",
    )  # fmt: skip

    def __init__(self, faults: FaultHypothesis | None = None) -> None:
        self.faults = faults or FaultHypothesis()
        self._lost: tuple[float, float] | None = None  # see `_losses`; None: to be computed
        self._measured: bool | None = None  # see `is_measured`; None: to be looked at
        self._most: dict[str, float] = {}  # by drive spoken to: the most slack that there ever is
        self.by_drive: dict[str, WatchdogDeadline] = {}
        self._latest_end_s = math.inf  # a lower bound of L, see above
        self._due_from_s = math.inf  # a lower bound: no feed is due before
        self._left_out = False  # some feeds were left out of the last sums
        self._spare_s: tuple[float, float] | None = None  # see `_spares`; None: to be computed
        self.by_manual = False  # what was measured does not count: nothing would fit

    def changed(self) -> None:
        """Forget the bounds: a feed was added, taken away, paused, restarted or costs otherwise."""
        self.count_by(manual=False)
        if self.is_measured:
            worst_s = max(feed.costs.documented[1] for feed in self.by_drive.values())
            if self.most_s("")[0] < worst_s:
                self.count_by(manual=True)

    def count_by(self, *, manual: bool) -> None:
        """Use the times of manual and roster, or the measured ones."""
        self.by_manual = manual
        for feed in self.by_drive.values():
            feed.cost_s, feed.worst_s = feed.costs.documented if manual else feed.costs.measured
        self._latest_end_s = self._due_from_s = -math.inf
        self._spare_s = self._lost = None
        self._measured = None
        self._most.clear()

    def need_s(self, request: Request) -> float:
        """Return how much slack it takes to begin an exchange: room for what may be lost, seconds.

        Limited to the slack that can occur; otherwise a fitting exchange would never begin.
        """
        need_s = self._whole_need_s(request)
        most_s = self._most.get(request.drive)
        if most_s is None:
            most_s = self._most[request.drive] = self.most_s(request.drive)[0]
        return self._waited_for_s(request, need_s, most_s, self._least_room_s(request))

    def _whole_need_s(self, request: Request) -> float:
        """Return how much slack it takes to begin an exchange, also where there never is so much.

        A multicast is not answered and feeds no drive, and its members are left alone after it. All
        lost answers and the stop may come behind that.
        """
        if request.members:
            behind_s = self.faults.left_s(self.faults.tolerate, *self._losses())
            return request.worst_s + request.hold_s + behind_s
        return self.faults.need_s(request.cost_s, request.worst_s, *self._losses())

    def _waited_for_s(
        self, request: Request, need_s: float, most_s: float, least_s: float
    ) -> float:
        """Return for how much room an exchange waits, of what it needs, seconds.

        There may never be so much: more lost answers are tolerated than ever fit, or feeds take as
        long as measured and never leave the room that the manual promises. Where the most that
        there can be was made in vain, less will do, by the manual also less than its own lost
        answer takes (`Schedule._admit_by_manual` says what that may cost).
        """
        if least_s > most_s:
            return least_s - ROUNDING_S  # see `never`
        if need_s <= most_s - ROUNDING_S and not (self.by_manual and request.eased):
            return need_s
        floor_s = request.cost_s if self.by_manual else least_s
        eased_s = min(need_s, most_s) * EASED_PART**request.eased
        return max(eased_s, floor_s) - ROUNDING_S

    def _least_room_s(self, request: Request) -> float:
        """Return how much slack there must be at some time for an exchange, or it is not begun.

        Where measured times count, room for its own lost answer is enough: they may be wrong. A
        multicast takes all of its room: its members can be spoken to one by one instead.
        """
        if request.members:
            return self._whole_need_s(request)
        if request.documented is not None or self.is_measured:
            return request.worst_s
        return self.least_room_s(request.cost_s, request.worst_s)

    def least_room_s(self, cost_s: float, worst_s: float) -> float:
        """Return how much slack an exchange takes with a stop and one lost answer, at least."""
        return self.faults.least_room_s(cost_s, worst_s, *self._losses())

    def behind_s(self) -> tuple[float, float]:
        """Return how much slack is kept behind an exchange, answered and not answered, seconds."""
        faults, losses = self.faults, self._losses()
        left_s = faults.left_s(faults.tolerate - 1, *losses) if faults.tolerate else 0.0
        return faults.behind_s(*losses), left_s

    def _losses(self) -> tuple[float, float]:
        """Give the longest lost feed, and a tenth of the shortest watchdog time."""
        if self._lost is None:
            active = [feed for feed in self.by_drive.values() if feed.active]
            self._lost = (
                max((feed.worst_s for feed in active), default=0.0),
                (1.0 - HARD_PART) * min((feed.time_s for feed in active), default=0.0),
            )
        return self._lost

    @property
    def is_measured(self) -> bool:
        """Whether something was measured that makes a feed longer than its manual does."""
        if self._measured is None:
            self._measured = any(feed.costs.is_longer for feed in self.by_drive.values())
        return self._measured

    def tenth_s(self) -> float:
        """Return the last tenth of the shortest watchdog time, seconds: it is there to be used."""
        return (1.0 - HARD_PART) * self.shortest_s()

    def shortest_s(self) -> float:
        """Return the shortest watchdog time, seconds."""
        return min(feed.time_s for feed in self.by_drive.values())

    @property
    def calm_until_s(self) -> float:
        """Before this no feed is due; it may be long after it that one is."""
        return self._due_from_s

    @property
    def latest_end_s(self) -> float:
        """An exchange over by then makes no feed late, for any drive."""
        return self._latest_end_s

    def fits(self, now_s: float, worst_s: float, drive: str) -> bool:
        """Return whether an exchange with a drive may start now.

        The drive's own deadline does not forbid it, as the exchange feeds it; but its feed stays
        in the sums of the others, as an exchange that times out feeds nothing.
        """
        end_s = now_s + worst_s
        if end_s <= self._latest_end_s:
            return True
        return self._fit(self._in_order(now_s), end_s, drive)

    def _fit(self, feeds: list[WatchdogDeadline], end_s: float, drive: str) -> bool:
        """Return whether all feeds still fit behind an exchange; keeps the bound for all drives."""
        latest_s = others_s = math.inf
        total_s = 0.0
        for feed in feeds:
            total_s += feed.cost_s
            end_by_s = feed.hard_s - total_s
            if end_by_s < latest_s:
                latest_s = end_by_s
            if end_by_s < others_s and feed.drive != drive:
                others_s = end_by_s
        self._latest_end_s = latest_s
        return end_s <= others_s

    def _in_order(self, now_s: float) -> list[WatchdogDeadline]:
        """Sort the feeds that can still be in time by hard deadline, and count those too late."""
        found = []
        self._left_out = False
        for feed in self.by_drive.values():
            if not feed.active:
                continue
            cost_s, by_s = feed.cost_s, feed.hard_s + ROUNDING_S
            feed.left_out = (
                now_s + cost_s > by_s
                or feed.held_until_s + cost_s > by_s
                or feed.retry_at_s + cost_s > by_s
            )
            if not feed.left_out:
                found.append(feed)
            else:
                feed.judge(now_s)
                self._left_out = True
        found.sort(key=_hard)
        return found

    def due(self, now_s: float) -> list[WatchdogDeadline]:
        """List the feeds that are due, the earliest hard deadline first."""
        if now_s < self._due_from_s:
            return []
        found = []
        earliest_s = math.inf
        for feed in self.by_drive.values():
            if feed.active:
                next_s = feed.due_s
                if next_s <= now_s:
                    next_s = feed.next_s()
                    if next_s <= now_s:
                        found.append(feed)
                if next_s < earliest_s:
                    earliest_s = next_s
        self._due_from_s = earliest_s
        found.sort(key=_hard)
        return found

    def own_first(self, now_s: float, worst_s: float, drive: str) -> WatchdogDeadline | None:
        """Find the drive's own feed if it goes before a longer exchange with that drive.

        Not answered, the exchange would make it late; after a lost answer, also if that leaves no
        time for all others that may yet be lost.
        """
        own = self.by_drive.get(drive)
        if own is None or not own.active or worst_s <= own.worst_s:
            return None
        if own.failures:
            left = self.faults.tolerate - own.failures  # answers that may yet be lost
            holds = now_s + worst_s + (left - 1) * own.worst_s + own.cost_s <= own.hard_s
            return None if left < 1 or holds or own.free_s() > now_s else own
        return None if own.outlasts(now_s, worst_s) or own.free_s() > now_s else own

    def failed(self, feed: WatchdogDeadline, now_s: float) -> None:
        """Note that a drive did not answer, and when to ask it again.

        Its pause ends while there is still room for the answers that may yet be lost and for a
        stop: a stop waits for nothing, and what is not free to be fed is not fed before it.
        """
        tolerate = self.faults.tolerate
        feed.failed(now_s, tolerate)
        left = tolerate - feed.failures
        if tolerate and left >= 0:
            by_s = now_s + self.slack_s(now_s) - self.faults.left_s(left, *self._losses())
            feed.pause_until(by_s, now_s)

    def lost_too_many(self, feed: WatchdogDeadline) -> bool:
        """Return whether a drive lost more answers in a row than are tolerated: it may be gone."""
        return feed.failures > self.faults.tolerate

    def own_late(self, from_s: float, drive: str) -> WatchdogDeadline | None:
        """Find the feed of a drive if it would be late, were it spoken to only from a time on.

        One that has lost more answers than are tolerated is not counted: it may be gone.
        """
        own = self.by_drive.get(drive)
        if own is None or not own.active or own.lapsed or self.lost_too_many(own):
            return None
        return own if from_s + own.cost_s > own.hard_s else None

    def own_before(
        self, now_s: float, other: WatchdogDeadline, drive: str
    ) -> WatchdogDeadline | None:
        """Find a drive's own feed if it goes before another's that makes room for that drive.

        The exchange that room is made for feeds the drive only if it is answered. Behind one more
        feed there would be no time left for the lost answers that are tolerated, or for a stop of
        another drive, as far as there ever is such time. It does not go before where it, not
        answered, would make another feed late whose deadline is earlier.
        """
        own = self.by_drive.get(drive)
        if own is None or not own.active or own.failures or own.free_s() > now_s:
            return None
        if own.hard_s > other.hard_s and not self.fits(now_s, own.worst_s, drive):
            return None
        behind_s = min(self.faults.behind_s(*self._losses()), self.most_s("")[0])
        behind_s = max(self.faults.tolerate * own.worst_s, behind_s)
        # A round of all feeds goes between two of it, or half its time: else room is never made.
        left_s = own.time_s * HARD_PART - self.round_s() - own.cost_s
        behind_s = min(behind_s, max(left_s, own.time_s * SOFT_PART))
        return own if now_s + other.cost_s + behind_s + own.cost_s > own.hard_s else None

    def own_holds(self, request: Request, now_s: float) -> bool:
        """Return whether the own watchdog of a drive outlasts a long exchange begun now.

        One whose time has run out has acted, or the drive is not there.
        """
        own = self._own_beside(request)
        if own is None or now_s > own.acts_s:
            return True
        return now_s + self.own_need_s(request, own) + own.cost_s <= own.hard_s + ROUNDING_S

    def own_room(self, request: Request, now_s: float) -> WatchdogDeadline | None:
        """Choose the feed to run first so that a long exchange fits into its own drive's time."""
        own = self._own_beside(request)
        if own is None or self.own_holds(request, now_s):
            return None
        return _room(self._in_order(now_s), now_s, self.own_need_s(request, own), "")

    def _own_beside(self, request: Request) -> WatchdogDeadline | None:
        """Find the own feed of a drive if an exchange takes longer, answered, than it does in vain.

        A module's own codes take half a second: that exchange feeds the drive only when it begins,
        and the next feed comes behind it. For all others it is enough that the feed goes first.
        """
        own = self.by_drive.get(request.drive)
        if own is None or not own.active or request.members:
            return None
        return own if by_manual(request)[0] > own.worst_s else None

    def own_need_s(self, request: Request, own: WatchdogDeadline) -> float:
        """Return how much of its own drive's time a long exchange takes, seconds; as `need_s`."""
        cost_s, worst_s = by_manual(request)
        need_s = self.faults.need_s(cost_s, worst_s, *self._losses())
        least_s = self._own_least_s(request, own)
        return self._waited_for_s(request, need_s, self._most_of_all_s(), least_s)

    def _own_least_s(self, request: Request, own: WatchdogDeadline) -> float:
        """Return how much of its own drive's time it takes at least, behind a feed of that drive.

        Its answer is lost, or, if answers may be lost, that of the feed behind it.
        """
        cost_s, worst_s = by_manual(request)
        lost_s = own.worst_s - own.cost_s if self.faults.tolerate else 0.0
        return max(worst_s, cost_s + lost_s)

    def _most_of_all_s(self) -> float:
        """Return the most slack that there ever is, all feeds counted, seconds."""
        if "" not in self._most:
            self._most[""] = self.most_s("")[0]
        return self._most[""]

    def never(self, request: Request) -> str:
        """Return why an exchange with a drive can never run, if it cannot; else an empty text."""
        own = self._own_beside(request)
        if own is not None and self._own_least_s(request, own) > self._most_of_all_s() + ROUNDING_S:
            most_s, whose = self.most_s("")
            return _never_fits(
                f"take {self._own_least_s(request, own):.3f} s, in which nothing feeds its drive",
                most_s, self.by_drive[whose],
            )  # fmt: skip
        most_s, whose = self.most_s(request.drive)
        if request.worst_s > most_s:
            takes = f"hold the line for {request.worst_s:.3f} s"
        elif (need_s := self._least_room_s(request)) > most_s + ROUNDING_S and request.members:
            takes = (
                f"keep feeds waiting for {need_s:.3f} s with the time its members are left "
                f"alone, a stop behind it and {self.faults.tolerate} lost answers"
            )
        elif need_s > most_s + ROUNDING_S:
            takes = f"keep feeds waiting for {need_s:.3f} s with a stop behind it and a lost answer"
        else:
            return ""
        return _never_fits(takes, most_s, self.by_drive[whose])

    def never_beside(self, request: Request, away: Collection[str]) -> str:
        """Return why an exchange does not fit beside these, by manual and roster; empty: it does.

        Asked of the watchdogs that the roster names (`capacity.work_ahead.feeds_of`), as `check`
        does.

        Args:
            request: What would be sent.
            away: Drives that do not count.
        """
        for name, feed in self.by_drive.items():
            feed.active = name not in away
        self.changed()
        cost_s, worst_s = request.documented or (request.cost_s, request.worst_s)
        need_s, (most_s, whose) = self.least_room_s(cost_s, worst_s), self.most_s("")
        if need_s <= most_s + ROUNDING_S:
            return ""
        takes = f"keep feeds waiting for {need_s:.3f} s with a stop behind it and a lost answer"
        return _never_fits(takes, most_s, self.by_drive[whose])

    def spare_s(self) -> float:
        """Return how much slack is kept for attempts that fail, and for stops, seconds."""
        return self._spares()[0]

    def soon_s(self) -> float:
        """Return with how much slack cyclic slots are chosen to feed, seconds."""
        return self._spares()[1]

    def _spares(self) -> tuple[float, float]:
        """Give both; a stop goes at any time, so feeds leave room for a lost one."""
        if self._spare_s is None:
            best_s, lost_s = max(self.most_s("")[0], 0.0), self.lost_s()
            tolerated_s = self.faults.tolerate * lost_s / SPARE_ATTEMPTS
            attempts_s = min(lost_s, max(SPARE_PART * best_s, min(tolerated_s, best_s)))
            cost_s = max((feed.cost_s for feed in self.by_drive.values() if feed.active), default=0)
            more_s = max(self.faults.tolerate - 1, 0) * lost_s / SPARE_ATTEMPTS
            stop_s = min(more_s + self.least_room_s(cost_s, 0.0), best_s)
            spare_s = max(attempts_s, stop_s)
            self._spare_s = spare_s, max(spare_s, SOON * attempts_s)
        return self._spare_s

    def lost_s(self) -> float:
        """Return how long the spare attempts take, seconds."""
        worst_s = max((feed.worst_s for feed in self.by_drive.values() if feed.active), default=0.0)
        return SPARE_ATTEMPTS * worst_s

    def pressing(self, now_s: float, spare_s: float) -> WatchdogDeadline | None:
        """Find the feed to run first if less than so much slack is left, whether due or not.

        It is the earliest deadline of those past half their time; before that, any that helps.
        """
        end_s = now_s + spare_s
        if not self.by_drive or end_s <= self._latest_end_s:
            return None
        feeds = self._in_order(now_s)
        if self._fit(feeds, end_s, ""):
            return None
        for feed in feeds:
            if feed.soft_s <= now_s and not feed.failures and feed.free_s() <= now_s:
                return feed
        return _room(feeds, now_s, spare_s, "")

    def first(self, now_s: float) -> WatchdogDeadline | None:
        """Find the earliest hard deadline of all drives that answer and may be spoken to.

        One that is past it counts until its watchdog fires: the last tenth is there to be used.
        """
        found = [
            feed
            for feed in self.by_drive.values()
            if feed.active
            and feed.failures < self.faults.gone_from
            and feed.free_s() <= now_s
            and now_s <= feed.acts_s
        ]
        return min(found, key=_hard, default=None)

    def late(
        self, now_s: float, *, lapsed: bool = False, but: Collection[str] = ()
    ) -> WatchdogDeadline | None:
        """Find a feed that is too late to be in time, though not for its watchdog, and may run.

        It is left out of the slack check, so that nothing else would bring it forward. While its
        watchdog can be kept, those that are in time may use the last tenth of theirs for it. The
        watchdog that acts first goes first; behind these go those that have acted, and drives that
        lost too many answers. A watchdog is kept by a feed that begins before it acts.

        Args:
            now_s: Monotonic seconds.
            lapsed: Also those whose watchdog has run out: the drive may run on, and be asked.
            but: Drives that are not to be asked.
        """
        if not self._left_out:
            return None
        tenth_s = self.tenth_s()

        def may_go(feed: WatchdogDeadline) -> bool:
            if now_s <= feed.acts_s:
                return self.fits(now_s, feed.cost_s - tenth_s, feed.drive)
            return lapsed and self.fits(now_s, feed.cost_s, feed.drive)

        def place(feed: WatchdogDeadline) -> tuple[bool, bool, float]:
            return self.lost_too_many(feed), now_s > feed.acts_s, feed.acts_s

        found = [
            feed
            for feed in self.by_drive.values()
            if feed.active
            and feed.left_out
            and feed.drive not in but
            and feed.failures < self.faults.gone_from
            and feed.free_s() <= now_s
            and may_go(feed)
        ]
        return min(found, key=place, default=None)

    def next_s(self, now_s: float) -> float | None:
        """Return when a feed may be due or pressing, after there was none just now."""
        feeds = [feed for feed in self.by_drive.values() if feed.active]
        if not feeds:
            return None
        times = [feed.next_s() for feed in feeds]
        latest_s, total_s = math.inf, 0.0
        for feed in self._in_order(now_s):
            total_s += feed.cost_s
            latest_s = min(latest_s, feed.hard_s - total_s)
        # A hair later, so that rounding does not find the slack just large enough.
        pressing_s = latest_s - self.spare_s() + WAKE_S
        if pressing_s > now_s:
            times.append(pressing_s)
        else:  # it is urgent, and the drives that could be fed are on hold
            times += [at_s for feed in feeds if (at_s := feed.free_s()) > now_s]
        return min(times)

    def slack_s(self, now_s: float) -> float:
        """Return how long it is until the line must be free for feeding; changes nothing.

        Infinite while nothing is fed. Feeds that can no longer be in time do not count.
        """
        latest_s, total_s = math.inf, 0.0
        for feed in sorted(self.by_drive.values(), key=_hard):
            late = max(now_s, feed.free_s()) + feed.cost_s > feed.hard_s + ROUNDING_S
            if feed.active and not late:
                total_s += feed.cost_s
                latest_s = min(latest_s, feed.hard_s - total_s)
        return latest_s - now_s

    def room(self, now_s: float, worst_s: float, drive: str) -> WatchdogDeadline | None:
        """Choose the feed to run first so that an exchange that does not fit may follow.

        Feeding a drive whose own bound is broken helps, more the longer ago it was fed. Any other
        feed takes as much time as it saves; but a longer watchdog that is due before a broken bound
        stays out of its sum for long, and a short one fed instead is due again soon: two short ones
        could be fed in turn without end. So of those whose bound is broken, and those of longer
        watchdogs before them, the longest goes first, if those before it can wait that long; else
        the earliest deadline goes. Where all are alike it is one whose bound is broken.
        """
        return _room(self._in_order(now_s), now_s, worst_s, drive)

    def round_s(self) -> float:
        """Return how long it takes to feed every drive once, seconds."""
        return sum(feed.cost_s for feed in self.by_drive.values())

    def first_held(self, now_s: float, drive: str) -> WatchdogDeadline | None:
        """Find the feed of another drive that is left alone now, and the first that no longer is.

        Those that can no longer be in time, or fail to answer, do not count.
        """
        held = [
            feed
            for feed in self._in_order(now_s)
            if feed.drive != drive and not feed.failures and feed.held_until_s > now_s
        ]
        return min(held, key=_held_until, default=None)

    def retry_s(self, now_s: float) -> float:
        """Return when it is worth asking again whether something fits that does not fit now."""
        least_s = self.shortest_s()
        times = [feed.free_s() for feed in self.by_drive.values() if feed.active]
        return min([at_s for at_s in times if at_s > now_s] + [now_s + least_s / 8])

    def most_s(self, drive: str) -> tuple[float, str]:
        """Return how long an exchange with a drive may last at best, and whose watchdog says so.

        At best is right after all drives have been fed in one go, the longest watchdog first.
        """
        hard_at: list[tuple[float, WatchdogDeadline]] = []
        clock_s = 0.0
        feeds = [feed for feed in self.by_drive.values() if feed.active]
        for feed in sorted(feeds, key=_time, reverse=True):
            hard_at.append((clock_s + feed.time_s * HARD_PART, feed))
            clock_s += feed.cost_s
        most_s, whose = math.inf, ""
        total_s = 0.0
        for hard_s, feed in sorted(hard_at, key=_first):
            total_s += feed.cost_s
            if feed.drive != drive and hard_s - total_s - clock_s < most_s:
                most_s, whose = hard_s - total_s - clock_s, feed.drive
        return most_s, whose


def by_manual(request: Request) -> tuple[float, float]:
    """Give what an exchange takes, answered and not, by manual and roster alone, seconds."""
    cost_s, worst_s = request.documented or (request.cost_s, request.worst_s)
    return cost_s, worst_s + request.hold_s


def _never_fits(takes: str, most_s: float, feed: WatchdogDeadline) -> str:
    return (
        f"it may {takes}, and {most_s:.3f} s is the most that keeping the watchdogs leaves at any "
        f"time (drive {feed.drive}, watchdog {feed.time_s:g} s)"
    )


def _room(
    feeds: list[WatchdogDeadline], now_s: float, worst_s: float, drive: str
) -> WatchdogDeadline | None:
    """Find the feed that must go first; the feeds are in the order of their hard deadlines."""
    end_s = now_s + worst_s
    total_s = 0.0
    earlier_s = math.inf  # by when the line must be free for the feeds before this one
    broken = False  # a bound that can be mended
    first: WatchdogDeadline | None = None
    longest: WatchdogDeadline | None = None  # of those before which the earlier ones can wait
    best: WatchdogDeadline | None = None
    for feed in feeds:
        total_s += feed.cost_s
        end_by_s = feed.hard_s - total_s
        if feed.drive != drive and feed.free_s() <= now_s:
            first = first or feed
            helps = now_s + feed.worst_s <= earlier_s
            if helps and (longest is None or feed.time_s > longest.time_s):
                longest = feed
            if end_s > end_by_s:
                broken = True
                if helps and (best is None or feed.time_s > best.time_s):
                    best = feed
                if best is not None and longest is not None and longest.time_s > best.time_s:
                    best = longest
        if end_by_s < earlier_s:
            earlier_s = end_by_s
    return best or (first if broken else None)
