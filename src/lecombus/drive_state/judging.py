"""The quality of known values at this moment, and the state of drives.

How quality is decided, the first that fits:

1. the line is not open: `BAD`, because a dead line never shows fresh values;
2. never read: `BAD`, "not read yet", or why the attempt failed;
3. the last attempt failed, or what the drive answers is not what was asked for: `BAD` with its
   reason; the last value stays visible beside it;
4. the drive is offline: `STALE`;
5. older than allowed: `STALE`. A cyclic code may be twice its period (times the stretch that the
   plan of the roster gives, fourfold at most) plus 1 s old, however late the line or the daemon is
   at present; any other code 10 s, or what `fresh_for_s` says;
6. otherwise `GOOD`.

Nothing is stored beforehand: quality is calculated for each request, so that a value cannot stay
good because no code marked it as old.

What is judged are the records of the line, its drives and each of their codes. They are mutable on
purpose: each exchange writes them. Only the store keeps them; other modules get the frozen
snapshots of `readings`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from lecombus.drive_state.readings import (
    ADDRESSING_LOCK,
    NOT_CYCLIC,
    ActiveFault,
    DriveInfo,
    DriveState,
    LineInfo,
    LineState,
    Quality,
    Reading,
)
from lecombus.drives import OperatingState, believed_states, join_states
from lecombus.parameters import Code
from lecombus.roster import good_for_s

if TYPE_CHECKING:
    from lecombus.drives import CodeInfo, Family
    from lecombus.parameters import Value

__all__ = [
    "Cell",
    "DriveRecord",
    "Judge",
    "LineRecord",
    "is_before_command",
    "make_cell",
    "set_remark",
]


@dataclass(slots=True, eq=False)
class Cell:
    """What is known of one code of one drive. `value` None: never read."""

    code: Code
    info: CodeInfo | None
    name: str
    unit: str | None
    format: str | None
    every_s: float | None = None
    value: Value | None = None
    at_s: float = 0.0
    failure: str | None = None


@dataclass(slots=True, eq=False)
class DriveRecord:
    """What is known of one drive."""

    name: str
    address: int
    family: Family
    since_s: float
    state: DriveState = DriveState.STARTING
    reason: str = ""
    remarks: dict[str, str] = field(default_factory=dict)
    identity: dict[str, str] = field(default_factory=dict)
    cells: dict[Code, Cell] = field(default_factory=dict)
    on_demand: dict[Code, None] = field(default_factory=dict)
    fault: ActiveFault | None = None
    setpoints: dict[Code, tuple[Value, float]] = field(default_factory=dict)
    """Setpoints that were written and acknowledged, and when, monotonic seconds."""
    commanded_s: float | None = None
    """When something was last written that may stop the drive or let it go, monotonic seconds."""
    lapsed_s: float | None = None
    """Up to when the drive was silent for its watchdog's time, monotonic seconds."""
    lapse_quick_stops: bool = False
    """What its watchdog does then is a quick stop."""
    quick_stop_taken_s: float | None = None
    """When the drive last acknowledged a write of the code of its quick stop, monotonic seconds."""


@dataclass(slots=True, eq=False)
class LineRecord:
    """How the line is doing."""

    since_s: float
    state: LineState = LineState.CLOSED
    reason: str = ""
    stretch: float = 1.0
    planned_stretch: float = 1.0
    remarks: dict[str, str] = field(default_factory=dict)


def make_cell(family: Family, code: Code) -> Cell:
    """Return an empty cell with what the family's description says of the code."""
    info = family.info(code)
    if info is None:
        return Cell(code, None, "", None, None)
    return Cell(code, info, info.name, info.unit, info.format.value)


def set_remark(remarks: dict[str, str], key: str, text: str | None) -> bool:
    """Set or clear one remark; return whether that changed anything."""
    if remarks.get(key) == text:
        return False
    if text is None:
        del remarks[key]
    else:
        remarks[key] = text
    return True


OUTPUT: Final = Code(50)

CLOCK_STEP_S: Final = 0.02
"""The time of day is followed in steps of this, so that a value's time does not flicker."""


class Judge:
    """Judges what is known of one line.

    Args:
        line: How the line is doing.
        clock: The monotonic clock that values are dated by, seconds.
        wall: The time of day, Unix seconds.
        fresh_for_s: How long a value that is not read cyclically counts as fresh, seconds.
    """

    def __init__(
        self,
        line: LineRecord,
        clock: Callable[[], float],
        wall: Callable[[], float],
        *,
        fresh_for_s: float,
    ) -> None:
        self._line = line
        self._clock = clock
        self._wall = wall
        self._offset_s = wall() - clock()
        self._fresh_for_s = fresh_for_s

    def line(self) -> LineInfo:
        """Return a snapshot of the line."""
        line = self._line
        remarks = MappingProxyType(dict(line.remarks))
        return LineInfo(
            line.state, line.reason, line.since_s, line.stretch, line.planned_stretch, remarks
        )

    def reading(self, record: DriveRecord, cell: Cell, now_s: float) -> Reading:
        """Return what is known of a code, as good as it is now."""
        value = cell.value
        age_s = None if value is None else max(0.0, now_s - cell.at_s)
        quality, reason = self._quality(record, cell, age_s)
        return Reading(
            record.name,
            cell.code,
            cell.name,
            cell.unit,
            cell.format if value is None else value.format.value,
            value,
            quality,
            reason,
            None if value is None else self._time_of(cell.at_s, now_s),
            age_s,
            None if value is None or cell.info is None else meaning_of(cell.info, value),
        )

    def state(self, record: DriveRecord) -> DriveState:
        """Return a drive's state: offline while the line is not open."""
        return record.state if self._line.state is LineState.OPEN else DriveState.OFFLINE

    def drive(self, record: DriveRecord) -> DriveInfo:
        """Return a snapshot of a drive: no drive looks well over a line that is not there."""
        reason, since_s = record.reason, record.since_s
        if self._line.state is not LineState.OPEN:
            reason, since_s = self._why_no_line(), max(since_s, self._line.since_s)
        return DriveInfo(
            record.name,
            record.address,
            record.family.name,
            self.state(record),
            reason,
            since_s,
            MappingProxyType(dict(record.remarks)),
            MappingProxyType(dict(record.identity)),
            record.fault,
            self._states(record),
        )

    def _states(self, record: DriveRecord) -> tuple[OperatingState, ...] | None:
        """Join what the status words show, each only while its value is good.

        A word from before the last command does not count. None where the first of them does not:
        the others alone would leave a fault or an inhibit out, and a list without them looks like
        a drive without them.
        """
        shown: list[tuple[float, tuple[OperatingState, ...], frozenset[OperatingState]]] = []
        now_s = self._clock()
        for code, word in record.family.words.items():
            cell = record.cells.get(code)
            reading = None if cell is None else self.reading(record, cell, now_s)
            number = None if reading is None or reading.value is None else reading.value.number
            is_good = reading is not None and reading.quality is Quality.GOOD
            if (
                cell is not None
                and is_good
                and not is_before_command(record, cell)
                and type(number) is int
            ):
                shown.append((now_s - cell.at_s, word.shown_states(number), word.possible_states))
            elif not shown:
                return None
        return join_states(believed_states(shown)) if shown else None

    def _why_no_line(self) -> str:
        return with_cause(f"line {self._line.state.value}", self._line.reason)

    def _quality(
        self, record: DriveRecord, cell: Cell, age_s: float | None
    ) -> tuple[Quality, str | None]:
        """Decide by the rules of the module's docstring, in their order."""
        if self._line.state is not LineState.OPEN:
            return Quality.BAD, self._why_no_line()
        if ADDRESSING_LOCK in record.remarks:
            return Quality.BAD, "not what was asked for: see the drive's remarks"
        if cell.failure is not None:
            return Quality.BAD, cell.failure
        if age_s is None:
            return Quality.BAD, "not read yet"
        if record.state is DriveState.OFFLINE:
            return Quality.STALE, with_cause("drive offline", record.reason)
        if cell.every_s is None:
            if age_s > self._fresh_for_s:
                return Quality.STALE, f"read {age_s:.1f} s ago, {NOT_CYCLIC}"
            return Quality.GOOD, None
        allowed_s = good_for_s(cell.every_s, self._line.planned_stretch)
        if age_s > allowed_s:
            return Quality.STALE, f"read {age_s:.1f} s ago, {allowed_s:.1f} s allowed"
        return Quality.GOOD, None

    def _time_of(self, at_s: float, now_s: float) -> float:
        """Return the time of day of a moment on the monotonic clock, following clock steps."""
        offset_s = self._wall() - now_s
        if abs(offset_s - self._offset_s) > CLOCK_STEP_S:
            self._offset_s = offset_s
        return at_s + self._offset_s


def is_before_command(record: DriveRecord, cell: Cell) -> bool:
    """Return whether a code was read before a command that may have changed what it shows.

    That counts for status words and the speed. A command is true until it is written itself.
    """
    code, commanded_s = cell.code, record.commanded_s
    is_effect = code in record.family.words or code == OUTPUT
    return is_effect and commanded_s is not None and cell.at_s <= commanded_s


def meaning_of(info: CodeInfo, value: Value) -> str | None:
    """Return what a value means in words, where its description gives that."""
    text = info.meaning(value)
    return None if text is None else text.en


def with_cause(what: str, cause: str) -> str:
    """Join what is the case and why, where there is a why."""
    return f"{what}: {cause}" if cause else what
