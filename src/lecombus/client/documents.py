"""What the daemon says is known, as frozen objects: readings, drives, the line, groups, why.

Strategy: every object is made from one JSON document and keeps it (`answer` or `document`), so
that what this library does not name is not lost. A key that a document lacks is empty or None: a
newer or an older daemon can be spoken with. Decimals are `decimal.Decimal`, exactly as the daemon
wrote them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from decimal import Decimal
from enum import StrEnum
from typing import Any

from lecombus.client.errors import ClientError

__all__ = [
    "Answer",
    "Document",
    "DriveStatus",
    "Finding",
    "GroupInfo",
    "LineStatus",
    "Quality",
    "Reading",
    "Why",
    "doing_of",
    "kind_of",
    "reading_of",
    "text_of",
]

Document = Mapping[str, Any]
"""A JSON object; its decimals are `Decimal`."""


class Quality(StrEnum):
    """How far a value may be trusted: `GOOD`, `STALE` (not refreshed in time), `BAD`."""

    GOOD = "good"
    STALE = "stale"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Answer:
    """One answer of the daemon.

    Args:
        text: The JSON document as it came.
        data: The same, read; decimals as `Decimal`.
        status: The HTTP status.
    """

    text: str
    data: Any
    status: int = 200


@dataclass(frozen=True, slots=True)
class Reading:
    """One value of one drive, with its age and its quality.

    Args:
        drive: The drive's name.
        code: `C0050`.
        subcode: 0 where there is none.
        name: What the code is called; empty where no description knows it.
        value: Decimals exactly, words as integers, text, or octets as hex; None: never read.
        raw: As on the wire, with its format letter, such as `H8678`.
        unit: Such as `Hz`; empty where it has none.
        quality: How far it may be trusted.
        reason: Why it is not good; empty when it is.
        time: When it was read; None: never.
        age_s: Its age when the daemon answered, seconds; None: never read.
        text: What the value means, such as `quick stop`; empty where that is not described.
        answer: The daemon's answer, where this reading is the whole of it.
    """

    drive: str
    code: str
    subcode: int
    name: str
    value: Decimal | int | str | None
    raw: str
    unit: str
    quality: Quality
    reason: str
    time: datetime | None
    age_s: float | None
    text: str
    answer: Answer | None = field(default=None, repr=False, compare=False)

    @classmethod
    def of(cls, document: Document, answer: Answer | None = None) -> Reading:
        """Return the reading that a document shows."""
        time, age_s = document.get("time"), document.get("age_s")
        return cls(
            drive=text_of(document, "drive"),
            code=text_of(document, "code"),
            subcode=int(document.get("subcode") or 0),
            name=text_of(document, "name"),
            value=document.get("value"),
            raw=text_of(document, "raw"),
            unit=text_of(document, "unit"),
            quality=quality_of(document),
            reason=text_of(document, "reason"),
            time=None if time is None else datetime.fromisoformat(str(time)),
            age_s=None if age_s is None else float(age_s),
            text=text_of(document, "text"),
            answer=answer,
        )

    @property
    def is_good(self) -> bool:
        """Whether it was read in time."""
        return self.quality is Quality.GOOD

    @property
    def number(self) -> Decimal:
        """The value for calculations: never an old one.

        Raises:
            ClientError: Its quality is not good, or it is not a number.
        """
        if not self.is_good:
            problem = f"{self.drive} {self.code} is {self.quality}: {self.reason}"
            raise ClientError(problem, kind=str(self.quality), drive=self.drive, code=self.code)
        if not isinstance(self.value, int | Decimal):
            problem = f"{self.drive} {self.code} is not a number but `{self.value}`"
            raise ClientError(problem, drive=self.drive, code=self.code)
        return Decimal(self.value)


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """One drive with all that is known of it; asking for it sends nothing to the line.

    Args:
        name: Its name in the roster.
        address: 1..99.
        family: Such as `8200vector`.
        state: `starting`, `online`, `degraded` or `offline`.
        reason: Why; empty where nothing needs saying.
        states: What its status words show now; None: not known well enough, so a state that is
            missing says nothing.
        doing: `running`, `stopping`, `stopped` (its motor may coast), `enabled` or `unknown`, also
            where that is only known from before, as of a silent drive: `document["motion"]` has it.
        fault: The fault that it shows now, with `number`, `kind`, `meaning`, `remedy` and more
            (docs/api.md); None: it shows none, which is only certain when `states` is not None.
        remarks: What stands to be said about it, by subject.
        values: Every value known.
        document: The daemon's document.
    """

    name: str
    address: int
    family: str
    state: str
    reason: str
    states: tuple[str, ...] | None
    doing: str
    fault: Document | None
    remarks: Mapping[str, str]
    values: tuple[Reading, ...]
    document: Document = field(repr=False, compare=False)

    @classmethod
    def of(cls, document: Document) -> DriveStatus:
        """Return the drive that a document shows."""
        states = document.get("states")
        return cls(
            name=text_of(document, "drive"),
            address=int(document.get("address") or 0),
            family=text_of(document, "family"),
            state=text_of(document, "state"),
            reason=text_of(document, "reason"),
            states=None if states is None else tuple(states),
            doing=doing_of(document.get("motion") or {}),
            fault=document.get("fault"),
            remarks=dict(document.get("remarks") or {}),
            values=tuple(Reading.of(one) for one in document.get("values") or ()),
            document=document,
        )


@dataclass(frozen=True, slots=True)
class LineStatus:
    """The line.

    Args:
        name: Its name in the roster.
        state: `open`, `lost` or `closed`.
        reason: Why; empty where nothing needs saying.
        drives: How many drives are in each state.
        remarks: What stands to be said about it, by subject.
        document: The daemon's document.
    """

    name: str
    state: str
    reason: str
    drives: Mapping[str, int]
    remarks: Mapping[str, str]
    document: Document = field(repr=False, compare=False)

    @classmethod
    def of(cls, document: Document) -> LineStatus:
        """Return the line that a document shows."""
        return cls(
            name=text_of(document, "line"),
            state=text_of(document, "state"),
            reason=text_of(document, "reason"),
            drives=dict(document.get("drives") or {}),
            remarks=dict(document.get("remarks") or {}),
            document=document,
        )


@dataclass(frozen=True, slots=True)
class GroupInfo:
    """A group of the roster.

    Args:
        name: Its name.
        members: Its drives.
        stops: How its stops are sent: `multicast` or `one-by-one`.
        writes: How everything else is sent: `multicast` or `one-by-one`.
    """

    name: str
    members: tuple[str, ...]
    stops: str
    writes: str

    @classmethod
    def of(cls, document: Document) -> GroupInfo:
        """Return the group that a document shows."""
        return cls(
            name=text_of(document, "group"),
            members=tuple(document.get("members") or ()),
            stops=text_of(document, "how"),
            writes=text_of(document, "writes"),
        )


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that bears on whether a drive turns.

    Args:
        name: A stable word for programs, such as `quick-stop-by-line`.
        weight: `reason` (keeps it from turning), `hint` (may) or `note`.
        text: What it is.
        remedy: What to do about it; empty where nothing is known.
        shown_by: What shows it, such as `C0135 reads H0008`.
        is_stale: As last known; the drive has been silent since.
    """

    name: str
    weight: str
    text: str
    remedy: str
    shown_by: str
    is_stale: bool


@dataclass(frozen=True, slots=True)
class Why:
    """Why a drive does not turn.

    Args:
        drive: The drive's name.
        answer: The answer in one sentence.
        findings: All that bears on it, the weightiest first.
        document: The daemon's document, with the fault memory and the last enable.
    """

    drive: str
    answer: str
    findings: tuple[Finding, ...]
    document: Document = field(repr=False, compare=False)

    @classmethod
    def of(cls, document: Document) -> Why:
        """Return the answer that a document shows."""
        findings = tuple(
            Finding(
                name=text_of(one, "name"),
                weight=text_of(one, "weight"),
                text=text_of(one, "text"),
                remedy=text_of(one, "remedy"),
                shown_by=text_of(one, "shown_by"),
                is_stale=bool(one.get("stale")),
            )
            for one in document.get("findings") or ()
        )
        return cls(text_of(document, "drive"), text_of(document, "answer"), findings, document)


def quality_of(document: Document) -> Quality:
    """Return the quality; a word that this library does not know is none to trust."""
    try:
        return Quality(text_of(document, "quality"))
    except ValueError:
        return Quality.BAD


def doing_of(motion: Document) -> str:
    """Return what a drive does, as far as that is known now."""
    return "unknown" if motion.get("stale") else text_of(motion, "doing") or "unknown"


def kind_of(document: Document) -> str:
    """Return the stable word of a problem document, the last part of its type; or nothing."""
    return text_of(document, "type").rpartition("/")[2].rpartition(":")[2]


def reading_of(document: Document) -> Reading | None:
    """Return what was read back, where something was."""
    found = document.get("reading")
    return None if found is None else Reading.of(found)


def text_of(document: Document, key: str) -> str:
    """Return a text; empty where there is none."""
    found = document.get(key)
    return "" if found is None else str(found)
