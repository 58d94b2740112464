"""A snapshot of a schedule for metrics and status; plain numbers, taken on request.

Nothing here changes a schedule, and nothing in it is counted for the snapshot's sake alone except
where a comment there says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lecombus.schedule.request import Priority

__all__ = ["FeedStats", "ScheduleStats"]


@dataclass(frozen=True, slots=True)
class FeedStats:
    """How one drive's watchdog is kept.

    Args:
        time_s: The watchdog time set in the drive.
        age_s: Time since the drive was last fed.
        margin_last_s: What was left of the watchdog time at the last feed; infinite before it.
        margin_least_s: The least ever left.
        fed: Exchanges that fed it.
        failures: Exchanges in a row that it did not answer.
        misses: Times the hard deadline passed unfed.
        lapses: Times the watchdog time itself passed unfed: the drive has acted.
        paused: Not kept at present: the drive is parked.
    """

    time_s: float
    age_s: float
    margin_last_s: float
    margin_least_s: float
    fed: int
    failures: int
    misses: int
    lapses: int
    paused: bool


@dataclass(frozen=True, slots=True)
class ScheduleStats:
    """A schedule at one moment.

    Args:
        depth: Waiting requests by class.
        stretch: Factor by which the cyclic cadence was stretched over the last 10 s; 1.0: held.
        cyclic_late_most_s: The latest start of a cyclic slot since the last snapshot.
        cyclic_skipped: Slots passed over because their drive was held.
        cyclic_dropped: Slots that could not be run without making a feed late.
        feeds: The watchdogs by drive.
        feeds_due: Feeds that are due now.
        refused: Requests refused by class: queue full, never fitting, parked, line lost.
        expired: Requests expired by class.
        superseded: Requests superseded by class, those ended by a stop included.
        probes_refused: Probes that could not be run without making a feed late.
    """

    depth: Mapping[Priority, int]
    stretch: float
    cyclic_late_most_s: float
    cyclic_skipped: int
    cyclic_dropped: int
    feeds: Mapping[str, FeedStats]
    feeds_due: int
    refused: Mapping[Priority, int]
    expired: Mapping[Priority, int]
    superseded: Mapping[Priority, int]
    probes_refused: int
