"""What a client may send: bodies and query parameters, checked as strictly as a roster.

Strategy: the JSON is read exactly (`exact`), then held against a strict pydantic model, and every
mistake is told in one go with what would be right. A misspelt key is an error with the nearest
key, never ignored: `?fersh=true` must not quietly give a stored value.

What must not live here: what is done with a request.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from decimal import Decimal
from difflib import get_close_matches
from enum import StrEnum
from typing import Annotated, ClassVar, Final, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, WithJsonSchema, field_validator
from starlette.requests import ClientDisconnect, Request

from lecombus.api.exact import NotJsonError, decode, short
from lecombus.api.problems import Problem, ProblemError
from lecombus.drives import StopAction
from lecombus.schedule.request import Priority

__all__ = [
    "BODY_LIMIT",
    "RIGHT",
    "TARGET_LIMIT",
    "AcceptBody",
    "AddressBody",
    "Body",
    "DriveWriteBody",
    "SpeedBody",
    "StopBody",
    "Urgency",
    "VerbBody",
    "WriteBody",
    "check_query",
    "read_body",
    "read_stop",
]

BODY_LIMIT: Final = 64 * 1024

TEXT_LIMIT: Final = 250
"""A little more than the longest value (241 characters), so that its own error can speak."""

TARGET_LIMIT: Final = 200

MISTAKES_LIMIT: Final = 10

EXPONENT_LIMIT: Final = 30
"""A number such as 1E+999999 is a few bytes here and a megabyte once written out."""

DURATION: Final = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*(ms|s|min)")
UNIT_S: Final = {"ms": Decimal("0.001"), "s": Decimal(1), "min": Decimal(60)}
LONGEST_EXPIRY_S: Final = 3600

RIGHT: Final[Mapping[str, str]] = {
    "value": 'a number such as 35.4 or a text such as "H0008"',
    "expires": 'a duration such as "2s", "500ms" or a number of seconds, over 0 and up to 1 h',
    "verify": "true or false",
    "priority": '"interactive", or "background" for long work that only takes idle line time',
    "restore": "true or false",
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


class WriteBody(Body):
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

    @field_validator("expires")
    @classmethod
    def bounded(cls, value: int | Decimal | str | None) -> int | Decimal | str | None:
        """Refuse durations out of range."""
        return in_bounds(value)

    @property
    def expires_s(self) -> float | None:
        """How long the write may wait, seconds."""
        return None if self.expires is None else float(seconds_of(self.expires))


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


class StopBody(Body):
    """How to stop, and what."""

    action: Annotated[
        StopAction,
        Field(strict=False, description=RIGHT["action"]),
        WithJsonSchema({"type": "string", "enum": [one.value for one in StopAction]}),
    ]
    target: Annotated[
        str, Field(min_length=1, max_length=TARGET_LIMIT, description=RIGHT["target"])
    ]


class VerbBody(Body):
    """How long a verb may wait before its first write."""

    expires: Annotated[
        Number | None,
        Field(description=f"Not begun any more after this: {RIGHT['expires']}"),
    ] = None

    @field_validator("expires")
    @classmethod
    def bounded(cls, value: int | Decimal | str | None) -> int | Decimal | str | None:
        """Refuse durations out of range."""
        return in_bounds(value)

    @property
    def expires_s(self) -> float | None:
        """How long the verb may wait, seconds."""
        return None if self.expires is None else float(seconds_of(self.expires))


class SpeedBody(VerbBody):
    """A speed with its unit."""

    right: ClassVar[Mapping[str, str]] = {"value": "a number such as 35.4"}

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


class AcceptBody(Body):
    """The identity that whoever accepts a drive has seen."""

    identity: Annotated[dict[str, str], Field(description=RIGHT["identity"])]


def in_bounds(value: int | Decimal | str | None) -> int | Decimal | str | None:
    """Return a duration that a request may wait.

    Raises:
        ValueError: It is none; pydantic makes a mistake of it.
    """
    if value is not None and not 0 < float(seconds_of(value)) <= LONGEST_EXPIRY_S:
        raise ValueError(RIGHT["expires"])
    return value


class AddressBody(Body):
    """Where a drive shall be found from now on."""

    address: Annotated[int, Field(description=RIGHT["address"])]


def seconds_of(value: int | Decimal | str) -> Decimal:
    """Return a duration in seconds.

    Raises:
        ValueError: It is not one; pydantic makes a mistake of it.
    """
    if not isinstance(value, str):
        return Decimal(value)
    match = DURATION.fullmatch(value.strip())
    if match is None:
        raise ValueError(RIGHT["expires"])
    return Decimal(match[1]) * UNIT_S[match[2]]


B = TypeVar("B", bound=Body)


async def read_body(
    request: Request, model: type[B], *, may_be_empty: bool = False
) -> tuple[B, bytes]:
    """Return a request's body, checked, and its bytes.

    Args:
        request: The request.
        model: What it must be.
        may_be_empty: No body at all stands for one without keys.

    Raises:
        ProblemError: It is too big, not JSON, or not what is asked for.
    """
    raw = await bounded_bytes(request) or (b"{}" if may_be_empty else b"")
    return checked(object_of(raw, model), model), raw


async def read_stop(request: Request) -> tuple[StopBody, bytes, tuple[str, ...]]:
    """Return a stop, the bytes of its body, and what in it is superfluous.

    A stop whose action and target are right is taken, whatever else its body says.

    Raises:
        ProblemError: It does not say how to stop and what; every mistake is told.
    """
    raw = await bounded_bytes(request)
    given = object_of(raw, StopBody)
    known = {key: value for key, value in given.items() if key in StopBody.model_fields}
    try:
        return StopBody.model_validate(known), raw, superfluous(given)
    except ValidationError:
        return checked(given, StopBody), raw, ()


def superfluous(given: Mapping[str, object]) -> tuple[str, ...]:
    """Return what to say of the keys of a stop that nobody knows."""
    known = tuple(StopBody.model_fields)
    unknown = [key for key in given if key not in known]
    said = [f"there is no key {short(key)}: {nearest(key, known)}" for key in unknown]
    return bounded_list(said)


def object_of(raw: bytes, model: type[Body]) -> dict[str, object]:
    """Return the JSON object that a body is.

    Raises:
        ProblemError: It is none.
    """
    try:
        given = decode(raw)
    except NotJsonError as exc:
        raise refusal(f"the body is not JSON: {exc}", f"send {example(model)}") from exc
    if not isinstance(given, dict):
        raise refusal("the body is not a JSON object", f"send {example(model)}")
    return given


def checked(given: Mapping[str, object], model: type[B]) -> B:
    """Return a body that is as its model says.

    Raises:
        ProblemError: It is not; every mistake is told.
    """
    try:
        return model.model_validate(given)
    except ValidationError as exc:
        mistakes = list(dict.fromkeys(mistake_text(one, given, model) for one in exc.errors()))
        raise refusal("; ".join(bounded_list(mistakes)), f"send {example(model)}") from exc


def bounded_list(mistakes: list[str]) -> tuple[str, ...]:
    """Return so many mistakes as a message has room for, and the number of the others."""
    if len(mistakes) <= MISTAKES_LIMIT:
        return tuple(mistakes)
    return (*mistakes[:MISTAKES_LIMIT], f"and {len(mistakes) - MISTAKES_LIMIT} more")


async def bounded_bytes(request: Request) -> bytes:
    """Return the body, reading no more than `BODY_LIMIT`.

    Raises:
        ProblemError: It is longer, or the client went away before it was complete.
    """
    parts = bytearray()
    try:
        async for part in request.stream():
            parts += part
            if len(parts) > BODY_LIMIT:
                raise ProblemError(
                    Problem(
                        "too-big",
                        f"the body is longer than {BODY_LIMIT} bytes",
                        remedy="a write is one value; send it alone",
                        headers={"Connection": "close"},
                    )
                )
    except ClientDisconnect as exc:
        raise refusal("the client went away before its request was complete", "") from exc
    return bytes(parts)


def check_query(request: Request, allowed: Iterable[str] = ()) -> None:
    """Refuse query parameters that nobody reads, and those given twice.

    Raises:
        ProblemError: There is one; the nearest right one is named.
    """
    if not request.scope["query_string"]:
        return
    known = tuple(allowed)
    seen: set[str] = set()
    for key, _ in request.query_params.multi_items():
        if key not in known:
            raise refusal(f"there is no query parameter {short(key)}", nearest(key, known))
        if key in seen:
            raise refusal(f"query parameter {short(key)} stands twice", "give it once")
        seen.add(key)


def nearest(word: str, known: tuple[str, ...]) -> str:
    """Return a remedy for a misspelt word."""
    near = get_close_matches(word, known, n=1, cutoff=0.5)
    if near:
        return f"did you mean {near[0]}?"
    return f"known are: {', '.join(known)}" if known else "none is known here"


def mistake_text(error: Mapping[str, object], given: Mapping[str, object], model: type[B]) -> str:
    """Return one mistake pydantic found, as a person would say it."""
    place = error["loc"]
    key = str(place[0]) if isinstance(place, tuple) and place else ""
    if error["type"] == "extra_forbidden":
        return f"there is no key {short(key)}: {nearest(key, tuple(model.model_fields))}"
    right = {**RIGHT, **model.right}
    if key not in right:
        return "a key is not text: it holds one half of a character"
    if error["type"] == "missing":
        return f"key {key} is missing: it takes {right[key]}"
    return f"{key} takes {right[key]}, not {shown(given.get(key))}"


def shown(value: object) -> str:
    """Return a wrong value as it can stand in a message, cut short."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return "an array"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    text = str(value)
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


def example(model: type[Body]) -> str:
    """Return a right body, for messages."""
    if model is StopBody:
        return '{"action": "quick-stop", "target": "all"}'
    if model is SpeedBody:
        return '{"value": 35.4, "unit": "Hz"}'
    if model is VerbBody:
        return "{}"
    if model is AddressBody:
        return '{"address": 12}'
    if model is AcceptBody:
        return '{"identity": {"C1810": "33S2102I_10000"}}'
    return '{"value": 35.4, "expires": "2s", "verify": true}'


def refusal(detail: str, remedy: str) -> ProblemError:
    """Return the error for a request that cannot be understood."""
    return ProblemError(Problem("bad-request", detail, remedy=remedy))
