"""JSON that keeps decimals exact, both ways.

The standard encoder writes decimals only by way of a binary float, so the writer here is our own:
35.4 goes out as `35.4` and 50.10 as `50.10`. Reading uses the standard decoder with decimals. What
JSON does not know (`NaN`), keys that stand twice and numbers of many digits are refused, all by the
same error. A stop must go through, so it is read by its texts alone: numbers are not looked at,
keys may stand twice.

What must not live here: what a document means.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from json.encoder import encode_basestring_ascii as quote
from typing import Any, Final, NoReturn

from lecombus.readings import Json

__all__ = ["NotJsonError", "decode", "decode_texts", "encode", "short"]

SHORT_CHARS: Final = 80
"""The most that is given back of what a client sent."""

NUMBER_CHARS: Final = 128
"""The longest value that a telegram carries has 241 characters, but no number has that many."""


@dataclass(frozen=True, slots=True)
class Unread:
    """A number, or what stands in a number's place, as it was written."""

    text: str

    def __str__(self) -> str:
        """Return it as it was written."""
        return self.text


class Repeating(dict[str, object]):
    """An object some of whose keys stand twice; which, is looked for when somebody asks."""

    def __init__(self, pairs: list[tuple[str, object]]) -> None:
        super().__init__(pairs)
        self._pairs = pairs

    @property
    def twice(self) -> list[str]:
        """The keys that stand twice or more, in order."""
        return repeated(self._pairs)


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
            parse_int=integer_of,
            parse_constant=refuse_constant,
            object_pairs_hook=unique_keys,
        )
    except RecursionError as exc:
        raise NotJsonError("it is nested too deeply") from exc
    except ValueError as exc:
        raise NotJsonError(str(exc)) from exc


def decode_texts(text: bytes, once: Collection[str]) -> object:
    """Return what a JSON text says, judging nothing but its texts.

    A number of any size and `NaN` stay unread, a byte order mark before the text is skipped.

    Args:
        text: The JSON text.
        once: Keys that stand at most once in it, if it is an object; any other may repeat.

    Raises:
        NotJsonError: It is not UTF-8, not JSON, has one of those keys twice, or is nested without
            end.
    """
    try:
        given = json.loads(
            text.decode("utf-8-sig"),
            parse_float=Unread,
            parse_int=Unread,
            parse_constant=Unread,
            object_pairs_hook=any_keys,
        )
    except RecursionError as exc:
        raise NotJsonError("it is nested too deeply") from exc
    except ValueError as exc:
        raise NotJsonError(str(exc)) from exc
    if isinstance(given, Repeating):
        refuse_twice([key for key in given.twice if key in once])
        return dict(given)
    return given


def integer_of(text: str) -> int:
    """Return a number without point and exponent, unless it has more digits than any value."""
    refuse_long(text)
    return int(text)


def decimal_of(text: str) -> Decimal:
    """Return a number with a point or exponent; an exponent beyond any decimal is refused."""
    refuse_long(text)
    try:
        return Decimal(text)
    except InvalidOperation as exc:
        raise NotJsonError(f"{short(text)} is too large or too small for any number") from exc


def refuse_long(text: str) -> None:
    """Refuse a number of many digits: whoever reckons with it would pay for each of them."""
    if len(text) > NUMBER_CHARS:
        raise NotJsonError(f"{short(text)} has more than {NUMBER_CHARS} characters")


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
        refuse_twice(repeated(pairs))
    return made


def any_keys(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return an object; one of whose keys some stand twice says which."""
    made = dict(pairs)
    return made if len(made) == len(pairs) else Repeating(pairs)


def repeated(pairs: list[tuple[str, object]]) -> list[str]:
    """Return the keys that stand twice or more, in order."""
    counts = Counter(key for key, _ in pairs)
    return sorted(key for key, count in counts.items() if count > 1)


def refuse_twice(keys: list[str]) -> None:
    """Refuse keys that stand twice, if there are any."""
    if keys:
        raise NotJsonError(f"key {short(', '.join(keys))} stands twice")
