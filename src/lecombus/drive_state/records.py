"""What the store keeps of line, drives and each of their codes, and changes as the line works.

Mutable on purpose: each exchange writes them. Only the store keeps them; other modules get the
frozen snapshots of `readings`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from lecombus.drive_state.readings import ActiveFault, DriveState, LineState

if TYPE_CHECKING:
    from lecombus.drives import CodeInfo, Family
    from lecombus.parameters import Code, Value

__all__ = ["Cell", "DriveRecord", "LineRecord", "make_cell", "set_remark"]


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
