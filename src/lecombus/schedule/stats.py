"""A snapshot of a schedule for metrics and status; plain numbers, taken on request.

The counting is done where things happen; here it is only gathered. Taking a snapshot changes
nothing except that it begins new measures of the latest cyclic start and of the least margins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from lecombus.schedule.polling import Polling
from lecombus.schedule.request import Outcome, Priority
from lecombus.schedule.shares import Probes
from lecombus.schedule.waiting import Waiting
from lecombus.schedule.watchdog_deadline import WatchdogDeadline
from lecombus.schedule.watchdog_set import WatchdogSet

__all__ = ["ScheduleStats", "WatchdogStats", "snapshot"]


@dataclass(frozen=True, slots=True)
class WatchdogStats:
    """How one drive's watchdog is kept.

    Args:
        time_s: The watchdog time set in the drive.
        age_s: Time since the drive was last fed.
        margin_last_s: What was left of the watchdog time at the last feed; infinite before it.
        margin_least_s: The least ever left.
        margin_since_s: The least left since the last snapshot; infinite: not fed since.
        fed: Exchanges that fed it.
        failures: Exchanges in a row that it did not answer.
        misses: Times the hard deadline passed unfed.
        lapses: Times the watchdog time itself passed unfed: the drive may have acted. Once until
            the drive answers again; not while it was not heard since the port was opened.
        paused: Not kept at present: the drive is parked.
    """

    time_s: float
    age_s: float
    margin_last_s: float
    margin_least_s: float
    margin_since_s: float
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
        slack_s: Time left until the line must be free for feeding; infinite: nothing is fed.
    """

    depth: Mapping[Priority, int]
    stretch: float
    cyclic_late_most_s: float
    cyclic_skipped: int
    cyclic_dropped: int
    feeds: Mapping[str, WatchdogStats]
    feeds_due: int
    refused: Mapping[Priority, int]
    expired: Mapping[Priority, int]
    superseded: Mapping[Priority, int]
    probes_refused: int
    slack_s: float


def snapshot(
    waiting: Waiting,
    watchdogs: WatchdogSet,
    polling: Polling,
    probes: Probes,
    speaking_to: str | None,
    now_s: float,
) -> ScheduleStats:
    """Gather the figures of a schedule's parts.

    Args:
        waiting: What waits.
        watchdogs: The watchdogs.
        polling: The cyclic entries.
        probes: The probes.
        speaking_to: The drive of the exchange under way: whether it is fed shows at its end.
        now_s: Now.
    """
    for name, feed in watchdogs.by_drive.items():
        if name != speaking_to:
            feed.judge(now_s)
    late_s, polling.late_most_s = polling.late_most_s, 0.0
    by_class = {
        outcome: {priority: counts[priority] for priority in Priority}
        for outcome, counts in waiting.counts.items()
    }
    return ScheduleStats(
        depth={priority: waiting.queues[priority].depth for priority in Priority},
        stretch=polling.stretch(now_s),
        cyclic_late_most_s=late_s,
        cyclic_skipped=polling.skipped,
        cyclic_dropped=polling.dropped,
        feeds={name: _feed_stats(f, now_s) for name, f in watchdogs.by_drive.items()},
        feeds_due=len(watchdogs.due(now_s)),
        refused=by_class[Outcome.REFUSED],
        expired=by_class[Outcome.EXPIRED],
        superseded=by_class[Outcome.SUPERSEDED],
        probes_refused=sum(probe.refused for probe in probes.by_drive.values()),
        slack_s=watchdogs.slack_s(now_s),
    )


def _feed_stats(feed: WatchdogDeadline, now_s: float) -> WatchdogStats:
    since_s, feed.margin_since_s = feed.margin_since_s, math.inf
    return WatchdogStats(
        time_s=feed.time_s,
        age_s=now_s - feed.fed_at_s,
        margin_last_s=feed.margin_last_s,
        margin_least_s=feed.margin_least_s,
        margin_since_s=since_s,
        fed=feed.fed,
        failures=feed.failures,
        misses=feed.misses,
        lapses=feed.lapses,
        paused=not feed.active,
    )
