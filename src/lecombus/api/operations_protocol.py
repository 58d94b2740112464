"""The operations that the HTTP API calls, as protocols.

Implemented by `operations.recorded`, put together by `operations.facade`. The API calls nothing
else of schedule, worker and supervision, so it can be tested with fake operations. It also uses
`Store`, `Metrics`, `operations.requests` and `operations.actions`. Errors come as `LecombusError`;
`problems` decides which answer each becomes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Protocol

from lecombus.drives import StopAction, Verb
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.operations.address_reads import Heard
from lecombus.operations.findings import WhyReport
from lecombus.operations.identities import IdentityReport
from lecombus.operations.maintenance import TimesReport
from lecombus.operations.reports import (
    GroupInfo,
    GroupReport,
    RestoreRights,
    VerbReport,
    WriteReport,
)
from lecombus.operations.wear import WearReport
from lecombus.parameters import Code
from lecombus.schedule.request import Priority
from lecombus.store import Reading

__all__ = [
    "GroupInfo",
    "GroupReport",
    "MaintenanceProtocol",
    "OperationsProtocol",
    "Reading",
    "RestoreRights",
    "StopAction",
    "VerbReport",
    "WriteReport",
]


class MaintenanceProtocol(Protocol):
    """Identities, counts of writes, addresses and measured times of drives."""

    def identity(self, drive: str) -> IdentityReport:
        """Return a drive's identity.

        Raises:
            OperationError: No such drive.
        """

    def wear(self, drive: str) -> WearReport:
        """Return how often a drive's memory was written.

        Raises:
            OperationError: No such drive.
        """

    async def readdress(self, drive: str, address: int) -> WriteReport:
        """Give a drive another address and follow it there.

        Raises:
            LineError, ExchangeError, ScheduleError, OperationError: Nothing was changed.
        """

    def forget_times(self, drive: str) -> TimesReport:
        """Forget how long a drive was measured to think.

        Raises:
            OperationError: No such drive.
        """

    def accept(self, drive: str, shown: Mapping[str, str]) -> IdentityReport:
        """Take the drive that is there for the drive of this name.

        Raises:
            OperationError: No such drive, or it is not what was shown.
        """


class OperationsProtocol(Protocol):
    """Everything a client can have done on the line."""

    async def read(
        self,
        drive: str,
        code: Code,
        *,
        priority: Priority = Priority.INTERACTIVE,
        timeout_s: float = 10.0,
    ) -> Reading:
        """Read a code now.

        Raises:
            ExchangeError, LineError, ScheduleError, OperationError: There is no value.
        """

    async def write(
        self,
        drive: str,
        code: Code,
        value: Decimal | int | str,
        *,
        expires_s: float | None,
        verify: bool,
        urgency: Priority | None = None,
        restoring: bool = False,
        unless_stopped_since: str | None = None,
    ) -> WriteReport:
        """Write a code and return how that ended.

        Raises:
            LineError, ScheduleError, OperationError, CodeValueError: Nothing was sent.
        """

    async def write_group(
        self,
        group: str,
        code: Code,
        value: Decimal | int | str,
        *,
        expires_s: float | None,
        verify: bool | None,
    ) -> GroupReport:
        """Write a code of every member of a group.

        Raises:
            LineError, ScheduleError, OperationError, CodeValueError: Nothing was sent.
        """

    def restore_rights(self, drive: str) -> RestoreRights:
        """Say whether a backup may be restored into a drive.

        Raises:
            OperationError: There is no such drive.
        """

    async def read_address(
        self, address: int, code: Code, *, form: Form, family_name: str, patient: bool
    ) -> Heard:
        """Read a code at an address that the roster does not have, once.

        Raises:
            ExchangeError, LineError, ScheduleError, OperationError: Nothing was asked.
        """

    async def stop(self, action: StopAction, target: str) -> GroupReport:
        """Stop a drive, a group or `all`, before everything else.

        Raises:
            LineError, OperationError: Nothing was sent.
        """

    async def verb(
        self,
        drive: str,
        verb: Verb,
        *,
        value: Decimal | None = None,
        unit: str = "",
        expires_s: float | None = None,
        verify: bool = False,
    ) -> VerbReport:
        """Carry out a verb and return how it ended.

        Raises:
            LineError, ScheduleError, OperationError, ExchangeError: Nothing was written.
        """

    async def why(self, drive: str, *, fresh: bool = False) -> WhyReport:
        """Say why a drive does not turn; `fresh`: read the few codes that matter first.

        Raises:
            OperationError: No such drive.
        """

    def groups(self) -> Sequence[GroupInfo]:
        """Return the groups of the roster."""
