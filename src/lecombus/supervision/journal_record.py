"""What stands in the journal: operations with their ends, trips, losses, starts, rosters.

Strategy: one follower of operations (`actions`) and one subscriber of the store; nothing else in
the program writes to the journal, so its rows are made in one place. An operation other than a stop
waits until its intent is on the disk: the line goes on with other requests in that time. While
the journal fails, one that controls a drive is refused, or goes on where the roster says
`on_failure: go-on`; settings go on. Stops are recorded behind the telegram and never refused.
"""

from __future__ import annotations

from collections.abc import Awaitable, Mapping, Sequence
from typing import Final

import anyio.to_thread

from lecombus.config import Roster, RosterError, roster_values, value_changes
from lecombus.drive_state.readings import ActiveFault, DriveState, LineState
from lecombus.drive_state.store import DriveChanged, Event, LineChanged, Store
from lecombus.errors import OperationError
from lecombus.journal.chain import Row
from lecombus.journal.journal import Journal
from lecombus.journal.journal_file import JournalFileError
from lecombus.journal.kept import NOT_KNOWN, Fact
from lecombus.operations.actions import ACTOR, Act
from lecombus.operations.facade import Operations

__all__ = ["JournalRecord"]

LONGEST: Final = 300
"""Characters of one field: a client chose some of them."""

CHANGES_MOST: Final = 200
"""Values of a roster's changes that one row names."""

ROSTER: Final = "roster"


class JournalRecord:
    """Records what is done to drives, and what happens to them.

    Args:
        journal: The journal.
        store: What is known; gets the changes of states and faults from there.
        refuses: Whether operations are refused while the journal fails, all but stops and settings.
    """

    def __init__(self, journal: Journal, store: Store, *, refuses: bool) -> None:
        self._journal = journal
        self._store = store
        self._refuses = refuses
        self._under_way: dict[Act, Row] = {}
        self._states: dict[str, DriveState] = {}
        self._faults: dict[str, ActiveFault] = {}
        self._line = store.line().state

    def follow(self, operations: Operations) -> None:
        """Record what is done by operations, and what happens to their drives, from now on."""
        operations.actions.followers += (self,)
        operations.leases.followers += (self.lease_changed,)
        self._store.subscribe(self.store_changed)

    # ---- operations --------------------------------------------------------------------------

    def begun(self, act: Act) -> Awaitable[None] | None:
        """Record that an operation was asked for (`ActionFollower`)."""
        fields = {**act.said, "old": act.old, **act.actor.fields()}
        intent = self._under_way[act] = self._journal.intend(
            act.event, act.target[:LONGEST], cut(fields), is_vital=act.is_stop
        )
        return None if act.is_stop else self._on_disk(intent, act)

    def ended(self, act: Act, outcome: str, fields: Mapping[str, str]) -> None:
        """Record the end of an operation (`ActionFollower`)."""
        intent = self._under_way.pop(act, None)
        if intent is None:
            whole = {**fields, **act.actor.fields()}
            self._journal.record(act.event, act.target[:LONGEST], cut(whole), outcome=outcome)
            return
        more = {key: text for key, text in fields.items() if act.said.get(key) != text}
        self._journal.conclude(intent, outcome, cut(more))

    async def _on_disk(self, intent: Row, act: Act) -> None:
        try:
            if (why := NOT_KNOWN.get()) and self._refuses and not act.is_setting:
                raise JournalFileError(why)
            await self._journal.committed(intent)
        except JournalFileError as exc:
            if act.is_setting or not self._refuses:
                return
            self._journal.withdraw(intent)
            raise OperationError(
                f"the journal cannot record it ({exc}): nothing was sent",
                kind="journal-failing",
                drive=act.target,
                remedy="see to the journal's disk; stops are always sent, and `on_failure: go-on` "
                "in the roster lets writes go on without the journal",
            ) from exc

    def lease_changed(self, what: str, drives: Sequence[str], fields: Mapping[str, str]) -> None:
        """Record what became of a lease, for each of its drives (`LeaseFollower`)."""
        for drive in drives:
            self._journal.record(f"lease-{what}", drive, cut(fields))

    # ---- drives and the line -----------------------------------------------------------------

    def store_changed(self, event: Event) -> None:
        """Take a change of the store: losses, trips and their ends are recorded."""
        if isinstance(event, DriveChanged):
            if event.drive in self._store.names():
                self._drive_changed(event.drive)
            else:
                self._states.pop(event.drive, None)
                self._faults.pop(event.drive, None)
        elif isinstance(event, LineChanged):
            self._line_changed()

    def _drive_changed(self, name: str) -> None:
        drive = self._store.drive(name)
        before, self._states[name] = self._states.get(name), drive.state
        is_away, was_away = (one is DriveState.OFFLINE for one in (drive.state, before))
        if is_away and not was_away:
            self._journal.record("drive-lost", name, {"reason": drive.reason})
        elif was_away and not is_away:
            self._journal.record("drive-found", name)
        known, fault = self._faults.get(name), drive.fault
        if known is not None and (fault is None or fault.since_s != known.since_s):
            self._journal.record(f"{known.kind}-ended", name, {"fault": str(known)})
            del self._faults[name]
            known = None
        if fault is not None and (known is None or known.number != fault.number):
            self._faults[name] = fault
            self._journal.record(str(fault.kind), name, {"fault": str(fault)})

    def _line_changed(self) -> None:
        line = self._store.line()
        if line.state is self._line:
            return
        self._line = line.state
        if line.state is LineState.OPEN:
            self._journal.record("line-opened", "", {"port": line.reason})
        else:
            self._journal.record("line-lost", "", {"reason": line.reason})

    # ---- the daemon --------------------------------------------------------------------------

    async def started(self, roster: Roster, version: str) -> None:
        """Record the start, and what differs from the roster of the run before."""
        fields = {"version": version, "line": roster.line.name, "drives": str(len(roster.drives))}
        self._journal.record("start", "", fields)
        try:
            kept = await self._journal.fact(ROSTER)
        except (JournalFileError, TimeoutError):
            return
        values = roster_values(roster)
        if kept is not None:
            before = (line.partition("=") for line in kept.splitlines())
            self._record_changes({key: value for key, _, value in before}, values)
        self._keep(values)

    async def reloaded(self, old: Roster, new: Roster) -> None:
        """Record what a reload has changed; comparing takes 4 ms for 31 drives."""
        before, after = await anyio.to_thread.run_sync(
            lambda: (roster_values(old), roster_values(new))
        )
        self._record_changes(before, after)
        self._keep(after)

    def reload_refused(self, refused: RosterError) -> None:
        """Record that a reload was refused."""
        mistakes = {f"mistake_{n}": str(one) for n, one in enumerate(refused.mistakes[:20], 1)}
        fields = {"mistakes": str(len(refused.mistakes)), **mistakes, **ACTOR.get().fields()}
        self._journal.record("reload-refused", "", cut(fields))

    def ended_run(self, reason: str) -> None:
        """Record the end of the daemon."""
        self._journal.record("end", "", {"reason": reason[:LONGEST]}, is_vital=True)

    def _record_changes(self, old: Mapping[str, str], new: Mapping[str, str]) -> None:
        changes = value_changes(old, new)
        if not changes:
            return
        named = dict(list(changes.items())[:CHANGES_MOST])
        fields = {"changes": str(len(changes)), **ACTOR.get().fields(), **named}
        self._journal.record("roster", "", cut(fields))

    def _keep(self, values: Mapping[str, str]) -> None:
        self._journal.keep(Fact(ROSTER, "\n".join(f"{key}={one}" for key, one in values.items())))


def cut(fields: Mapping[str, str]) -> dict[str, str]:
    """Return fields that are not too long."""
    return {key: text[:LONGEST] for key, text in fields.items()}
