"""Everything that users can ask of the drives of one line, in one object.

Each change leaves a log event when it has ended (`actions`); what only reads leaves none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from decimal import Decimal
from typing import Final

from lecombus.drive_state.store import Quality, Store
from lecombus.drives import StopAction, Verb
from lecombus.line_events import LineRequests
from lecombus.operations.actions import SECRET, Actions
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.context import OperationContext
from lecombus.operations.findings import WhyReport
from lecombus.operations.group_writes import GroupWrites
from lecombus.operations.identities import Identities, IdentityReport
from lecombus.operations.operation_reports import GroupReport, TimesReport, VerbReport, WriteReport
from lecombus.operations.readdress import Readdress
from lecombus.operations.reads import Reads
from lecombus.operations.stop_requests import Stops
from lecombus.operations.verb_operations import Verbs
from lecombus.operations.writes import Writes
from lecombus.parameters import Code
from lecombus.saved_state import State
from lecombus.schedule import Priority

__all__ = ["Operations"]


class Operations:
    """The operations of one line. What only reads is a method of the object that carries it out.

    Args:
        requests: Sends requests.
        store: The last values and states of the drives.
        state: What outlives the daemon.
        line: Has drives audited, and uses other answer times for them.
        clock: Monotonic time, seconds.
        wall: The time of day, Unix seconds.
        follow: Makes the line speak to a drive at another address.
        disturbances: How often the line has carried something that was no answer.

    Attributes:
        actions: Logs each change.
        identities: Who the drives are.
        leases: Who may control them.
        readdressing: Changes their addresses.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        state: State,
        line: LineRequests,
        clock: Callable[[], float],
        wall: Callable[[], float],
        *,
        follow: Callable[[str, int], None],
        disturbances: Callable[[], int],
    ) -> None:
        self.actions = Actions(clock)
        self.identities = Identities(state, store, wall, requests.drives, line)
        self.context = context = OperationContext(
            requests, store, state, line, clock, wall, disturbances
        )
        self.leases = context.leases
        self.readdressing = Readdress(
            requests, store, state, self.identities, self.leases, clock, wall, follow
        )
        reads, self._writes = Reads(context), Writes(context)
        self._stops = Stops(context, self._writes)
        self._groups = GroupWrites(context, self._writes)
        self._verbs = Verbs(context, self._writes, self._stops)
        self.set_roster: Final = context.set_roster
        self.is_command: Final = context.kinds.is_command
        self.close: Final = context.permissions.close
        self.read: Final = reads.read
        self.read_address: Final = reads.read_address
        self.restore_rights: Final = self._writes.restore_rights
        self.groups: Final = self._groups.groups
        self.identity: Final = self.identities.report
        self.wear: Final = context.wear.report

    async def why(
        self, drive: str, *, fresh: bool = False, priority: Priority = Priority.INTERACTIVE
    ) -> WhyReport:
        """Say why a drive does not turn.

        Args:
            drive: The drive.
            fresh: Read the few codes that matter first.
            priority: The class in which they are read.

        Raises:
            OperationError: No such drive.
        """
        self.context.station(drive)
        return await self.context.why.why(drive, fresh=fresh, priority=priority)

    async def write(
        self,
        drive: str,
        code: Code,
        value: Decimal | int | str,
        *,
        expires_s: float | None = None,
        verify: bool = False,
        urgency: Priority | None = None,
        restoring: bool = False,
        unless_stopped_since: str | None = None,
    ) -> WriteReport:
        """Write a code of a drive (`Writes.write`)."""
        said = {"code": str(code), "value": self._shown(drive, code, value)}
        if restoring:
            said["restore"] = "yes"
        return await self.actions.log_end(
            "write", drive, said,
            lambda waited_s: self._writes.write(
                drive, code, value, expires_s=left(expires_s, waited_s), verify=verify,
                urgency=urgency, restoring=restoring, unless_stopped_since=unless_stopped_since,
            ),
            old=self._old(drive, code), is_stop=self._means_stop(drive, code, value),
            is_setting=self._is_setting(drive, code, value),
        )  # fmt: skip

    async def write_group(
        self,
        group: str,
        code: Code,
        value: Decimal | int | str,
        *,
        expires_s: float | None = None,
        verify: bool | None = None,
    ) -> GroupReport:
        """Write a code of every member of a group (`GroupWrites.write_group`)."""
        said = {"code": str(code), "value": self._shown(group, code, value)}
        return await self.actions.log_end(
            "group-write", group, said,
            lambda waited_s: self._groups.write_group(
                group, code, value, expires_s=left(expires_s, waited_s), verify=verify
            ),
            old=self._old(group, code), is_stop=self._means_stop(group, code, value),
            is_setting=self._is_setting(group, code, value),
        )  # fmt: skip

    async def stop(self, action: StopAction, target: str) -> GroupReport:
        """Stop a drive, a group or all, ahead of everything else (`Stops.stop`)."""
        return await self.actions.log_end(
            "stop", target, {"action": action.value},
            lambda _: self._stops.stop(action, target), is_stop=True,
        )  # fmt: skip

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
        """Enable, inhibit, quick-stop, set the speed or reset the fault of a drive (`Verbs`)."""
        is_stop = verb in (Verb.INHIBIT, Verb.QUICK_STOP)
        said = {"action" if is_stop else "verb": verb.value}
        if value is not None:
            said["value"] = f"{value}{unit}"
        return await self.actions.log_end(
            "stop" if is_stop else "verb", drive, said,
            lambda waited_s: self._verbs.verb(
                drive, verb, value=value, unit=unit, expires_s=left(expires_s, waited_s),
                verify=verify,
            ),
            is_stop=is_stop,
        )  # fmt: skip

    async def readdress(self, drive: str, address: int) -> WriteReport:
        """Give a drive another address and follow it there (`Readdress.change`)."""
        return await self.actions.log_end(
            "readdress-asked", drive, {"value": str(address)},
            lambda _: self.readdressing.change(drive, address),
        )  # fmt: skip

    def accept(self, drive: str, shown: Mapping[str, str]) -> IdentityReport:
        """Take the drive that is there for the drive of this name (`Identities.accept`).

        Args:
            drive: The drive.
            shown: Its identity as the user has seen it.

        Raises:
            OperationError: No such drive, nothing known of it yet, or it is not what was shown.
        """
        with self.actions.logged("accept", drive):
            return self.identities.accept(drive, shown)

    def forget_times(self, drive: str) -> TimesReport:
        """Drop the measured answer times of a drive: those of manual and roster count then.

        Raises:
            OperationError: `no-such-drive`.
        """
        with self.actions.logged("forget-times", drive):
            found = self.context.requests.drives.get(drive)
            rows = tuple(row for row in found.station.measured.rows() if row.slow)
            found.station.measured.forget()
            self.context.line.use_answer_times(found)
            return TimesReport(drive, rows)

    def _shown(self, target: str, code: Code, value: Decimal | int | str) -> str:
        if self.context.kinds.is_secret(target, code):
            return SECRET
        return self.context.kinds.on_the_wire(target, code, value)

    def _means_stop(self, target: str, code: Code, value: Decimal | int | str) -> bool:
        """Whether a plain write is a stop, which no follower of operations may delay."""
        return bool(self.actions.followers) and self.context.kinds.is_stop(target, code, value)

    def _is_setting(self, target: str, code: Code, value: Decimal | int | str) -> bool:
        """Whether a write changes settings only, which is carried out while a journal fails."""
        return bool(self.actions.followers) and self.context.kinds.is_setting(target, code, value)

    def _old(self, target: str, code: Code) -> str:
        """Return what a drive, or each of a group, was last read to hold, as on the wire."""
        if not self.actions.followers or self.context.kinds.is_secret(target, code):
            return ""
        found = {
            name: reading.value.raw
            for name in self.context.drive_names(target)
            if name in self.context.entries
            and (reading := self.context.store.reading(name, code)) is not None
            and reading.value is not None
            and reading.quality is not Quality.BAD  # it may have been written since
        }
        return (
            ",".join(f"{name}:{raw}" for name, raw in found.items())
            if target in self.context.groups
            else found.get(target, "")
        )


def left(expires_s: float | None, waited_s: float) -> float | None:
    """Return the time that is left for a write that has waited, seconds."""
    return None if expires_s is None else expires_s - waited_s
