"""Carries out what those that follow the line's events ask of it (`line_events.LineRequests`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from lecombus.drive_runtime import Drive
from lecombus.drives import Family
from lecombus.operations.requests import Requests
from lecombus.parameters import Code
from lecombus.schedule import Priority, Settle
from lecombus.store import Store
from lecombus.supervision.audit_queue import AuditQueue
from lecombus.supervision.health import Health

__all__ = ["RequestsToLine"]

ASKED_FOR_S = 10.0
"""What an event calls for is not read any more after this: its own turn has come by then."""


class RequestsToLine:
    """Asks the line, the drive supervisor and the store.

    Args:
        requests: Sends requests.
        store: Keeps which family a drive is.
        audits: Takes audits.
        health: Takes doubts about drives.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        audits: AuditQueue,
        health: Health,
        clock: Callable[[], float],
    ) -> None:
        self._requests = requests
        self._store = store
        self._audits = audits
        self._health = health
        self._clock = clock

    def read_soon(self, drive: Drive, code: Code, settle: Settle) -> None:
        """Read a code before the cyclic ones, without waiting for it here."""
        requests = self._requests
        station = requests.station(drive.name)
        requests.worker.submit(
            requests.maker.read(
                station, code, Priority.INTERACTIVE, settle=settle,
                expires_at_s=self._clock() + ASKED_FOR_S,
            )
        )  # fmt: skip

    def read_later(self, drive: Drive, code: Code, settle: Settle) -> None:
        """Read a code when the line has time for it."""
        requests = self._requests
        station = requests.station(drive.name)
        requests.worker.submit(
            requests.maker.read(station, code, Priority.BACKGROUND, settle=settle)
        )

    def audit_soon(self, drive: Drive) -> None:
        """Audit a drive; one under audit is audited once more after that."""
        self._audits.ask(drive)

    def doubt(self, drive: Drive, reason: str) -> None:
        """Write nothing but stops to a drive until it was audited again."""
        self._health.doubted(drive, reason)

    def use_family(self, drive: Drive, family: Family) -> None:
        """Use another description of its family: the drive's words mean something else."""
        self._store.take_family(drive.name, family)
        drive.station = replace(drive.station, family=family)

    def use_early_answers(self, drive: Drive, early: bool | None) -> None:
        """Leave a drive alone after a write if it acknowledges early, or may (None)."""
        station = drive.station
        hold_s = 0.0 if early is False else station.family.hold_after_write_s
        if (station.hold_s, station.answers_early) != (hold_s, early is True):
            drive.station = replace(station, hold_s=hold_s, answers_early=early is True)
