"""The drives of a line, what recurs for each, and the state of each.

A drive is made known, given a watchdog to be kept, cyclic requests and a probe, and taken away
again. It may be held (not used until a time; stops go all the same, other drives go on), or
parked (offline: what waits for it is refused, and only its probe runs); and the line may be lost,
which ends all that waits and every hold.

Lanes of held drives leave their queue when they come to the head, and are given back when the hold
ends; cyclic entries likewise leave the cadence.

Each change here invalidates a choice made beforehand (`_invalidate`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

from lecombus.schedule.polling import Cyclic, Polling, PollingEntry
from lecombus.schedule.queues import QueuedDrive
from lecombus.schedule.request import Outcome, Priority, Request
from lecombus.schedule.shares import Probe, Probes
from lecombus.schedule.waiting import Waiting
from lecombus.schedule.watchdog_deadline import FaultHypothesis, WatchdogDeadline, WatchdogFeeding
from lecombus.schedule.watchdog_set import WatchdogSet

__all__ = ["DriveTable"]


class DriveTable(ABC):
    """The drives of one line, as the schedule sees them; `Schedule` is made of it.

    Args:
        limits: Most waiting requests by class.
        absent_share: The part of line time that probes of absent drives may take, 0..1.
    """

    def __init__(self, limits: Mapping[Priority, int] | None, absent_share: float) -> None:
        self._waiting = Waiting(limits)
        self._drives = self._waiting.drives
        self._watchdogs = WatchdogSet()
        self._by_roster = WatchdogSet()
        self._polling = Polling()
        self._probes = Probes(absent_share)
        self._fed_before: dict[
            str, WatchdogDeadline
        ] = {}  # drives that are not fed at present, for the counts

    @abstractmethod
    def _invalidate(self) -> None:
        """Forget a choice made beforehand: something changed."""

    # -- what the line has ------------------------------------------------------------------------

    def expect(self, faults: FaultHypothesis, by_roster: WatchdogSet | None = None) -> None:
        """Keep room for such faults from now on, beside the exchange that is begun.

        Args:
            faults: The faults.
            by_roster: The watchdogs that the roster names, for `never_beside_roster`.
        """
        self._invalidate()
        self._watchdogs.faults = faults
        self._by_roster = by_roster or WatchdogSet(faults)
        self._watchdogs.changed()

    def add_drive(self, name: str) -> None:
        """Make a drive known."""
        assert name not in self._drives, f"{name} is known already"
        self._drives[name] = QueuedDrive(name)
        self._waiting.set_silent(name, silent=False)

    def remove_drive(self, name: str, now_s: float, reason: str) -> WatchdogDeadline | None:
        """Forget a drive: its waiting requests end as refused; stops still go out.

        What is on the line for it ends behind the telegram under way, also if the name comes back:
        it may be another device by then.

        Returns:
            How it was fed, for `resume_feeding` if it comes back; None: it was not.
        """
        silent = name in self._waiting.silent
        fed = self._watchdogs.by_drive.pop(name, None)  # before parking, which would pause it
        left = fed or self._fed_before.get(name)
        self._fed_before.pop(name, None)
        self.park(name, now_s, reason)
        self._waiting.end_multicasts(self._drives[name], reason)
        self._waiting.set_silent(name, silent=silent)
        self.set_feeding(name, None, now_s)
        self.set_probe(name, None, now_s)
        for entry in list(self._polling.by_drive.pop(name, ())):
            self._polling.leave(entry)
        self._release(self._drives.pop(name), now_s)
        return left

    def refuse_group(self, name: str, reason: str) -> None:
        """End the multicasts of a group that wait, stops apart: it is another group by now."""
        self._invalidate()
        self._waiting.end_all(self._waiting.listed(drive=name), Outcome.REFUSED, reason)

    def resume_feeding(self, name: str, left: WatchdogDeadline, *, is_same: bool) -> None:
        """Go on feeding a drive that was taken out and is back already.

        Args:
            name: The drive.
            left: What `remove_drive` gave.
            is_same: It is the drive it was: its watchdog has been running since it was last fed.
        """
        self._invalidate()
        feed = self._watchdogs.by_drive.get(name)
        if feed is None:
            self._fed_before[name] = left
        elif is_same:
            if left.active:  # a longer time is not set in the drive yet
                feed.time_s = min(feed.time_s, left.time_s)
            feed.follow(left)
        else:
            feed.count_on(left)
        self._watchdogs.changed()

    def set_feeding(self, name: str, feeding: WatchdogFeeding | None, now_s: float) -> None:
        """Keep a drive's watchdog from now on, or no longer.

        Its time is counted from the last exchange that fed it; from now, if it is a new one.
        `feeding.make` is called once immediately, for the cost; that request becomes the first
        feed.
        """
        self._invalidate()
        drive = self._drives[name]
        old = self._watchdogs.by_drive.pop(name, None)
        if feeding is not None:
            feed = self._watchdogs.by_drive[name] = WatchdogDeadline(name, feeding, now_s)
            before = self._fed_before.pop(name, None)
            if old is not None:
                feed.follow(old)
            elif before is not None:
                feed.resume(before, now_s)
            feed.active = drive.parked is None
            if drive.held:
                feed.held_until_s = drive.held_until_s
        elif old is not None:
            self._fed_before[name] = old
        self._watchdogs.changed()

    def costs_changed(self, name: str) -> None:
        """Calculate again what feeding a drive costs: its measured times have changed."""
        feed = self._watchdogs.by_drive.get(name)
        if feed is not None:
            self._invalidate()
            feed.request = feed.feeding.make()
            if feed.costs.take(feed.request):
                self._watchdogs.changed()

    def add_cyclic(self, cyclic: Cyclic, now_s: float) -> PollingEntry:
        """Ask something of a drive every period; entries added together are spread evenly.

        Returns:
            The handle for `remove_cyclic`.
        """
        self._invalidate()
        entry = self._polling.add(cyclic)
        if self._drives[cyclic.drive].parked is not None:
            self._polling.leave(entry)
        return entry

    def remove_cyclic(self, handle: PollingEntry) -> None:
        """Ask it no longer."""
        self._invalidate()
        self._polling.remove(handle)

    def set_probe(self, name: str, make: Callable[[], Request] | None, now_s: float) -> None:
        """Say how to look whether a drive is back; probes run only while it is parked."""
        self._invalidate()
        old = self._probes.by_drive.pop(name, None)
        if old is not None:
            self._probes.stop(old)
        if make is not None:
            probe = self._probes.by_drive[name] = Probe(name, make)
            if self._drives[name].parked is not None:
                self._probes.start(probe, now_s)

    # -- how they are doing -----------------------------------------------------------------------

    def hold(self, name: str, until_s: float, now_s: float) -> None:
        """Leave a drive alone until a time, stops apart; others go on."""
        self._invalidate()
        drive = self._drives.get(name)
        if drive is None:  # taken out of the roster while it was spoken to
            return
        if until_s <= max(now_s, drive.held_until_s if drive.held else now_s):
            return
        drive.held_until_s = until_s
        feed = self._watchdogs.by_drive.get(name)
        if feed is not None:
            feed.held_until_s = until_s
        if not drive.held:
            drive.held = True
            self._waiting.at(until_s, drive)

    def _release(self, drive: QueuedDrive, now_s: float) -> None:
        drive.held = False
        lanes, drive.lanes = drive.lanes, []
        for queue, lane in lanes:
            queue.release(lane)
        entries, drive.entries = drive.entries, []
        for entry in entries:
            self._polling.rejoin(entry, now_s)

    def park(self, name: str, now_s: float, reason: str) -> None:
        """Take a drive as offline: what waits for it is refused, stops apart; probing begins."""
        self._invalidate()
        drive = self._drives[name]
        if drive.parked is not None:
            drive.parked = reason
            return
        drive.parked = reason
        self._waiting.set_silent(name, silent=True)
        feed = self._watchdogs.by_drive.get(name)
        if feed is not None:
            feed.active = False
            self._watchdogs.changed()
        for entry in self._polling.by_drive.get(name, ()):
            self._polling.leave(entry)
        drive.entries.clear()
        probe = self._probes.by_drive.get(name)
        if probe is not None:
            self._probes.start(probe, now_s)
        self._waiting.end_all(self._waiting.listed(drive=name), Outcome.REFUSED, reason)

    def unpark(self, name: str, now_s: float) -> None:
        """Take a drive as back: its cyclic requests and feeding resume, its probing ends."""
        self._invalidate()
        drive = self._drives[name]
        if drive.parked is None:
            return
        drive.parked = None
        self._waiting.set_silent(name, silent=False)
        feed = self._watchdogs.by_drive.get(name)
        if feed is not None:
            feed.restart(now_s)
            if drive.held:
                feed.held_until_s = drive.held_until_s
            self._watchdogs.changed()
        for entry in self._polling.by_drive.get(name, ()):
            self._polling.join(entry)
        probe = self._probes.by_drive.get(name)
        if probe is not None:
            self._probes.stop(probe)

    def fail_all(self, now_s: float, reason: str, *, stops: bool = True) -> None:
        """End all that waits, and the stops unless they are to be kept: the line is lost.

        Cyclic requests and feeding stay and resume; holds end.
        """
        self._invalidate()
        for drive in self._drives.values():
            self._release(drive, now_s)
        for feed in self._watchdogs.by_drive.values():
            feed.held_until_s = feed.retry_at_s = -math.inf
        for name in [one for one in self._waiting.silent if not self._is_parked(one)]:
            self._waiting.set_silent(name, silent=False)
        self._watchdogs.changed()
        self._waiting.end_all(self._waiting.listed(stops=stops), Outcome.REFUSED, reason)

    def port_opened(self) -> None:
        """Take no drive as heard: which drives there are on an opened port is not known."""
        for feed in (*self._watchdogs.by_drive.values(), *self._fed_before.values()):
            feed.heard = False

    def _is_parked(self, name: str) -> bool:
        drive = self._drives.get(name)
        return drive is not None and drive.parked is not None
