"""Which stops go out now, and which are carried out together. Pure.

A stop waits for no other command. But a client that repeats one stop all the time must not occupy
the bridge. So of each target and kind only a few stops are sent at the same time. Those that come
after them wait until the first has ended, and are then sent as one stop.

A stop that is under way cannot stand for a later one: a client may have enabled the drive between
them. A stop that was not sent yet can.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from lecombus.bridges.mqtt.broker import Incoming

__all__ = ["AT_ONCE", "LANES_MOST", "StopLanes"]

AT_ONCE: Final = 4
"""Stops of one target and kind."""

WAITING_MOST: Final = 100
"""Stops that go out as one, each with its answer; further ones get none."""

LANES_MOST: Final = 400
"""Targets and kinds at the same time, also those that there are not."""

Lane = tuple[str, str]
"""Target and kind."""


@dataclass(slots=True)
class LaneStops:
    """Stops of one target and kind."""

    under_way: int = 0
    waiting: list[Incoming] = field(default_factory=list)


class StopLanes:
    """The stops that were taken and have not ended."""

    def __init__(self) -> None:
        self._lanes: dict[Lane, LaneStops] = {}

    def has_room(self, lane: Lane) -> bool:
        """Whether a stop can be taken that may be of something that there is not."""
        return lane in self._lanes or len(self._lanes) < LANES_MOST

    def take(self, lane: Lane, stop: Incoming) -> bool:
        """Take a stop; returns whether it goes out now. Otherwise `ended` gives it."""
        stops = self._lanes.setdefault(lane, LaneStops())
        if stops.under_way < AT_ONCE:
            stops.under_way += 1
            return True
        if len(stops.waiting) < WAITING_MOST:
            stops.waiting.append(stop)
        return False

    def ended(self, lane: Lane) -> list[Incoming]:
        """Note that one under way has ended; returns those that go out now, as one."""
        stops = self._lanes[lane]
        found, stops.waiting = stops.waiting, []
        if not found:
            stops.under_way -= 1
            if not stops.under_way:
                del self._lanes[lane]
        return found
