"""What a stop of a drive that does not answer is promised, and what it costs the others.

Its first telegram is the stop class's own (`waits`), unless the drive is known to be offline. Every
other telegram waits until the watchdogs can be fed in time besides; before it go feeds for as long
as a round of the line and a drive that goes away take at most, and nothing else
(`schedule.silent_stops`). So the bound is plain addition: the exchange under way, that round, the
attempts, the last feed begun, and the time for which a drive is left alone after a write. It holds
whoever else fails to answer; other drives' stops add theirs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from lecombus.config import Roster
from lecombus.config.exchanges import dearest_feed_times, stop_attempt_s, watched_s
from lecombus.drives import LineTiming, family
from lecombus.planning.ahead import Ahead
from lecombus.planning.waits import LATENESS_S
from lecombus.schedule.feed import SPARE_ATTEMPTS

__all__ = ["PATIENCE_S", "PAUSE_S", "SilentStop", "silent_stop"]

PATIENCE_S: Final = 5.0
"""A stop is said again for so long (`line.stop_job`), seconds."""
PAUSE_S: Final = 0.1
"""And left to others before each telegram after the first few (`line.stop_job`), seconds."""
LEAST_TELEGRAMS: Final = 3
"""Said twice and asked once, however long that takes (`line.stop_job`)."""


@dataclass(frozen=True, slots=True)
class SilentStop:
    """What a line promises to a stop of a drive that does not answer.

    Args:
        quiet_s: From when it may be said again until its telegram begins, nobody else asking; for
            a drive that is offline already, from its request to the first telegram.
        loaded_s: The same with the longest exchange under way.
        attempt_s: What one telegram without an answer then takes at most.
        telegrams: So many go out at least, in `PATIENCE_S` or however long they take.
        counts: What the bounds consist of, in words.
    """

    quiet_s: float
    loaded_s: float
    attempt_s: float
    telegrams: int
    counts: str


def silent_stop(roster: Roster, timing: LineTiming, ahead: Ahead) -> SilentStop:
    """Reckon what a stop of a silent drive is promised.

    Args:
        roster: The line.
        timing: Its times.
        ahead: What can go before a request on it.
    """
    watched = [drive for drive in roster.drives if watched_s(drive) is not None]
    feeds = [dearest_feed_times(drive, timing) for drive in watched]
    last_s = max((feed.worst_s for feed in feeds), default=0.0)
    alone_s = max((family(drive.family).hold_after_write_s for drive in watched), default=0.0)
    lost_s = (SPARE_ATTEMPTS + 1) * last_s
    more_s = sum(feed.usual_s for feed in feeds) + alone_s + lost_s + LATENESS_S
    attempt_s = max(stop_attempt_s(drive, timing) for drive in roster.drives)
    loaded_s = ahead.anything.times.worst_s + more_s
    telegrams = 1 + int(PATIENCE_S / (attempt_s + PAUSE_S + loaded_s))
    return SilentStop(
        ahead.own.times.worst_s + more_s, loaded_s, attempt_s, max(telegrams, LEAST_TELEGRAMS),
        "as above, and feeds that would come too late, a round of the line at most",
    )  # fmt: skip
