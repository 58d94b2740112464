"""What queries and bodies of requests may say: strict models, as strict as a roster."""

from __future__ import annotations

import re
from collections.abc import Mapping
from decimal import Decimal
from enum import StrEnum
from typing import Annotated, ClassVar, Final

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    WithJsonSchema,
    field_validator,
)

from lecombus.drives import Language, StopAction
from lecombus.durations import LONGEST_EXPIRY_S
from lecombus.schedule.request import Priority

__all__ = [
    "NAME",
    "RIGHT",
    "TARGET_LIMIT",
    "AcceptBody",
    "AddressBody",
    "AddressQuery",
    "Body",
    "DriveWriteBody",
    "EventQuery",
    "LeaseBody",
    "NoKeysBody",
    "Query",
    "SpeedBody",
    "StopBody",
    "Urgency",
    "ValueQuery",
    "VerbBody",
    "WaitingBody",
    "WhyQuery",
    "WriteBody",
    "seconds_of",
]

TEXT_LIMIT: Final = 250
"""A little more than the longest value (241 characters), so that its own error can speak."""

TARGET_LIMIT: Final = 200
STOPS_LIMIT: Final = 100

IDENTITY_CODES: Final = 16
"""More than any family has that say who a drive is."""

DURATION_CHARS: Final = 40

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,59}")
"""The name of a lease."""

LEASE_TARGETS: Final = 100
LARGEST_COUNTER: Final = 2**53
"""Larger numbers lose digits in programs that take every number of JSON for a double."""


EXPONENT_LIMIT: Final = 30
"""A number such as 1E+999999 is a few bytes here and a megabyte once written out."""

DURATION: Final = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*(ms|s|min|h)")
UNIT_S: Final = {"ms": Decimal("0.001"), "s": Decimal(1), "min": Decimal(60), "h": Decimal(3600)}

RIGHT: Final[Mapping[str, str]] = {
    "value": 'a number such as 35.4 or a text such as "H0008"',
    "expires": 'a duration such as "2s", "500ms" or a number of seconds, over 0 and up to 1 h',
    "verify": "true or false",
    "priority": '"interactive", or "background" for long work that only takes idle line time',
    "restore": "true or false",
    "stops": "what `GET /v1/drives/{drive}/restore` gives as `stops`",
    "action": '"quick-stop" or "inhibit"',
    "identity": 'what the drive said of itself, such as {"C1810": "33S2102I_10000"}',
    "unit": '"Hz", or "%" of the highest frequency or speed',
    "address": "the new address, 1 to 99 without 10, 20 .. 90",
    "target": 'the name of a drive or a group, or "all"',
}
"""What each key takes, for messages."""

Number = Annotated[
    int | Decimal | str,
    Field(union_mode="left_to_right"),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
]


class Urgency(StrEnum):
    """What a client may say of how soon its request should run."""

    INTERACTIVE = "interactive"
    BACKGROUND = "background"

    @property
    def priority(self) -> Priority:
        """The class of the schedule."""
        return Priority.BACKGROUND if self is Urgency.BACKGROUND else Priority.INTERACTIVE

    @property
    def timeout_s(self) -> float:
        """How long a read may wait for its turn, seconds.

        Less than the 60 s after which a client takes the daemon for dead; a person has gone much
        sooner than a backup, which waits for the line to be idle.
        """
        return 45.0 if self is Urgency.BACKGROUND else 10.0


class Body(BaseModel):
    """The common rules: nothing converted, nothing ignored."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    right: ClassVar[Mapping[str, str]] = {}
    """What a key takes here, where that is not what it takes elsewhere."""

    example: ClassVar[str] = '{"value": 35.4, "expires": "2s", "verify": true}'
    """A right body, for messages."""


class WaitingBody(Body):
    """How long what is asked for may wait for its turn."""

    expires: Number | None = None

    @field_validator("expires")
    @classmethod
    def bounded(cls, value: int | Decimal | str | None) -> int | Decimal | str | None:
        """Refuse durations out of range."""
        if value is not None and not 0 < float(seconds_of(value)) <= LONGEST_EXPIRY_S:
            raise ValueError(RIGHT["expires"])
        return value

    @property
    def expires_s(self) -> float | None:
        """How long it may wait, seconds."""
        return None if self.expires is None else float(seconds_of(self.expires))


class WriteBody(WaitingBody):
    """What to write, how long it may wait, and whether to read it back."""

    value: Annotated[Number, Field(description=RIGHT["value"])]
    expires: Annotated[
        Number | None,
        Field(description=f"Not sent any more after this: {RIGHT['expires']}"),
    ] = None
    verify: Annotated[
        bool | None,
        Field(
            description="Read the value back and compare. Not given: no for one drive and for one "
            "write after another, yes for a multicast, which nobody acknowledges"
        ),
    ] = None

    @field_validator("value")
    @classmethod
    def sendable(cls, value: int | Decimal | str) -> int | Decimal | str:
        """Refuse numbers and texts no telegram could ever carry."""
        if isinstance(value, str):
            fits = 0 < len(value) <= TEXT_LIMIT
        else:
            fits = abs(Decimal(value).adjusted()) <= EXPONENT_LIMIT
        if not fits:
            raise ValueError(RIGHT["value"])
        return value


class DriveWriteBody(WriteBody):
    """A write to one drive, which may be part of long work."""

    priority: Annotated[
        Urgency | None,
        Field(
            strict=False,
            description=f"How soon: {RIGHT['priority']}. What moves a drive never waits for long "
            "work: it keeps its class",
        ),
    ] = None

    restore: Annotated[
        bool | None,
        Field(
            description="Part of restoring a backup: parameters that the roster's `writable` does "
            "not list may be written where it says `restore: true`"
        ),
    ] = None

    stops: Annotated[
        str | None,
        Field(
            max_length=STOPS_LIMIT,
            description="Not written if the drive was stopped, or lecombus was started, since "
            "this was given: `stops` of `GET /v1/drives/{drive}/restore`. For work of several "
            "writes",
        ),
    ] = None


class StopBody(Body):
    """How to stop, and what."""

    example: ClassVar[str] = '{"action": "quick-stop", "target": "all"}'

    action: Annotated[
        StopAction,
        Field(strict=False, description=RIGHT["action"]),
        WithJsonSchema({"type": "string", "enum": [one.value for one in StopAction]}),
    ]
    target: Annotated[
        str, Field(min_length=1, max_length=TARGET_LIMIT, description=RIGHT["target"])
    ]


class VerbBody(WaitingBody):
    """How long a verb may wait before its first write."""

    example: ClassVar[str] = "{}"

    expires: Annotated[
        Number | None,
        Field(description=f"Not begun any more after this: {RIGHT['expires']}"),
    ] = None


class SpeedBody(VerbBody):
    """A speed with its unit."""

    right: ClassVar[Mapping[str, str]] = {"value": "a number such as 35.4"}
    example: ClassVar[str] = '{"value": 35.4, "unit": "Hz"}'

    value: Annotated[
        int | Decimal,
        Field(union_mode="left_to_right", description="The speed"),
        WithJsonSchema({"type": "number"}),
    ]
    unit: Annotated[str, Field(min_length=1, max_length=20, description=RIGHT["unit"])]
    verify: Annotated[bool | None, Field(description="Read it back and compare")] = None

    @field_validator("value")
    @classmethod
    def writable(cls, value: int | Decimal) -> int | Decimal:
        """Refuse numbers that take a megabyte to write out."""
        if abs(Decimal(value).adjusted()) > EXPONENT_LIMIT:
            raise ValueError("too big or too small")
        return value


class NoKeysBody(Body):
    """Nothing to say: no body at all, or `{}`."""

    example: ClassVar[str] = "{}"


class AcceptBody(Body):
    """The identity that whoever accepts a drive has seen."""

    example: ClassVar[str] = '{"identity": {"C1810": "33S2102I_10000"}}'

    identity: Annotated[
        dict[str, str], Field(description=RIGHT["identity"], max_length=IDENTITY_CODES)
    ]

    @field_validator("identity", mode="before")
    @classmethod
    def few(cls, value: object) -> object:
        """Refuse more codes than any drive has, before each of them is looked at."""
        if isinstance(value, dict) and len(value) > IDENTITY_CODES:
            raise ValueError(RIGHT["identity"])
        return value


class AddressBody(Body):
    """Where a drive shall be found from now on."""

    example: ClassVar[str] = '{"address": 12}'

    address: Annotated[int, Field(description=RIGHT["address"])]


class LeaseBody(Body):
    """What a client asks of a lease: `targets` and `time` to take it, `token` to renew it."""

    right: ClassVar[Mapping[str, str]] = {
        "targets": f"a list of 1 to {LEASE_TARGETS} names of drives and groups",
        "time": 'a duration such as "2s", at most the `lease.time` of each drive',
        "token": "what the answer to taking it had as `token`",
        "counter": f"a whole number, 0 to {LARGEST_COUNTER}, larger with each renewal",
        "take_over": "the name of the lease that holds the drives",
    }
    example: ClassVar[str] = (
        '{"targets": ["feeder"], "time": "2s", "counter": 1}, or {"token": "..", "counter": 2}'
    )

    counter: Annotated[int, Field(ge=0, le=LARGEST_COUNTER, description=right["counter"])]
    targets: Annotated[
        list[str] | None,
        Field(min_length=1, max_length=LEASE_TARGETS, description=right["targets"]),
    ] = None
    time: Annotated[Number | None, Field(description=right["time"])] = None
    token: Annotated[str | None, Field(max_length=TARGET_LIMIT, description=right["token"])] = None
    take_over: Annotated[
        str | None,
        Field(
            pattern=f"^{NAME.pattern}$",
            description=f"Take over its drives; its token counts no more: {right['take_over']}",
        ),
    ] = None

    @field_validator("time")
    @classmethod
    def bounded(cls, value: int | Decimal | str | None) -> int | Decimal | str | None:
        """Refuse durations out of range."""
        if value is not None and not 0 < float(seconds_of(value)) <= LONGEST_EXPIRY_S:
            raise ValueError(cls.right["time"])
        return value

    @property
    def is_right(self) -> bool:
        """Whether it says how to take a lease, or how to renew one, and not both."""
        taking = (self.targets, self.time, self.take_over)
        if self.token is not None:
            return taking == (None, None, None)
        return self.targets is not None and self.time is not None

    @property
    def time_s(self) -> float:
        """For how long it is taken, seconds."""
        assert self.time is not None
        return float(seconds_of(self.time))


class Query(BaseModel):
    """The common rules of queries: texts are converted; `read_query` refuses unknown names."""

    model_config = ConfigDict(frozen=True)

    right: ClassVar[Mapping[str, str]] = {}
    """What a parameter takes, for messages."""


class ValueQuery(Query):
    """How a code is read."""

    right: ClassVar[Mapping[str, str]] = {"fresh": "true or false"}

    fresh: Annotated[bool, Field(description="Read it now")] = False
    priority: Annotated[Urgency, Field(description=RIGHT["priority"])] = Urgency.INTERACTIVE


class EventQuery(Query):
    """Which events are read."""

    drive: Annotated[
        str,
        Field(
            description="Only those about these drives and groups, and the "
            "line; with commas between them"
        ),
    ] = ""
    kind: Annotated[
        str,
        Field(
            description="Only value, state, remark, trip, write, lease or line; "
            "with commas between them"
        ),
    ] = ""
    last_event_id: Annotated[
        str,
        Field(
            description="The last event that the client had, where it "
            "cannot send the header Last-Event-ID"
        ),
    ] = ""


class AddressQuery(Query):
    """How a code is read at an address that the roster does not have."""

    right: ClassVar[Mapping[str, str]] = {"patient": "true or false"}

    addressing: Annotated[str, Field(description="standard or extended")] = "standard"
    family: Annotated[str, Field(description="By whose answer times to wait")] = "generic"
    patient: Annotated[bool, Field(description="Wait longer than any family needs")] = False


class WhyQuery(Query):
    """How it is found out why a drive does not turn."""

    right: ClassVar[Mapping[str, str]] = {"fresh": "true or false", "lang": "en or de"}

    fresh: Annotated[bool, Field(description="Read the few codes that matter first")] = False
    lang: Annotated[Language, Field(description="en or de")] = Language.EN


def seconds_of(value: int | Decimal | str) -> Decimal:
    """Return a duration in seconds.

    Raises:
        ValueError: It is not one; pydantic makes a mistake of it.
    """
    if not isinstance(value, str):
        return Decimal(value)
    match = DURATION.fullmatch(value.strip()) if len(value) <= DURATION_CHARS else None
    if match is None:
        raise ValueError(RIGHT["expires"])
    return Decimal(match[1]) * UNIT_S[match[2]]
