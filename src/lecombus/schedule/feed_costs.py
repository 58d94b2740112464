"""What feeding a drive costs: as was measured, and as manual and roster tell."""

from __future__ import annotations

from lecombus.schedule.request import Request

__all__ = ["FeedCosts"]


class FeedCosts:
    """Cost and longest time of the read that feeds a drive, seconds.

    Args:
        request: That read.

    Attributes:
        measured: As was measured; as told, where nothing longer was.
        told: By manual and roster.
    """

    __slots__ = ("measured", "told")

    def __init__(self, request: Request) -> None:
        self.measured = self.told = (0.0, 0.0)
        self.take(request)

    def take(self, request: Request) -> bool:
        """Take what the read costs now; say whether that is news."""
        measured = (request.cost_s, request.worst_s + request.cut_by_s)
        told = request.told or measured
        news = (measured, told) != (self.measured, self.told)
        self.measured, self.told = measured, told
        return news

    @property
    def is_longer(self) -> bool:
        """Whether what was measured is longer than what is told."""
        return self.measured != self.told
