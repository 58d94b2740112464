"""How short each drive's watchdog could be, the others staying as they are.

Method: the demand bound of `schedule.demand`, over the feeds of `config.feeding`, halved down to a
millisecond. Two times are given: the least that can be held, as many answers being lost at the
worst moments as the roster wants outlasted (`line.tolerate`), and the least that also outlasts a
drive that goes away: it is asked `AWAY_ATTEMPTS` times in vain before it is given up.

A restart of the daemon after it was killed is reckoned with `RESTART_S` until the first telegram,
and one exchange with each drive until all have been spoken to. A watchdog outlasts that if its
drive was spoken to so shortly before as leaves the rest of its time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from lecombus.config import Roster
from lecombus.config.exchanges import feed_times, watched_s
from lecombus.config.feeding import LONGEST_S, Feeding, feeding_of, lowest_s, smallest
from lecombus.drives import LineTiming
from lecombus.schedule.feed import HARD_PART

__all__ = ["AWAY_ATTEMPTS", "WatchdogPlan", "watchdog_plans"]

AWAY_ATTEMPTS: Final = 4
"""Exchanges in a row that a drive fails before it counts as offline."""
MOST_LOST: Final = 9
"""More lost answers than these are not counted."""


RESTART_S: Final = 3.0
"""From the end of a daemon that was killed to the first telegram of the next: 1.4 to 2.8 s were
measured."""


@dataclass(frozen=True, slots=True)
class WatchdogPlan:
    """One drive's watchdog.

    Args:
        drive: The drive.
        time_s: What the roster says, seconds.
        feed_s: What one feed costs, seconds.
        least_s: The least time that can be held; None: none.
        outlasts_s: The least time that outlasts a drive that goes away; None: none.
        restart_s: It outlasts a restart of the daemon if the drive was spoken to in so many seconds
            before; 0: it does not.
        lost: So many lost answers within its time, whosever, it outlasts for certain.
    """

    drive: str
    time_s: float
    feed_s: float
    least_s: float | None
    outlasts_s: float | None
    restart_s: float
    lost: int

    @property
    def at_restart(self) -> str:
        """Say what it does while the daemon is started again."""
        if self.restart_s >= HARD_PART * self.time_s:
            return "outlasts it"
        return f"if fed {self.restart_s:.1f} s before" if self.restart_s else "may act"

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
    plans, lost = [], _lost(feeding)
    restart_s = RESTART_S + sum(feed_times(one, timing).usual_s for one in roster.drives)
    known: dict[tuple[float, float, float, float], tuple[float | None, float | None]] = {}
    for number, drive in enumerate(feeding.drives):
        stream = feeding.streams[number]
        low_s = max(lowest_s(drive), feeding.own_s[number] / HARD_PART)
        alike = (stream.cost_s, stream.every_s, stream.blocked_s, low_s)
        if alike not in known:
            known[alike] = (
                _least(feeding, number, low_s, None),
                _least(feeding, number, low_s, AWAY_ATTEMPTS + 1),
            )
        least_s, outlasts_s = known[alike]
        time_s = watched_s(drive) or 0.0
        left_s = max(time_s - restart_s, 0.0)
        plans.append(
            WatchdogPlan(drive.name, time_s, stream.cost_s, least_s, outlasts_s, left_s, lost)
        )
    return plans


def _lost(feeding: Feeding) -> int:
    """Count the lost answers within a watchdog time that all watchdogs outlast."""
    found = 0
    while found < MOST_LOST and feeding.holds(lost=found + 1):
        found += 1
    return found


def _least(feeding: Feeding, number: int, low_s: float, lost: int | None) -> float | None:
    def holds(time_s: float) -> bool:
        return feeding.with_time(number, time_s).holds(lost=lost)

    now_s = feeding.streams[number].every_s / HARD_PART
    return smallest(holds, low_s, now_s if holds(now_s) else LONGEST_S)
