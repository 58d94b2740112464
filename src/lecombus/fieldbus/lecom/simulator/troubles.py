"""Faults inside a drive: what is wrong now, why it stays, and what the drive remembers of it.

Strategy: a family gives the fault numbers its manual lists, each with its kind. A TRIP stays
until it is reset, and a reset does not help while its cause is there. A message or a warning is
there exactly as long as its cause. Every fault enters the memory, newest first.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, auto
from typing import Final

__all__ = ["Kind", "Troubles", "kinds"]

_PLACES: Final = 8


class Kind(IntEnum):
    """What a fault does to the drive. Source: EDB2102EN 8.2, C0161, C0168."""

    TRIP = auto()
    """Pulses inhibited until it is reset."""
    MESSAGE = auto()
    """Pulses inhibited as long as it lasts."""
    WARNING = auto()
    """Nothing, but it is shown."""


def kinds(
    trips: tuple[int, ...], messages: tuple[int, ...] = (), warnings: tuple[int, ...] = ()
) -> Mapping[int, Kind]:
    """Write a family's fault numbers as a table."""
    return (
        dict.fromkeys(trips, Kind.TRIP)
        | dict.fromkeys(messages, Kind.MESSAGE)
        | dict.fromkeys(warnings, Kind.WARNING)
    )


class Troubles:
    """The faults of one drive.

    Args:
        known: The family's fault numbers.

    Attributes:
        memory: What has occurred, newest first; a power cycle does not touch it.
    """

    def __init__(self, known: Mapping[int, Kind]) -> None:
        self._known = known
        self._active: dict[Kind, int] = {}
        self._causes: set[int] = set()
        self.memory: list[int] = []

    @property
    def trip(self) -> int:
        """The active TRIP's number, 0 when none."""
        return self._active.get(Kind.TRIP, 0)

    @property
    def message(self) -> int:
        """The active message's number, 0 when none."""
        return self._active.get(Kind.MESSAGE, 0)

    @property
    def warning(self) -> int:
        """The active warning's number, 0 when none."""
        return self._active.get(Kind.WARNING, 0)

    def numbers(self) -> str:
        """Write the numbers of the family's faults for people: `11 to 16, 32, 50`."""
        ranges: list[list[int]] = []
        for number in sorted(self._known):
            if ranges and number == ranges[-1][-1] + 1:
                ranges[-1][1:] = [number]
            else:
                ranges.append([number])
        return ", ".join(" to ".join(map(str, one)) for one in ranges) or "it has none"

    def occur(self, number: int, *, stays: bool = False) -> None:
        """Let a fault occur.

        Args:
            number: Its number in the family's fault memory: a LECOM number, or that of P500.
            stays: Whether a TRIP's cause is there until `clear`; other kinds always stay.

        Raises:
            ValueError: The family has no such fault.
        """
        kind = self._known.get(number)
        if kind is None:
            raise ValueError(f"no fault has the number {number} here: {self.numbers()}")
        self._active[kind] = number
        self.memory = [number, *self.memory][:_PLACES]
        if stays or kind is not Kind.TRIP:
            self._causes.add(number)

    def clear(self) -> None:
        """Take all causes away: messages and warnings end, a TRIP waits for its reset."""
        self._causes.clear()
        trip = self.trip
        self._active = {Kind.TRIP: trip} if trip else {}

    def reset(self) -> None:
        """Acknowledge a TRIP; while its cause is there it remains."""
        if self.trip not in self._causes:
            self._active.pop(Kind.TRIP, None)

    def restart(self) -> None:
        """Start again after power was off: what still has its cause occurs again."""
        self._active.clear()
        for number in sorted(self._causes):
            self.occur(number, stays=True)

    def shifted(self, place: int) -> int:
        """What a memory shows whose place 1 is the active fault and whose others are the past.

        Args:
            place: 1 is the active fault, 2 the last one before it; 0 when the place is empty.
        """
        active = self.trip or self.message or self.warning
        if place <= 1:
            return active
        past = list(self.memory)
        if active in past:
            past.remove(active)
        return past[place - 2] if place - 2 < len(past) else 0

    def newest(self, place: int) -> int:
        """What a memory shows whose place 1 is the newest fault, reset or not."""
        index = max(0, place - 1)
        return self.memory[index] if index < len(self.memory) else 0
