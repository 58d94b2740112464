"""What the answers look like: models for the OpenAPI document.

The answers themselves are written from the store (`lecombus.api.answers`), because passing every
value through a model costs more than everything else about a stored read. So that the two cannot
differ, the tests check real answers against these models.
"""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema

__all__ = [
    "AnswerTimeDocument",
    "BitDocument",
    "ChangedDriveDocument",
    "CodeDocument",
    "CodeWearDocument",
    "DescribedDocument",
    "Document",
    "DriveControlDocument",
    "DriveDocument",
    "DrivesDocument",
    "EndedLeaseDocument",
    "FaultDocument",
    "FindingDocument",
    "ForgottenTimesDocument",
    "GroupDocument",
    "GroupOutcomeDocument",
    "GroupsDocument",
    "HeardDocument",
    "HeldLeaseDocument",
    "IdentityDocument",
    "LastEnableDocument",
    "LeaseDocument",
    "LeasesDocument",
    "LineDocument",
    "MeaningDocument",
    "MemoryDocument",
    "MotionDocument",
    "OutcomeDocument",
    "OutputDocument",
    "PlanDocument",
    "ProblemDocument",
    "ProofDocument",
    "ReadingDocument",
    "ReloadDocument",
    "RestoreDocument",
    "SpeedDocument",
    "StatusDocument",
    "StopShownDocument",
    "VerbDocument",
    "WearDocument",
    "WhyDocument",
    "WrittenDocument",
]

Exact = Annotated[Decimal, WithJsonSchema({"type": "number"})]
Scalar = Annotated[
    int | Decimal | str | None,
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}, {"type": "null"}]}),
]


class Document(BaseModel):
    """The common rules."""

    model_config = ConfigDict(extra="forbid")


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
    zero: Annotated[
        bool | None,
        Field(description="Its output frequency is 0 (93XX: its speed); the motor may coast"),
    ]
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
    planned_stretch: Annotated[
        Exact, Field(description="`stretch` as the roster's plan gives it; values are judged by it")
    ]
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
            description="How a write that is not a stop is sent: multicast only where the roster "
            "says `multicast: yes`, else one-by-one"
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
    received: Annotated[str | None, Field(description="What was not a usable answer, as hex")]
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


IGNORED: Any = Field(description="Only for stops: what of the request was not looked at")


class ProofDocument(Document):
    """The reading that `verified` comes from."""

    code: str
    subcode: int
    raw: Annotated[str, Field(description="As on the wire")]
    shows: Annotated[
        str,
        Field(
            description="inhibited, quick stop, command held (it reads back, no more), enabled, "
            "no fault or value"
        ),
    ]


class OutcomeDocument(Document):
    """How one write ended."""

    drive: str
    code: Annotated[str | None, Field(description="Null where none could be written")]
    subcode: int | None
    outcome: Annotated[
        str, Field(description="done, verified, refused, expired, superseded or unknown")
    ]
    reason: str | None
    cause: str | None
    remedy: str | None
    reading: Annotated[ReadingDocument | None, Field(description="What was read back")]
    proof: Annotated[
        ProofDocument | None, Field(description="Only where the outcome is verified")
    ] = None


class WrittenDocument(Document):
    """One value that a verb wrote."""

    code: str
    subcode: int
    raw: Annotated[str, Field(description="As on the wire")]


class VerbDocument(Document):
    """How a verb ended."""

    drive: str
    verb: str
    outcome: Annotated[
        str, Field(description="done, verified, refused, expired, superseded or unknown")
    ]
    reason: str | None
    cause: str | None
    remedy: str | None
    states: Annotated[
        list[str],
        Field(
            description="What the drive's words show afterwards, such as inhibited, quick_stop or "
            "fault; empty where they were not read"
        ),
    ]
    written: Annotated[list[WrittenDocument], Field(description="What was written, in order")]
    reading: Annotated[ReadingDocument | None, Field(description="What was read back")]
    proof: Annotated[
        ProofDocument | None, Field(description="Only where the outcome is verified")
    ] = None
    ignored: Annotated[list[str] | None, IGNORED] = None


class GroupOutcomeDocument(Document):
    """How a group write or a stop ended."""

    target: str
    how: str
    outcome: str
    reason: str | None
    members: list[OutcomeDocument]
    ignored: Annotated[list[str] | None, IGNORED] = None


class IdentityDocument(Document):
    """Who a drive is, was, and should be; each by code."""

    drive: str
    found: Annotated[dict[str, str], Field(description="What it said when last asked")]
    accepted: Annotated[dict[str, str], Field(description="What is recorded of it")]
    roster: Annotated[dict[str, str], Field(description="What the roster says")]
    accepted_at: Annotated[str | None, Field(description="When the record was made, RFC 3339")]
    problem: Annotated[str | None, Field(description="Why nothing is written to it")]


class CodeWearDocument(Document):
    """How often one code was written."""

    code: Annotated[str, Field(examples=["C0012"])]
    name: Annotated[str, Field(description="Empty where no description knows the code")]
    writes: Annotated[int, Field(description="That may have reached the memory, for ever")]
    to_this_device: Annotated[int, Field(description="Since the present device was accepted")]
    wait_s: Annotated[Exact, Field(description="Until it may be written again; 0: now")]


class WearDocument(Document):
    """How often a drive's memory was written, and how often it may be."""

    drive: str
    burst: Annotated[int, Field(description="Writes of one code that may follow each other")]
    every_s: Annotated[Exact, Field(description="Until one more may follow; 0: no limit")]
    codes: list[CodeWearDocument]


class AnswerTimeDocument(Document):
    """How long one code was measured to take."""

    code: Annotated[str, Field(examples=["C0150"])]
    write: Annotated[bool, Field(description="Written rather than read")]
    manual_s: Annotated[Exact, Field(description="The longest that manual and roster tell")]
    measured_s: Annotated[Exact, Field(description="What was measured, the adapter taken off")]


class ForgottenTimesDocument(Document):
    """What was reckoned with of a drive's answer times, and no longer is."""

    drive: str
    forgotten: list[AnswerTimeDocument]


class ChangedDriveDocument(Document):
    """A drive that a reload changed, and the keys that differ."""

    drive: str
    keys: Annotated[list[str], Field(examples=[["cyclic", "watchdog"]])]


class ReloadDocument(Document):
    """What a reload changed."""

    outcome: Annotated[str, Field(description="done; a refused reload is a problem document")]
    file: str
    drives: int
    added: list[str]
    removed: list[str]
    changed: list[ChangedDriveDocument]
    groups: Annotated[list[str], Field(description="New, gone, or with other members")]
    keys: Annotated[list[str], Field(description="Other keys that differ, such as on_shutdown")]


class MeaningDocument(Document):
    """What one value means."""

    value: int
    en: str
    de: str


class BitDocument(Document):
    """One bit or field of a word."""

    low: int
    high: int
    kind: Annotated[str, Field(description="bit, field, free (its user assigns it) or reserved")]
    name: Annotated[str | None, Field(description="A word that stays the same in every language")]
    name_de: str | None
    meanings: list[MeaningDocument]


class CodeDocument(Document):
    """What is known of one code."""

    code: Annotated[str, Field(examples=["C0046"])]
    subcode: int
    name: str
    name_de: str
    unit: str | None
    format: Annotated[str, Field(description="VD, VH, VS or VO")]
    low: Exact | None
    high: Exact | None
    step: Exact | None
    selection: Annotated[
        list[MeaningDocument],
        Field(description="Without low and high: all values there are, unless selection_partial"),
    ]
    selection_partial: Annotated[
        bool, Field(description="The drive takes values that its manual for the line does not name")
    ]
    array: Annotated[
        bool, Field(description="Its values have subcodes; its manual does not say how many")
    ]
    default: Annotated[str | None, Field(description="As on the wire")]
    readable: bool
    writable: bool
    write_class: Annotated[str, Field(description="plain, edge, step, save, address or reset")]
    needs_inhibit: bool
    motion: Annotated[bool, Field(description="Writing it can move the drive")]
    storage: Annotated[str, Field(description="stored, module (lost at power-off) or volatile")]
    parameter_set: int
    secret: bool
    bits: list[BitDocument]
    source: str


class DescribedDocument(Document):
    """A drive's described codes; what its manual does not give is null."""

    drive: str
    family: str
    title: str
    configuration: Annotated[
        str | None, Field(description="The signal configuration its words follow, such as 1xx1")
    ]
    configured_by: str | None
    saved_by: Annotated[str | None, Field(description="What makes stored values stay")]
    parameter_set_offsets: list[int]
    codes: list[CodeDocument]


class FindingDocument(Document):
    """One thing found about a drive that does not turn."""

    name: Annotated[str, Field(description="A word that stays the same", examples=["inhibited"])]
    weight: Annotated[str, Field(description="reason: keeps it from turning; hint: may; note")]
    text: str
    remedy: str | None
    shown_by: Annotated[str | None, Field(examples=["C0150 reads H0380"])]
    age_s: Annotated[Exact | None, Field(description="Age of the oldest value it rests on")]
    stale: Annotated[bool, Field(description="One of these values is not fresh")]


class MemoryDocument(Document):
    """One fault in a fault memory: it was once, which says nothing of now."""

    code: str
    number: int
    keypad: str | None
    kind: str | None
    meaning: str | None
    age_s: Exact | None
    stale: bool


class OutputDocument(Document):
    """Output frequency or speed, as known."""

    value: Scalar
    unit: str | None
    age_s: Exact | None
    stale: bool


class LastEnableDocument(Document):
    """The last enable, where it was refused or taken back and none succeeded since."""

    time: str
    outcome: Annotated[str, Field(description="refused, or unknown")]
    taken_back: Annotated[
        bool, Field(description="The drive did not show the enable and was stopped again")
    ]
    reason: str | None
    cause: Annotated[str | None, Field(description="Why, probably")]
    remedy: str | None


class WhyDocument(Document):
    """Why a drive does not turn."""

    drive: str
    family: str
    state: str
    reason: str | None
    since: str
    answer: Annotated[str, Field(description="The most important finding in one sentence")]
    findings: list[FindingDocument]
    states: Annotated[list[str], Field(description="What its status words show")]
    output: OutputDocument | None
    history: list[MemoryDocument]
    history_known: Annotated[bool, Field(description="Whether a fault memory has been read")]
    last_enable: LastEnableDocument | None


class LeaseDocument(Document):
    """A lease that is held."""

    name: str
    number: Annotated[int, Field(description="Larger than that of every lease before")]
    targets: Annotated[list[str], Field(description="Drives and groups, as the client named them")]
    drives: list[str]
    time_s: Annotated[Exact, Field(description="It lapses so long after its last renewal")]
    expires_in_s: Exact
    held_s: Annotated[Exact, Field(description="For how long it is held")]
    counter: Annotated[int, Field(description="A renewal needs a larger one")]
    on_lapse: Annotated[dict[str, str], Field(description="By drive: what its end does")]
    latched: Annotated[list[str], Field(description="Its drives that must be enabled first")]
    holder: Annotated[dict[str, str], Field(description="Who took it")]


class HeldLeaseDocument(LeaseDocument):
    """A lease, for who took or renewed it."""

    token: Annotated[str, Field(description="What writes carry in the header Lecombus-Lease")]


class DriveControlDocument(Document):
    """A drive that needs a lease, is held by one, or must be enabled again."""

    drive: str
    required: Annotated[bool, Field(description="The roster requires a lease")]
    on_lapse: Annotated[str, Field(description="quick-stop, inhibit, silence or hold")]
    time_s: Annotated[Exact, Field(description="The longest time a lease may ask for")]
    lease: Annotated[str | None, Field(description="The lease that holds it")]
    latched: Annotated[bool, Field(description="It takes no setpoint until it is enabled")]
    because: Annotated[str | None, Field(description="started, lapsed or released")]
    silenced: Annotated[bool, Field(description="It is sent nothing but stops, on purpose")]


class LeasesDocument(Document):
    """Who controls what."""

    leases: list[LeaseDocument]
    drives: list[DriveControlDocument]


class EndedLeaseDocument(Document):
    """A lease that was given up."""

    name: str
    number: int
    drives: list[str]


class JournalRowDocument(Document):
    """One row of the journal."""

    number: int
    time: str
    what: str
    drive: Annotated[str | None, Field(description="The drive or group")]
    asked: Annotated[int | None, Field(description="The row that it is the end of")]
    outcome: Annotated[str | None, Field(description="`asked`, or how it ended")]
    ended: Annotated[bool, Field(description="A later row has its end")]
    fields: Annotated[dict[str, str], Field(description="With those of the row asked")]
    hash: Annotated[str, Field(description="SHA-256 over it and the row before")]


class JournalDocument(Document):
    """Rows of the journal, in their order."""

    rows: list[JournalRowDocument]
    next: Annotated[int | None, Field(description="There may be more behind this row")]
    head: Annotated[str, Field(description="Number and hash of the newest row")]
    trouble: Annotated[str, Field(description="Why nothing can be written now; empty: it can")]


class VerifiedDocument(Document):
    """Whether the journal is whole."""

    whole: bool
    rows: int
    first: int
    last: Annotated[int, Field(description="The last row that is right")]
    head: Annotated[str, Field(description="Number and hash of that row")]
    problem: str | None


class PlanDocument(Document):
    """What a plan of the running line is made from, and what its last five minutes showed."""

    roster: Annotated[
        dict[str, Any], Field(description="The line and the drives, as far as a plan needs them")
    ]
    measured: Annotated[
        dict[str, Any],
        Field(description="Waits and line time by class, margins by drive, gaps by cyclic code"),
    ]
    answers: Annotated[
        dict[str, Any], Field(description="Answer times measured, by drive, the slowest first")
    ]
    state: Annotated[str, Field(description="How the line is: open, closed or lost")]
    away: Annotated[list[str], Field(description="The drives that do not answer now")]


class ProblemDocument(BaseModel):
    """A problem document (RFC 9457).

    Group problems also carry `target`, `how` and `members`, a refused roster `mistakes`.
    """

    type: Annotated[str, Field(examples=["urn:lecombus:problem:no-answer"])]
    title: str
    status: int
    detail: str
    drive: str | None
    code: str | None
    cause: str | None
    remedy: str | None
    outcome: str | None
    sent: Annotated[bool, Field(description="False: the write was refused before it was sent")] = (
        True
    )


class StatusDocument(Document):
    """Health or readiness."""

    status: str
    detail: str
