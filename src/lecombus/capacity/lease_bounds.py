"""How long after its client's last sign of life a drive is stopped: by drive and `on_lapse`.

From the last renewal that lecombus took. A stop then waits for the exchange under way and for the
stops of all other drives that need a lease, should all their clients die together: each gets its
telegram before any is proven. A stop that is not proven is left to the drive's watchdog after the
time for which it is repeated. With `silence` the last telegram may have begun just before the
lapse, and its watchdog runs from there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lecombus.capacity.exchange_costs import read_times, stop_attempt_s, watched_s, write_times
from lecombus.capacity.waits import LATENESS_S
from lecombus.drives import StopAction, family, knows_stop, needs_control_word, stop_value
from lecombus.drives.stops import STOP_PATIENCE_S, inhibit_proofs
from lecombus.fieldbus.costs import LineTiming
from lecombus.roster import DriveEntry, Roster

__all__ = ["LeaseBound", "lease_bounds", "stops_by_silence"]

STOPS = frozenset(StopAction)


@dataclass(frozen=True, slots=True)
class LeaseBound:
    """What a drive that needs a lease is promised; infinite where nothing is.

    Args:
        drive: The drive.
        on_lapse: What is done when its lease lapses.
        time_s: The longest lease, seconds.
        stop_s: From the last renewal until the telegram of its stop begins.
        watchdog_s: From the last renewal until its own watchdog has acted, if it was sent nothing
            because of `silence` or because its stop was not proven.
        counts: What the bounds consist of, in words.
    """

    drive: str
    on_lapse: str
    time_s: float
    stop_s: float
    watchdog_s: float
    counts: str


def lease_bounds(roster: Roster, timing: LineTiming, stop_wait_s: float) -> list[LeaseBound]:
    """Give the bound of each drive that needs a lease, in the roster's order.

    Args:
        roster: The line.
        timing: Its times.
        stop_wait_s: How long a stop waits for the exchange under way, seconds.
    """
    leased = [drive for drive in roster.drives if drive.lease.required]
    said = {drive.name: _said_s(drive, timing) for drive in leased}
    most_s = sum(said.values())
    return [_bound(drive, timing, stop_wait_s, most_s) for drive in leased]


def _bound(drive: DriveEntry, timing: LineTiming, stop_wait_s: float, stops_s: float) -> LeaseBound:
    lease, watchdog_s = drive.lease, watched_s(drive)
    name, time_s = drive.name, lease.time_s
    if lease.on_lapse == "hold":
        text = "it runs on, and an alarm says so"
        return LeaseBound(name, "hold", time_s, math.inf, math.inf, text)
    if lease.on_lapse == "silence":
        acts_s = math.inf if watchdog_s is None else time_s + LATENESS_S + watchdog_s
        text = "the lease, and its watchdog from the last telegram on"
        return LeaseBound(name, "silence", time_s, math.inf, acts_s, text)
    stop_s = time_s + LATENESS_S + stop_wait_s + stops_s
    text = "the lease, the wait of a stop, and the stops of all drives that need a lease"
    acts_s = math.inf
    if watchdog_s is not None and stops_by_silence(drive):
        acts_s = stop_s + STOP_PATIENCE_S + stop_attempt_s(drive, timing) + watchdog_s
    else:
        text += "; no watchdog may stop it: an unproven stop is repeated"
    return LeaseBound(name, lease.on_lapse, time_s, stop_s, acts_s, text)


def _said_s(drive: DriveEntry, timing: LineTiming) -> float:
    """Give the line time of one telegram that stops a drive, with the reads before it."""
    of = family(drive.family)
    if drive.lease.on_lapse not in STOPS:
        return 0.0
    action = StopAction(drive.lease.on_lapse)
    if not knows_stop(of, action):
        return 0.0
    code, value = stop_value(of, action, 0)
    times_s = write_times(drive, code, value, timing).usual_s
    if needs_control_word(of, action):
        shown_by = next(iter(inhibit_proofs(of)), code)
        times_s += sum(read_times(drive, one, timing).usual_s for one in (code, shown_by))
    return times_s


def stops_by_silence(drive: DriveEntry) -> bool:
    """Whether a drive's own watchdog stops it as the roster allows when it is sent nothing."""
    if watched_s(drive) is None or drive.watchdog is None:
        return False
    return drive.stop_fallback == "inhibit" or drive.watchdog.action == "quick-stop"
