"""Looking after drives: who one is, another in its place, wear, address, measured answer times.

One place for the faces to ask.

What must not live here: how any of it is done.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from lecombus.drive_runtime import Drive, LineDrives
from lecombus.drives.measured import AnswerRow
from lecombus.operations.identities import Identities, IdentityReport
from lecombus.operations.readdress import Readdress
from lecombus.operations.reports import WriteReport
from lecombus.operations.wear import Wear, WearReport
from lecombus.readings import Json, seconds

__all__ = ["Maintenance", "TimesReport"]


@dataclass(frozen=True, slots=True)
class TimesReport:
    """What was forgotten of a drive's answer times.

    Args:
        drive: The drive.
        forgotten: What was reckoned with, the slowest first.
    """

    drive: str
    forgotten: tuple[AnswerRow, ...]

    def as_json(self) -> dict[str, Json]:
        """Give the document."""
        return {
            "drive": self.drive,
            "forgotten": [
                {
                    "code": str(row.code),
                    "write": row.write,
                    "manual_s": seconds(row.manual_s),
                    "measured_s": seconds(row.measured_s),
                }
                for row in self.forgotten
            ],
        }


class Maintenance:
    """What looking after the drives of one line takes.

    Args:
        identities: Who they are.
        wear: How often their memories were written.
        readdress: Changes their addresses.
        drives: The drives.
        times_changed: Told of a drive whose measured times are others now.
    """

    def __init__(
        self,
        identities: Identities,
        wear: Wear,
        readdress: Readdress,
        drives: LineDrives,
        times_changed: Callable[[Drive], None],
    ) -> None:
        self._identities = identities
        self._wear = wear
        self._readdress = readdress
        self._drives = drives
        self._times_changed = times_changed

    async def readdress(self, drive: str, address: int) -> WriteReport:
        """Give a drive another address and follow it there (see `Readdress.change`)."""
        return await self._readdress.change(drive, address)

    def forget_times(self, drive: str) -> TimesReport:
        """Reckon with what manual and roster tell of a drive, until it is measured anew.

        Raises:
            OperationError: `no-such-drive`.
        """
        found = self._drives.get(drive)
        rows = tuple(row for row in found.station.measured.rows() if row.slow)
        found.station.measured.forget()
        self._times_changed(found)
        return TimesReport(drive, rows)

    def wear(self, drive: str) -> WearReport:
        """Return how often a drive's memory was written.

        Raises:
            OperationError: `no-such-drive`.
        """
        return self._wear.report(drive)

    def identity(self, drive: str) -> IdentityReport:
        """Return who a drive is.

        Raises:
            OperationError: `no-such-drive`.
        """
        return self._identities.report(drive)

    def accept(self, drive: str, shown: Mapping[str, str]) -> IdentityReport:
        """Take the drive that is there for the drive of this name.

        Args:
            drive: The drive.
            shown: Its identity as whoever accepts it has seen it.

        Raises:
            OperationError: No such drive, nothing known of it yet, or it is not what was shown.
        """
        return self._identities.accept(drive, shown)
