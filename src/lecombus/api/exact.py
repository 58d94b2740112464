"""JSON that keeps decimals exact, both ways.

The standard encoder writes decimals only by way of a binary float, so the writer here is our own:
35.4 goes out as `35.4` and 50.10 as `50.10`. Reading uses the standard decoder with decimals,
refuses what JSON does not know (`NaN`) and keys that stand twice, and raises one error.

What must not live here: what a document means.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping
from decimal import Decimal, InvalidOperation
from json.encoder import encode_basestring_ascii as quote
from typing import Any, Final, NoReturn

from lecombus.readings import Json

__all__ = ["NotJsonError", "decode", "encode", "short"]

SHORT_CHARS: Final = 80
"""The most that is given back of what a client sent."""


class NotJsonError(ValueError):
    """A text is not the JSON we take; the message says why."""


def encode(value: Json) -> str:
    """Return a document as JSON text, decimals exactly as they are."""
    return WRITERS[type(value)](value)


def object_text(value: Mapping[str, Json]) -> str:
    """Return an object."""
    return "{" + ", ".join(f"{quote(key)}: {WRITERS[type(v)](v)}" for key, v in value.items()) + "}"


def array_text(value: list[Json]) -> str:
    """Return an array."""
    return "[" + ", ".join([WRITERS[type(item)](item) for item in value]) + "]"


def decimal_text(value: Decimal) -> str:
    """Return a decimal without exponent; JSON knows no infinity."""
    assert value.is_finite(), value
    return format(value, "f")


WRITERS: dict[type, Callable[[Any], str]] = {
    str: quote,
    int: str,
    Decimal: decimal_text,
    bool: lambda value: "true" if value else "false",
    type(None): lambda _: "null",
    dict: object_text,
    list: array_text,
}


def decode(text: bytes) -> object:
    """Return what a JSON text says; numbers with a point or exponent become decimals.

    Raises:
        NotJsonError: It is not UTF-8, not JSON, has a key twice, or is nested without end.
    """
    try:
        return json.loads(
            text.decode("utf-8"),
            parse_float=decimal_of,
            parse_constant=refuse_constant,
            object_pairs_hook=unique_keys,
        )
    except RecursionError as exc:
        raise NotJsonError("it is nested too deeply") from exc
    except ValueError as exc:
        raise NotJsonError(str(exc)) from exc


def decimal_of(text: str) -> Decimal:
    """Return a number with a point or exponent; an exponent beyond any decimal is refused."""
    try:
        return Decimal(text)
    except InvalidOperation as exc:
        raise NotJsonError(f"{short(text)} is too large or too small for any number") from exc


def short(text: str, chars: int = SHORT_CHARS) -> str:
    """Return what a client sent as it can stand in a message: bounded."""
    return text if len(text) <= chars else f"{text[: chars - 3]}..."


def refuse_constant(name: str) -> NoReturn:
    """Refuse NaN and the infinities, which the standard decoder takes."""
    raise NotJsonError(f"{name} is not a number JSON knows")


def unique_keys(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return an object, unless one of its keys stands twice."""
    made = dict(pairs)
    if len(made) != len(pairs):
        counts = Counter(key for key, _ in pairs)
        twice = sorted(key for key, count in counts.items() if count > 1)
        raise NotJsonError(f"key {short(', '.join(twice))} stands twice")
    return made
