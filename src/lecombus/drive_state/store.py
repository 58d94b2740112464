"""What is known about the line, its drives and their values, at any moment.

`supervision.exchange_recorder` writes values here (`value_read`, `value_failed`), health and
supervisor write states and remarks, and all interfaces read. Strategy: one mutable cell per drive
and code, so that the write behind every exchange is two dictionary look-ups and three assignments;
quality, age and time of day are calculated only for a request, from the state at that time
(`judging`). So an old value cannot pass for a fresh one: no code has to mark it.

Everything runs on one event loop thread: there are no locks. Memory is bounded: besides the
cyclic codes a drive keeps at most `ON_DEMAND_LIMIT` codes, the first asked for going first.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from lecombus.drive_state.judging import (
    Cell,
    DriveRecord,
    Judge,
    LineRecord,
    is_before_command,
    make_cell,
    set_remark,
)
from lecombus.drive_state.motion import Doing, Lapse, Motion, motion_of, setpoint_codes
from lecombus.drive_state.readings import (
    ADDRESSING_LOCK,
    WRITTEN_SINCE,
    ActiveFault,
    DriveInfo,
    DriveState,
    LineInfo,
    LineState,
    Quality,
    Reading,
)
from lecombus.drives import StopAction
from lecombus.errors import OperationError, meant
from lecombus.roster import ON_DEMAND_GOOD_S

if TYPE_CHECKING:
    from lecombus.drives import Family
    from lecombus.parameters import Code, Value

__all__ = [
    "ON_DEMAND_LIMIT",
    "DriveChanged",
    "DriveInfo",
    "DriveState",
    "Event",
    "LineChanged",
    "LineInfo",
    "LineState",
    "Quality",
    "Reading",
    "Store",
    "ValueChanged",
]

ON_DEMAND_LIMIT: Final = 1000
"""Codes kept per drive beyond its cyclic ones: a whole backup of a drive fits, a scan does not."""


@dataclass(frozen=True, slots=True)
class ValueChanged:
    """A code was read or an attempt failed; `Store.reading` says what is known now."""

    drive: str
    code: Code


@dataclass(frozen=True, slots=True)
class DriveChanged:
    """A drive's state, reason or remarks changed."""

    drive: str


@dataclass(frozen=True, slots=True)
class LineChanged:
    """The line's state, reason or remarks changed."""


Event = ValueChanged | DriveChanged | LineChanged
Subscriber = Callable[[Event], None]


class Store:
    """Everything known about one line.

    Args:
        clock: The monotonic clock that `at_s` of every write is read from, seconds.
        wall: The time of day, Unix seconds.
        fresh_for_s: How long a value that is not read cyclically counts as fresh, seconds.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        wall: Callable[[], float],
        *,
        fresh_for_s: float = ON_DEMAND_GOOD_S,
    ) -> None:
        self._clock = clock
        self._wall = wall
        self._drives: dict[str, DriveRecord] = {}
        self._line = LineRecord(wall())
        self._judge = Judge(self._line, clock, wall, fresh_for_s=fresh_for_s)
        self._subscribers: tuple[Subscriber, ...] = ()
        self.changes = 0
        """Counts the changes that make a written page wrong: all except new readings of a value."""

    # -- what is on the line -------------------------------------------------------------------

    def add_drive(self, name: str, address: int, family: Family) -> None:
        """Make a drive known.

        What is known of a drive of the same name stays if it is the same device (address and
        family), so that a reloaded roster does not blank the values.
        """
        old = self._drives.get(name)
        if old is not None and (old.address, old.family.name) == (address, family.name):
            old.family = family
            return
        self._drives[name] = DriveRecord(name, address, family, self._wall())
        self._publish(DriveChanged(name))

    def take_family(self, name: str, family: Family) -> None:
        """Take a drive by another description of its family, such as a signal configuration's."""
        record = self._record(name)
        record.family = family
        self._publish(DriveChanged(name))

    def remove_drive(self, name: str) -> None:
        """Forget a drive and its values; unknown names are ignored."""
        if self._drives.pop(name, None) is not None:
            self._publish(DriveChanged(name))

    def expect(self, drive: str, code: Code, every_s: float | None) -> None:
        """Say how often a code is read cyclically, which decides when it is stale.

        Args:
            drive: The drive's name.
            code: Code and subcode.
            every_s: The period, seconds; None when it is no longer read cyclically.
        """
        record = self._record(drive)
        cell = record.cells.get(code) or self._new_cell(record, code)
        cell.every_s = every_s
        if every_s is None:
            record.on_demand[code] = None
        else:
            record.on_demand.pop(code, None)

    def set_stretch(self, stretch: float) -> None:
        """Say how far the cyclic reads were stretched of late, 1 or more; it is only shown."""
        self._line.stretch = max(1.0, stretch)

    def plan_stretch(self, stretch: float) -> None:
        """Say how far the plan of the roster stretches them, 1 or more: values are judged by it."""
        self._line.planned_stretch = max(1.0, stretch)

    # -- what `StoreRecord` says of exchanges ----------------------------------------------------

    def value_read(self, drive: str, code: Code, value: Value, at_s: float) -> None:
        """Keep a value just read. Costs about a microsecond: it stands behind every exchange.

        Args:
            drive: The drive's name.
            code: Code and subcode.
            value: What the drive answered.
            at_s: When the answer came, by the store's monotonic clock.

        Raises:
            KeyError: The drive was never added: a programming error.
        """
        record = self._drives[drive]
        cell = record.cells.get(code)
        if cell is None:
            cell = self._new_cell(record, code)
        cell.value = value
        cell.at_s = at_s
        cell.failure = None
        if self._subscribers:
            self._publish(ValueChanged(drive, code))

    def value_failed(self, drive: str, code: Code, reason: str) -> None:
        """Keep that an attempt to read failed; the last value stays visible as bad."""
        record = self._drives[drive]
        cell = record.cells.get(code)
        if cell is None:
            cell = self._new_cell(record, code)
        cell.failure = reason
        self.changes += 1
        if self._subscribers:
            self._publish(ValueChanged(drive, code))

    def value_written(self, drive: str, code: Code, at_s: float) -> None:
        """Keep that a code was written: what was read of it before is true no longer.

        After a command that stops a drive or lets it go (C0040, C0135) neither is what its status
        words said of that.

        Args:
            drive: The drive's name.
            code: Code and subcode.
            at_s: When the write ended, by the store's monotonic clock.
        """
        record = self._drives[drive]
        if any(rule.code == code for rule in record.family.stops.values()):
            record.commanded_s = at_s
            self.changes += 1
        cell = record.cells.get(code)
        if cell is not None and cell.value is not None:
            cell.failure = WRITTEN_SINCE
            self.changes += 1
            if self._subscribers:
                self._publish(ValueChanged(drive, code))

    def is_outdated(self, drive: str, code: Code) -> bool:
        """Say whether what is known of a code is from before a write or a command that changes it.

        Raises:
            OperationError: `no-such-drive`.
        """
        record = self._record(drive)
        cell = record.cells.get(code)
        if cell is None or cell.value is None:
            return True
        return cell.failure == WRITTEN_SINCE or is_before_command(record, cell)

    def is_from_before_lapse(self, drive: str, code: Code) -> bool:
        """Say whether what is known of a code is from before the last lapse of the watchdog.

        Raises:
            OperationError: `no-such-drive`.
        """
        record = self._record(drive)
        cell = record.cells.get(code)
        if cell is None or cell.value is None:
            return True
        return record.lapsed_s is not None and cell.at_s < record.lapsed_s

    def write_taken(self, drive: str, code: Code, value: Value, at_s: float) -> None:
        """Keep a write that the drive has acknowledged: of a setpoint, or of its quick stop."""
        record = self._drives[drive]
        if code in setpoint_codes(record.family):
            record.setpoints[code] = (value, at_s)
        rule = record.family.stops.get(StopAction.QUICK_STOP)
        if rule is not None and rule.code == code:
            record.quick_stop_taken_s = at_s

    def watchdog_lapsed(self, drive: str, at_s: float, *, quick_stops: bool) -> None:
        """Keep that the drive was silent for its watchdog's time, which may have acted.

        Args:
            drive: The drive's name.
            at_s: What was read before is from before that, monotonic seconds.
            quick_stops: What its watchdog does is a quick stop.

        Raises:
            KeyError: The drive was never added: a programming error.
        """
        record = self._drives[drive]
        record.lapsed_s, record.lapse_quick_stops = at_s, quick_stops
        self.changes += 1

    def drive_state(self, drive: str, state: DriveState, reason: str = "") -> None:
        """Set how a drive is doing; `since` moves only when the state changes."""
        record = self._record(drive)
        if (record.state, record.reason) == (state, reason):
            return
        if record.state is not state:
            record.since_s = self._wall()
        record.state = state
        record.reason = reason
        self._publish(DriveChanged(drive))

    def line_state(self, state: LineState, reason: str = "") -> None:
        """Set how the line is doing; `since` moves only when the state changes."""
        line = self._line
        if (line.state, line.reason) == (state, reason):
            return
        if line.state is not state:
            line.since_s = self._wall()
        line.state = state
        line.reason = reason
        self._publish(LineChanged())

    def note(self, drive: str, key: str, text: str | None) -> None:
        """Set or clear a standing remark about a drive, such as a watchdog that differs."""
        if set_remark(self._record(drive).remarks, key, text):
            self._publish(DriveChanged(drive))

    def set_fault(self, drive: str, fault: ActiveFault | None) -> None:
        """Set or clear the fault a drive has."""
        record = self._record(drive)
        if record.fault != fault:
            record.fault = fault
            self._publish(DriveChanged(drive))

    def identify(self, drive: str, identity: dict[str, str]) -> None:
        """Keep what a drive says of itself, by code."""
        self._record(drive).identity = identity
        self._publish(DriveChanged(drive))

    def note_line(self, key: str, text: str | None) -> None:
        """Set or clear a standing remark about the line, such as a stretched cadence."""
        if set_remark(self._line.remarks, key, text):
            self._publish(LineChanged())

    # -- what the faces ask ------------------------------------------------------------------------

    def reading(self, drive: str, code: Code) -> Reading | None:
        """Return what is known of a code, or None if the drive was never asked for it.

        Raises:
            OperationError: `no-such-drive`.
        """
        record = self._record(drive)
        cell = record.cells.get(code)
        return None if cell is None else self._judge.reading(record, cell, self._clock())

    def is_cyclic(self, drive: str, code: Code) -> bool:
        """Return whether a code is read cyclically.

        Raises:
            OperationError: `no-such-drive`.
        """
        cell = self._record(drive).cells.get(code)
        return cell is not None and cell.every_s is not None

    def unread(self, drive: str, code: Code) -> Reading:
        """Return the reading of a code that was never asked for, without keeping it.

        Raises:
            OperationError: `no-such-drive`.
        """
        record = self._record(drive)
        return self._judge.reading(record, make_cell(record.family, code), self._clock())

    def readings(self, drive: str, *, cyclic_only: bool = False) -> list[Reading]:
        """Return everything known of a drive's values, cyclic codes first.

        Args:
            drive: The drive's name.
            cyclic_only: Leave out codes that are not read cyclically.

        Raises:
            OperationError: `no-such-drive`.
        """
        record = self._record(drive)
        now_s = self._clock()
        cyclic = [cell for cell in record.cells.values() if cell.every_s is not None]
        rest = [] if cyclic_only else [record.cells[code] for code in record.on_demand]
        return [self._judge.reading(record, cell, now_s) for cell in cyclic + rest]

    def codes(self, drive: str) -> tuple[Code, ...]:
        """Return the codes something is known of, cyclic ones first.

        To get many readings without blocking the loop, ask for them one by one.

        Raises:
            OperationError: `no-such-drive`.
        """
        record = self._record(drive)
        cyclic = (code for code, cell in record.cells.items() if cell.every_s is not None)
        return (*cyclic, *record.on_demand)

    def drive(self, drive: str) -> DriveInfo:
        """Return how a drive is doing; offline while the line is not open.

        Raises:
            OperationError: `no-such-drive`.
        """
        return self._judge.drive(self._record(drive))

    def state(self, drive: str) -> DriveState:
        """Return a drive's state alone, which costs far less than all of `drive`.

        Raises:
            OperationError: `no-such-drive`.
        """
        return self._judge.state(self._record(drive))

    def motion(self, drive: str, *, since_s: float = -math.inf) -> Motion:
        """Return what a drive does with its motor, as far as that is known.

        Args:
            drive: The drive's name.
            since_s: What was read before does not count, nor a fault shown before, monotonic
                seconds.

        Raises:
            OperationError: `no-such-drive`.
        """
        record = self._record(drive)
        if ADDRESSING_LOCK in record.remarks:
            return Motion(Doing.UNKNOWN)  # what its codes read is not what was asked for
        now_s = self._clock()

        def known(code: Code) -> Reading | None:
            cell = record.cells.get(code)
            if cell is None:
                return None
            reading = self._judge.reading(record, cell, now_s)
            if is_before_command(record, cell) or cell.at_s < since_s:
                return replace(reading, quality=Quality.BAD, reason=WRITTEN_SINCE)
            return reading

        written = [
            self._judge.reading(record, replace(make_cell(record.family, code), value=value,
                                                at_s=at_s), now_s)
            for code, (value, at_s) in record.setpoints.items()
        ]  # fmt: skip
        lapse = None
        if record.lapsed_s is not None:
            is_written = (record.quick_stop_taken_s or 0.0) > record.lapsed_s
            may_quick_stop = record.lapse_quick_stops and not is_written
            lapse = Lapse(max(0.0, now_s - record.lapsed_s), may_quick_stop=may_quick_stop)
        fault = record.fault if since_s == -math.inf else None  # a word read since shows one too
        return motion_of(record.family, fault, known, written, lapse)

    def drives(self) -> list[DriveInfo]:
        """Return how every drive is doing, in the order they were added."""
        return [self._judge.drive(record) for record in self._drives.values()]

    def names(self) -> tuple[str, ...]:
        """Return the names of the drives, in the order they were added."""
        return tuple(self._drives)

    def family(self, drive: str) -> Family:
        """Return the family of a drive.

        Raises:
            OperationError: `no-such-drive`.
        """
        return self._record(drive).family

    def line(self) -> LineInfo:
        """Return how the line is doing."""
        return self._judge.line()

    def time_of_day(self) -> float:
        """Return what time it is, Unix seconds."""
        return self._wall()

    def subscribe(self, subscriber: Subscriber) -> None:
        """Call `subscriber` after every change; it must return immediately and never raise.

        `supervision.event_sources` subscribes while events are read.
        """
        self._subscribers = (*self._subscribers, subscriber)

    def unsubscribe(self, subscriber: Subscriber) -> None:
        """Stop calling `subscriber`; unknown ones are ignored."""
        self._subscribers = tuple(one for one in self._subscribers if one != subscriber)

    # -- inside ------------------------------------------------------------------------------------

    def _publish(self, event: Event) -> None:
        if type(event) is not ValueChanged:
            self.changes += 1
        for subscriber in self._subscribers:
            subscriber(event)

    def _record(self, drive: str) -> DriveRecord:
        record = self._drives.get(drive)
        if record is None:
            raise no_such_drive(drive, tuple(self._drives))
        return record

    def _new_cell(self, record: DriveRecord, code: Code) -> Cell:
        if len(record.on_demand) >= ON_DEMAND_LIMIT:
            oldest = next(iter(record.on_demand))
            del record.on_demand[oldest]
            del record.cells[oldest]
        cell = make_cell(record.family, code)
        record.cells[code] = cell
        record.on_demand[code] = None
        return cell


def no_such_drive(name: str, known: tuple[str, ...]) -> OperationError:
    """Return the error for an unknown drive, with the nearest name there is."""
    return OperationError(
        f"there is no drive {name}",
        kind="no-such-drive",
        drive=name,
        remedy=meant(name, known, "the drives"),
    )
