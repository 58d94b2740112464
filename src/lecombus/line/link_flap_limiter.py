"""What of a port's coming and going is told, so that one that flaps for hours fills no log.

::

    steady ──third loss in a minute──▶ unsteady: told in sums, after 1, 2, 4 .. 60 minutes
       ▲                                   │
       └──── a minute without a change ────┘  told, with the number of losses

Every change of a steady port is told at once. What the line's state is does not depend on it: that
stands in the store whatever is told here.

What must not live here: logging itself, clocks, ports (`port_connection`).
"""

from __future__ import annotations

from collections import deque
from enum import StrEnum
from typing import Final

__all__ = ["FlapMessage", "LinkFlapLimiter"]

FEW: Final = 3
"""Losses that are told one by one, or a little less: the last of them opens the first sum."""

WHILE_S: Final = 60.0
"""So many losses in this time are too many; after this time without a change all is told again."""

FIRST_PAUSE_S: Final = 60.0
LONGEST_PAUSE_S: Final = 3600.0


class FlapMessage(StrEnum):
    """What to say of a change."""

    NOTHING = "nothing"
    CHANGE = "change"
    SUM = "sum"
    STEADY = "steady"
    """The port has been as it is for a while, after losses that were only counted."""


class LinkFlapLimiter:
    """Decides what is told. Times are in seconds of any one clock that never goes back.

    Attributes:
        losses: In this time of unsteadiness, or in the one that has just ended.
        since_s: When it began.
        pause_s: How long nothing is told after the sum that is due.
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
        """Take note that the port was lost."""
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
        """Take note that the port is open."""
        self._changed_s = now_s
        return FlapMessage.CHANGE if self.is_steady else self._sum(now_s)

    def looked(self, now_s: float) -> FlapMessage:
        """Take note that the port is as it was: open or away."""
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
