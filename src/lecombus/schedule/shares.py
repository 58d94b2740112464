"""Line time reserved for lower classes behind higher ones, and for absent drives.

Classes are served in strict priority, but three of them have a small share of the line when they
wait behind others (`CLASS_SHARES`). While such a class has something that could go, it earns its
share of all line time as credit, and pays for the line time that it uses. When the credit covers
its next exchange, that one goes first.

* Credit is limited to a few exchanges. It is lost when nothing waits, and kept while what waits may
  not go.
* An exchange that feeds a watchdog costs no credit. Otherwise feeds that are cyclic reads would use
  up what other reads wait for.
* A lost answer causes no debt. Otherwise the next request of its class would wait for twenty such
  times.

No class goes first twice in a row. An exchange goes by credit only directly after one that went by
priority and was of the class that it overtakes, or of a higher one; feeds between them do not
count. So a lone request of a higher class is never overtaken, and many of them lose at most every
second exchange, however large the credit is. Of several classes with enough credit, the one goes
that went by credit least recently. Where exchanges of higher classes are far longer the shares
become smaller, but each class gets its turn.

Absent drives share one token bucket. It fills with their share of elapsed time and holds one probe.
A probe starts only when the bucket covers the longest that it can take, and pays what it took. A
full bucket is one probe above the share in any window; so the bucket fills slower, by one probe per
`WINDOW_S`, and the share holds in any window of that length.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from heapq import heappop, heappush
from typing import Final

from lecombus.schedule.request import DispatchReason, Priority, Request

__all__ = ["CLASS_SHARES", "LISTEN_EVERY_S", "LISTEN_S", "Probe", "Probes", "Shares"]

CLASS_SHARES: Final = {
    Priority.INTERACTIVE: 0.15,
    Priority.CYCLIC: 0.20,
    Priority.BACKGROUND: 0.05,
}
CREDIT_EXCHANGES: Final = 4.0  # most credit, in exchanges of the size at hand

WINDOW_S: Final = 30.0
BACKOFF_LEAST_S: Final = 1.0
BACKOFF_MOST_S: Final = 30.0
LISTEN_S: Final = 1.0  # the line is left idle for so long at most, to hear a very slow drive
LISTEN_EVERY_S: Final = 60.0  # and so often
ROUNDING_S: Final = 1e-6


class Shares:
    """The credit of the classes that wait behind others."""

    __slots__ = ("_credit_s", "_last", "_order", "_waiting")

    def __init__(self) -> None:
        self._credit_s = dict.fromkeys(CLASS_SHARES, 0.0)
        self._waiting: Mapping[Priority, float] = {}  # class: cost of its head at the last choice
        self._last: Priority | None = None  # the class that went last, if it went by right
        self._order = tuple(CLASS_SHARES)  # least recently gone by credit first

    def had_its_turn(self, top: Priority) -> bool:
        """Return whether a class, or one above it, went last and by right: others may go now."""
        return _had_its_turn(top, self._last)

    def entitled(self, waiting: Mapping[Priority, float], top: Priority) -> Priority | None:
        """Choose the class that goes first by its credit.

        Args:
            waiting: The classes that have something, highest first, and the cost of their first
                request, seconds; 0: it may not go just now.
            top: The highest class that has something that may go.
        """
        self._waiting = waiting
        if not _had_its_turn(top, self._last):
            return None
        return _entitled(waiting, top, self._credit_s, self._order)

    def foresee(
        self,
        waiting: Mapping[Priority, float],
        top: Priority,
        under_way: Request | None,
        duration_s: float,
    ) -> Priority | None:
        """Return which class will go first once an exchange has been booked; changes nothing.

        Args:
            waiting: As for `entitled`.
            top: As for `entitled`.
            under_way: The request whose exchange it is; None: nothing is to be booked.
            duration_s: How long it will have taken.
        """
        credit_s, last = self._credit_s, self._last
        if under_way is not None:
            last = _last(last, under_way.priority, under_way.turn)
        if not _had_its_turn(top, last):
            return None
        if under_way is not None:
            credit_s = self._booked(under_way.priority, under_way.turn, duration_s)
        return _entitled(waiting, top, credit_s, self._order)

    def least_recent(self, classes: Container[Priority]) -> Priority | None:
        """Choose the one of some classes that has gone before a higher one least recently."""
        return next((one for one in self._order if one in classes), None)

    def note(self, waiting: Mapping[Priority, float]) -> None:
        """Record what waits at a choice that was made from the result of `foresee`."""
        self._waiting = waiting

    def passed(self, request: Request) -> None:
        """Note that a request was put off: feeds have gone for it, and it is the turn of others."""
        self._last = _last(self._last, request.priority, request.turn)

    def book(self, used_by: Priority, turn: DispatchReason, duration_s: float) -> None:
        """Book the line time of one exchange.

        Args:
            used_by: The class it belonged to.
            turn: By what it went.
            duration_s: How long it took.
        """
        self._credit_s = self._booked(used_by, turn, duration_s)
        self._last = _last(self._last, used_by, turn)
        if turn is DispatchReason.CREDIT or turn is DispatchReason.KEPT:
            self._order = (*(one for one in self._order if one is not used_by), used_by)

    def _booked(
        self, used_by: Priority, turn: DispatchReason, duration_s: float
    ) -> dict[Priority, float]:
        waiting = self._waiting
        booked: dict[Priority, float] = {}
        for priority, credit_s in self._credit_s.items():
            cost_s = waiting.get(priority)
            if cost_s is None:
                if credit_s > 0.0:
                    credit_s = 0.0
            else:
                # The cap never takes away credit: heads of different size follow each other.
                earned_s = credit_s + CLASS_SHARES[priority] * duration_s
                credit_s = min(earned_s, max(credit_s, CREDIT_EXCHANGES * cost_s))
            if (
                priority is used_by
                and turn is not DispatchReason.FEED
                and turn is not DispatchReason.FEED_AHEAD
            ):
                # A class that went by right starts at nothing when it falls behind.
                credit_s = max(credit_s - duration_s, 0.0)
            booked[priority] = credit_s
        return booked


def _had_its_turn(top: Priority, last: Priority | None) -> bool:
    return last is not None and last <= top


def _last(last: Priority | None, used_by: Priority, turn: DispatchReason) -> Priority | None:
    """Return who has gone last by right after one more exchange; stops and feeds do not count."""
    if turn is DispatchReason.FEED or used_by is Priority.STOP:
        return last
    return used_by if turn is DispatchReason.RIGHT else None


def _entitled(
    waiting: Mapping[Priority, float],
    top: Priority,
    credit_s: Mapping[Priority, float],
    order: Sequence[Priority],
) -> Priority | None:
    """Find the class below the top one that goes first.

    The top class goes by right. Behind feeds it may have credit that it does not use, and would
    keep the others from their turns with it.
    """
    for priority in order:
        cost_s = waiting.get(priority)
        if priority > top and cost_s is not None and credit_s[priority] >= cost_s > 0.0:
            return priority
    return None


class Probe:
    """A look, now and then, whether an absent drive is back."""

    __slots__ = (
        "active",
        "backoff_s",
        "drive",
        "make",
        "next_at_s",
        "refused",
        "request",
        "version",
    )

    def __init__(self, drive: str, make: Callable[[], Request]) -> None:
        self.drive = drive
        self.make = make
        self.active = False
        self.backoff_s = BACKOFF_LEAST_S
        self.next_at_s = 0.0
        self.version = -1  # of its item in the heap
        self.request: Request | None = None  # made, but not yet run
        self.refused = 0  # probes that could not be run without making a feed late

    def made(self) -> Request:
        """Return the request for the next probe."""
        request = self.request
        if request is None:
            request = self.request = self.make()
            request.source = self
        return request


class Probes:
    """All probes of a line and the bucket that pays for them.

    Args:
        share: The part of elapsed time that all probes together may take, 0..1.
    """

    __slots__ = ("_at_s", "_heap", "_share", "_tokens_s", "_versions", "_worst_s", "by_drive")

    def __init__(self, share: float) -> None:
        self.by_drive: dict[str, Probe] = {}
        self._share = share
        self._heap: list[tuple[float, int, Probe]] = []
        self._versions = 0
        self._tokens_s = 0.0
        self._worst_s = 0.0  # the longest probe seen: the size of the bucket
        self._at_s = 0.0

    def start(self, probe: Probe, now_s: float) -> None:
        """Begin probing immediately, with the shortest backoff."""
        probe.active = True
        probe.backoff_s = BACKOFF_LEAST_S
        self.schedule(probe, now_s)

    def stop(self, probe: Probe) -> None:
        """Stop probing until the next `start`."""
        probe.active = False
        probe.request = None
        probe.version = -1

    def schedule(self, probe: Probe, at_s: float) -> None:
        """Set when the probe runs next."""
        self._versions += 1
        probe.version = self._versions
        probe.next_at_s = at_s
        heappush(self._heap, (at_s, self._versions, probe))

    def _tidy(self) -> Probe | None:
        heap = self._heap
        while heap and heap[0][2].version != heap[0][1]:
            heappop(heap)
        return heap[0][2] if heap else None

    def _rate(self) -> float:
        return max(self._share - self._worst_s / WINDOW_S, self._share / 2)

    def _fill(self, now_s: float, worst_s: float) -> None:
        """Bring the bucket up to date; a larger probe than any before makes it larger, and full."""
        if worst_s > self._worst_s:
            self._tokens_s += worst_s - self._worst_s
            self._worst_s = worst_s
        gained_s = max(0.0, now_s - self._at_s) * self._rate()
        self._tokens_s = min(self._worst_s, self._tokens_s + gained_s)
        self._at_s = now_s

    def ready(self, now_s: float) -> Probe | None:
        """Find the probe that may run now."""
        probe = self._tidy() if self._heap else None
        if probe is None or probe.next_at_s > now_s or self._share <= 0.0:
            return None
        worst_s = probe.made().worst_s
        self._fill(now_s, worst_s)
        return probe if self._tokens_s >= worst_s else None

    def next_s(self, now_s: float) -> float | None:
        """Return when the next probe may run."""
        probe = self._tidy()
        if probe is None or self._share <= 0.0:
            return None
        worst_s = probe.made().worst_s
        self._fill(now_s, worst_s)
        # A hair later than computed, so that rounding does not wake the caller too early.
        short_s = max(0.0, worst_s - self._tokens_s)
        return max(
            probe.next_at_s, now_s + short_s / self._rate() + (ROUNDING_S if short_s else 0.0)
        )

    def not_before_s(self) -> float:
        """Return before what time no probe may run; changes nothing, not even by rounding."""
        probe = self._tidy() if self._heap else None
        if probe is None or self._share <= 0.0:
            return math.inf
        worst_s = probe.made().worst_s
        if worst_s > self._worst_s or self._tokens_s >= worst_s:
            return probe.next_at_s
        full_s = self._at_s + (worst_s - self._tokens_s) / self._rate()
        return max(probe.next_at_s, full_s - ROUNDING_S)

    def take(self, probe: Probe, now_s: float) -> Request:
        """Run the probe now, and set its next time one backoff later."""
        request = probe.made()
        probe.request = None
        self._put_off(probe, now_s)
        return request

    def drop(self, probe: Probe, now_s: float) -> None:
        """Give up this probe: it cannot be run now."""
        probe.request = None
        probe.refused += 1
        self._put_off(probe, now_s)

    def _put_off(self, probe: Probe, now_s: float) -> None:
        self.schedule(probe, now_s + probe.backoff_s)
        probe.backoff_s = min(BACKOFF_MOST_S, 2 * probe.backoff_s)

    def paid(self, duration_s: float, now_s: float) -> None:
        """Take the time a probe took out of the bucket."""
        self._fill(now_s, 0.0)
        self._tokens_s -= duration_s
