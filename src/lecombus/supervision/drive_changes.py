"""Adding, changing and removing drives of a running line: who must know it, in which order.

One place for all of it, at the start, at a reload and when a drive is followed to another address.
A drive whose entry is the same is not touched. A drive that is only used otherwise (other codes are
read, other writes allowed) keeps all that is known of it. Any other change makes it start again,
because another device may answer from now on; its values stay while address and family do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lecombus.capacity.watchdog_demand import faults_of
from lecombus.capacity.work_ahead import feeds_of
from lecombus.config import DriveEntry, Roster
from lecombus.drive_state.drive_runtime import Drive
from lecombus.drive_state.store import Store
from lecombus.drives import family
from lecombus.drives.measured import MeasuredTimes
from lecombus.fieldbus.requests import Station
from lecombus.metrics import Metrics
from lecombus.operations.awaited_requests import Requests
from lecombus.schedule import Cyclic, WatchdogDeadline
from lecombus.schedule.request import TAKEN_OUT
from lecombus.supervision.drive_supervisor import DriveSupervisor
from lecombus.supervision.health import Health

__all__ = ["DriveChanges"]


@dataclass(frozen=True, slots=True)
class _Left:
    """What a drive that starts again was before.

    Args:
        drive: The drive.
        entry: Its entry.
        feed: How far the feeding of its watchdog was; None: it was not fed.
    """

    drive: Drive
    entry: DriveEntry
    feed: WatchdogDeadline | None


class DriveChanges:
    """Changes the drives of one line.

    Args:
        requests: Has the drives, and makes their requests.
        store: Their values and states.
        metrics: Their counters.
        health: How they are doing; has them audited.
        supervisor: Has their watchdogs fed.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        metrics: Metrics,
        health: Health,
        supervisor: DriveSupervisor,
        clock: Callable[[], float],
    ) -> None:
        self._requests = requests
        self._drives = requests.drives
        self._schedule = requests.worker.schedule
        self._store = store
        self._metrics = metrics
        self._health = health
        self._supervisor = supervisor
        self._clock = clock

    def apply(self, old: Roster, roster: Roster) -> None:
        """Make the line's drives and groups those of a roster.

        Drives leave before others come, because these may have their addresses.
        """
        wanted = {entry.name: entry for entry in roster.drives}
        left: dict[str, _Left] = {}
        for drive in tuple(self._drives):
            entry = wanted.get(drive.name)
            if entry is None:
                self.remove(drive)
            elif drive.entry.asks_for_audit(entry):
                left[drive.name] = _Left(drive, drive.entry, self._leave(drive))
            elif entry != drive.entry:
                self.change_use(drive, entry)
        for entry in roster.drives:
            if entry.name in left:
                self._begin_again(left[entry.name], entry)
            elif self._drives.find(entry.name) is None:
                self.add(entry)
        for name, group in old.groups.items():
            if roster.groups.get(name) != group:
                self._schedule.refuse_group(name, f"the roster's group {name} was changed")
        for name in set(old.groups) - set(roster.groups):
            self._metrics.counters.remove(name)
        for name in roster.groups:
            self._metrics.counters.add_group(name)
        timing = self._requests.maker.timing
        self._schedule.expect(faults_of(roster, timing), feeds_of(roster, timing))

    def add(self, entry: DriveEntry) -> None:
        """Add a drive."""
        lasting = self._drives.lasting(entry.name)
        self._join(Drive(entry, self._station(entry), self._clock, lasting))

    def change_use(self, drive: Drive, entry: DriveEntry) -> None:
        """Read other codes of a drive, or allow other things; it stays the drive it is."""
        drive.entry = entry
        self._read_cyclically(drive)

    def remove(self, drive: Drive) -> None:
        """Remove a drive and all that is known of it."""
        self._leave(drive)
        self._store.remove_drive(drive.name)
        self._metrics.counters.remove(drive.name)
        self._metrics.rolling_window.forget(drive.name)

    def _begin_again(self, left: _Left, entry: DriveEntry) -> None:
        """Start a drive again with another entry."""
        drive = left.drive
        drive.begin(entry, self._station(entry))
        self._join(drive)
        if left.feed is not None:  # no deadline of its watchdog slips because its entry changed
            is_same = (left.entry.address, left.entry.family) == (entry.address, entry.family)
            self._schedule.resume_feeding(drive.name, left.feed, is_same=is_same)

    def _join(self, drive: Drive) -> None:
        name, entry = drive.name, drive.entry
        self._store.add_drive(name, entry.address, drive.family)
        self._metrics.counters.add_drive(name)
        drive.probe = self._requests.maker.probe(drive.station)
        self._drives.put(drive)
        self._schedule.add_drive(name)
        self._health.begin(drive)
        self._read_cyclically(drive)
        self._supervisor.begin(drive)
        if self._requests.worker.is_open:
            self._health.audits.ask(drive)

    def _leave(self, drive: Drive) -> WatchdogDeadline | None:
        """Send nothing more to a drive; gives how far the feeding of its watchdog was."""
        name = drive.name
        self._health.audits.withdraw(drive)
        reason = f"{name} {TAKEN_OUT}"
        feed = self._schedule.remove_drive(name, self._clock(), reason)
        self._drives.take_out(drive)
        drive.control_word.forget()
        for code in drive.cyclic:  # the schedule has forgotten them already
            self._store.expect(name, code, None)
        drive.cyclic.clear()
        return feed

    def _read_cyclically(self, drive: Drive) -> None:
        """Read of a drive what its entry says from now on, and nothing else.

        Schedule, store and metrics must agree on these codes. Only what differs is exchanged: reads
        that stayed keep their place in the cadence, and values known keep standing.
        """
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
                running[code] = self._schedule.add_cyclic(cyclic, self._clock())
        self._metrics.rolling_window.expect(entry.name, tuple(wanted))

    def _station(self, entry: DriveEntry) -> Station:
        kind = family(entry.family)
        return Station(
            entry.name,
            entry.address,
            kind,
            entry.forms,
            hold_s=kind.hold_after_write_s,
            answer_time_s=entry.answer_time_s,
            measured=MeasuredTimes(self._requests.maker.timing.adapter_latency_s),
        )
