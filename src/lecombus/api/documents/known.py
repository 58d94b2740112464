"""What is known: readings, drives, the line, groups."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lecombus.api.documents.common import Document, Exact, Scalar

__all__ = [
    "DriveDocument",
    "DrivesDocument",
    "FaultDocument",
    "GroupDocument",
    "GroupsDocument",
    "HeardDocument",
    "LineDocument",
    "MotionDocument",
    "ReadingDocument",
    "RestoreDocument",
    "SpeedDocument",
    "StopShownDocument",
]


class ReadingDocument(Document):
    """One value with its age and quality."""

    drive: str
    code: Annotated[str, Field(examples=["C0046"])]
    subcode: int
    name: Annotated[str, Field(description="Empty where no description knows the code")]
    value: Annotated[Scalar, Field(description="Decimals exactly, words as integers, bytes as hex")]
    raw: Annotated[str | None, Field(description="As on the wire, with its format letter")]
    format: Annotated[str | None, Field(description="VD, VH, VS or VO")]
    unit: str | None
    quality: Annotated[str, Field(description="good, stale or bad")]
    reason: Annotated[str | None, Field(description="Why it is not good")]
    time: Annotated[str | None, Field(description="When it was read, RFC 3339")]
    age_s: Exact | None
    text: Annotated[str | None, Field(description="What the value means, where that is described")]


class FaultDocument(Document):
    """The fault a drive has, as its status words show it."""

    number: Annotated[int | None, Field(description="LECOM number; null while it is not known")]
    keypad: Annotated[str | None, Field(description="What the keypad shows", examples=["OH"])]
    kind: Annotated[str, Field(description="trip, message or warning")]
    meaning: str | None
    cause: str | None
    remedy: str | None
    since: str
    shown_by: Annotated[str, Field(examples=["C0150 reads H0898"])]
    stale: Annotated[bool, Field(description="The drive has not been heard since")]


class StopShownDocument(Document):
    """One thing that stops a drive."""

    name: Annotated[str, Field(examples=["quick-stop", "inhibited", "trip"])]
    text: str
    shown_by: Annotated[list[str], Field(examples=[["C0135 reads H0008"]])]


class SpeedDocument(Document):
    """A speed, actual or wanted, as last known."""

    code: str
    value: Scalar
    raw: str | None
    unit: str | None
    age_s: Exact | None
    stale: bool
    known_by: Annotated[str, Field(description="read, or written and acknowledged")]


class MotionDocument(Document):
    """Whether a drive runs, as far as that is known."""

    doing: Annotated[
        str,
        Field(
            description="running; stopping: in a quick stop and not at 0 yet; stopped: something "
            "keeps it from driving its motor, which may coast; enabled: nothing does, its speed "
            "is reported as 0 or not told; unknown"
        ),
    ]
    stops: Annotated[list[StopShownDocument], Field(description="What stops it")]
    speed: Annotated[SpeedDocument | None, Field(description="Output frequency")]
    zero: Annotated[bool | None, Field(description="It reports its speed as 0")]
    setpoint: SpeedDocument | None
    age_s: Annotated[Exact | None, Field(description="Of the oldest word this rests on")]
    stale: Annotated[bool, Field(description="As last known: its words are not fresh")]


class DriveDocument(Document):
    """One drive with everything known of it."""

    drive: str
    address: int
    family: str
    state: Annotated[str, Field(description="starting, online, degraded or offline")]
    reason: str | None
    since: str
    states: Annotated[
        list[str] | None,
        Field(description="What its status words show; null while they are not known well"),
    ]
    fault: Annotated[FaultDocument | None, Field(description="Null: none is shown")]
    remarks: dict[str, str]
    identity: Annotated[dict[str, str], Field(description="What it said of itself, by code")]
    motion: MotionDocument
    values: list[ReadingDocument]


class DrivesDocument(Document):
    """Every drive."""

    drives: list[DriveDocument]


class LineDocument(Document):
    """The line."""

    line: str
    port: Annotated[str, Field(description="As in the roster")]
    baud: int
    state: Annotated[str, Field(description="closed, open or lost")]
    reason: str | None
    since: str
    stretch: Annotated[Exact, Field(description="1 when every cyclic read keeps its period")]
    remarks: dict[str, str]
    drives: Annotated[dict[str, int], Field(description="How many drives are in each state")]


class GroupDocument(Document):
    """One group of the roster."""

    group: str
    members: list[str]
    how: Annotated[str, Field(description="How a stop is sent: multicast or one-by-one")]
    multicast_address: int | None
    writes: Annotated[
        str,
        Field(
            description="How a write that is no stop is sent: multicast only where the roster says "
            "`multicast: yes`, else one-by-one"
        ),
    ]


class GroupsDocument(Document):
    """Every group."""

    groups: list[GroupDocument]


class HeardDocument(Document):
    """What came back from an address of which nothing is known."""

    address: int
    code: str
    subcode: int
    heard: Annotated[
        str,
        Field(description="value, no-such-code, transmission-error, silence, garbled or echo"),
    ]
    value: Scalar
    raw: str | None
    format: str | None
    received: Annotated[str | None, Field(description="What was no usable answer, as hex")]
    disturbances: Annotated[
        int, Field(description="How often the line carried something that was no answer")
    ]


class RestoreDocument(Document):
    """Whether a backup may be restored into a drive."""

    drive: str
    permitted: bool
    owned: Annotated[
        list[str], Field(description="Codes that lecombus sets from the roster, left alone")
    ]
    stops: Annotated[
        str,
        Field(description="Given back in each write of the restore: a stop said since ends it"),
    ]
    reason: Annotated[str | None, Field(description="Why it is not permitted")]
    remedy: Annotated[str | None, Field(description="What to do about it")]
