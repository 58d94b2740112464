"""When a line that is left idle on purpose is wanted again.

Cyclic and background work do not count: they are what may wait. Everything else ends the idling,
also a stop that must itself wait for a feed.
"""

from __future__ import annotations

import math
from typing import Final

from lecombus.schedule.request import Priority
from lecombus.schedule.waiting import Waiting
from lecombus.schedule.watchdog_arbiter import WatchdogArbiter
from lecombus.schedule.watchdog_set import WatchdogSet

__all__ = ["wanted_at_s"]

PRESSING: Final = (Priority.CONTROL, Priority.WATCHDOG, Priority.INTERACTIVE)
LOOK_AGAIN_S: Final = 0.01
"""An idle line looks no sooner again for a feed that could not go, seconds."""


def wanted_at_s(
    waiting: Waiting, watchdogs: WatchdogSet, watchdog_arbiter: WatchdogArbiter, now_s: float
) -> float:
    """Return when to look again whether anything but cyclic and background work wants the line.

    Args:
        waiting: What waits; what has come due by now stands in its lanes.
        watchdogs: The watchdogs.
        watchdog_arbiter: Says which feed goes.
        now_s: The time.

    Returns:
        `now_s`: something does. Submitting may make it so at any time.
    """
    if waiting.stop() is not None or watchdog_arbiter.urgent(now_s) is not None:
        return now_s
    if any(waiting.head(one, now_s) is not None for one in PRESSING):
        return now_s
    timer_s = waiting.timers[0][0] if waiting.timers else math.inf
    feed_s = watchdogs.next_s(now_s)
    return min(timer_s, math.inf if feed_s is None else max(feed_s, now_s + LOOK_AGAIN_S))
