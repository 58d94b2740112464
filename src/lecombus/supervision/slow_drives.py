"""Saying which drives answer slower than their manual: once in the log, and as a remark.

Strategy: the line measures and widens its time-outs by itself; once a second it is looked here
whether that has changed for a drive, so that the path behind an exchange says nothing.

What must not live here: when a drive is slow, and by how much (`drives.measured`).
"""

from __future__ import annotations

import logging
from collections.abc import Iterable

from lecombus.drive_runtime import Drive
from lecombus.drives.measured import AnswerRow
from lecombus.schedule import Schedule
from lecombus.store import Store

__all__ = ["SlowDrives"]

logger = logging.getLogger(__name__)

KEY = "answer-time"
SHOWN = 3
"""Codes named in a remark; all stand in `lecombus plan --from-daemon`."""


class SlowDrives:
    """Keeps the remarks.

    Args:
        store: Where remarks stand.
        schedule: Calculates the costs of a drive's requests again.
    """

    def __init__(self, store: Store, schedule: Schedule) -> None:
        self._store = store
        self._schedule = schedule

    def look(self, drives: Iterable[Drive]) -> None:
        """Say what has changed."""
        for drive in drives:
            slow = drive.station.measured.slow
            if drive.answer_times.seen is not slow:
                drive.answer_times.seen = slow
                self._schedule.costs_changed(drive.name)
                self._say(drive)

    def _say(self, drive: Drive) -> None:
        station = drive.station
        rows = [row for row in station.measured.rows() if row.slow]
        if not rows:
            self._store.note(station.name, KEY, None)
            return
        text = (
            f"answers later than its manual says ({', '.join(map(_words, rows[:SHOWN]))}"
            f"{', ..' if len(rows) > SHOWN else ''}); its time-outs are widened: give its "
            "answer_time in the roster, look at what delays it, or, if that is past, "
            f"`lecombus forget-times {station.name}`"
        )
        self._store.note(station.name, KEY, text)
        if not drive.answer_times.logged:
            drive.answer_times.logged = True
            logger.warning(
                "drive=%s event=slow-drive code=%s measured_s=%.3f manual_s=%.3f",
                station.name, rows[0].code, rows[0].measured_s, rows[0].manual_s,
            )  # fmt: skip


def _words(row: AnswerRow) -> str:
    what = f"{row.code} written" if row.write else str(row.code)
    return f"{what} after {row.measured_s * 1000:.0f} ms instead of {row.manual_s * 1000:.0f} ms"
