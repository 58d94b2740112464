"""The requests that wait for a line, and every way in which waiting ends other than being chosen.

A request comes in by `submit`, or comes back by `take_back` for its next step. It waits in the
lane of its drive (queues.py) or for a time, and is taken out by `leave`, or ends here: expired,
superseded by a later request with the same key, ended by a stop, refused because its drive is
parked, or withdrawn. Each end is counted and reported exactly once.

Stops. Accepting a stop ends every write that waits for the drives it stops, settings too (they may
make the stop void) and multicasts that reach one of them, and notes its serial number with these
drives. A write that was on the line at that moment is compared with that number when it comes
back, and ended: no write is repeated after a stop that came later.

Times. Deferred requests, holds of drives and all else that the schedule puts off share one heap.

What is chosen when, and what feeds a watchdog, is not decided here.
"""

from __future__ import annotations

from collections.abc import Mapping
from heapq import heappop, heappush
from typing import Final

from lecombus.errors import QueueFullError
from lecombus.schedule.polling import PollingEntry
from lecombus.schedule.queues import ClassQueue, Expiries, QueuedDrive
from lecombus.schedule.request import (
    DEFERRED,
    OUT,
    QUEUED,
    REPLACED,
    STOPPED,
    TAKEN_OUT,
    UNDER_WAY,
    Outcome,
    Priority,
    Request,
)
from lecombus.schedule.shares import CLASS_SHARES, Probe

__all__ = ["DEFAULT_LIMITS", "Waiting", "has_expired"]

DEFAULT_LIMITS: Final[Mapping[Priority, int]] = {
    Priority.CONTROL: 1000,
    Priority.INTERACTIVE: 2000,
    Priority.BACKGROUND: 10000,
}
KEPT_S: Final = 3.0
"""For so long after a hold, requests that waited for it go before those that would begin another,
seconds .."""
KEPT_AFTER_S: Final = 3.0
""".. if holds have kept it for so long: a client that reads and writes in turn is not a stream."""
EXPIRE_BATCH: Final = 64  # expired requests ended per choice: about 0.1 ms
_FIRST_AHEAD: Final = -(1 << 62)  # places of requests that go ahead of their class
_LAST: Final = 1 << 63  # added to the places of stops of silent drives: behind all others

_TOO_LATE: Final = "it was too late to begin"


Timed = Request | QueuedDrive | PollingEntry


class Waiting:
    """Everything submitted that waits.

    Args:
        limits: Most waiting requests by class, over the defaults; stops have no limit.
    """

    def __init__(self, limits: Mapping[Priority, int] | None = None) -> None:
        self.drives: dict[str, QueuedDrive] = {}
        self.silent: set[str] = set()  # drives that did not answer a stop, or are offline
        self.queues = tuple(ClassQueue() for _ in Priority)
        self.expiries = Expiries()
        self.timers: list[tuple[float, int, Timed]] = []
        self.counts: dict[Outcome, list[int]] = {
            outcome: [0] * len(Priority)
            for outcome in (Outcome.REFUSED, Outcome.EXPIRED, Outcome.SUPERSEDED)
        }
        self._limits = {**DEFAULT_LIMITS, **(limits or {})}
        self._latest: dict[object, Request] = {}  # by `supersedes`
        self._serial = 0
        self._ahead = _FIRST_AHEAD

    # -- coming in --------------------------------------------------------------------------------

    def number(self, request: Request) -> None:
        """Give a request its serial number and its place behind all others."""
        self._serial += 1
        request.serial = request.place = self._serial

    def submit(self, request: Request, now_s: float) -> None:
        """Take a new request. Limits and supersession are checked."""
        request.submitted_at_s = now_s
        if request.priority is Priority.STOP:
            self._submit_stop(request)
            return
        drive = self.drives.get(request.drive)
        if drive is not None and drive.parked is not None:
            self.end(request, Outcome.REFUSED, drive.parked)
            return
        request.home = drive
        queue = self.queues[request.priority]
        old = self._superseded_by(request)
        if old is None or old.priority is not request.priority:
            self._check_limit(request.priority, queue.depth)
        self.number(request)
        if old is None or not self._take_over(old, request):
            queue.put(request)
        request.state = QUEUED
        self._enter(request, queue)
        if request.members:
            for reached in self._reached(request):
                reached.multicast_at = request.serial
        if request.expires_at_s is not None:
            self.expiries.add(request)
        if old is not None:
            self.end_waiting(old, Outcome.SUPERSEDED, REPLACED)

    def _superseded_by(self, request: Request) -> Request | None:
        """Find the waiting request that a new one takes the place of."""
        if request.supersedes is None:
            return None
        old = self._latest.get(request.supersedes)
        return old if old is not None and old.state in (QUEUED, DEFERRED) else None

    def _take_over(self, old: Request, new: Request) -> bool:
        """Give the new request the place of the old one, if that is a place to have.

        It is not where a multicast to that drive came between: the latest of the three must be
        said last.
        """
        drive = self.drives.get(old.drive)
        fresh = old.state == QUEUED and not old.attempts
        overtakes = drive is not None and old.place < drive.multicast_at
        if fresh and not overtakes and old.priority is new.priority and old.drive == new.drive:
            ClassQueue.replace(old, new)
            return True
        return False

    def _check_limit(self, priority: Priority, depth: int) -> None:
        limit = self._limits.get(priority)
        if limit is not None and depth >= limit:
            self.counts[Outcome.REFUSED][priority] += 1
            raise QueueFullError(priority=priority.name.lower(), depth=depth, limit=limit)

    def _submit_stop(self, request: Request) -> None:
        """Take a stop, and end the writes that wait for the drives it stops."""
        self.number(request)
        if self.yields(request):
            request.place += _LAST
        queue = self.queues[Priority.STOP]
        request.state = QUEUED
        queue.put(request)
        queue.depth += 1
        self._end_writes(request)

    def join(self, request: Request, *, yields: bool) -> bool:
        """Let a stop that waits and was never sent stand for another one asked for just now.

        Args:
            request: The stop that waits.
            yields: The other one would let feeds go first, too.

        Returns:
            Whether it can: it waits, so that nothing but other stops goes out before it, and
            feeds if its drive is silent.
        """
        if request.state != QUEUED or request.attempts:
            return False
        self._serial += 1
        request.serial = self._serial  # writes asked for before the later stop end as well
        if not yields:
            self.yield_no_more(request)
        self._end_writes(request)
        return True

    def yield_no_more(self, request: Request) -> None:
        """Let a stop that waits go before feeds, unless its drive is silent."""
        if request.yields:
            request.yields = False
            if not self.yields(request):
                self._move(request, -_LAST)

    def _move(self, request: Request, by: int) -> None:
        """Give a stop another place; one that waits for a time takes it afterwards."""
        queue = self.queues[Priority.STOP]
        queued = request.state == QUEUED
        if queued:
            queue.remove(request)
        request.place += by
        if queued:
            queue.put(request)

    def _end_writes(self, request: Request) -> None:
        """End the writes that wait for the drives a stop stops."""
        ended: list[Request] = []
        for name in request.stops:
            drive = self.drives.get(name)
            if drive is not None:
                drive.stopped_at = request.serial
                ended += drive.writes
        for write in ended:
            if not write.settled:  # a multicast stands with each of its members
                self.end_waiting(write, Outcome.SUPERSEDED, STOPPED)

    # -- coming back ------------------------------------------------------------------------------

    def place(self, request: Request, *, behind: bool) -> None:
        """Give a request that comes back a place ahead of its class, or behind what waits now.

        Behind goes a stop that was sent and has only to be proven: it must not keep the next
        drive waiting for its own. A stop before which feeds may go, that of a silent drive or one
        of which only more proof is wanted, goes behind all others, so that they wait for no feed.
        """
        request.latest_s = None
        if request.priority is Priority.STOP and self.yields(request):
            self._serial += 1
            request.place = _LAST + self._serial
        elif behind:
            self._serial += 1
            request.place = self._serial
        else:
            self._ahead += 1
            request.place = self._ahead

    def set_silent(self, name: str, *, silent: bool) -> None:
        """Note that a drive does not answer, or does; its waiting stops go to their new places."""
        if silent is (name in self.silent):
            return
        if silent:
            self.silent.add(name)
        else:
            self.silent.discard(name)
        for request in self.listed(drive=name, stops=True):
            if request.priority is not Priority.STOP or request.members or request.yields:
                continue  # what yields has its place behind all others already
            self._move(request, _LAST if silent else -_LAST)

    def take_back(self, request: Request, until_s: float, now_s: float) -> None:
        """Take back a request that was chosen, to wait until a time and then at its place."""
        assert request.state in (OUT, UNDER_WAY), f"{request!r} waits already"
        assert not request.settled, f"{request!r} has ended"
        request.state = OUT
        if self._cut_off(request):
            return
        queue = self.queues[request.priority]
        self._enter(request, queue)
        if until_s > now_s:
            request.state = DEFERRED
            self.at(until_s, request)
        else:
            request.state = QUEUED
            queue.put(request)

    def _cut_off(self, request: Request) -> bool:
        """End a request that may not come back, because of what happened while it was out."""
        if request.priority is Priority.STOP:
            return False
        drive = self.drives.get(request.drive)
        if request.home is not None and request.home is not drive:
            self.end(request, Outcome.REFUSED, f"{request.drive} {TAKEN_OUT}")
        elif drive is not None and drive.parked is not None and type(request.source) is not Probe:
            self.end(request, Outcome.REFUSED, drive.parked)
        elif request.writes and self._stopped_since(request):
            self.end(request, Outcome.SUPERSEDED, STOPPED)
        elif self._replaced_since(request):
            self.end(request, Outcome.SUPERSEDED, REPLACED)
        else:
            return False
        return True

    def _stopped_since(self, request: Request) -> bool:
        return any(drive.stopped_at > request.serial for drive in self._reached(request))

    def _replaced_since(self, request: Request) -> bool:
        if request.supersedes is None:
            return False
        later = self._latest.get(request.supersedes)
        return later is not None and later.serial > request.serial and not later.settled

    # -- bookkeeping ------------------------------------------------------------------------------

    def _reached(self, request: Request) -> list[QueuedDrive]:
        names = request.members or (request.drive,)
        return [self.drives[name] for name in names if name in self.drives]

    def _enter(self, request: Request, queue: ClassQueue) -> None:
        queue.depth += 1
        if request.supersedes is not None and request.priority is not Priority.STOP:
            self._latest[request.supersedes] = request
        if request.writes and request.priority is not Priority.STOP:
            for drive in self._reached(request):
                drive.writes.add(request)

    def leave(self, request: Request) -> None:
        """Take a waiting request out, chosen or ended."""
        queue = self.queues[request.priority]
        if request.cell is not None:
            queue.remove(request)
        queue.depth -= 1
        if request.writes:
            for drive in self._reached(request):
                drive.writes.discard(request)

    def went_out(self, request: Request) -> None:
        """Note that a write was on the line: nothing asked for before it may undo it.

        An earlier one can still wait: it was not answered and is to be said again, had to be put
        off, or is of a lower class. Behind a write that stops the drive it could let it run, as a
        setting does that gives control to its terminals, or, as a quick stop behind an inhibit,
        lift that stop. One that lets nothing go is said again all the same. So is one that stops
        other drives, too. A setting of a lower class goes on where it moves nothing, or where the
        stop is only said again: it was asked for behind the first.
        """
        ends_settings = request.halts and not request.repeats
        for drive in self._reached(request):
            for other in drive.writes:
                if other.serial > request.serial or (other.members and other.halts):
                    continue
                early = bool(other.attempts) or other.priority <= request.priority
                if request.halts and (early or (ends_settings and other.may_move)):
                    other.overtaken = other.overtaken or ("" if other.lifts_nothing else STOPPED)
                elif request.halts or not early or other.members:
                    continue
                elif request.says is not None and other.says == request.says:
                    other.overtaken = other.overtaken or REPLACED

    def forget_key(self, request: Request) -> None:
        """Note that a request is no longer one that a later one could take the place of."""
        key = request.supersedes
        if key is not None and self._latest.get(key) is request:
            del self._latest[key]

    def put_off(self, request: Request, until_s: float) -> None:
        """Let a request in a lane wait for a time, and then at its place again."""
        self.queues[request.priority].remove(request)
        request.state = DEFERRED
        self.at(until_s, request)

    # -- ends -------------------------------------------------------------------------------------

    def withdraw(self, request: Request, outcome: Outcome, reason: str) -> bool:
        """End a request if it still waits; return whether it did."""
        if request.state not in (QUEUED, DEFERRED):
            return False
        self.end_waiting(request, outcome, reason)
        return True

    def end_waiting(self, request: Request, outcome: Outcome, reason: str) -> None:
        """End a request that waits."""
        self.leave(request)
        self.end(request, outcome, reason)

    def end(self, request: Request, outcome: Outcome, reason: str) -> None:
        """End a request that does not wait, or no longer."""
        request.state = OUT
        self.forget_key(request)
        if outcome in self.counts:
            self.counts[outcome][request.priority] += 1
        request.cut(outcome, reason)

    def end_multicasts(self, drive: QueuedDrive, reason: str) -> None:
        """End the multicasts that wait and reach a drive, stops apart."""
        self.end_all([one for one in drive.writes if one.members], Outcome.REFUSED, reason)

    def end_all(self, requests: list[Request], outcome: Outcome, reason: str) -> None:
        """End those of the requests that still wait: one's end may have ended another."""
        for request in requests:
            if request.state in (QUEUED, DEFERRED):
                self.end_waiting(request, outcome, reason)

    def expire(self, now_s: float) -> None:
        """End expired requests, a batch at most; what has begun no longer expires."""
        for request in self.expiries.due(now_s, EXPIRE_BATCH):
            if request.state in (QUEUED, DEFERRED) and not request.attempts:
                self.end_waiting(request, Outcome.EXPIRED, _TOO_LATE)

    def listed(self, *, drive: str | None = None, stops: bool = False) -> list[Request]:
        """List what waits, for one drive or all, without the stops or with them."""
        queues = self.queues if stops else self.queues[1:]
        found = [request for queue in queues for request in queue.waiting(drive)]
        for _, _, what in self.timers:
            if (
                isinstance(what, Request)
                and what.state == DEFERRED
                and (stops or what.priority is not Priority.STOP)
                and (drive is None or what.drive == drive)
            ):
                found.append(what)
        return found

    # -- times ------------------------------------------------------------------------------------

    def at(self, at_s: float, what: Timed) -> None:
        """Come back to something at a time."""
        self._serial += 1
        heappush(self.timers, (at_s, self._serial, what))

    def run_timers(self, now_s: float) -> list[QueuedDrive | PollingEntry]:
        """Put requests whose time has come into their lanes; give what else has come due."""
        timers = self.timers
        others: list[QueuedDrive | PollingEntry] = []
        while timers and timers[0][0] <= now_s:
            what = heappop(timers)[2]
            if not isinstance(what, Request):
                others.append(what)
            elif what.state == DEFERRED:
                what.state = QUEUED
                self.queues[what.priority].put(what)
        return others

    # -- heads ------------------------------------------------------------------------------------

    def stop(self) -> Request | None:
        """Find the stop that goes first: no hold delays it; stops of silent drives are the last."""
        queue = self.queues[Priority.STOP]
        return queue.head(_never_held) if queue.depth else None

    def yields(self, stop: Request) -> bool:
        """Return whether feeds may go before a stop (silent_stops.py)."""
        return stop.yields or stop.drive in self.silent

    def keep(self, drive: QueuedDrive, *, slots: bool, now_s: float) -> None:
        """Note what waited for the end of a drive's hold.

        Args:
            drive: The drive.
            slots: Cyclic slots of the drive did.
            now_s: Now, when the hold ends.
        """
        queues = self.queues
        before = drive.kept
        drive.kept = {
            one: before.get(one, now_s)
            for one in CLASS_SHARES
            if queues[one].first_for(drive.name) is not None or (slots and one is Priority.CYCLIC)
        }
        drive.kept_until_s = now_s + KEPT_S

    def kept_by(
        self, request: Request, now_s: float, after_s: float = KEPT_AFTER_S
    ) -> dict[Priority, list[str]]:
        """Return of which drives of a request holds have kept what of lower classes for so long."""
        found: dict[Priority, list[str]] = {}
        for drive in self._reached(request):
            if drive.kept and now_s <= drive.kept_until_s:
                for one, since_s in drive.kept.items():
                    if one > request.priority and since_s + after_s <= drive.kept_until_s - KEPT_S:
                        found.setdefault(one, []).append(drive.name)
        return found

    def head(self, priority: Priority, now_s: float) -> Request | None:
        """Find the first request of a class that may go; what has expired there ends."""
        queue = self.queues[priority]
        if not queue.depth:
            return None
        for _ in range(EXPIRE_BATCH):
            request = queue.head(self._holder)
            if request is None or not has_expired(request, now_s):
                return request
            self.end_waiting(request, Outcome.EXPIRED, _TOO_LATE)
        return None  # `expire` goes on with the rest

    def _holder(self, request: Request) -> QueuedDrive | None:
        """Find the held drive that keeps a request from going."""
        if not request.members:
            drive = self.drives.get(request.drive)
            return drive if drive is not None and drive.held else None
        for name in request.members:
            drive = self.drives.get(name)
            if drive is not None and drive.held:
                return drive
        return None


def has_expired(request: Request, now_s: float) -> bool:
    """Return whether a request may no longer be begun; one that has begun does not expire."""
    expires_at_s = request.expires_at_s
    return expires_at_s is not None and expires_at_s <= now_s and not request.attempts


def _never_held(_request: Request) -> None:
    """Keep nothing back."""
