"""Who speaks next on a line: priorities, deadlines, cadence, hold-offs, shares of line time.

Start reading at `schedule.py`, whose header is the theory of operation. Pure: no clock and no I/O,
every call is given `now_s`; and no word of any line protocol: a request is a drive, a piece of
work, a cost in seconds and a deadline.
"""

from lecombus.schedule.cadence import Cyclic, Entry
from lecombus.schedule.faults import Faults
from lecombus.schedule.feed import Feed, Feeding
from lecombus.schedule.request import Outcome, Priority, Request, Settle
from lecombus.schedule.schedule import Schedule
from lecombus.schedule.stats import FeedStats, ScheduleStats

__all__ = [
    "Cyclic",
    "Entry",
    "Faults",
    "Feed",
    "FeedStats",
    "Feeding",
    "Outcome",
    "Priority",
    "Request",
    "Schedule",
    "ScheduleStats",
    "Settle",
]
