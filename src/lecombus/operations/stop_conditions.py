"""What a write needs of a drive's stops: that none came since, and that a latched drive shows one.

Stops and plain writes that mean one are counted as they are submitted; a mark of the count says
later whether a stop came. What a latched drive shows is read before the write (ADR 79).
"""

from __future__ import annotations

import contextlib
import re
import secrets
from collections.abc import Callable
from decimal import Decimal
from typing import Final

import anyio

from lecombus.drive_state.readings import Quality
from lecombus.drive_state.store import Store
from lecombus.drives import StopAction, asks_to_stop
from lecombus.drives.verb_facts import Known
from lecombus.drives.verbs import acts_on_setpoints, held_stop_codes, held_stops, may_move
from lecombus.errors import ExchangeError, LineError, OperationError, ScheduleError
from lecombus.fieldbus.requests import Station
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.lease_operations import Leases
from lecombus.operations.write_kinds import WriteKinds
from lecombus.parameters import Code, Value
from lecombus.schedule.request import STOPPED

__all__ = ["ShownStops", "StopMarks"]

SHOWN_WITHIN_S: Final = 2.0
"""So long before a write that depends on it a drive must have shown its stop, seconds."""

MARK: Final = re.compile(r"(?P<run>[0-9a-f]{8})-(?P<drive>[a-z0-9_-]+)-[0-9]{1,15}")
"""A mark of stops, as `StopMarks.mark` makes it."""

OTHER_RUN: Final = (
    "lecombus was started again since it was asked which stops there were: whether the drive was "
    "stopped since is not known"
)


class StopMarks:
    """Counts the stops of drives, and says of a mark whether a stop came since.

    Args:
        requests: Knows the drives.
        stopped: Told of each stop: the drive's name.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self, requests: Requests, stopped: Callable[[str], None], clock: Callable[[], float]
    ) -> None:
        self._requests = requests
        self._stopped = stopped
        self._clock = clock
        self._run = secrets.token_hex(4)

    def note_write(self, station: Station, code: Code, wire: Value) -> None:
        """Count a plain write that means to stop a drive, or may lift its inhibit.

        A verb under way must not undo the one, and a reset must not go on behind the other.
        """
        drive = self._requests.drives.find(station.name)
        lasting = self._requests.drives.lasting(station.name)
        if asks_to_stop(station.family, code, wire):
            lasting.stop_written_at_s, lasting.stop_write_done = self._clock(), None
            lasting.count_stop()
            self._stopped(station.name)
            lasting.stop_writes += drive is None or not drive.control_word.repeats(code, wire)
        elif drive is not None and drive.control_word.moves(code):
            lasting.lifts += 1

    def note_stop(self, drive: str) -> None:
        """Count a stop of a drive; writes and verbs under way end behind it."""
        self._requests.drives.lasting(drive).count_stop()
        self._stopped(drive)
        self._requests.note_stop(drive)

    def mark(self, drive: str) -> str:
        """Return a mark of this run and this drive that its next stop outdates."""
        return f"{self._run}-{drive}-{self._requests.stops_said(drive)}"

    def is_outdated(self, drive: str, mark: str) -> bool:
        """Whether a stop of the drive came after a mark that was taken in this run."""
        return mark != self.mark(drive)

    def before_write(self, station: Station, code: Code) -> Callable[[], bool]:
        """Return what says whether a plain write was to stop the drive since, and counts here.

        It does for a write that can move the drive: that must not follow the stop. A stop that was
        only said again does not count: the write was asked for behind it.
        """
        lasting = self._requests.drives.lasting(station.name)
        before = lasting.stop_writes
        moves = may_move(station.family, code)
        return lambda: moves and lasting.stop_writes != before

    def why_outdated(self, drive: str, mark: str) -> str:
        """Return why a mark that a client gave does not allow a write; empty if it does.

        Of another run it is not known whether a stop came since, so it does not.

        Raises:
            OperationError: `bad-request`: it is not a mark of this drive.
        """
        match = MARK.fullmatch(mark)
        if match is None or match["drive"] != drive:
            raise OperationError(
                f"stops is {mark!r}, which is not a mark of {drive}: nothing was sent",
                kind="bad-request",
                drive=drive,
                remedy=f"send `stops` as `GET /v1/drives/{drive}/restore` gives it",
            )
        if match["run"] != self._run:
            return OTHER_RUN
        return STOPPED if self.is_outdated(drive, mark) else ""


class Look:
    """A reading of a drive's stops for all writes that wait for it.

    Attributes:
        ended: Set when it has ended.
        is_whole: It was not cancelled with the write that began it: the others need no other one.
    """

    def __init__(self) -> None:
        self.ended = anyio.Event()
        self.is_whole = False


class ShownStops:
    """The stops that latched drives show, which some writes to them depend on.

    Args:
        requests: Reads what shows them.
        store: What was read last.
        leases: Which drives are latched.
        kinds: What is written.
    """

    def __init__(self, requests: Requests, store: Store, leases: Leases, kinds: WriteKinds) -> None:
        self._requests = requests
        self._store = store
        self._leases = leases
        self._kinds = kinds
        self._looks: dict[str, Look] = {}  # by drive whose stops are being read

    async def see(self, target: str, code: Code, value: Decimal | int | str | None = None) -> None:
        """Have latched drives show their stops, where a write depends on them (`held`).

        Args:
            target: The drive or group that is to be written to.
            code: What is to be written; only a setpoint, a setting that acts on setpoints, or one
                of control depends on a stop.
            value: The value; a write that stops drives waits for nothing. None: no such write.
        """
        found = [
            drive.station
            for name in self._kinds.drive_names(target)
            if (drive := self._requests.drives.find(name)) is not None
            and (info := drive.family.info(code)) is not None
            and (info.motion or info.control_source or acts_on_setpoints(drive.family, code))
            and self._leases.needs_stop_shown(name)
        ]
        if not found or (value is not None and self._kinds.is_stop(target, code, value)):
            return  # without a pause: what is asked for first is submitted first
        async with anyio.create_task_group() as tasks:
            for station in found:
                tasks.start_soon(self._see, station)

    async def _see(self, station: Station) -> None:
        # A client that sends many setpoints must not keep its own enable from the line.
        while (under_way := self._looks.get(station.name)) is not None:
            await under_way.ended.wait()
            if under_way.is_whole:
                return
        look = self._looks[station.name] = Look()
        try:
            # What cannot be read is not shown: the write is refused then, with the reason.
            with contextlib.suppress(ExchangeError, LineError, OperationError, ScheduleError):
                await self._requests.read_known(station, held_stop_codes(station.family))
            look.is_whole = True
        finally:
            del self._looks[station.name]
            look.ended.set()

    def held(self, drive: str) -> frozenset[StopAction]:
        """Return the stops of the line that a drive has shown within `SHOWN_WITHIN_S`.

        None while an enable or a reset is under way, which may let it run: what it has written may
        not be known yet.
        """
        found = self._requests.drives.find(drive)
        if found is None or self._requests.drives.lasting(drive).alone:
            return frozenset()
        family, values = found.family, {}
        for code in held_stop_codes(family):
            one = self._store.reading(drive, code)
            if one is None or one.value is None or self._store.is_outdated(drive, code):
                continue
            if one.quality is Quality.GOOD and (one.age_s or 0.0) <= SHOWN_WITHIN_S:
                values[code] = one.value
        return held_stops(Known(drive, family, values), found.control_word.said)
