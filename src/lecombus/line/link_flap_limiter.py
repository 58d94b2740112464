"""Limits log messages of a port that flaps.

::

    steady ──third loss in a minute──▶ unsteady: logged as sums, after 1, 2, 4 .. 60 minutes
       ▲                                   │
       └──── a minute without a change ────┘  logged, with the number of losses

Each change of a steady port is logged immediately. The state of the line in the store does not
depend on this: it always follows the port.
"""

from __future__ import annotations

from collections import deque
from enum import StrEnum
from typing import Final

__all__ = ["FlapMessage", "LinkFlapLimiter"]

FEW: Final = 3
"""So many losses within `WHILE_S` make the port unsteady."""

WHILE_S: Final = 60.0
"""Losses are counted over this time; so long without a change is steady again, seconds."""

FIRST_PAUSE_S: Final = 60.0
LONGEST_PAUSE_S: Final = 3600.0


class FlapMessage(StrEnum):
    """What to log for a change."""

    NOTHING = "nothing"
    CHANGE = "change"
    SUM = "sum"
    STEADY = "steady"
    """The port is steady again, after losses that were only counted."""


class LinkFlapLimiter:
    """Decides what is logged. Times are in seconds of a monotonic clock.

    Attributes:
        losses: In this time of unsteadiness, or in the one that has just ended.
        since_s: When it began.
        pause_s: How long nothing is logged after the sum that is due.
    """

    def __init__(self) -> None:
        self.losses = 0
        self.since_s = 0.0
        self.pause_s = FIRST_PAUSE_S
        self.is_steady = True
        self._latest: deque[float] = deque(maxlen=FEW)
        self._changed_s = 0.0
        self._next_s = 0.0

    def lost(self, now_s: float) -> FlapMessage:
        """Record a loss of the port."""
        self._changed_s = now_s
        self._latest.append(now_s)
        self.losses += 1
        if not self.is_steady:
            return self._sum(now_s)
        if len(self._latest) < FEW or now_s - self._latest[0] > WHILE_S:
            return FlapMessage.CHANGE
        self.is_steady = False
        self.since_s, self.losses = self._latest[0], FEW
        self._next_s, self.pause_s = now_s, FIRST_PAUSE_S / 2.0
        return self._sum(now_s)

    def opened(self, now_s: float) -> FlapMessage:
        """Record that the port was opened."""
        self._changed_s = now_s
        return FlapMessage.CHANGE if self.is_steady else self._sum(now_s)

    def looked(self, now_s: float) -> FlapMessage:
        """Record that the port has not changed since the last call."""
        if self.is_steady:
            return FlapMessage.CHANGE
        if now_s - self._changed_s < WHILE_S:
            return self._sum(now_s)
        self.is_steady = True
        self._latest.clear()
        return FlapMessage.STEADY

    def _sum(self, now_s: float) -> FlapMessage:
        if now_s < self._next_s:
            return FlapMessage.NOTHING
        self.pause_s = min(2.0 * self.pause_s, LONGEST_PAUSE_S)
        self._next_s = now_s + self.pause_s
        return FlapMessage.SUM
