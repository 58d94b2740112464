"""Looking after drives: who one is, what another in its place is, its wear, its address.

One place for the faces to ask.

What must not live here: how any of it is done.
"""

from __future__ import annotations

from collections.abc import Mapping

from lecombus.operations.identities import Identities, IdentityReport
from lecombus.operations.readdress import Readdress
from lecombus.operations.reports import WriteReport
from lecombus.operations.wear import Wear, WearReport

__all__ = ["Custody"]


class Custody:
    """What looking after the drives of one line takes.

    Args:
        identities: Who they are.
        wear: How often their memories were written.
        readdress: Changes their addresses.
    """

    def __init__(self, identities: Identities, wear: Wear, readdress: Readdress) -> None:
        self._identities = identities
        self._wear = wear
        self._readdress = readdress

    async def readdress(self, drive: str, address: int) -> WriteReport:
        """Give a drive another address and follow it there (see `Readdress.change`)."""
        return await self._readdress.change(drive, address)

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
