"""What users are told of their writes and stops.

A write ends in exactly one outcome; a group's outcome is the worst of its members', because
whoever reads only one word must not be told better than it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from .protocol.addressing import Code
from .readings import Reading
from .schedule import Outcome

__all__ = ["GroupReport", "How", "WriteReport", "group_report"]


class How(StrEnum):
    """How several drives were spoken to."""

    MULTICAST = "multicast"
    ONE_BY_ONE = "one-by-one"


@dataclass(frozen=True, slots=True)
class WriteReport:
    """What came of one write.

    Args:
        drive: The drive's name.
        code: What was written.
        outcome: How it ended.
        reason: Why, in words; may be empty when it is done or verified.
        reading: What is known of the code afterwards, if anything.
    """

    drive: str
    code: Code
    outcome: Outcome
    reason: str
    reading: Reading | None = None


@dataclass(frozen=True, slots=True)
class GroupReport:
    """What came of a write or a stop to several drives.

    Args:
        target: The group's or the drive's name.
        how: One telegram to all, or one to each.
        outcome: The worst of the members' outcomes.
        members: Each member's report, in the roster's order.
    """

    target: str
    how: How
    outcome: Outcome
    members: tuple[WriteReport, ...]


_FROM_BEST = (
    Outcome.VERIFIED,
    Outcome.DONE,
    Outcome.SUPERSEDED,
    Outcome.EXPIRED,
    Outcome.REFUSED,
    Outcome.UNKNOWN,
)


def group_report(target: str, how: How, reports: Iterable[WriteReport]) -> GroupReport:
    """Put the members' reports together."""
    members = tuple(reports)
    worst = max((one.outcome for one in members), key=_FROM_BEST.index)
    return GroupReport(target, how, worst, members)
