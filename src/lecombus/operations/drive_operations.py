"""What users ask of one drive: read a code, write one. Every face calls this.

Here stands how such wishes become requests and reports, whoever has them. Whether a write may be
made is asked of `permissions`. The stop stands in `stop_operations`, writes to several drives in
`group_operations`.

What must not live here: HTTP, telegrams, waiting lists.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal

from lecombus.config import DriveEntry, GroupEntry
from lecombus.drives import (
    WriteClass,
)
from lecombus.drives.stops import asks_to_stop
from lecombus.errors import (
    ExchangeError,
    LecombusError,
    OperationError,
    RefusedError,
)
from lecombus.line.jobs import WriteJob
from lecombus.line.station import Station
from lecombus.operations.address_reads import Heard, check_address, read_address
from lecombus.operations.control_words import ControlWords
from lecombus.operations.endings import (
    CUT_REMEDY,
    REMEDIES,
    STOPPED_REMEDY,
    kind_of,
    stopped_first,
)
from lecombus.operations.findings import WhyReport
from lecombus.operations.permissions import Permissions
from lecombus.operations.refusals import Refusals
from lecombus.operations.reports import Proof, RestoreRights, WriteReport
from lecombus.operations.requests import (
    Ending,
    Requests,
    client_check,
    refuse_for_gone_client,
)
from lecombus.operations.wear import Wear, wears
from lecombus.operations.why import Why
from lecombus.protocol.addressing import Code, Form
from lecombus.protocol.values import Value
from lecombus.readings import Reading
from lecombus.schedule import Outcome, Priority
from lecombus.schedule.request import STOPPED
from lecombus.store import Store

__all__ = ["Operations"]

READ_WITHIN_S = 10.0
"""A read that could not be begun for this long is given up: whoever asked has gone."""


class Operations:
    """Carries out what users ask for on one line.

    Args:
        requests: Sends requests.
        store: What is known.
        words: The drives' control words as last seen.
        wear: Counts and limits what wears the drives' memories.
        clock: Monotonic time, seconds.
        disturbances: How often the line has carried something that was no answer.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        words: ControlWords,
        wear: Wear,
        clock: Callable[[], float],
        disturbances: Callable[[], int] = lambda: 0,
    ) -> None:
        self._wear = wear
        self._requests = requests
        self._store = store
        self._words = words
        self._refusals = Refusals(requests, store, clock)
        self._why = Why(requests, store, clock, lambda drive: self._stops_said[drive])
        self._permissions = Permissions(requests, store)
        self._clock = clock
        self._disturbances = disturbances
        self._entries: dict[str, DriveEntry] = {}
        self._groups: Mapping[str, GroupEntry] = {}
        self._mark = secrets.token_hex(4)
        self._stops_said: Counter[str] = Counter()
        self._lifts_said: Counter[str] = Counter()

    def close(self) -> None:
        """Take no more writes: the daemon is ending; stops are still said."""
        self._permissions.close()

    def set_roster(self, entries: Sequence[DriveEntry], groups: Mapping[str, GroupEntry]) -> None:
        """Take the roster's drives and groups, at the start and at every reload."""
        now = {entry.name: (entry.address, entry.family) for entry in entries}
        self._why.forget(
            name for name, entry in self._entries.items()
            if now.get(name) != (entry.address, entry.family)
        )  # fmt: skip
        self._entries = {entry.name: entry for entry in entries}
        self._groups = dict(groups)
        self._permissions.entries = self._entries

    def _station(self, drive: str) -> Station:
        """Look a drive up.

        Raises:
            OperationError: `no-such-drive`; where the name is a group's, it says so.
        """
        group = self._groups.get(drive)
        if group is not None and drive not in self._entries:
            members = ", ".join(group.members)
            raise OperationError(
                f"{drive} is a group: this takes one drive",
                kind="no-such-drive",
                drive=drive,
                remedy=f"name one of its drives ({members}); a group is taken by `group`, `stop`, "
                "`quick-stop` and `inhibit`",
            )
        return self._requests.station(drive)

    async def read(
        self,
        drive: str,
        code: Code,
        *,
        priority: Priority = Priority.INTERACTIVE,
        timeout_s: float = READ_WITHIN_S,
    ) -> Reading:
        """Read a code from the drive now.

        Args:
            drive: The drive's name.
            code: What to read; any code may be.
            priority: The class to run in.
            timeout_s: Not begun after this long, seconds.

        Raises:
            OperationError: No such drive, or nothing was sent.
            ExchangeError: The drive did not answer, or refused.
            LineError: There is no line.
            QueueFullError: Too many requests wait.
        """
        station = self._station(drive)
        try:
            await self._requests.read(station, code, priority, timeout_s=timeout_s)
        except RefusedError as exc:
            self._refusals.explain_read(exc, station, code)
            raise
        reading = self._store.reading(drive, code)
        if reading is None:
            raise OperationError(
                f"the roster changed while {code} of {drive} was read",
                kind="not-ready",
                drive=drive,
                code=str(code),
                remedy="ask again",
            )
        return reading

    async def read_address(
        self, address: int, code: Code, *, form: Form, family_name: str, patient: bool
    ) -> Heard:
        """Read a code at an address that the roster does not have, once, when nothing else is due.

        Args:
            address: 1..99, not ending in 0.
            code: What to read.
            form: In this addressing form and no other.
            family_name: Whose answer times to wait by.
            patient: Wait longer than any description says.

        Raises:
            OperationError: No drive can have the address, the roster has it, or nothing was sent.
            LineError: There is no line.
            QueueFullError: Too many requests wait.
        """
        check_address(address, family_name, self._entries.values())
        return await read_address(
            self._requests,
            address,
            code,
            form=form,
            family_name=family_name,
            patient=patient,
            priority=Priority.BACKGROUND,
            disturbances=self._disturbances,
        )

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
        """Write a code and say what came of it.

        Args:
            drive: The drive's name.
            code: What to write; the roster must allow it.
            value: A number, or text such as `35.4`, `H0008` or `0x0008`.
            expires_s: Not begun after this long, seconds.
            verify: Read back afterwards.
            urgency: The class to run in; None: by what is written. What moves a drive keeps its
                own.
            restoring: It belongs to the restore of a backup: other codes may be written then.
            unless_stopped_since: A `stop_mark` of the drive: a stop that was said since ends it.

        Raises:
            OperationError: It may not be written, or the value is not one for this code.
            LineError: There is no line; nothing was sent.
            QueueFullError: Too many requests wait; nothing was sent.
        """
        station = self._station(drive)
        wire = self._permissions.permitted(drive, station, code, value, restoring=restoring)
        if not asks_to_stop(station.family, code, wire):
            refuse_for_gone_client(drive)
        expires_at_s = None if expires_s is None else self._clock() + expires_s
        mark = self.stop_mark(drive)
        outdated = self._requests.stopped_since_asked(drive)
        if unless_stopped_since is not None:
            outdated |= self._is_outdated(drive, unless_stopped_since)
        if outdated:
            return stopped_first(drive, code)
        if wears(station.family, code):
            there = await self.already_there(
                station, code, wire, verify=verify, within_s=expires_s, urgency=urgency
            )
            if there is not None:
                return there
            # Much may have become of the drive meanwhile.
            if self._is_outdated(drive, mark):
                return stopped_first(drive, code)
            station = self._requests.station(drive)
            wire = self._permissions.permitted(drive, station, code, value, restoring=restoring)
            self._wear.take(drive, code)
        self.note_stop(station, code, wire)
        ending = self.submit_write(
            station, code, wire, expires_at_s, verify=verify, urgency=urgency
        )
        report = self.report(drive, code, ending, *await ending.wait())
        return await self._refusals.explain(report, station, wire)

    def stop_mark(self, drive: str) -> str:
        """Give a mark that another stop of the drive outdates, for work of several steps."""
        return f"{self._mark}-{self._requests.stops_said[drive]}"

    def _is_outdated(self, drive: str, mark: str) -> bool:
        """Whether a stop was said since; a mark of another run of lecombus tells nothing."""
        return mark.startswith(f"{self._mark}-") and mark != self.stop_mark(drive)

    async def already_there(
        self,
        station: Station,
        code: Code,
        wire: Value,
        *,
        verify: bool,
        within_s: float | None,
        urgency: Priority | None = None,
    ) -> WriteReport | None:
        """Read a stored parameter first: what it holds already need not wear its memory.

        Returns:
            How the write ended without being sent; None: it must be.
        """
        info = station.family.info(code)
        if not wears(station.family, code) or info is None or info.motion or not info.readable:
            return None
        if station.family.write_class(code, wire) is not WriteClass.PLAIN:
            return None
        try:
            found, doubt = await self._requests.read_back(
                station,
                code,
                wire,
                urgency or Priority.INTERACTIVE,
                timeout_s=READ_WITHIN_S if within_s is None else within_s,
            )
        except (ExchangeError, OperationError):
            return None  # the write itself tells what is the matter
        if doubt or not found.means_same(wire):
            return None  # what may be another drive's value is written
        outcome = Outcome.VERIFIED if verify else Outcome.DONE
        reading = self._store.reading(station.name, code)
        reason = "already there, not written"
        proof = Proof(code, found.raw, "value") if verify else None
        return WriteReport(station.name, code, outcome, reason, reading=reading, proof=proof)

    def note_stop(self, station: Station, code: Code, wire: Value) -> None:
        """Count a plain write that means to stop a drive, or may lift what stops it.

        A verb under way must not undo the one, and a reset must not go on behind the other.
        """
        if asks_to_stop(station.family, code, wire):
            self._stops_said[station.name] += 1
        elif self._words.moves(station.name, code):
            self._lifts_said[station.name] += 1

    async def why(self, drive: str, *, fresh: bool = False) -> WhyReport:
        """Say why a drive does not turn; `fresh`: after reading the few codes that matter.

        Raises:
            OperationError: No such drive.
        """
        self._station(drive)
        return await self._why.why(drive, fresh=fresh)

    def submit_write(
        self,
        station: Station,
        code: Code,
        wire: Value,
        expires_at_s: float | None,
        *,
        verify: bool,
        urgency: Priority | None = None,
        goes_on: bool = False,
    ) -> Ending:
        """Put a permitted write into the line; its end is waited for by the caller.

        Args:
            station: The drive.
            code: What to write.
            wire: The value, as it is sent.
            expires_at_s: Not begun after this time.
            verify: Read back afterwards.
            urgency: The class to run in; None: by what is written.
            goes_on: It is part of something that was begun on the line: it is sent even when its
                client leaves.
        """
        ending = Ending()
        # From now on a stop must not rely on the control word this write may change.
        settle = self._words.guard((station.name,), code, ending.settle)
        ending.request = request = self._requests.maker.write(
            station, code, wire, settle=settle, verify=verify, expires_at_s=expires_at_s,
            urgency=urgency, duplicates=self._requests.worker.talk.duplicates,
        )  # fmt: skip
        request.is_gone = None if goes_on else client_check(station, code, wire)
        try:
            self._requests.worker.submit(request)
        except LecombusError as exc:
            request.end(Outcome.REFUSED, str(exc))
            raise
        return ending

    def restore_rights(self, drive: str) -> RestoreRights:
        """Say whether a backup may be restored into a drive.

        Raises:
            OperationError: `no-such-drive`.
        """
        return replace(self._permissions.restore_rights(drive), stops=self.stop_mark(drive))

    def report(
        self, drive: str, code: Code, ending: Ending, outcome: Outcome, reason: str
    ) -> WriteReport:
        """Say what came of a write or a stop, with what is known of the code now."""
        good = outcome in (Outcome.DONE, Outcome.VERIFIED)
        kind = "" if good else kind_of(ending, outcome, reason)
        remedy = REMEDIES.get(kind, "")
        if outcome is Outcome.UNKNOWN and kind == "line-lost":
            remedy = CUT_REMEDY
        elif reason == STOPPED:
            remedy = STOPPED_REMEDY
        reading = self._store.reading(drive, code)
        job, proof = ending.request.work if ending.request is not None else None, None
        if outcome is Outcome.VERIFIED and isinstance(job, WriteJob) and job.proof is not None:
            proof = Proof(job.code, job.proof.raw, "value")
        return WriteReport(
            drive, code, outcome, reason, kind=kind, remedy=remedy, reading=reading, proof=proof
        )
