"""Pre-checks of writes: what is asked of a drive before anything may be written to it.

In this order, each before the first write of the audit itself:

1. *addressing*: C0248 and C0249 move what standard addressing reaches, in every later access. They
   can be read with any value. With one of them not 0 the drive is spoken to in extended
   addressing only, which they do not touch; where the roster rules that out, nothing it answers is
   what was asked for: every value is bad and nothing is written.
2. *identity*: is it the drive that was there (`operations.identities`)? What differs is read twice
   before it is believed: one damaged character may pass the BCC.
   Where answers come twice it may be another drive's, as what is recorded for the first time may:
   both are read until it is certain whose they are. If that does not get certain, the audit is made
   again where they differ, and otherwise nothing is recorded.
3. *software*: the manual of the SMVector forbids writing to any software but its own.

Each check that fails is a remark (`readings.WRITE_LOCKS`); stops pass all of them.
Source: EDB2102EN 8.2 (C0248, C0249), 8.3.1; CMVLC401A preface, 5.3.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterable

from lecombus.drive_state.drive_runtime import Drive
from lecombus.drive_state.readings import ADDRESSING_LOCK, ADDRESSING_MOVED, SOFTWARE_LOCK
from lecombus.drive_state.store import Store
from lecombus.drives import SoftwareGate
from lecombus.drives.procedures import identity_codes
from lecombus.errors import OperationError, UnknownCodeError
from lecombus.fieldbus.protocols import find
from lecombus.fieldbus.requests import Station
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.identities import Identities
from lecombus.operations.readdress import Readdress
from lecombus.parameters import Code, Value
from lecombus.schedule import Priority
from lecombus.supervision.watchdogs import DOES_NOT_FIT, PATIENCE_S, AuditError

__all__ = ["WritePrechecks"]

logger = logging.getLogger(__name__)

UNCHECKED = "identity-unchecked"
"""The remark where the line has no time for the question who a drive is."""


class WritePrechecks:
    """Asks drives what decides whether they may be written to.

    Args:
        requests: Sends requests and waits for their end.
        store: Gets the remarks.
        identities: Judges who they are.
        readdress: Knows which were moved to another address.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        identities: Identities,
        readdress: Readdress,
    ) -> None:
        self._requests = requests
        self._store = store
        self._identities = identities
        self._readdress = readdress

    def passed(self, drive: Drive) -> None:
        """A drive was audited to the end where the roster says that it is."""
        if self._store.drive(drive.name).write_lock is None:
            self._readdress.seen_at_home(drive)

    async def check_addressing(self, drive: Drive, station: Station) -> Station:
        """See that what is asked for is what is answered.

        Returns:
            The drive as it is to be spoken to from now on.

        Raises:
            LecombusError: It could not be finished.
        """
        protocol = find(station.family.protocol)
        codes = protocol.shifting_codes(station.family)
        if not codes:
            return station
        found = await self._read_all(station, codes)
        moved = {code: value for code, value in found.items() if value.number != 0}
        forms = drive.entry.forms
        if moved:
            forms = protocol.unshifted(forms)
        self._remark_addressing(drive.name, moved, reachable=bool(forms))
        if moved:
            drive.control_word.forget()  # it may have been another code's value
        if not forms or forms == station.forms:
            return station
        changed = dataclasses.replace(station, forms=forms)
        if drive.station is station:  # no reload came between
            drive.station = changed
        return changed

    def _remark_addressing(self, name: str, moved: dict[Code, Value], *, reachable: bool) -> None:
        reads = " and ".join(f"{code} is {value.raw}" for code, value in moved.items())
        before = self._store.drive(name).remarks
        text = (
            f"{reads}: standard addressing reaches other codes or subcodes of this drive than it "
            "should; "
        )
        lock = note = None
        if moved and not reachable:
            lock = (
                f"{text}every value is bad and nothing is written but stops, which may go astray; "
                "write 0 to both by whatever set them, or switch the drive off and on"
            )
        elif moved:
            note = (
                f"{text}extended addressing is used instead; another master on this line may have "
                "set them; they are 0 again after switching off and on"
            )
        if moved and not before.keys() & {ADDRESSING_LOCK, ADDRESSING_MOVED}:
            logger.warning("drive=%s event=addressing-moved reason=%s", name, lock or note)
        self._store.note(name, ADDRESSING_LOCK, lock)
        self._store.note(name, ADDRESSING_MOVED, note)
        if note is not None:
            for code in self._store.codes(name):
                self._store.value_failed(name, code, f"{reads} when it was read")

    async def check_identity(self, drive: Drive, station: Station) -> dict[Code, Value]:
        """Find out who it is.

        Returns:
            What could be read, by code.

        Raises:
            LecombusError: The line was no help; a code that the drive does not know is none.
        """
        codes = identity_codes(drive.entry.identity, station.family.identity)
        found = await self._read_identity(station, codes)
        if self._requests.may_be_anothers():
            found = await self._own_identity(drive, station, found)
        else:
            doubtful = self._identities.differing(drive, found)
            found |= await self._read_all(station, doubtful)
        if found or not codes:  # where nothing is asked for any more, nothing differs
            self._identities.judge(drive, found)
        return found

    async def _read_identity(self, station: Station, codes: Iterable[Code]) -> dict[Code, Value]:
        """Read who it is; where the others' watchdogs leave no time for that, remark it and go on.

        A drive that never came online because of its label would be worse than one whose label is
        not known.
        """
        found: dict[Code, Value] = {}
        hindered = None
        for code in codes:
            try:
                found |= await self._read_all(station, (code,))
            except OperationError as exc:
                if exc.kind != DOES_NOT_FIT:
                    raise
                hindered = f"who it is cannot be checked: {exc}"
        self._store.note(station.name, UNCHECKED, hindered)
        return found

    async def _own_identity(
        self, drive: Drive, station: Station, found: dict[Code, Value]
    ) -> dict[Code, Value]:
        """Read until it is certain who it is; what would be recorded first may stay unknown.

        Raises:
            AuditError: It seems to be another drive, and that is not certain.
            LecombusError: It could not be read.
        """
        own, unsure = dict(found), []
        differing = self._identities.differing(drive, found)
        for code in self._identities.unconfirmed(drive, found):
            value, spoken = own.pop(code), station.family.spoken(code)
            try:
                sure = await self._requests.own_value(station, code, value, timeout_s=PATIENCE_S)
            except UnknownCodeError:
                continue  # it was another's
            if sure is not None:
                own[code] = sure
            elif code in differing:
                raise AuditError(f"{spoken} reads {value.raw}, which may be another drive's answer")
            else:
                unsure.append(spoken)
        if unsure:
            codes = " and ".join(unsure)
            text = f"who it is cannot be checked: answers come twice, {codes} may be another's"
            self._store.note(station.name, UNCHECKED, text)
        return own

    async def check_software(
        self, drive: Drive, station: Station, gate: SoftwareGate, known: Value | None
    ) -> None:
        """A drive whose software the manual does not vouch for is read, and never written to.

        Args:
            drive: The drive.
            station: How it is spoken to.
            gate: Which software may be written to.
            known: The version, where it was read just now.

        Raises:
            LecombusError: It could not be read.
        """
        found = known or await self._read(station, gate.code)
        accepted = (*gate.versions, *drive.entry.accept_software)
        text = None
        if not any(found.raw == one or found.means_same(Value.parse(one)) for one in accepted):
            code = station.family.spoken(gate.code)
            text = (
                f"{code} reads software {found.raw}, the manual's codes are those of "
                f"{', '.join(gate.versions)}: nothing is written to this drive but stops; if its "
                f"manual says the same codes, add accept_software: ['{found.raw}'] in the roster"
            )
            logger.warning("drive=%s event=software-unknown reason=%s", drive.name, text)
        self._store.note(drive.name, SOFTWARE_LOCK, text)

    async def _read_all(self, station: Station, codes: Iterable[Code]) -> dict[Code, Value]:
        return await self._requests.read_known(station, codes, timeout_s=PATIENCE_S)

    async def _read(self, station: Station, code: Code) -> Value:
        return await self._requests.read(station, code, Priority.INTERACTIVE, timeout_s=PATIENCE_S)
