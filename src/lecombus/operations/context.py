"""What the operations of one line share: its drives, what is known of them, and the stop marks."""

from __future__ import annotations

import contextlib
import re
import secrets
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from typing import Final

import anyio

from lecombus.config import DriveEntry, GroupEntry
from lecombus.drive_state.control_word import ControlWord
from lecombus.drive_state.drive_runtime import Drive, LastingRecord
from lecombus.drive_state.readings import DriveState, Quality
from lecombus.drive_state.store import Store
from lecombus.drives import StopAction, asks_to_stop, encode_for
from lecombus.drives.verb_facts import Known
from lecombus.drives.verbs import acts_on_setpoints, held_stop_codes, held_stops
from lecombus.errors import (
    CodeValueError,
    ExchangeError,
    LineError,
    OperationError,
    ScheduleError,
    meant,
)
from lecombus.fieldbus.requests import Station
from lecombus.leases import Use
from lecombus.line_events import LineRequests
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.lease_operations import Leases, use_of
from lecombus.operations.nak_diagnosis import NakDiagnosis
from lecombus.operations.permissions import Permissions
from lecombus.operations.wear import Wear
from lecombus.operations.why import StandstillDiagnosis
from lecombus.parameters import Code, Value
from lecombus.saved_state import State
from lecombus.schedule.request import STOPPED

__all__ = ["OperationContext"]

SHOWN_WITHIN_S: Final = 2.0
"""So long before a write that depends on it a drive must have shown its stop, seconds."""

MARK: Final = re.compile(r"(?P<run>[0-9a-f]{8})-(?P<drive>[a-z0-9_-]+)-[0-9]{1,15}")
"""A mark of stops, as `OperationContext.stop_mark` makes it."""

OTHER_RUN: Final = (
    "lecombus was started again since it was asked which stops there were: whether the drive was "
    "stopped since is not known"
)


class OperationContext:
    """What reads, writes, stops, groups and verbs of one line share.

    Args:
        requests: Sends requests.
        store: The last values and states of the drives.
        state: What outlives the daemon.
        line: Has a drive audited that was made to restart.
        clock: Monotonic time, seconds.
        wall: The time of day, Unix seconds.
        disturbances: How often the line has carried something that was no answer.

    Attributes:
        entries: The roster's drives by name.
        groups: The roster's groups by name.
        wear: Counts and limits writes to the drives' EEPROMs.
        leases: Who may control the drives now.
        permissions: Whether a write may be made.
        diagnosis: Why a drive refused.
        why: Why a drive does not turn.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        state: State,
        line: LineRequests,
        clock: Callable[[], float],
        wall: Callable[[], float],
        disturbances: Callable[[], int],
    ) -> None:
        self.requests = requests
        self.store = store
        self.wear = Wear(state, requests.drives, clock)
        self.line = line
        self.clock = clock
        self.disturbances = disturbances
        self.entries: dict[str, DriveEntry] = {}
        self.groups: Mapping[str, GroupEntry] = {}
        self.leases = Leases(state, clock, wall)
        self.permissions = Permissions(requests, store, self.leases)
        self.diagnosis = NakDiagnosis(requests, store, clock)
        self.why = StandstillDiagnosis(requests, store, clock)
        self.leases.held_stops = self.held_stops
        self._run = secrets.token_hex(4)
        self._looks: dict[str, anyio.Event] = {}  # by drive whose stops are being read

    def set_roster(self, entries: Sequence[DriveEntry], groups: Mapping[str, GroupEntry]) -> None:
        """Take the roster's drives and groups, at the start and at every reload."""
        self.entries = {entry.name: entry for entry in entries}
        self.groups = dict(groups)
        self.leases.set_roster(entries)

    def station(self, drive: str) -> Station:
        """Look a drive up.

        Raises:
            OperationError: `no-such-drive`; the text says it where the name is a group's.
        """
        group = self.groups.get(drive)
        if group is not None and drive not in self.entries:
            members = ", ".join(group.members)
            raise OperationError(
                f"{drive} is a group: this takes one drive",
                kind="no-such-drive",
                drive=drive,
                remedy=f"name one of its drives ({members}); a group is taken by `group`, `stop`, "
                "`quick-stop` and `inhibit`",
            )
        return self.requests.station(drive)

    def group(self, name: str) -> GroupEntry:
        """Look a group up.

        Raises:
            OperationError: `no-such-group`.
        """
        entry = self.groups.get(name)
        if entry is None:
            raise OperationError(
                f"there is no group {name!r}",
                kind="no-such-group",
                remedy=meant(name, self.groups, "the groups"),
            )
        return entry

    def members(self, target: str) -> tuple[str, ...]:
        """Return the drives of a target: one drive, or those of a group.

        Raises:
            OperationError: `no-such-drive`.
        """
        if target in self.entries:
            return (target,)
        if target in self.groups:
            return tuple(self.groups[target].members)
        raise OperationError(
            f"there is no drive and no group {target!r}",
            kind="no-such-drive",
            drive=target,
            remedy=meant(target, (*self.entries, *self.groups), "they"),
        )

    def is_secret(self, target: str, code: Code) -> bool:
        """Whether a code of a drive, or of one of a group, is a password."""
        group = self.groups.get(target)
        names = (target,) if group is None else group.members
        drives = filter(None, map(self.requests.drives.find, names))
        return any(drive.family.is_secret(code) for drive in drives)

    def means_stop(self, target: str, code: Code, value: Decimal | int | str) -> bool:
        """Whether a plain write would stop a drive, or each of a group."""
        wires = self._wires(target, code, value)
        return wires is not None and all(
            asks_to_stop(drive.family, code, wire) for drive, wire in wires
        )

    def is_setting(self, target: str, code: Code, value: Decimal | int | str) -> bool:
        """Whether a write changes a setting of a drive, or of each of a group, and no more."""
        wires = self._wires(target, code, value)
        return wires is not None and all(
            use_of(drive.family, code, wire) is Use.SETTING for drive, wire in wires
        )

    def on_the_wire(self, target: str, code: Code, value: Decimal | int | str) -> str:
        """Return what a write sends, for people; as given where drives differ or refuse it."""
        wires = self._wires(target, code, value)
        texts = {wire.raw for _, wire in wires or ()}
        return texts.pop() if len(texts) == 1 else str(value)

    def _wires(
        self, target: str, code: Code, value: Decimal | int | str
    ) -> list[tuple[Drive, Value]] | None:
        """Encode a value for a drive, or for each of a group; None: a write of it is refused."""
        group = self.groups.get(target)
        found: list[tuple[Drive, Value]] = []
        for name in (target,) if group is None else group.members:
            drive = self.requests.drives.find(name)
            if drive is None:
                return None
            reading = self.store.reading(name, code)
            last_read = None if reading is None else reading.value
            try:
                wire = encode_for(drive.family, code, value, last_read=last_read)
            except CodeValueError:
                return None  # with the reason
            found.append((drive, wire))
        return found

    def is_command(self, drive: str, code: Code) -> bool:
        """Whether writing a code of a drive can move it; also if nothing is known of it."""
        found = self.requests.drives.find(drive)
        return found is None or found.family.is_command(code)

    def control_word(self, drive: str) -> ControlWord:
        """Return the control word of a drive; one that left the roster has none that is known."""
        found = self.requests.drives.find(drive)
        return ControlWord(self.clock) if found is None else found.control_word

    def lasting(self, drive: str) -> LastingRecord:
        """Return what counts for a drive with any entry, also after it left the roster."""
        return self.requests.drives.lasting(drive)

    def silence_of(self, station: Station) -> int:
        """Return how little a drive answers: 0 online, 1 not known yet, 2 offline."""
        state = self.store.state(station.name)
        return 2 if state is DriveState.OFFLINE else int(state is not DriveState.ONLINE)

    async def see_stops(
        self, target: str, code: Code, value: Decimal | int | str | None = None
    ) -> None:
        """Have latched drives show their stops, where a write depends on them (`held_stops`).

        Args:
            target: The drive or group that is to be written to.
            code: What is to be written; only a setpoint, a setting that acts on setpoints, or one
                of control depends on a stop.
            value: The value; a write that stops drives waits for nothing. None: no such write.
        """
        group = self.groups.get(target)
        found = [
            drive.station
            for name in ((target,) if group is None else group.members)
            if (drive := self.requests.drives.find(name)) is not None
            and (info := drive.family.info(code)) is not None
            and (info.motion or info.control_source or acts_on_setpoints(drive.family, code))
            and self.leases.needs_stop_shown(name)
        ]
        if not found or (value is not None and self.means_stop(target, code, value)):
            return  # without a pause: what is asked for first is submitted first
        async with anyio.create_task_group() as tasks:
            for station in found:
                tasks.start_soon(self._see_stops, station)

    async def _see_stops(self, station: Station) -> None:
        # A client that sends many setpoints must not keep its own enable from the line.
        if (under_way := self._looks.get(station.name)) is not None:
            await under_way.wait()
            return
        looked = self._looks[station.name] = anyio.Event()
        try:
            # What cannot be read is not shown: the write is refused then, with the reason.
            with contextlib.suppress(ExchangeError, LineError, OperationError, ScheduleError):
                await self.requests.read_known(station, held_stop_codes(station.family))
        finally:
            del self._looks[station.name]
            looked.set()

    def held_stops(self, drive: str) -> frozenset[StopAction]:
        """Return the stops of the line that a drive has shown within `SHOWN_WITHIN_S`.

        None while a verb is under way that may let it run: what it has written may not be known
        yet.
        """
        found = self.requests.drives.find(drive)
        if found is None or self.lasting(drive).verb is not None:
            return frozenset()
        family, values = found.family, {}
        for code in held_stop_codes(family):
            one = self.store.reading(drive, code)
            if one is None or one.value is None or self.store.is_outdated(drive, code):
                continue
            if one.quality is Quality.GOOD and (one.age_s or 0.0) <= SHOWN_WITHIN_S:
                values[code] = one.value
        return held_stops(Known(drive, family, values), found.control_word.said)

    def note_write(self, station: Station, code: Code, wire: Value) -> None:
        """Count a plain write that means to stop a drive, or may lift its inhibit.

        A verb under way must not undo the one, and a reset must not go on behind the other.
        """
        if asks_to_stop(station.family, code, wire):
            self.lasting(station.name).stop_written_at_s = self.clock()
            self.lasting(station.name).count_stop()
        elif self.control_word(station.name).moves(code):
            self.lasting(station.name).lifts += 1

    def note_stop(self, drive: str) -> None:
        """Count a stop of a drive; writes and verbs under way end behind it."""
        self.lasting(drive).count_stop()
        self.requests.note_stop(drive)

    def stop_mark(self, drive: str) -> str:
        """Return a mark of this run and this drive that its next stop outdates."""
        return f"{self._run}-{drive}-{self.requests.stops_said(drive)}"

    def is_outdated(self, drive: str, mark: str) -> bool:
        """Whether a stop of the drive came after a mark that was taken in this run."""
        return mark != self.stop_mark(drive)

    def why_outdated(self, drive: str, mark: str) -> str:
        """Return why a mark that a client gave does not allow a write; empty if it does.

        Of another run it is not known whether a stop came since, so it does not.

        Raises:
            OperationError: `bad-request`: it is no mark of this drive.
        """
        match = MARK.fullmatch(mark)
        if match is None or match["drive"] != drive:
            raise OperationError(
                f"stops is {mark!r}, which is no mark of {drive}: nothing was sent",
                kind="bad-request",
                drive=drive,
                remedy=f"send `stops` as `GET /v1/drives/{drive}/restore` gives it",
            )
        if match["run"] != self._run:
            return OTHER_RUN
        return STOPPED if self.is_outdated(drive, mark) else ""
