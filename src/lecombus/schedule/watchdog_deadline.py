"""The watchdog of one drive: when it was fed last, when it must be fed next, and at what cost.

And, for all watchdogs of a line, how many answers may be lost (`FaultHypothesis`). Pure: seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from lecombus.schedule.request import Request

__all__ = [
    "HARD_PART",
    "SOFT_PART",
    "SPARE_ATTEMPTS",
    "FaultHypothesis",
    "WatchdogCosts",
    "WatchdogDeadline",
    "WatchdogFeeding",
]


@dataclass(frozen=True, slots=True)
class FaultHypothesis:
    """How many answers of a line may be lost within any watchdog time, and the room kept for them.

    An exchange is begun only if the watchdogs outlast what may be lost from then on. If its own
    answer is lost, it takes its longest, and all but one of the lost answers that are tolerated may
    be those of the feeds after it; a stop may follow, too, and its answer be one of them. If it is
    answered, all the lost answers that are tolerated may be those of the feeds after it. A stop
    does not wait; it and its lost answer may use the last tenth of a watchdog time, and room is
    kept for what that does not hold.
    With none to be tolerated an exchange is begun if the watchdogs outlast its own lost answer. One
    for which there is never room together with one lost answer and a stop is not begun; where there
    is never room for all that are tolerated, it is begun when there is most (`watchdog_set`).

    The roster was accepted by the same sum (`capacity.watchdog_demand`).

    Args:
        tolerate: So many answers.
        stop_s: The longest stop with its proof, seconds.
        stop_failed_s: The longest telegram of a stop that is not answered, seconds.
    """

    tolerate: int = 0
    stop_s: float = 0.0
    stop_failed_s: float = 0.0

    @property
    def gone_from(self) -> int:
        """From so many lost answers in a row on a drive may be gone, and others go before it."""
        return max(SPARE_ATTEMPTS, self.tolerate + 1)

    def need_s(self, cost_s: float, worst_s: float, lost_s: float, tenth_s: float) -> float:
        """Return how much slack it takes to begin an exchange, seconds.

        Args:
            cost_s: It is answered.
            worst_s: It is not answered.
            lost_s: The longest feed that is not answered.
            tenth_s: A tenth of the shortest watchdog time.
        """
        if not self.tolerate:
            return worst_s
        failed_s = worst_s + self.left_s(self.tolerate - 1, lost_s, tenth_s)
        return max(failed_s, cost_s + self.behind_s(lost_s, tenth_s))

    def least_room_s(self, cost_s: float, worst_s: float, lost_s: float, tenth_s: float) -> float:
        """Return how much slack an exchange must find to be begun at all; arguments as `need_s`.

        It is room for its own lost answer, or for one behind it, and a stop.
        """
        if not self.tolerate:
            return worst_s
        failed_s = worst_s + max(self.stop_s - tenth_s, 0.0)
        return max(failed_s, cost_s + self.stop_behind_s(lost_s, tenth_s))

    def behind_s(self, lost_s: float, tenth_s: float) -> float:
        """Return how much slack an exchange that is answered must leave, seconds.

        Args:
            lost_s: The longest feed that is not answered.
            tenth_s: A tenth of the shortest watchdog time.
        """
        return self.left_s(self.tolerate, lost_s, tenth_s) if self.tolerate else 0.0

    def left_s(self, left: int, lost_s: float, tenth_s: float) -> float:
        """Return how much slack it takes that so many more answers are lost, with a stop, seconds.

        Args:
            left: So many answers.
            lost_s: The longest feed that is not answered.
            tenth_s: A tenth of the shortest watchdog time.
        """
        if not left:
            return max(self.stop_s - tenth_s, 0.0)
        return (left - 1) * lost_s + max(lost_s, self.stop_behind_s(lost_s, tenth_s))

    def stop_behind_s(self, lost_s: float, tenth_s: float) -> float:
        """Return how much slack a stop and one lost answer take, seconds; arguments as above.

        Nothing, or less, where a tenth of the shortest watchdog time holds them.
        """
        return max(lost_s + self.stop_s, self.stop_failed_s) - tenth_s


SOFT_PART: Final = 0.5  # of the watchdog time: from then on a feed is due
HARD_PART: Final = 0.9  # of the watchdog time: by then the feed is over
SPARE_ATTEMPTS: Final = 3  # a feed is due while so many failed attempts would still fit
RETRY_LEAST_S: Final = 0.02  # least pause between two attempts, and least time worth one
FRESH_PART: Final = 0.25  # of the watchdog time


@dataclass(frozen=True, slots=True)
class WatchdogFeeding:
    """How a drive's watchdog is kept from firing.

    Args:
        time_s: The watchdog time set in the drive, seconds, > 0.
        make: Builds the cheapest useful read, of class `WATCHDOG`.
    """

    time_s: float
    make: Callable[[], Request]


class WatchdogCosts:
    """Cost and longest time of the read that feeds a drive, seconds.

    Args:
        request: That read.

    Attributes:
        measured: As measured, where that is longer; else as documented.
        documented: By manual and roster.
    """

    __slots__ = ("documented", "measured")

    def __init__(self, request: Request) -> None:
        self.measured = self.documented = (0.0, 0.0)
        self.take(request)

    def take(self, request: Request) -> bool:
        """Take what the read costs now; return whether that is news."""
        measured = (request.cost_s, request.worst_s + request.cut_by_s)
        documented = request.documented or measured
        news = (measured, documented) != (self.measured, self.documented)
        self.measured, self.documented = measured, documented
        return news

    @property
    def is_longer(self) -> bool:
        """Whether measured times are longer than documented ones."""
        return self.measured != self.documented


class WatchdogDeadline:
    """The state of one drive's watchdog as seen from here."""

    __slots__ = (
        "active",
        "cost_s",
        "costs",
        "counted",
        "drive",
        "due_s",
        "failures",
        "fed",
        "fed_at_s",
        "feeding",
        "hard_s",
        "heard",
        "held_until_s",
        "lapsed",
        "lapses",
        "left_out",
        "margin_last_s",
        "margin_least_s",
        "margin_since_s",
        "missed",
        "misses",
        "request",
        "retry_at_s",
        "runs_from_s",
        "soft_s",
        "time_s",
        "worst_s",
    )

    def __init__(self, drive: str, feeding: WatchdogFeeding, now_s: float) -> None:
        assert feeding.time_s > 0.0, "a watchdog time must be longer than nothing"
        self.drive = drive
        self.feeding = feeding
        self.time_s = feeding.time_s
        self.request: Request | None = feeding.make()  # kept for the first feed: it gives the cost
        self.costs = WatchdogCosts(self.request)
        self.cost_s, self.worst_s = self.costs.measured
        self.active = True
        self.held_until_s = self.retry_at_s = -math.inf
        self.left_out = False  # of the slack check: too late to be in time
        self.fed = self.failures = self.misses = self.lapses = 0
        self.margin_last_s = self.margin_least_s = self.margin_since_s = math.inf
        self.runs_from_s = math.inf  # the last exchange that the drive answered; none yet
        self.heard = False  # since the port was opened
        self.counted = False  # that its time ran out since that exchange
        self._count_from(now_s)

    def _count_from(self, at_s: float) -> None:
        self.fed_at_s = at_s
        self.hard_s = at_s + self.time_s * HARD_PART
        self.soft_s = at_s + self.time_s * SOFT_PART
        self.due_s = max(self.soft_s, self.hard_s - SPARE_ATTEMPTS * self.worst_s)
        self.retry_at_s = -math.inf
        self.failures = 0
        self.missed = self.lapsed = False

    @property
    def acts_s(self) -> float:
        """When the drive's watchdog acts if it is fed no more."""
        return self.fed_at_s + self.time_s

    def follow(self, old: WatchdogDeadline) -> None:
        """Take the place of the drive's feed so far: its count and the moment it was last fed.

        Counting from now instead would forget how long ago the last exchange began: half a second
        and more where a module answers slowly.
        """
        self.count_on(old)
        self.margin_last_s, self.margin_least_s = old.margin_last_s, old.margin_least_s
        self.runs_from_s, self.heard, self.counted = old.runs_from_s, old.heard, old.counted
        if old.active:
            self._count_from(old.fed_at_s)
            self.failures, self.retry_at_s = old.failures, old.retry_at_s
            self.missed, self.lapsed = old.missed, old.lapsed

    def count_on(self, old: WatchdogDeadline) -> None:
        """Go on with the counts of the drive's feed so far: they never fall."""
        self.fed, self.misses, self.lapses = old.fed, old.misses, old.lapses

    def resume(self, old: WatchdogDeadline, now_s: float) -> None:
        """Begin again after the watchdog was off: it has been running since now."""
        self.count_on(old)
        self.runs_from_s, self.heard, self.counted = now_s, old.heard, old.counted

    def heard_at(self, at_s: float) -> None:
        """Take the drive as heard: its watchdog has been running since then."""
        self.heard, self.counted, self.runs_from_s = True, False, at_s

    def restart(self, now_s: float) -> None:
        """Count from now after a pause, without judging the pause."""
        self.active = True
        self._count_from(now_s)

    def reached(self, started_s: float) -> None:
        """Note that the drive answered an exchange begun at that time."""
        self.heard = True
        margin_s = self.fed_at_s + self.time_s - started_s
        self.margin_last_s = margin_s
        if margin_s < self.margin_least_s:
            self.margin_least_s = margin_s
        if margin_s < self.margin_since_s:
            self.margin_since_s = margin_s
        self.judge(started_s)
        self.fed += 1
        self._count_from(started_s)
        self.heard_at(started_s)

    def judge(self, now_s: float) -> None:
        """Count, once each, that the hard deadline or the watchdog time has passed unfed.

        The drive's watchdog runs from the last exchange that it answered, also while the drive is
        parked or the port is away: a pause begins no other lapse. One that was not heard since the
        port was opened may not be there at all.
        """
        if self.active and now_s > self.hard_s and not self.missed:
            self.missed = True
            self.misses += 1
        if self.active and now_s > self.fed_at_s + self.time_s:
            self.lapsed = True
        if self.heard and not self.counted and now_s > self.runs_from_s + self.time_s:
            self.counted = True
            self.lapses += 1

    def failed(self, now_s: float, tolerate: int = 0) -> None:
        """Note that the drive did not answer, and when to try again.

        Args:
            now_s: Monotonic seconds.
            tolerate: So many answers may be lost without its watchdog acting.
        """
        self.failures += 1
        left_s, few = self.hard_s - now_s, self.failures <= max(1, tolerate)
        if left_s <= RETRY_LEAST_S:  # late, but the watchdog may not have fired yet
            left_s = 0.0 if few else self.acts_s - now_s
        if left_s <= RETRY_LEAST_S and self.failures >= max(SPARE_ATTEMPTS, tolerate + 1):
            self.retry_at_s = now_s + self.time_s * SOFT_PART
            return
        spare = max(SPARE_ATTEMPTS - self.failures, 1)
        pause_s = min(left_s / 2, left_s - spare * self.worst_s)
        # A lost answer or two are no reason to be late: if need be it is asked again immediately.
        least_s = 0.0 if few else RETRY_LEAST_S
        pause_s = max(pause_s, least_s)
        self.retry_at_s = now_s + pause_s if pause_s > 0.0 else -math.inf

    def pause_until(self, by_s: float, now_s: float) -> None:
        """Have it asked again by a time at the latest; by a time that is past: now."""
        self.retry_at_s = min(self.retry_at_s, by_s) if by_s > now_s else -math.inf

    def outlasts(self, now_s: float, worst_s: float) -> bool:
        """Return whether a failed exchange with the drive would leave time to feed it afterwards.

        None longer than the watchdog does; a drive fed just now is as ready for it as ever.
        """
        fresh = now_s - self.fed_at_s < self.time_s * FRESH_PART
        return fresh or now_s + worst_s + self.cost_s <= self.hard_s

    def outlasts_late(self, now_s: float, takes_s: float) -> bool:
        """Return whether its watchdog, if it can be kept at all, is kept behind something else.

        The slack check leaves out a feed that is too late for its hard deadline.
        """
        return now_s > self.acts_s or now_s + takes_s <= self.acts_s - self.cost_s

    def made(self) -> Request:
        """Build the feeding request, with time-outs no longer than is counted with."""
        request = self.request or self.feeding.make()
        self.request = None
        request.shorten(self.worst_s)
        return request

    def next_s(self) -> float:
        """Return when it wants to run next."""
        return max(self.due_s, self.free_s())

    def free_s(self) -> float:
        """Return when it may be tried: its drive is not held, no attempt has just failed."""
        return self.held_until_s if self.held_until_s > self.retry_at_s else self.retry_at_s
