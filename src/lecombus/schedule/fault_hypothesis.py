"""The fault hypothesis of a line: how many answers may be lost, and the room that is kept for them.

An exchange is begun only if the watchdogs outlast what may be lost from then on. If its own
answer is lost, it takes its longest, and all but one of the lost answers that are tolerated may
be those of the feeds after it; a stop may follow, too. If it is answered, all the lost answers
that are tolerated may be those of the feeds after it. A stop does not wait; it and its lost
answer may use the last tenth of a watchdog time, and room is kept for what that does not hold.
With none to be tolerated an exchange is begun if the watchdogs outlast its own lost answer. One
for which there is never room together with one lost answer and a stop is not begun; where there
is never room for all that are tolerated, it is begun when there is most (`watchdog_set`).

The roster was accepted by the same sum (`capacity.watchdog_demand`).

Pure: seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FaultHypothesis"]


@dataclass(frozen=True, slots=True)
class FaultHypothesis:
    """What may be lost within any watchdog time.

    Args:
        tolerate: So many answers.
        stop_s: The longest stop with its proof, seconds.
        stop_failed_s: The longest telegram of a stop that is not answered, seconds.
    """

    tolerate: int = 0
    stop_s: float = 0.0
    stop_failed_s: float = 0.0

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
        failed_s = (self.tolerate - 1) * lost_s + worst_s + max(self.stop_s - tenth_s, 0.0)
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
        if not self.tolerate:
            return 0.0
        stop_s = self.stop_behind_s(lost_s, tenth_s)
        return (self.tolerate - 1) * lost_s + max(lost_s, stop_s)

    def stop_behind_s(self, lost_s: float, tenth_s: float) -> float:
        """Return how much slack a stop and one lost answer take, seconds; arguments as above.

        Nothing, or less, where a tenth of the shortest watchdog time holds them.
        """
        return max(lost_s + self.stop_s, self.stop_failed_s) - tenth_s
