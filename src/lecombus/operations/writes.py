"""Writes to one drive: from the value that a user gives to the outcome and its reason."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal

from lecombus.drive_state.control_word import unknown_until_ended
from lecombus.drives import (
    WriteClass,
)
from lecombus.drives.stops import asks_to_stop
from lecombus.errors import (
    ExchangeError,
    OperationError,
)
from lecombus.fieldbus.requests import Station, WriteWork
from lecombus.leases import Use
from lecombus.operations.awaited_requests import Ending, client_check, refuse_for_gone_client
from lecombus.operations.context import OperationContext
from lecombus.operations.lease_operations import use_of
from lecombus.operations.operation_reports import (
    CUT_REMEDY,
    READ_REMEDY,
    REMEDIES,
    STOPPED_REMEDY,
    Proof,
    RestoreRights,
    WriteReport,
    stopped_first,
)
from lecombus.operations.reads import READ_WITHIN_S
from lecombus.operations.wear import wears
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority
from lecombus.schedule.request import STOPPED

__all__ = ["Writes"]


class Writes:
    """Writes codes of one drive at a time."""

    def __init__(self, context: OperationContext) -> None:
        self._context = context

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
        """Write a code and return how it ended.

        Args:
            drive: The drive's name.
            code: What to write; the roster must allow it.
            value: A number, or text such as `35.4`, `H0008` or `0x0008`.
            expires_s: Not begun after this long, seconds.
            verify: Read back afterwards.
            urgency: The class to run in; None: by what is written. What moves a drive keeps its
                own.
            restoring: It belongs to the restore of a backup: other codes may be written then.
            unless_stopped_since: A mark of the drive (`StopMarks`): a later stop ends the write,
                and so does a start of lecombus since.

        Raises:
            OperationError: It may not be written, or the value is not one for this code.
            LineError: There is no line; nothing was sent.
            QueueFullError: Too many requests wait; nothing was sent.
        """
        station = self._context.station(drive)
        expires_at_s = None if expires_s is None else self._context.clock() + expires_s
        mark = self._context.stop_marks.mark(drive)
        since = self._context.stop_marks.before_write(station, code)
        await self._context.shown_stops.see(drive, code, value)
        wire = self._context.permissions.permitted(drive, station, code, value, restoring=restoring)
        if not asks_to_stop(station.family, code, wire):
            refuse_for_gone_client(drive)
        if outdated := self._why_outdated(drive, mark, unless_stopped_since):
            return stopped_first(drive, code, outdated)
        if since() and not asks_to_stop(station.family, code, wire):
            return stopped_first(drive, code)
        if wears(station.family, code):
            there = await self.already_there(
                station, code, wire, verify=verify, within_s=expires_s, urgency=urgency
            )
            # The drive may have been stopped, changed or removed during the read.
            if self._context.stop_marks.is_outdated(drive, mark) or since():
                return stopped_first(drive, code)
            if there is not None:
                return there
            station = self._context.requests.station(drive)
            wire = self._context.permissions.permitted(
                drive, station, code, value, restoring=restoring
            )
            self._context.wear.take(drive, code)
        self._context.stop_marks.note_write(station, code, wire)
        ending = self.submit_write(
            station, code, wire, expires_at_s, verify=verify, urgency=urgency,
            use=use_of(station.family, code, wire, restoring=restoring),
        )  # fmt: skip
        report = self.report(drive, code, ending, *await ending.wait())
        return await self._context.diagnosis.explain(report, station, wire)

    def _why_outdated(self, drive: str, mark: str, unless_stopped_since: str | None) -> str:
        """Say why a stop ends the write before it begins; empty: none does."""
        requests, marks = self._context.requests, self._context.stop_marks
        stopped = requests.stopped_since_asked(drive) or marks.is_outdated(drive, mark)
        outdated = STOPPED if stopped else ""
        if unless_stopped_since is not None:
            outdated = marks.why_outdated(drive, unless_stopped_since) or outdated
        return outdated

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
        """Read a stored parameter first: an equal value need not be written to its EEPROM.

        Returns:
            How the write ended without being sent; None: it must be.
        """
        info = station.family.info(code)
        if not wears(station.family, code) or info is None or info.motion or not info.readable:
            return None
        if station.family.write_class(code, wire) is not WriteClass.PLAIN:
            return None
        try:
            found, doubt = await self._context.requests.read_back(
                station,
                code,
                wire,
                urgency or Priority.INTERACTIVE,
                timeout_s=READ_WITHIN_S if within_s is None else within_s,
            )
        except (ExchangeError, OperationError):
            return None  # the write itself will fail with the reason
        if doubt or not found.means_same(wire):
            return None  # what may be another drive's value is written
        outcome = Outcome.VERIFIED if verify else Outcome.DONE
        reading = self._context.store.reading(station.name, code)
        reason = "already there, not written"
        proof = Proof(code, found.raw, "value") if verify else None
        return WriteReport(station.name, code, outcome, reason, reading=reading, proof=proof)

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
        use: Use | None = None,
    ) -> Ending:
        """Submit a permitted write; the caller waits for its end.

        Args:
            station: The drive.
            code: What to write.
            wire: The value, as it is sent.
            expires_at_s: Not begun after this time.
            verify: Read back afterwards.
            urgency: The class to run in; None: by what is written.
            goes_on: It belongs to an operation that has sent something already: it is sent also
                when its client has gone.
            use: What it is for, which its lease must permit when it is sent; None: by the code.
        """
        ending = Ending()
        # From here on a stop must not use the stored control word: this write may change it.
        word = self._context.control_word(station.name)
        repeats = word.repeats(code, wire)
        settle = unknown_until_ended((word,), code, ending.settle)
        ending.request = request = self._context.requests.maker.write(
            station, code, wire, settle=settle, verify=verify, expires_at_s=expires_at_s,
            urgency=urgency,
        )  # fmt: skip
        request.is_gone = None if goes_on else client_check(station, code, wire)
        request.lease_ended = self._context.permissions.lease_check((station,), code, (wire,), use)
        request.repeats = repeats
        self._context.requests.submit(request)
        if asks_to_stop(station.family, code, wire):
            self._context.lasting(station.name).stop_write_done = ending.is_done
        return ending

    def restore_rights(self, drive: str) -> RestoreRights:
        """Return whether a backup may be restored into a drive.

        Raises:
            OperationError: `no-such-drive`.
        """
        return replace(
            self._context.permissions.restore_rights(drive),
            stops=self._context.stop_marks.mark(drive),
        )

    def report(
        self, drive: str, code: Code, ending: Ending, outcome: Outcome, reason: str
    ) -> WriteReport:
        """Make the report of a write or a stop that has ended."""
        kind = "" if outcome.is_good else ending.failure(outcome, reason)
        remedy = REMEDIES.get(kind, "")
        if outcome is Outcome.UNKNOWN and kind == "line-lost":
            remedy = CUT_REMEDY
        elif reason.startswith(STOPPED):
            remedy = READ_REMEDY if outcome is Outcome.UNKNOWN else STOPPED_REMEDY
        reading = self._context.last_reading(drive, code)
        job, proof = ending.request.work if ending.request is not None else None, None
        if outcome is Outcome.VERIFIED and isinstance(job, WriteWork) and job.proof is not None:
            proof = Proof(job.code, job.proof.raw, "value")
        return WriteReport(
            drive, code, outcome, reason, kind=kind, remedy=remedy, reading=reading, proof=proof
        )
