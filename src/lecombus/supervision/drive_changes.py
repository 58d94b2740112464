"""Adding, changing and removing drives of a running line: who must know it, in which order.

One place for all of it, at the start, at a reload and when a drive is followed to another address.
A drive whose entry is the same is not touched. A drive that is only used otherwise (other codes are
read, other writes allowed) keeps all that is known of it. Any other change makes it start again,
because another device may answer from now on; its values stay while address and family do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lecombus.config import DriveEntry
from lecombus.drive_runtime import Drive
from lecombus.drives import family
from lecombus.drives.measured import MeasuredTimes
from lecombus.fieldbus.station import Station
from lecombus.metrics import Metrics
from lecombus.operations.requests import Requests
from lecombus.schedule import Schedule, WatchdogDeadline
from lecombus.store import Store
from lecombus.supervision.audit_queue import AuditQueue
from lecombus.supervision.cyclic_reads import CyclicReads
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
        schedule: Who is sent to when.
        store: Their values and states.
        metrics: Their counters.
        health: How they are doing.
        audits: Takes drives that are to be audited.
        supervisor: Has their watchdogs fed.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self,
        requests: Requests,
        schedule: Schedule,
        store: Store,
        metrics: Metrics,
        health: Health,
        audits: AuditQueue,
        supervisor: DriveSupervisor,
        clock: Callable[[], float],
    ) -> None:
        self._requests = requests
        self._drives = requests.drives
        self._schedule = schedule
        self._store = store
        self._metrics = metrics
        self._health = health
        self._audits = audits
        self._supervisor = supervisor
        self._clock = clock
        self._reads = CyclicReads(requests, schedule, store, metrics.rolling_window)

    def apply(self, entries: Sequence[DriveEntry]) -> None:
        """Make the line's drives those of a roster.

        Drives leave before others come, because these may have their addresses.
        """
        wanted = {entry.name: entry for entry in entries}
        left: dict[str, _Left] = {}
        for drive in tuple(self._drives):
            entry = wanted.get(drive.name)
            if entry is None:
                self.remove(drive)
            elif drive.entry.asks_for_audit(entry):
                left[drive.name] = _Left(drive, drive.entry, self._leave(drive))
            elif entry != drive.entry:
                self.change_use(drive, entry)
        for entry in entries:
            if entry.name in left:
                self._begin_again(left[entry.name], entry)
            elif self._drives.find(entry.name) is None:
                self.add(entry)

    def add(self, entry: DriveEntry) -> None:
        """Add a drive."""
        lasting = self._drives.lasting(entry.name)
        self._join(Drive(entry, self._station(entry), self._clock, lasting))

    def change_use(self, drive: Drive, entry: DriveEntry) -> None:
        """Read other codes of a drive, or allow other things; it stays the drive it is."""
        drive.entry = entry
        self._reads.take(drive, self._clock())

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
        self._reads.take(drive, self._clock())
        self._supervisor.begin(drive)
        if self._requests.worker.is_open:
            self._audits.ask(drive)

    def _leave(self, drive: Drive) -> WatchdogDeadline | None:
        """Send nothing more to a drive; gives how far the feeding of its watchdog was."""
        name = drive.name
        self._audits.withdraw(drive)
        reason = f"{name} was taken out of the roster"
        feed = self._schedule.remove_drive(name, self._clock(), reason)
        self._drives.take_out(drive)
        drive.control_word.forget()
        self._reads.forget(drive)
        return feed

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
