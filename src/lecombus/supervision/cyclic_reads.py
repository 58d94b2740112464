"""What is read of each drive all the time, as the roster has it, at the start and at every reload.

Schedule, store and measures must agree on which codes these are and how often each is read: this
is where they are set. A reload exchanges only what differs, so that the reads that stayed keep
their place in the cadence, and values known keep standing. Feeding is not touched by any of it.

What must not live here: when each read goes (`schedule`), when a value is stale (`judging`).
"""

from __future__ import annotations

from lecombus.drive_runtime import Drive
from lecombus.metrics.rolling_window import RollingWindow
from lecombus.operations.requests import Requests
from lecombus.schedule import Cyclic, Schedule
from lecombus.store import Store

__all__ = ["CyclicReads"]


class CyclicReads:
    """The cyclic reads of one line's drives.

    Args:
        requests: Makes them.
        schedule: Runs them.
        store: Keeps how often a code is read.
        window: Keeps which codes are read.
    """

    def __init__(
        self, requests: Requests, schedule: Schedule, store: Store, window: RollingWindow
    ) -> None:
        self._requests = requests
        self._schedule = schedule
        self._store = store
        self._window = window

    def take(self, drive: Drive, now_s: float) -> None:
        """Read of a drive what its entry says from now on, and nothing else."""
        running, entry = drive.cyclic, drive.entry
        wanted = {one.code: one.every_s for one in entry.cyclic}
        same = {code for code, one in running.items() if wanted.get(code) == one.cyclic.period_s}
        if running and same == set(running) == set(wanted):
            return
        for code in set(running) - same:
            self._schedule.remove_cyclic(running.pop(code))
            if code not in wanted:
                self._store.expect(entry.name, code, None)
        for code, every_s in wanted.items():
            if code not in same:
                self._store.expect(entry.name, code, every_s)
                make = self._requests.cyclic_maker(entry.name, code)
                cyclic = Cyclic(entry.name, every_s, make)
                running[code] = self._schedule.add_cyclic(cyclic, now_s)
        self._window.expect(entry.name, tuple(wanted))

    def forget(self, drive: Drive) -> None:
        """The schedule reads nothing of a drive any more: it was taken out there."""
        for code in drive.cyclic:
            self._store.expect(drive.name, code, None)
        drive.cyclic.clear()
