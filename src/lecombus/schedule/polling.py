"""Cyclic requests on an absolute grid that is stretched evenly when the line cannot hold it.

Each entry is due on a grid of its period on a virtual timeline; real time is virtual time
plus an offset. As long as the line keeps up the offset stands still, and the k-th slot is due at
start + k * period exactly: nothing drifts. The entry with the earliest virtual due time goes first.

An entry may be late by one of its periods; short bursts are caught up. When the first entry
is later than that, the line is overloaded, and the offset grows by the excess: virtual time runs
slower, so every cycle is stretched by the same factor and no entry is favoured because of its
period. What was missed that way is never run twice. The stretch is the ratio of real to virtual
time over the last ten seconds.

An entry whose drive was set apart (held, parked) skips the slots it missed and keeps its grid; its
absence must not stretch the cycles of the others.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final, Protocol

from lecombus.schedule.request import Request

__all__ = ["STRETCH_WINDOW_S", "Cyclic", "Polling", "PollingEntry"]

STRETCH_WINDOW_S: Final = 10.0
STAND_BACK_PERIODS: Final = 2.0  # so late, a slot no longer stands back for one that feeds
_SNAPSHOT_EVERY_S: Final = 0.5
# Stretch when virtual time practically stands still; a figure that can still be shown.
_STRETCH_MOST: Final = 1000.0


@dataclass(slots=True)
class Cyclic:
    """Something to be asked of a drive every so often.

    Args:
        drive: The drive.
        period_s: How often, seconds, > 0.
        make: Builds a fresh request, of class `CYCLIC`.
    """

    drive: str
    period_s: float
    make: Callable[[], Request]


class PollingEntry:
    """A cyclic request and its place on the grid; also the handle for its caller."""

    __slots__ = ("active", "cyclic", "due_v", "request", "served", "version")

    def __init__(self, cyclic: Cyclic) -> None:
        self.cyclic = cyclic
        self.due_v = 0.0  # virtual time of its next slot
        self.version = -1  # of its item in the heap; older items are void
        self.active = True
        self.request: Request | None = None  # made, but not yet run
        self.served = 0  # slots run

    def made(self) -> Request:
        """Return the request for the slot at hand."""
        request = self.request
        if request is None:
            request = self.request = self.cyclic.make()
            request.source = self
        return request


class _Apart(Protocol):
    """What the cadence needs to know of a drive."""

    held: bool
    entries: list[PollingEntry]


class Polling:
    """All cyclic entries of a line."""

    __slots__ = (
        "_heap",
        "_joining",
        "_snapshots",
        "_versions",
        "by_drive",
        "dropped",
        "late_most_s",
        "offset_s",
        "skipped",
    )

    def __init__(self) -> None:
        self.by_drive: dict[str, list[PollingEntry]] = {}
        self.offset_s = 0.0
        self.late_most_s = 0.0
        # Of all entries ever: counts do not fall when one is taken away.
        self.skipped = 0  # slots passed over while their drive was set apart
        self.dropped = 0  # slots that could not be run without making a feed late
        self._heap: list[tuple[float, int, PollingEntry]] = []
        self._joining: list[PollingEntry] = []
        self._versions = 0
        self._snapshots: deque[tuple[float, float]] = deque()

    def add(self, cyclic: Cyclic) -> PollingEntry:
        """Take a new entry; it joins, with all others new by then, at the next `head`."""
        assert cyclic.period_s > 0.0, "a period must be longer than nothing"
        entry = PollingEntry(cyclic)
        self.by_drive.setdefault(cyclic.drive, []).append(entry)
        self._joining.append(entry)
        return entry

    def remove(self, entry: PollingEntry) -> None:
        """Forget an entry."""
        self.leave(entry)
        self.by_drive[entry.cyclic.drive].remove(entry)

    def leave(self, entry: PollingEntry) -> None:
        """Take an entry off the timeline; `join` brings it back."""
        entry.active = False
        entry.version = -1
        entry.request = None
        if entry in self._joining:
            self._joining.remove(entry)

    def join(self, entry: PollingEntry) -> None:
        """Bring an entry back at the present virtual time."""
        if not entry.active:
            entry.active = True
            self._joining.append(entry)

    def _push(self, entry: PollingEntry) -> None:
        self._versions += 1
        entry.version = self._versions
        heappush(self._heap, (entry.due_v, self._versions, entry))

    def _let_join(self, now_s: float) -> None:
        """Put the joining entries on the timeline, those of equal period spread evenly over it."""
        alike: dict[float, list[PollingEntry]] = {}
        for entry in self._joining:
            alike.setdefault(entry.cyclic.period_s, []).append(entry)
        self._joining.clear()
        for period_s, entries in alike.items():
            for number, entry in enumerate(entries):
                entry.due_v = now_s - self.offset_s + period_s * number / len(entries)
                self._push(entry)

    def head(self, now_s: float, drives: Mapping[str, _Apart]) -> PollingEntry | None:
        """Find the entry that is due and goes first; entries of held drives are set apart."""
        if self._joining:
            self._let_join(now_s)
        heap = self._heap
        while heap:
            due_v, version, entry = heap[0]
            if entry.version != version:
                heappop(heap)
                continue
            if due_v + self.offset_s > now_s:
                return None
            drive = drives[entry.cyclic.drive]
            if not drive.held:
                return entry
            heappop(heap)
            entry.version = -1
            drive.entries.append(entry)
        return None

    def prepare(self) -> None:
        """Make the request of the next slot, so that it is ready when the line becomes free."""
        if self.next_s() is not None:
            self._heap[0][2].made()

    @property
    def is_joining(self) -> bool:
        """Whether entries wait to be put on the timeline at the next `head`."""
        return bool(self._joining)

    def first(self) -> tuple[PollingEntry | None, float]:
        """Return which entry is due next, and when; changes nothing, unlike `head`."""
        heap = self._heap
        while heap and heap[0][2].version != heap[0][1]:
            heappop(heap)
        return (heap[0][2], heap[0][0] + self.offset_s) if heap else (None, math.inf)

    def may_wait(self, entry: PollingEntry, now_s: float) -> bool:
        """Return whether a due slot may stand back for another: not when it has for long."""
        late_s = now_s - entry.due_v - self.offset_s
        return late_s <= STAND_BACK_PERIODS * entry.cyclic.period_s

    def next_s(self) -> float | None:
        """Return when the next slot is due."""
        entry, due_s = self.first()
        return None if entry is None else due_s

    def take(self, entry: PollingEntry, now_s: float) -> Request:
        """Run the slot of an entry now, whether due or early, and set its next one."""
        request = entry.made()
        request.submitted_at_s = min(now_s, entry.due_v + self.offset_s)
        entry.request = None
        entry.served += 1
        self._pass_slot(entry, now_s)
        return request

    def drop(self, entry: PollingEntry, now_s: float) -> None:
        """Give up the slot at hand: it cannot be run."""
        entry.request = None
        self.dropped += 1
        self._pass_slot(entry, now_s)

    def _pass_slot(self, entry: PollingEntry, now_s: float) -> None:
        period_s = entry.cyclic.period_s
        late_s = now_s - entry.due_v - self.offset_s
        if late_s > self.late_most_s:
            self.late_most_s = late_s
        if late_s > period_s:
            self._snapshot(now_s)
            self.offset_s += late_s - period_s
        entry.due_v += period_s
        self._push(entry)

    def set_apart(self, entry: PollingEntry) -> None:
        """Take the entry out until `rejoin`."""
        entry.version = -1

    def rejoin(self, entry: PollingEntry, now_s: float) -> None:
        """Put an entry that was set apart back on its own grid, without the slots it missed."""
        if not entry.active or entry.version >= 0:
            return
        period_s = entry.cyclic.period_s
        missed = int(max(0.0, now_s - self.offset_s - entry.due_v) / period_s)
        entry.due_v += missed * period_s
        self.skipped += missed
        self._push(entry)

    def is_due(self, drive: str, now_s: float) -> bool:
        """Return whether a slot of a drive is due; it may be set apart."""
        due_v = now_s - self.offset_s
        return any(one.active and one.due_v <= due_v for one in self.by_drive.get(drive, ()))

    def early(self, drive: str, now_s: float) -> PollingEntry | None:
        """Find the drive's slot that is due soonest, to be run early.

        A slot further away than its period is the one after the next: the next has been run
        early already, and running ahead of the grid again would leave a gap later.
        """
        found: PollingEntry | None = None
        for entry in self.by_drive.get(drive, ()):
            if (
                entry.version >= 0
                and entry.due_v - (now_s - self.offset_s) <= entry.cyclic.period_s
                and (found is None or entry.due_v < found.due_v)
            ):
                found = entry
        return found

    def _snapshot(self, now_s: float) -> None:
        """Remember the offset as it was, at most twice a second, for the stretch."""
        snapshots = self._snapshots
        if not snapshots or now_s - snapshots[-1][0] >= _SNAPSHOT_EVERY_S:
            snapshots.append((now_s, self.offset_s))
            while snapshots[0][0] < now_s - STRETCH_WINDOW_S - _SNAPSHOT_EVERY_S:
                snapshots.popleft()

    def stretch(self, now_s: float) -> float:
        """Return by what factor the cycles were stretched of late; 1.0 when the cadence holds."""
        growth_s = self._owed(now_s)
        since = [(at_s, was) for at_s, was in self._snapshots if at_s >= now_s - STRETCH_WINDOW_S]
        if since:
            growth_s += self.offset_s - since[0][1]
        virtual_s = STRETCH_WINDOW_S - growth_s
        if virtual_s <= STRETCH_WINDOW_S / _STRETCH_MOST:
            return _STRETCH_MOST
        return STRETCH_WINDOW_S / virtual_s

    def _owed(self, now_s: float) -> float:
        """Return how far the offset would grow if the first entry ran now."""
        if self.next_s() is None:
            return 0.0
        due_v, _, entry = self._heap[0]
        return max(0.0, now_s - due_v - self.offset_s - entry.cyclic.period_s)
