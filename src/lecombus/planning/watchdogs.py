"""How short each drive's watchdog could be, the others staying as they are.

Method: the demand bound of `schedule.demand`, over the feeds of `config.feeding`, halved down to a
millisecond. Two times are given: the least that can be held, one exchange failing at the worst
moment, and the least that also outlasts a drive that goes away: it is asked `AWAY_ATTEMPTS` times
in vain before it is given up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from lecombus.config import Roster
from lecombus.config.exchanges import watched_s
from lecombus.config.feeding import LONGEST_S, Feeding, feeding_of, lowest_s, smallest
from lecombus.drives import LineTiming
from lecombus.schedule.feeds import HARD_PART

__all__ = ["AWAY_ATTEMPTS", "WatchdogPlan", "watchdog_plans"]

AWAY_ATTEMPTS: Final = 4
"""Exchanges in a row that a drive fails before it counts as offline."""


@dataclass(frozen=True, slots=True)
class WatchdogPlan:
    """One drive's watchdog.

    Args:
        drive: The drive.
        time_s: What the roster says, seconds.
        feed_s: What one feed costs, seconds.
        least_s: The least time that can be held; None: none.
        outlasts_s: The least time that outlasts a drive that goes away; None: none.
    """

    drive: str
    time_s: float
    feed_s: float
    least_s: float | None
    outlasts_s: float | None

    @property
    def verdict(self) -> str:
        """Say what the roster's time is good for."""
        if self.outlasts_s is not None and self.time_s >= self.outlasts_s:
            return "held, also when a drive goes away"
        if self.least_s is not None and self.time_s >= self.least_s:
            return "held while no drive goes away"
        return "cannot be held"


def watchdog_plans(roster: Roster, timing: LineTiming) -> list[WatchdogPlan]:
    """Plan every watched drive's watchdog, in the roster's order."""
    feeding = feeding_of(roster, timing)
    plans = []
    known: dict[tuple[float, float, float, float], tuple[float | None, float | None]] = {}
    for number, drive in enumerate(feeding.drives):
        stream = feeding.streams[number]
        low_s = max(lowest_s(drive), feeding.own_s[number] / HARD_PART)
        alike = (stream.cost_s, stream.every_s, stream.blocked_s, low_s)
        if alike not in known:
            known[alike] = (
                _least(feeding, number, low_s, 0),
                _least(feeding, number, low_s, AWAY_ATTEMPTS),
            )
        least_s, outlasts_s = known[alike]
        time_s = watched_s(drive) or 0.0
        plans.append(WatchdogPlan(drive.name, time_s, stream.cost_s, least_s, outlasts_s))
    return plans


def _least(feeding: Feeding, number: int, low_s: float, lost: int) -> float | None:
    def holds(time_s: float) -> bool:
        return feeding.with_time(number, time_s).holds(lost=lost)

    now_s = feeding.streams[number].every_s / HARD_PART
    return smallest(holds, low_s, now_s if holds(now_s) else LONGEST_S)
