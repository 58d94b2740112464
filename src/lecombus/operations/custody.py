"""Looking after drives: one place for the faces to ask who a drive is and to take another for it.

What must not live here: how any of it is done.
"""

from __future__ import annotations

from collections.abc import Mapping

from lecombus.operations.identities import Identities, IdentityReport

__all__ = ["Custody"]


class Custody:
    """What looking after the drives of one line takes.

    Args:
        identities: Who they are.
    """

    def __init__(self, identities: Identities) -> None:
        self._identities = identities

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
