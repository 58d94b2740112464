"""The operations as the API and the daemon call them: with a log event for each change.

What only reads is handed on. `actions` limits how often an event is logged.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from decimal import Decimal
from typing import Any, Final, TypeVar

from lecombus.drives import StopAction, Verb
from lecombus.errors import LecombusError
from lecombus.operations.actions import Actions
from lecombus.operations.facade import Operations
from lecombus.operations.identities import IdentityReport
from lecombus.operations.maintenance import Maintenance, TimesReport
from lecombus.operations.reports import (
    GroupReport,
    VerbReport,
    WriteReport,
)
from lecombus.operations.wear import WearReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome

__all__ = ["RecordedMaintenance", "RecordedOperations"]

GOOD: Final = (Outcome.DONE, Outcome.VERIFIED)

SECRET: Final = "***"

T = TypeVar("T")
R = TypeVar("R", WriteReport, VerbReport, GroupReport)


class RecordedOperations:
    """Operations, each write of which leaves an event.

    Args:
        operations: What does it.
        actions: Logs it.
        is_secret: Whether the value of a code of a drive or group is a password.
    """

    def __init__(
        self,
        operations: Operations,
        actions: Actions,
        is_secret: Callable[[str, Code], bool],
    ) -> None:
        self._operations = operations
        self._actions = actions
        self._is_secret = is_secret
        self.read: Final = operations.read
        self.read_address: Final = operations.read_address
        self.restore_rights: Final = operations.restore_rights
        self.why: Final = operations.why
        self.groups: Final = operations.groups

    async def write(
        self, drive: str, code: Code, value: Decimal | int | str, **how: Any
    ) -> WriteReport:
        """Write a code and return how that ended."""
        said = {"code": str(code), "value": self._shown(drive, code, value)}
        if how.get("restoring"):
            said["restore"] = "yes"
        work = self._operations.write(drive, code, value, **how)
        return await recorded(self._actions, "write", drive, said, work)

    async def write_group(
        self, group: str, code: Code, value: Decimal | int | str, **how: Any
    ) -> GroupReport:
        """Write a code of every member of a group."""
        said = {"code": str(code), "value": self._shown(group, code, value)}
        work = self._operations.write_group(group, code, value, **how)
        return await recorded(self._actions, "group-write", group, said, work)

    async def stop(self, action: StopAction, target: str) -> GroupReport:
        """Stop a drive, a group or all; what is logged of it is logged afterwards."""
        work = self._operations.stop(action, target)
        return await recorded(self._actions, "stop", target, {"action": action.value}, work)

    async def verb(self, drive: str, verb: Verb, **how: Any) -> VerbReport:
        """Have a drive do something and return what came of it."""
        is_stop = verb in (Verb.INHIBIT, Verb.QUICK_STOP)
        said = {"action" if is_stop else "verb": verb.value}
        if how.get("value") is not None:
            said["value"] = f"{how['value']}{how.get('unit', '')}"
        work = self._operations.verb(drive, verb, **how)
        return await recorded(self._actions, "stop" if is_stop else "verb", drive, said, work)

    def _shown(self, target: str, code: Code, value: Decimal | int | str) -> str:
        return SECRET if self._is_secret(target, code) else str(value)


class RecordedMaintenance:
    """Maintenance, each change of which leaves an event.

    Args:
        maintenance: What does it.
        actions: Logs it.
    """

    def __init__(self, maintenance: Maintenance, actions: Actions) -> None:
        self._maintenance = maintenance
        self._actions = actions

    def identity(self, drive: str) -> IdentityReport:
        """Return who a drive is."""
        return self._maintenance.identity(drive)

    def wear(self, drive: str) -> WearReport:
        """Return how often a drive's memory was written."""
        return self._maintenance.wear(drive)

    async def readdress(self, drive: str, address: int) -> WriteReport:
        """Give a drive another address and follow it there."""
        work = self._maintenance.readdress(drive, address)
        return await recorded(
            self._actions, "readdress-asked", drive, {"value": str(address)}, work
        )

    def accept(self, drive: str, shown: Mapping[str, str]) -> IdentityReport:
        """Take the drive that is there for the drive of this name."""
        return self._at_once("accept", drive, lambda: self._maintenance.accept(drive, shown))

    def forget_times(self, drive: str) -> TimesReport:
        """Forget how long a drive was measured to think."""
        return self._at_once("forget-times", drive, lambda: self._maintenance.forget_times(drive))

    def _at_once(self, event: str, drive: str, act: Callable[[], T]) -> T:
        try:
            done = act()
        except LecombusError as exc:
            self._actions.log(event, drive, Outcome.REFUSED.value, {"reason": str(exc)})
            raise
        self._actions.log(event, drive, Outcome.DONE.value, {})
        return done


async def recorded(
    actions: Actions, event: str, target: str, said: Mapping[str, str], work: Awaitable[R]
) -> R:
    """Wait for something's end and log it; being cancelled leaves its outcome unknown."""
    outcome, more = Outcome.UNKNOWN.value, dict(said)
    try:
        report = await work
        outcome = report.outcome.value
        more |= details(report)
        return report
    except LecombusError as exc:
        outcome, more["reason"] = Outcome.REFUSED.value, str(exc)
        raise
    finally:
        if more.get("value") == SECRET:
            more.pop("reason", None)  # it may quote the value
        actions.log(event, target, outcome, more)


def details(report: WriteReport | VerbReport | GroupReport) -> dict[str, str]:
    """Return what an ending has besides its outcome."""
    found: dict[str, str] = {}
    if isinstance(report, VerbReport) and report.written:
        found["written"] = ",".join(f"{code}:{raw}" for code, raw in report.written)
    if isinstance(report, GroupReport):
        found["how"] = report.how
        found["not_done"] = named(one for one in report.members if one.outcome not in GOOD)
    if report.outcome not in GOOD:
        found["reason"] = report.reason
    return found


def named(members: Iterable[WriteReport]) -> str:
    """Return members with their outcomes."""
    return ",".join(f"{one.drive}:{one.outcome.value}" for one in members)
