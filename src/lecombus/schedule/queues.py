"""Waiting requests of one priority class, first come first served, with drives set apart.

A class is not one long queue but a lane for every drive, and a heap of lanes ordered by the place
of each lane's first request. So everything that concerns one drive (it is held, it needs a feed,
it is gone) touches one lane and never the hundred thousand requests of the others: choosing is
O(log drives), for any number of requests.

Removal is lazy. A place in a lane is a cell, a list `[place, request]`; a request that ends while
it waits leaves an empty cell behind, which is dropped when it comes to the front, or all together
once the empty cells of a lane outnumber the full ones. A later setpoint takes over the cell of the
one it supersedes: a stream of setpoints does not queue itself to the back again and again.

`Expiries` keeps the requests that end by themselves at a time, of all classes.

What is due, allowed or sensible is not decided here; who is held is asked of the caller.
"""

from __future__ import annotations

import math
from collections import deque
from heapq import heapify, heappop, heappush, heapreplace
from typing import Any, Final, Protocol

from lecombus.schedule.polling import PollingEntry
from lecombus.schedule.request import Priority, Request

__all__ = ["ClassQueue", "Expiries", "Holder", "Lane", "QueuedDrive"]

# Empty cells a lane may have beyond its full ones before it is tidied: tidying costs O(lane), so
# it happens at most once in as many removals.
EMPTY_LIMIT: Final = 64


class Holder(Protocol):
    """What holds lanes back, and releases them afterwards."""

    lanes: list[tuple[ClassQueue, Lane]]


class Lane:
    """The requests of one class for one drive."""

    __slots__ = ("blocked", "cells", "empty", "key")

    def __init__(self) -> None:
        self.cells: deque[list[Any]] = deque()
        self.empty = 0  # cells without a request
        self.key: int | None = None  # the place under which it stands in the heap of its class
        self.blocked = False  # given to a holder


class ClassQueue:
    """The waiting requests of one class."""

    __slots__ = ("_lanes", "_ready", "depth")

    def __init__(self) -> None:
        self._lanes: dict[str, Lane] = {}
        self._ready: list[tuple[int, Lane]] = []
        self.depth = 0  # requests of this class that wait, deferred ones too; kept by the owner

    def put(self, request: Request) -> None:
        """Set a request at its `place`."""
        lane = self._lanes.get(request.drive)
        if lane is None:
            lane = self._lanes[request.drive] = Lane()
        place = request.place
        cell = request.cell = [place, request]
        cells = lane.cells
        if not cells or cells[-1][0] < place:
            cells.append(cell)
        else:  # it comes back ahead of others: its place is at or near the front
            index = 0
            while cells[index][0] < place:
                index += 1
            cells.insert(index, cell)
        if not lane.blocked and (lane.key is None or place < lane.key):
            lane.key = place
            heappush(self._ready, (place, lane))

    def remove(self, request: Request) -> None:
        """Take a waiting request out, wherever it stands."""
        cell = request.cell
        assert cell is not None
        cell[1] = request.cell = None
        lane = self._lanes[request.drive]
        lane.empty += 1
        if lane.empty > EMPTY_LIMIT and 2 * lane.empty > len(lane.cells):
            lane.cells = deque(kept for kept in lane.cells if kept[1] is not None)
            lane.empty = 0

    @staticmethod
    def replace(old: Request, new: Request) -> None:
        """Give the cell of a waiting request to a later one for the same drive."""
        cell = old.cell
        assert cell is not None
        cell[1] = new
        new.cell, old.cell = cell, None
        new.place = cell[0]

    def head(self, held: Any) -> Request | None:
        """Find the first request that may go.

        Args:
            held: Given a request, returns the `Holder` that keeps it from going, or None.
        """
        ready = self._ready
        while ready:
            place, lane = ready[0]
            if lane.key != place:
                heappop(ready)
                continue
            request = _front(lane)
            if request is None:
                heappop(ready)
                lane.key = None
            elif request.place != place:
                lane.key = request.place
                heapreplace(ready, (request.place, lane))
            elif (holder := held(request)) is not None:
                heappop(ready)
                lane.key = None
                lane.blocked = True
                holder.lanes.append((self, lane))
            else:
                return request
        return None

    def first_for(self, drive: str) -> Request | None:
        """Find the first request for one drive."""
        lane = self._lanes.get(drive)
        return None if lane is None else _front(lane)

    def release(self, lane: Lane) -> None:
        """Take back a lane that a holder had."""
        lane.blocked = False
        request = _front(lane)
        if request is not None and lane.key is None:
            lane.key = request.place
            heappush(self._ready, (request.place, lane))

    def waiting(self, drive: str | None = None) -> list[Request]:
        """List every request in the lanes, or in one drive's lane."""
        if drive is None:
            lanes = list(self._lanes.values())
        else:
            lanes = [self._lanes[drive]] if drive in self._lanes else []
        return [cell[1] for lane in lanes for cell in lane.cells if cell[1] is not None]


def _front(lane: Lane) -> Request | None:
    """Drop the empty cells at the front and give the first request."""
    cells = lane.cells
    while cells:
        request: Request | None = cells[0][1]
        if request is not None:
            return request
        cells.popleft()
        lane.empty -= 1
    return None


class QueuedDrive:
    """What a schedule keeps for one drive."""

    __slots__ = (
        "entries",
        "held",
        "held_until_s",
        "kept",
        "kept_until_s",
        "lanes",
        "multicast_at",
        "name",
        "parked",
        "stopped_at",
        "writes",
    )  # fmt: skip

    def __init__(self, name: str) -> None:
        self.name = name
        self.held = False
        self.held_until_s = 0.0
        self.lanes: list[tuple[ClassQueue, Lane]] = []  # kept from their queues while held
        self.entries: list[PollingEntry] = []  # kept from the cadence while held
        # Classes that waited for the end of the last hold, each since the end of its first ..
        self.kept: dict[Priority, float] = {}
        self.kept_until_s = 0.0  # .. and until when that counts
        self.writes: set[Request] = set()  # waiting writes that reach it
        self.multicast_at = 0  # serial of the last multicast that reaches it
        self.parked: str | None = None  # why it is offline
        self.stopped_at = 0  # serial of the last stop


class Expiries:
    """The requests that end by themselves at a time, earliest first."""

    __slots__ = ("_heap", "_tidy_at")

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Request]] = []
        self._tidy_at = 1024

    def add(self, request: Request) -> None:
        """Watch a request that has an expiry time."""
        assert request.expires_at_s is not None
        heap = self._heap
        if len(heap) >= self._tidy_at:
            # Most requests end long before they expire; without this they would be kept till then.
            heap[:] = [item for item in heap if not item[2].settled]
            heapify(heap)
            self._tidy_at = max(1024, 2 * len(heap))
        heappush(heap, (request.expires_at_s, request.serial, request))

    def next_s(self) -> float | None:
        """Return when the next watched request expires."""
        heap = self._heap
        while heap and heap[0][2].settled:
            heappop(heap)
        return heap[0][0] if heap else None

    def first_s(self) -> float:
        """Return, without tidying, before what time nothing expires."""
        return self._heap[0][0] if self._heap else math.inf

    def due(self, now_s: float, most: int) -> list[Request]:
        """Take out what has expired by now, at most so many in one call."""
        heap = self._heap
        found: list[Request] = []
        while heap and heap[0][0] <= now_s and len(found) < most:
            request = heappop(heap)[2]
            if not request.settled:
                found.append(request)
        return found

    def may_have_expired(self, now_s: float) -> bool:
        """Return, without tidying, whether anything may have expired."""
        return bool(self._heap) and self._heap[0][0] <= now_s
