"""Whether a write may be made now, and the value that goes on the wire for it.

True of every write: which codes the roster lets be written, that a drive which is offline, not yet
audited or locked is not written to, and how a user's value becomes the wire's. Stops need none of
this.

A restore writes far more than the `writable` list of a roster allows, so it has a separate
permission in the roster (`restore: true`). That opens no more than a backup holds: parameters that
the family describes as settings, and the code that saves them; no commands, setpoints, addresses
and nothing that lecombus itself sets from the roster.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from decimal import Decimal

from lecombus.config import DriveEntry
from lecombus.drive_state.readings import DriveState, LineState
from lecombus.drive_state.store import Store
from lecombus.drives import Family, Verb, check_allowed, encode_for, not_restored, saving_rule
from lecombus.drives.stops import asks_to_stop
from lecombus.errors import CodeValueError, LineClosedError, OperationError
from lecombus.fieldbus.protocols import find
from lecombus.fieldbus.requests import Station
from lecombus.leases import Use
from lecombus.operations.awaited_requests import SILENCED_REMEDY, Requests
from lecombus.operations.lease_operations import Leases, needs_lease, use_of
from lecombus.operations.operation_reports import RestoreRights
from lecombus.parameters import Code, Value

__all__ = ["Permissions"]


class Permissions:
    """Says what may be written to the drives of one line.

    Args:
        requests: Knows the drives.
        store: How the drives are doing.
        leases: Who may control them now.
    """

    def __init__(self, requests: Requests, store: Store, leases: Leases) -> None:
        self.leases = leases
        self._requests = requests
        self._store = store
        self._closing = False

    def close(self) -> None:
        """Permit nothing more."""
        self._closing = True

    def permitted(
        self,
        drive: str,
        station: Station,
        code: Code,
        value: Decimal | int | str,
        *,
        restoring: bool = False,
        use: Use | None = None,
    ) -> Value:
        """Give the wire's value for a write that may be made now.

        Args:
            drive: The drive.
            station: How it is spoken to.
            code: What is written.
            value: The user's value.
            restoring: It belongs to the restore of a backup.
            use: What the write is for; None: by its code.

        Raises:
            OperationError: It may not.
            LineClosedError: The daemon is being ended.
        """
        if self._closing:
            raise LineClosedError(f"{drive} is not written to: the daemon is being ended")
        refuse_moving(drive, station.family, code)
        if restoring:
            check_restored(self.restore_rights(drive), station.family, code, value)
        else:
            self.check_writable(drive, code)
        self.check_ready(drive, code)
        remedy = "nothing was sent"
        named = station.family.spoken(code)
        known = self._store.reading(drive, code)
        last_read = known.value if known is not None else None
        try:
            wire = encode_for(station.family, code, value, last_read=last_read)
            if not restoring and code not in self._entry(drive).unchecked:
                remedy = (
                    f"give such a value; if this drive takes more, list {named} under `unchecked` "
                    "of the drive in the roster"
                )
                check_allowed(station.family, code, wire)
        except CodeValueError as exc:
            raise OperationError(
                f"{named} of {drive} cannot take {value!s}: {str(exc).removeprefix(f'{named}: ')}",
                kind="bad-value",
                drive=drive,
                code=str(code),
                remedy=remedy,
            ) from exc
        if needs_lease(station.family, code, wire):
            as_asked = use or use_of(station.family, code, wire, restoring=restoring)
            self._check_lease(drive, code, as_asked, stops=asks_to_stop(station.family, code, wire))
        return wire

    def _check_lease(self, drive: str, code: Code, use: Use, *, stops: bool) -> None:
        """Raise what the drive's lease refuses; for a word that stops, say how to stop it."""
        try:
            self.leases.check(drive, use)
        except OperationError as exc:
            if not stops:
                raise
            raise OperationError(
                str(exc),
                kind=exc.kind,
                drive=drive,
                code=str(code),
                remedy=f"stop it by POST /v1/stop or `lecombus stop {drive}`: that needs "
                "neither a lease nor an enable",
            ) from exc

    def lease_check(
        self,
        stations: Sequence[Station],
        code: Code,
        wires: Sequence[Value],
        use: Use | None = None,
    ) -> Callable[[], bool] | None:
        """Give what says that a permitted write must not be sent any more; None: it needs no lease.

        Args:
            stations: The drives that one telegram reaches.
            code: What is written.
            wires: The value for each.
            use: What it is for; None: by the code.
        """
        both = zip(stations, wires, strict=True)
        found = [(one, wire) for one, wire in both if needs_lease(one.family, code, wire)]
        if not found:
            return None
        return self.leases.ended_check(
            {one.name: use or use_of(one.family, code, wire) for one, wire in found}
        )

    def restore_rights(self, drive: str) -> RestoreRights:
        """Say whether a backup may be restored into a drive.

        Raises:
            OperationError: `no-such-drive`.
        """
        station = self._requests.station(drive)
        locked = self._store.drive(drive).write_lock
        return rights_of(self._entry(drive), station.family, locked)

    def check_ready(self, drive: str, code: Code | None = None) -> None:
        """Refuse to write to a drive that is away, not audited yet, or locked.

        Raises:
            OperationError: `offline`, `starting` or `locked`.
        """
        named = "" if code is None else str(code)
        state = self._store.drive(drive)
        # Without a line no drive answers: the worker says so when it is asked, and why.
        is_open = self._store.line().state is LineState.OPEN
        if is_open and state.state in (DriveState.OFFLINE, DriveState.STARTING):
            remedy = "nothing was sent; a drive is written to once it answers and was audited"
            if self._requests.is_silenced(drive):
                remedy = SILENCED_REMEDY
            raise OperationError(
                f"{drive} is {state.state.value}: {state.reason}",
                kind="offline" if state.state is DriveState.OFFLINE else "starting",
                drive=drive,
                code=named,
                remedy=remedy,
            )
        if state.write_lock is not None:
            raise OperationError(
                f"nothing is written to {drive}: {state.write_lock}",
                kind="locked",
                drive=drive,
                code=named,
            )

    def _entry(self, drive: str) -> DriveEntry:
        return self._requests.drives.get(drive).entry

    def check_writable(self, drive: str, code: Code) -> None:
        """Refuse a code that the roster does not let be written.

        Raises:
            OperationError: `not-writable`.
        """
        entry = self._entry(drive)
        writable = entry.writable
        if code in writable:
            return
        family = self._requests.station(drive).family
        info = family.info(code)
        named = family.spoken(code)
        text = f"{named} of {drive} is not writable"
        remedy = _remedy([code], writable, family)
        if info is not None and not info.writable:
            text = f"{named} of {drive} is read only: {info.name}"
            remedy = f"`lecombus describe {family.name}` lists what can be written"
        elif code in entry.owned:
            text = f"{named} of {drive} is set by lecombus, as `watchdog` of the roster says"
            remedy = "change `watchdog` of this drive in the roster and reload it"
        raise OperationError(text, kind="not-writable", drive=drive, code=str(code), remedy=remedy)

    def check_verb(self, drive: str, verb: Verb, codes: Iterable[Code]) -> None:
        """Refuse a verb that writes a code which the roster does not let be written.

        The refusal names all that the verb may need, not only what is in the way this time.

        Args:
            drive: The drive's name.
            verb: The verb.
            codes: What it writes this time.

        Raises:
            OperationError: `not-writable`.
        """
        writable = self._entry(drive).writable
        lacking = [code for code in dict.fromkeys(codes) if code not in writable]
        if not lacking:
            return
        family = self._requests.station(drive).family
        rules = family.verbs
        all_lacking = rules.not_writable(verb, writable) if rules is not None else ()
        named = ", ".join(map(family.spoken, lacking))
        are = "is" if len(lacking) == 1 else "are"
        raise OperationError(
            f"{verb} writes {named} of {drive}, which {are} not writable: nothing was sent",
            kind="not-writable",
            drive=drive,
            code=str(lacking[0]),
            remedy=_remedy(all_lacking or lacking, writable, family),
        )


def _remedy(codes: Sequence[Code], writable: Collection[Code], family: Family) -> str:
    named = ", ".join(map(family.spoken, codes))
    return (
        f"add {named} to `also_writable` of this drive in the roster and reload it; now "
        f"{listed(writable, family)}"
    )


def refuse_moving(drive: str, family: Family, code: Code) -> None:
    """Refuse codes after whose write the drive, or its codes, would be elsewhere.

    Raises:
        OperationError: `not-writable`.
    """
    protocol = find(family.protocol)
    moved = protocol.moves_drive(family, code)
    remedy = (
        f"change an address by `lecombus readdress {drive} NEW`, a baud rate by `lecombus rebaud` "
        "with the daemon stopped"
    )
    if moved is None and code in protocol.shifting_codes(family):
        moved = "moves what every later telegram in standard addressing reaches"
        remedy = "name a subcode after the code instead, as in C0039/1"
    if moved is not None:
        raise OperationError(
            f"{family.spoken(code)} of {drive} {moved}: it is never written like other codes",
            kind="not-writable",
            drive=drive,
            code=str(code),
            remedy=remedy,
        )


def listed(writable: Collection[Code], family: Family) -> str:
    """Say what may be written to a drive, to stand after "now"."""
    if not writable:
        return "nothing may be written"
    return f"{', '.join(map(family.spoken, sorted(writable)))} may be written"


def rights_of(entry: DriveEntry, family: Family, locked: str | None) -> RestoreRights:
    """Say whether a backup may be restored into a drive, and what the roster sets itself.

    Args:
        entry: What the roster says of the drive.
        family: Its family.
        locked: Why nothing at all is written to it; None where something is.
    """
    reason, remedy = "", ""
    if not entry.restore:
        reason = f"the roster does not let {entry.name} be restored"
        remedy = "write `restore: true` for this drive into the roster and reload it (SIGHUP)"
    elif locked is not None:
        reason = f"nothing is written to {entry.name}: {locked}"
        remedy = "see `lecombus status`"
    return RestoreRights(entry.name, not reason, tuple(entry.owned), reason, remedy)


def check_restored(
    rights: RestoreRights, family: Family, code: Code, value: Decimal | int | str
) -> None:
    """Refuse what a restore does not write.

    Raises:
        OperationError: `not-writable`.
    """
    why, remedy = rights.reason, rights.remedy
    saving = saving_rule(family)
    saves = saving is not None and code in saving.codes and str(value) == str(saving.value)
    if not why and not saves:
        why = not_restored(family, code, rights.owned) or ""
        remedy = "write it by itself, without `restore`, if it is meant"
    if why:
        raise OperationError(
            f"{family.spoken(code)} of {rights.drive} is not restored: {why}",
            kind="not-writable",
            drive=rights.drive,
            code=str(code),
            remedy=remedy,
        )
