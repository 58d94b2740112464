"""Carries out what those that follow the line's events ask of it (`line_events.LineRequests`)."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from lecombus.drive_state.drive_runtime import Drive
from lecombus.drive_state.store import Store
from lecombus.drives import Family
from lecombus.drives.measured import AnswerRow
from lecombus.operations.awaited_requests import Requests
from lecombus.parameters import Code
from lecombus.schedule import Priority, Settle
from lecombus.supervision.health import Health

__all__ = ["RequestsToLine"]

logger = logging.getLogger(__name__)

ASKED_FOR_S = 10.0
"""What an event calls for is not read any more after this: its own turn has come by then."""

SLOW_REMARK: Final = "answer-time"
SHOWN: Final = 3
"""Codes named in a remark; all stand in `lecombus plan --from-daemon`."""


class RequestsToLine:
    """Asks the line, the drive supervisor and the store.

    Args:
        requests: Sends requests.
        store: Keeps which family a drive is.
        clock: Monotonic time, seconds.

    Attributes:
        health: Takes audits and doubts about drives.
    """

    def __init__(self, requests: Requests, store: Store, clock: Callable[[], float]) -> None:
        self.health = Health(requests.drives, requests.worker.schedule, store, clock)
        self._requests = requests
        self._store = store
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
        self.health.audits.ask(drive)

    def doubt(self, drive: Drive, reason: str) -> None:
        """Write nothing but stops to a drive until it was audited again."""
        self.health.doubted(drive, reason)

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

    def use_answer_times(self, drive: Drive) -> None:
        """Use the answer times that a drive was measured with, where they are others now."""
        slow = drive.station.measured.slow
        if drive.answer_times.seen is not slow:
            drive.answer_times.seen = slow
            self._requests.worker.schedule.costs_changed(drive.name)
            remark_answer_times(drive, self._store)


def remark_answer_times(drive: Drive, store: Store) -> None:
    """Remark that a drive answers slower than its manual says, and log it once."""
    rows = [row for row in drive.station.measured.rows() if row.slow]
    if not rows:
        store.note(drive.name, SLOW_REMARK, None)
        return
    late = [_words(drive, row) for row in rows[:SHOWN]]
    text = (
        f"answers later than its manual says ({', '.join(late)}"
        f"{', ..' if len(rows) > SHOWN else ''}); its time-outs are widened: give its "
        "answer_time in the roster, look at what delays it, or, if that is past, "
        f"`lecombus forget-times {drive.name}`"
    )
    store.note(drive.name, SLOW_REMARK, text)
    if not drive.answer_times.logged:
        drive.answer_times.logged = True
        logger.warning(
            "drive=%s event=slow-drive code=%s measured_s=%.3f manual_s=%.3f",
            drive.name, rows[0].code, rows[0].measured_s, rows[0].manual_s,
        )  # fmt: skip


def _words(drive: Drive, row: AnswerRow) -> str:
    code = drive.station.family.spoken(row.code)
    what = f"{code} written" if row.write else code
    return f"{what} after {row.measured_s * 1000:.0f} ms instead of {row.manual_s * 1000:.0f} ms"
