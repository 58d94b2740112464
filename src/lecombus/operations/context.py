"""What the operations of one line share: its drives and groups, and what is known of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from lecombus.config import DriveEntry, GroupEntry
from lecombus.drive_state.control_word import ControlWord
from lecombus.drive_state.readings import DriveState, Reading
from lecombus.drive_state.store import Store
from lecombus.errors import OperationError, meant
from lecombus.fieldbus.requests import Station
from lecombus.line_events import LineRequests
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.lease_operations import Leases
from lecombus.operations.nak_diagnosis import NakDiagnosis
from lecombus.operations.permissions import Permissions
from lecombus.operations.stop_conditions import ShownStops, StopMarks
from lecombus.operations.wear import Wear
from lecombus.operations.why import StandstillDiagnosis
from lecombus.operations.write_kinds import WriteKinds
from lecombus.parameters import Code
from lecombus.saved_state import State

__all__ = ["OperationContext"]


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
        kinds: What a write is before it is made.
        stop_marks: Whether a stop came since something was asked.
        shown_stops: The stops that latched drives show.
        lasting: Gives what counts for a drive with any entry, also after it left the roster.
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
        self.why = StandstillDiagnosis(requests, store, state, clock)
        self.kinds = WriteKinds(requests.drives, store, self.drive_names)
        self.stop_marks = StopMarks(requests, self.why.stopped, clock)
        self.shown_stops = ShownStops(requests, store, self.leases, self.kinds)
        self.leases.held_stops = self.shown_stops.held
        self.leases.is_silenced = requests.is_silenced
        self.lasting: Final = requests.drives.lasting

    def set_roster(self, entries: Sequence[DriveEntry], groups: Mapping[str, GroupEntry]) -> None:
        """Take the roster's drives and groups, at the start and at every reload."""
        self.entries = {entry.name: entry for entry in entries}
        self.groups = dict(groups)
        self.leases.set_roster(entries)
        self.why.set_roster(entries)

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

    def drive_names(self, target: str) -> Sequence[str]:
        """Return the names of a group's drives; any other name stands for itself."""
        group = self.groups.get(target)
        return (target,) if group is None else group.members

    def control_word(self, drive: str) -> ControlWord:
        """Return the control word of a drive; one that left the roster has none that is known."""
        found = self.requests.drives.find(drive)
        return ControlWord(self.clock) if found is None else found.control_word

    def last_reading(self, drive: str, code: Code) -> Reading | None:
        """Return what a code read last; None: nothing, or a reload has removed the drive since."""
        if self.requests.drives.find(drive) is None:
            return None
        return self.store.reading(drive, code)

    def stands_otherwise(self, station: Station, code: Code) -> bool:
        """Whether a drive shows the stop of a code that the line has not said, as far as is known.

        A terminal, the keypad or the watchdog holds it: it may let it go, and then the drive runs
        unless it has heard the line's stop itself.
        """
        said = self.control_word(station.name).said(code)
        for rule in station.family.stops.values():
            own = rule.proofs.get(code)
            if rule.code != code or (said is not None and own is not None and own.holds(said)):
                continue
            for shown_by, proof in rule.proofs.items():
                reading = self.last_reading(station.name, shown_by) if shown_by != code else None
                if reading is not None and reading.value and proof.holds(reading.value):
                    return True
        return False

    def silence_of(self, station: Station) -> int:
        """Return how little a drive answers: 0 online, 1 not known yet, 2 offline."""
        state = self.store.state(station.name)
        return 2 if state is DriveState.OFFLINE else int(state is not DriveState.ONLINE)
