"""Everything that users can ask of the drives of one line, in one object."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from lecombus.operations.context import OperationContext
from lecombus.operations.findings import WhyReport
from lecombus.operations.group_writes import GroupWrites
from lecombus.operations.reads import Reads
from lecombus.operations.stop_requests import Stops
from lecombus.operations.verb_operations import Verbs
from lecombus.operations.verb_steps import VerbSteps
from lecombus.operations.writes import Writes

__all__ = ["Operations"]


class Operations:
    """The operations of one line; each attribute is a method of the object that carries it out.

    Args:
        context: What the operations share.
        restarted: Called with a drive that was made to restart; it is then audited.
    """

    def __init__(self, context: OperationContext, restarted: Callable[[str], None]) -> None:
        self.context = context
        reads, writes = Reads(context), Writes(context)
        stops = Stops(context, writes)
        groups = GroupWrites(context, writes)
        steps = VerbSteps(context, writes, stops, restarted)
        self.set_roster: Final = context.set_roster
        self.close: Final = context.permissions.close
        self.read: Final = reads.read
        self.read_address: Final = reads.read_address
        self.write: Final = writes.write
        self.restore_rights: Final = writes.restore_rights
        self.stop: Final = stops.stop
        self.groups: Final = groups.groups
        self.write_group: Final = groups.write_group
        self.verb: Final = Verbs(context, stops, steps).verb

    async def why(self, drive: str, *, fresh: bool = False) -> WhyReport:
        """Say why a drive does not turn; `fresh`: after reading the few codes that matter.

        Raises:
            OperationError: No such drive.
        """
        self.context.station(drive)
        return await self.context.why.why(drive, fresh=fresh)
