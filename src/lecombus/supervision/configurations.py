"""Two settings of a drive that change how lecombus treats it.

*Signal configuration.* On a 93XX most bits of C0135 and C0150 mean what the signal configuration
C0005 makes of them. It is read at every audit; until it is known, and whenever it was written and
not yet read again, only what holds for every configuration is used. Once known it is kept while
the drive is away: the audit that brings the drive back reads it again.

*Shortened response time.* With C1921 = 1 a module acknowledges a write before it has passed it
on, and must be left alone until then. Until that is known, and after it was written, lecombus
assumes that it does.

Strategy: as in `fault_watch`, no task and no timer: `seen` gets every value read and `written`
every write, and both cost one look-up where a drive's family has no such codes.
Source: EDB2102EN 8.2 (C0135, C0150), 6.3.2 (C1921).
"""

from __future__ import annotations

import logging

from lecombus.drive_state.drive_runtime import Drive
from lecombus.errors import LecombusError
from lecombus.line_events import ExchangeEvent, LineRequests
from lecombus.parameters import Code, Value
from lecombus.schedule import ignore_end

__all__ = ["Configurations"]

logger = logging.getLogger(__name__)


class Configurations:
    """Follows two codes of each drive.

    Args:
        line: Reads codes, and takes what they say into account.
    """

    def __init__(self, line: LineRequests) -> None:
        self._line = line

    def exchange_ended(self, event: ExchangeEvent) -> None:
        """Take an exchange."""
        if event.is_write:
            for drive in event.drives:
                self.written(drive, event.code)
        elif event.read is not None:
            family = event.drives[0].station.family
            if event.code in (family.configured_by, family.shortened_code):
                self.seen(event.drives[0], event.code, event.read)

    def seen(self, drive: Drive, code: Code, value: Value) -> None:
        """Take a value of a code that configures a drive."""
        self._take(drive, code, value.whole)

    def written(self, drive: Drive, code: Code) -> None:
        """Take a write of a code: whether it took effect is known when it is read."""
        family = drive.family
        if code not in (family.configured_by, family.shortened_code):
            return
        self._take(drive, code, None)
        is_urgent = code == family.configured_by
        ask = self._line.read_soon if is_urgent else self._line.read_later
        try:
            ask(drive, code, ignore_end)
        except LecombusError as exc:
            logger.info("drive=%s event=configuration-not-asked reason=%s", drive.name, exc)

    def _take(self, drive: Drive, code: Code, number: int | None) -> None:
        if code == drive.family.shortened_code:
            self._line.use_early_answers(drive, None if number is None else number == 1)
        else:
            self._take_configuration(drive, number)

    def _take_configuration(self, drive: Drive, number: int | None) -> None:
        known = drive.configuration.family
        found = known.configured(number)
        if found is known:
            return
        drive.configuration.family = found
        logger.info(
            "drive=%s event=configuration code=%s from=%s to=%s",
            drive.name, found.configured_by, known.configuration or "any",
            found.configuration or "any",
        )  # fmt: skip
        self._line.use_family(drive, found)
