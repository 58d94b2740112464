"""What the store returns: readings with their quality, drive and line states, and their JSON.

Strategy: frozen, slotted snapshots, made for each request and never changed afterwards. Each
knows its own JSON form (`as_json`), in which a decimal stays a `decimal.Decimal`; it must
be written as text exactly, never through a binary float. Times are Unix seconds here
and become RFC 3339 with milliseconds and `Z` only in the JSON form.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lecombus.drives import Fault, FaultKind, OperatingState
    from lecombus.parameters import Code, Json, Value

__all__ = [
    "ADDRESSING_LOCK",
    "ADDRESSING_MOVED",
    "IDENTITY_LOCK",
    "NOT_CYCLIC",
    "NO_SUCH_CODE",
    "SOFTWARE_LOCK",
    "ActiveFault",
    "DriveInfo",
    "DriveState",
    "LineInfo",
    "LineState",
    "Quality",
    "Reading",
    "json_value",
    "rfc3339",
]


class Quality(StrEnum):
    """How far a value may be trusted.

    `GOOD`: read in time. `STALE`: true once, not refreshed in time, or its drive is offline.
    `BAD`: never read, the last attempt failed, or the line is not there.
    """

    GOOD = "good"
    STALE = "stale"
    BAD = "bad"


class DriveState(StrEnum):
    """How a drive is doing: being audited, answering, answering badly, silent."""

    STARTING = "starting"
    ONLINE = "online"
    DEGRADED = "degraded"
    OFFLINE = "offline"


class LineState(StrEnum):
    """How the line is doing: not opened or shut down, in use, gone and being reopened."""

    CLOSED = "closed"
    OPEN = "open"
    LOST = "lost"


SOFTWARE_LOCK = "software"
IDENTITY_LOCK = "identity"
ADDRESSING_LOCK = "addressing"
ADDRESSING_MOVED = "addressing-moved"
"""The remark where extended addressing is used instead: writes go."""
WRITE_LOCKS = (IDENTITY_LOCK, SOFTWARE_LOCK, ADDRESSING_LOCK)
"""The remarks that let nothing but stops be written to a drive, for as long as one stands."""


WRITTEN_SINCE = "written since it was last read"
NO_SUCH_CODE = "the drive has no such code"
"""The reason of a value that may be another one by now."""


NOT_CYCLIC = "not read cyclically"
"""In the reason of a value that is stale only because it was not asked for again."""


@lru_cache(maxsize=256)
def second_text(second: int) -> str:
    """Return the part of an RFC 3339 time before the fraction; most values share a second."""
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(second))


def rfc3339(time_s: float) -> str:
    """Return a Unix time as text such as `2026-11-21T10:15:02.113Z`.

    Args:
        time_s: Seconds since 1970, UTC.
    """
    ms = round(time_s * 1000)
    return f"{second_text(ms // 1000)}.{ms % 1000:03d}Z"


def seconds(value_s: float) -> Decimal:
    """Return a duration for JSON: seconds, to the millisecond."""
    return Decimal(round(value_s * 1000)).scaleb(-3)


def json_value(value: Value) -> Decimal | int | str:
    """Return a value as JSON knows it: decimals exactly, words as integers, octets as hex."""
    number = value.number
    return number.hex() if isinstance(number, bytes) else number


@dataclass(frozen=True, slots=True)
class Reading:
    """One code of one drive, as far as it is known at the moment of asking.

    Args:
        drive: The drive's name.
        code: Code and subcode.
        name: What the family calls it; empty where no description knows it.
        unit: Its unit, where it has one.
        format: The wire format's name (`VD`, `VH`, `VS`, `VO`), where it is known.
        value: The last value read, also when it can no longer be trusted.
        quality: How far it can be.
        reason: Why it is not good.
        time_s: When it was read, Unix seconds.
        age_s: How long ago that was, seconds.
        text: What the value means, where its description gives that.
    """

    drive: str
    code: Code
    name: str
    unit: str | None
    format: str | None
    value: Value | None
    quality: Quality
    reason: str | None
    time_s: float | None
    age_s: float | None
    text: str | None = None

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form of a value, the same in HTTP and in commands."""
        value = self.value
        return {
            "drive": self.drive,
            "code": f"C{self.code.number:04d}",
            "subcode": self.code.subcode,
            "name": self.name,
            "value": None if value is None else json_value(value),
            "raw": None if value is None else value.raw,
            "format": self.format,
            "unit": self.unit,
            "quality": self.quality.value,
            "reason": self.reason,
            "time": None if self.time_s is None else rfc3339(self.time_s),
            "age_s": None if self.age_s is None else seconds(self.age_s),
            "text": self.text,
        }


@dataclass(frozen=True, slots=True)
class ActiveFault:
    """The fault a drive has, as its status words show it.

    Args:
        kind: TRIP, message or warning.
        number: Its LECOM number by the fault memory; None until that gave one that agrees.
        known: What the manual says of the number; None where it does not list it.
        since_s: Since when it is known to be there, Unix seconds.
        shown_by: The status words that show it, as read.
    """

    kind: FaultKind
    number: int | None
    known: Fault | None
    since_s: float
    shown_by: str

    def __str__(self) -> str:
        """Put it into words: `trip OH (50): heat sink too hot`."""
        if self.number is None:
            return f"{self.kind} of a number not known ({self.shown_by})"
        if self.known is None:
            return f"{self.kind} {self.number}, which the manual does not list ({self.shown_by})"
        keypad = f"{self.known.keypad} ({self.number})" if self.known.keypad else str(self.number)
        return f"{self.kind} {keypad}: {self.known.meaning}"

    def as_json(self, *, stale: bool) -> dict[str, Json]:
        """Return the JSON form; `stale`: the drive has not been heard since."""
        known = self.known
        return {
            "number": self.number,
            "keypad": (known.keypad if known is not None else "") or None,
            "kind": self.kind.value,
            "meaning": None if known is None else known.meaning.en,
            "cause": (known.cause.en if known is not None else "") or None,
            "remedy": None if known is None else known.remedy.en,
            "since": rfc3339(self.since_s),
            "shown_by": self.shown_by,
            "stale": stale,
        }


@dataclass(frozen=True, slots=True)
class DriveInfo:
    """One drive: where it is, how it is doing and since when.

    Args:
        name: Its name in the roster.
        address: 1..99.
        family: The family's name.
        state: How it is doing.
        reason: Why, in words; empty where nothing needs saying.
        since_s: Since when, Unix seconds.
        remarks: What stands to be said about it, by subject.
        fault: The fault it has, as far as it was last heard.
        identity: What it said of itself when it was last audited, by code.
        states: What its status words show now; None where they are not known well enough.
    """

    name: str
    address: int
    family: str
    state: DriveState
    reason: str
    since_s: float
    remarks: Mapping[str, str]
    identity: Mapping[str, str]
    fault: ActiveFault | None = None
    states: tuple[OperatingState, ...] | None = None

    @property
    def write_lock(self) -> str | None:
        """Why nothing but stops may be written to it; None where writes may go."""
        return next((self.remarks[key] for key in WRITE_LOCKS if key in self.remarks), None)

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form, without the drive's values."""
        return {
            "drive": self.name,
            "address": self.address,
            "family": self.family,
            "state": self.state.value,
            "reason": self.reason or None,
            "since": rfc3339(self.since_s),
            "states": None if self.states is None else [state.value for state in self.states],
            "fault": self.fault_json(),
            "remarks": dict(self.remarks),
            "identity": dict(self.identity),
        }

    def fault_json(self) -> Json:
        """Return the active fault's JSON form, or null."""
        if self.fault is None:
            return None
        return self.fault.as_json(stale=self.state is DriveState.OFFLINE)


@dataclass(frozen=True, slots=True)
class LineInfo:
    """The line: how it is doing, since when, and how far its cyclic reads are stretched.

    Args:
        state: How it is doing.
        reason: Why, in words; empty where nothing needs saying.
        since_s: Since when, Unix seconds.
        stretch: By what they were stretched of late: 1 when every cyclic read keeps its period, 2
            when each takes twice as long.
        planned_stretch: By what they are stretched if all drives answer, by the roster's plan: with
            it values become stale.
        remarks: What stands to be said about it, by subject.
    """

    state: LineState
    reason: str
    since_s: float
    stretch: float
    planned_stretch: float
    remarks: Mapping[str, str]

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form, without the line's name."""
        return {
            "state": self.state.value,
            "reason": self.reason or None,
            "since": rfc3339(self.since_s),
            "stretch": seconds(self.stretch),
            "planned_stretch": seconds(self.planned_stretch),
            "remarks": dict(self.remarks),
        }
