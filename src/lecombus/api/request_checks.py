"""Paths, queries and bodies of requests: read, checked against their models, and refused.

Strategy: the JSON is read exactly (`decimal_json`) and checked by a strict model
(`request_models`); the answer names all mistakes with what would be right. A misspelt key is an
error with the nearest key, never ignored: `?fersh=true` must not quietly give a stored value.
Stops are different: what is superfluous in them is reported and ignored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import Final, TypeVar

from pydantic import ValidationError
from starlette.requests import Request

from lecombus.api.answers import ProblemDocument, RefusedRequestError
from lecombus.api.decimal_json import NotJsonError, decode, decode_texts, short
from lecombus.api.limits import BODY_LIMIT, BODY_TOO_BIG
from lecombus.api.request_models import RIGHT, Body, Query, StopBody
from lecombus.errors import CodeValueError
from lecombus.parameters import Code

__all__ = ["code_of", "read_body", "read_query", "read_stop", "refusal", "refuse_query"]

STOP_KEYS: Final = tuple(StopBody.model_fields)

MISTAKES_LIMIT: Final = 10

WORD_LIMIT: Final = 40
"""A longer word is not a spelling mistake, and comparing takes its length squared."""

SHOWN_CHARS: Final = 40
"""The most that a message repeats of a wrong value."""

B = TypeVar("B", bound=Body)
Q = TypeVar("Q", bound=Query)


def code_of(request: Request) -> Code:
    """Return the code that a request's path names.

    Raises:
        ProblemError: It names none; 404, because no drive has it.
    """
    code, subcode = request.path_params["code"], request.path_params.get("subcode", "")
    text = f"{code}/{subcode}" if subcode else code
    try:
        return Code.parse(text)
    except CodeValueError as exc:
        raise RefusedRequestError(
            ProblemDocument("no-such-code", str(exc), code=text, remedy="write C0150 or C0039/1")
        ) from exc


async def read_body(
    request: Request, model: type[B], *, may_be_empty: bool = False
) -> tuple[B, bytes]:
    """Return a request's body, checked, and its bytes.

    Args:
        request: The request.
        model: What it must be.
        may_be_empty: No body at all stands for one without keys.

    Raises:
        ProblemError: It is too big, not JSON, or not as the model says.
    """
    raw = await bounded_bytes(request) or (b"{}" if may_be_empty else b"")
    return checked(object_of(raw, model), model), raw


async def read_stop(request: Request) -> tuple[StopBody, bytes, tuple[str, ...]]:
    """Return a stop, the bytes of its body, and what in it is superfluous.

    A stop whose action and target are right is taken, as long as its body is a JSON object that
    is not nested without end and has neither of the two twice.

    Raises:
        ProblemError: It does not say how to stop and what; names every mistake.
    """
    raw = await bounded_bytes(request)
    given = object_of(raw, StopBody, stop_texts)
    known = {key: value for key, value in given.items() if key in STOP_KEYS}
    try:
        return StopBody.model_validate(known), raw, superfluous(given)
    except ValidationError:
        return checked(given, StopBody), raw, ()


def superfluous(given: Mapping[str, object]) -> tuple[str, ...]:
    """Return a text for each unknown key of a stop."""
    unknown = [key for key in given if key not in STOP_KEYS]
    return cut([unknown_key(key, STOP_KEYS) for key in unknown[:MISTAKES_LIMIT]], len(unknown))


def stop_texts(raw: bytes) -> object:
    """Return what the body of a stop says: two texts count, and each must stand once."""
    return decode_texts(raw, STOP_KEYS)


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
        raise refusal(f"the body is not JSON: {exc}", f"send {model.example}") from exc
    if not isinstance(given, dict):
        raise refusal("the body is not a JSON object", f"send {model.example}")
    return given


def checked(given: Mapping[str, object], model: type[B]) -> B:
    """Return a body that is as its model says.

    Unknown keys are cut to those that the answer has room for before each is compared with the
    known ones: a body has room for thousands, and comparing them all took a fifth of a second.

    Raises:
        ProblemError: It is not; names every mistake.
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
        raise refusal("; ".join(cut(mistakes, count)), f"send {model.example}")
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
    body, more = b"", True
    while more:
        message = await request.receive()
        if message["type"] == "http.disconnect":
            raise refusal("the client went away before its request was complete", "")
        body, more = body + message.get("body", b""), message.get("more_body", False)
        if len(body) > BODY_LIMIT:
            raise RefusedRequestError(BODY_TOO_BIG)
    return body


def refuse_query(request: Request) -> None:
    """Refuse query parameters where none is known.

    Raises:
        ProblemError: There is one.
    """
    if request.scope["query_string"]:
        refuse_unknown(request, ())


def read_query(request: Request, model: type[Q]) -> Q:
    """Return a request's query, checked.

    Raises:
        ProblemError: A value is wrong, or a parameter is unknown or stands twice.
    """
    if not request.scope["query_string"]:
        return model()
    try:
        query = model.model_validate(dict(request.query_params))
    except ValidationError as exc:
        given = dict(request.query_params)
        found = [mistake_text(one, given, model) for one in exc.errors(include_url=False)]
        raise refusal("; ".join(dict.fromkeys(found)), "") from exc
    refuse_unknown(request, tuple(model.model_fields))
    return query


def refuse_unknown(request: Request, known: tuple[str, ...]) -> None:
    """Refuse query parameters that are unknown, with the nearest known one, or given twice.

    Raises:
        ProblemError: There is one.
    """
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
    """Return the text for an unknown key."""
    if any("\ud800" <= character <= "\udfff" for character in short(key)):
        return "a key is not text: it holds one half of a character"
    return f"there is no key {short(key)}: {nearest(key, known)}"


def mistake_text(
    error: Mapping[str, object], given: Mapping[str, object], model: type[Body | Query]
) -> str:
    """Return one mistake pydantic found, as a person would say it."""
    place = error["loc"]
    key = str(place[0]) if isinstance(place, tuple) and place else ""
    right = {**RIGHT, **model.right}
    if error["type"] == "missing":
        return f"key {key} is missing: it takes {right[key]}"
    return f"{key} takes {right[key]}, not {what_stands(error, given.get(key))}"


def what_stands(error: Mapping[str, object], value: object) -> str:
    """Return a wrong value; of a list that is right as such, what is wrong with it."""
    place = error["loc"]
    if not isinstance(value, list) or not isinstance(place, tuple):
        return shown(value)
    if len(place) > 1 and isinstance(place[1], int):
        return f"an array with {shown(value[place[1]])}"
    if error["type"] == "too_short":
        return "an empty array"
    return f"an array of {len(value)}" if error["type"] == "too_long" else shown(value)


def shown(value: object) -> str:
    """Return a wrong value as it was given, cut short; a text stands in quotes."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return "an array"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    text = short(str(value), SHOWN_CHARS)
    return repr(text) if isinstance(value, str) else text


def refusal(detail: str, remedy: str) -> RefusedRequestError:
    """Return the error for a request that cannot be understood."""
    return RefusedRequestError(ProblemDocument("bad-request", detail, remedy=remedy))
