"""Which request is sent next on a line: priorities, deadlines, polling, holds, shares of line time.

Start with `schedule.py`; its header is the theory of operation. Pure: no clock and no I/O, each
call gets `now_s`.

What must not live here: terms of a line protocol. A request is a drive, a piece of work, a cost in
seconds and a deadline.
"""

from lecombus.schedule.polling import Cyclic, PollingEntry
from lecombus.schedule.request import Outcome, Priority, Request, Settle, ignore_end
from lecombus.schedule.schedule import Schedule
from lecombus.schedule.stats import ScheduleStats, WatchdogStats
from lecombus.schedule.watchdog_deadline import FaultHypothesis, WatchdogDeadline, WatchdogFeeding

__all__ = [
    "Cyclic",
    "FaultHypothesis",
    "Outcome",
    "PollingEntry",
    "Priority",
    "Request",
    "Schedule",
    "ScheduleStats",
    "Settle",
    "WatchdogDeadline",
    "WatchdogFeeding",
    "WatchdogStats",
    "ignore_end",
]
