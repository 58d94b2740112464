"""Bodies and query parameters of requests, checked as strictly as a roster.

Strategy: the JSON is read exactly (`exact`), then held against a strict model (`bodies`), and every
mistake is told in one go with what would be right. A misspelt key is an error with the nearest
key, never ignored: `?fersh=true` must not quietly give a stored value. Stops alone are different:
what is superfluous in them is told and left aside.

What must not live here: what a body may say (`bodies`), what is done with a request.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from typing import Final, TypeVar

from pydantic import ValidationError
from starlette.requests import ClientDisconnect, Request

from lecombus.api.bodies import (
    RIGHT,
    AcceptBody,
    AddressBody,
    Body,
    SpeedBody,
    StopBody,
    VerbBody,
)
from lecombus.api.bounds import BODY_LIMIT, BODY_TOO_BIG
from lecombus.api.exact import NotJsonError, decode, decode_texts, short
from lecombus.api.problems import Problem, ProblemError

__all__ = ["check_query", "read_body", "read_stop"]

MISTAKES_LIMIT: Final = 10

WORD_LIMIT: Final = 40
"""A longer word is nobody's spelling mistake, and comparing takes its length squared."""

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

    A stop whose action and target are right is taken, whatever else its body says, as long as it
    is a JSON object that is not nested without end and has neither of the two twice.

    Raises:
        ProblemError: It does not say how to stop and what; every mistake is told.
    """
    raw = await bounded_bytes(request)
    given = object_of(raw, StopBody, stop_texts)
    known = {key: value for key, value in given.items() if key in StopBody.model_fields}
    try:
        return StopBody.model_validate(known), raw, superfluous(given)
    except ValidationError:
        return checked(given, StopBody), raw, ()


def superfluous(given: Mapping[str, object]) -> tuple[str, ...]:
    """Return what to say of the keys of a stop that nobody knows."""
    known = tuple(StopBody.model_fields)
    unknown = [key for key in given if key not in known]
    return cut([unknown_key(key, known) for key in unknown[:MISTAKES_LIMIT]], len(unknown))


def stop_texts(raw: bytes) -> object:
    """Return what the body of a stop says: two texts count, and each must stand once."""
    return decode_texts(raw, tuple(StopBody.model_fields))


def object_of(
    raw: bytes, model: type[Body], read: Callable[[bytes], object] = decode
) -> dict[str, object]:
    """Return the JSON object that a body is.

    Args:
        raw: The body.
        model: What it must be.
        read: How it is read.

    Raises:
        ProblemError: It is none.
    """
    try:
        given = read(raw)
    except NotJsonError as exc:
        raise refusal(f"the body is not JSON: {exc}", f"send {example(model)}") from exc
    if not isinstance(given, dict):
        raise refusal("the body is not a JSON object", f"send {example(model)}")
    return given


def checked(given: Mapping[str, object], model: type[B]) -> B:
    """Return a body that is as its model says.

    Keys that nobody knows are cut to what is told before anything else is done with them: a body
    has room for thousands, and looking for what each may have meant took a fifth of a second.

    Raises:
        ProblemError: It is not; every mistake is told.
    """
    known = tuple(model.model_fields)
    unknown = [key for key in given if key not in known]
    mistakes = [unknown_key(key, known) for key in unknown[:MISTAKES_LIMIT]]
    count = len(unknown)
    try:
        body = model.model_validate({key: given[key] for key in known if key in given})
    except ValidationError as exc:
        found = [mistake_text(one, given, model) for one in exc.errors(include_url=False)]
        found = list(dict.fromkeys(found))
        mistakes, count = found + mistakes, len(found) + count
    if count:
        raise refusal("; ".join(cut(mistakes, count)), f"send {example(model)}")
    return body


def cut(texts: list[str], count: int) -> tuple[str, ...]:
    """Return so many mistakes as a message has room for, and the number of the others.

    Args:
        texts: The first of them.
        count: How many there are.
    """
    if count <= MISTAKES_LIMIT:
        return tuple(texts)
    return (*texts[:MISTAKES_LIMIT], f"and {count - MISTAKES_LIMIT} more")


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
                raise ProblemError(BODY_TOO_BIG)
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
    near = get_close_matches(word, known, n=1, cutoff=0.5) if len(word) <= WORD_LIMIT else []
    if near:
        return f"did you mean {near[0]}?"
    return f"known are: {', '.join(known)}" if known else "none is known here"


def unknown_key(key: str, known: tuple[str, ...]) -> str:
    """Return what to say of a key that nobody knows."""
    if any("\ud800" <= character <= "\udfff" for character in short(key)):
        return "a key is not text: it holds one half of a character"
    return f"there is no key {short(key)}: {nearest(key, known)}"


def mistake_text(error: Mapping[str, object], given: Mapping[str, object], model: type[B]) -> str:
    """Return one mistake pydantic found, as a person would say it."""
    place = error["loc"]
    key = str(place[0]) if isinstance(place, tuple) and place else ""
    right = {**RIGHT, **model.right}
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
