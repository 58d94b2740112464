"""A motor behind an inverter: where it is at a given time, computed from time alone.

Strategy: the motor runs at a constant rate towards its target, so its speed at any time follows
from the speed at the last change. Nothing ticks. A frequency is in Hz or, for drives that count in
rotations, in min-1: the unit is the family's affair.
"""

from __future__ import annotations

__all__ = ["Motor"]


class Motor:
    """Speed that ramps to a target, coasts without power, or stands.

    Attributes:
        speed: The shaft's speed now, as a frequency; negative is counter-clockwise.
        target: Where the ramp leads.
        powered: Whether the inverter drives it; without power it coasts.
    """

    COAST_S = 3.0
    """Time to coast from the greatest frequency to standstill; a light conveyor's."""

    def __init__(self) -> None:
        self.speed = 0.0
        self.target = 0.0
        self.powered = False
        self._rate_up = 10.0
        self._rate_down = 10.0
        self._coast_rate = 50.0 / self.COAST_S

    def aim(self, target: float, *, rate_up: float, rate_down: float, span: float) -> None:
        """Power the motor towards a target.

        Args:
            target: The frequency to reach.
            rate_up: Change per second away from standstill, > 0.
            rate_down: Change per second towards standstill, > 0.
            span: The greatest frequency, from which coasting takes `COAST_S`.
        """
        self.target = target
        self.powered = True
        self._rate_up, self._rate_down = rate_up, rate_down
        self._coast_rate = span / self.COAST_S

    def release(self) -> None:
        """Take the power off: the motor coasts."""
        self.target = 0.0
        self.powered = False

    @property
    def output(self) -> float:
        """The inverter's output frequency: nothing when it is inhibited."""
        return self.speed if self.powered else 0.0

    def advance(self, elapsed_s: float) -> None:
        """Move on by a time in seconds, >= 0."""
        left = elapsed_s
        while left > 0.0 and self.speed != self.target:
            left = self._leg(left)

    def _leg(self, left: float) -> float:
        """One stretch at one rate: to the target, or to standstill when that lies between."""
        speed, target = self.speed, self.target
        if not self.powered:
            goal, rate = 0.0, self._coast_rate
        elif speed * target < 0.0 or abs(target) < abs(speed):
            goal, rate = (0.0 if speed * target < 0.0 else target), self._rate_down
        else:
            goal, rate = target, self._rate_up
        needed = abs(goal - speed) / rate
        if needed <= left:
            self.speed = goal
            return left - needed
        self.speed = speed + (rate * left if goal > speed else -rate * left)
        return 0.0
