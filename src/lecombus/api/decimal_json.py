"""JSON in which decimals stay exact, both ways.

Answers are written by msgspec, which writes a `Decimal` as a number with all its digits: 50.10 goes
out as `50.10`. Requests are read by the standard decoder with decimals. What JSON does not know
(`NaN`), keys that stand twice and numbers of many digits are refused, all by the same error.
msgspec does not read requests, because it accepts a key that stands twice. A stop is read by its
texts alone: numbers are not looked at, keys may stand twice.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Final, NoReturn

import msgspec

from lecombus.parameters import Json

__all__ = ["NotJsonError", "decode", "decode_texts", "encode", "short"]

ENCODER: Final = msgspec.json.Encoder(decimal_format="number")

DELETE: Final = "\x7f"
NOT_PRINTABLE: Final = re.compile(r"[^\x00-\x7e]+")
"""What is written as `\\u....`, so that every answer is ASCII; msgspec escapes the rest."""

SHORT_CHARS: Final = 80
"""The most that is given back of what a client sent."""

PARTS_LIMIT: Final = 256
"""Opening brackets of a text, read or not. Thousands of arrays make the interpreter look for
garbage, which takes milliseconds. No request has more than ten."""

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
    """An object some of whose keys stand twice; `twice` finds which."""

    def __init__(self, pairs: list[tuple[str, object]]) -> None:
        super().__init__(pairs)
        self._pairs = pairs

    @property
    def twice(self) -> list[str]:
        """The keys that stand twice or more, in order."""
        return repeated(self._pairs)


class NotJsonError(ValueError):
    """A text is not JSON as it is accepted here; the message says why."""


def encode(value: Json) -> str:
    """Return a document as JSON text in ASCII, with a space after each comma and colon."""
    try:
        text = msgspec.json.format(ENCODER.encode(value), indent=0).decode()
    except UnicodeEncodeError:  # half of a character pair, which a client may send as `\\ud800`
        return written(value)
    if text.isascii() and DELETE not in text:
        return text
    return NOT_PRINTABLE.sub(lambda found: json.dumps(found[0])[1:-1], text)


def written(value: Json) -> str:
    """Return a document as JSON text where texts in it hold half a character, decimals exactly."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(key)}: {written(of)}' for key, of in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(written, value))}]"
    return json.dumps(value) if isinstance(value, str) else ENCODER.encode(value).decode()


def refuse_many_parts(text: bytes) -> None:
    """Refuse what takes long to read, before it is read."""
    parts = text.count(b"[") + text.count(b"{")
    if parts > PARTS_LIMIT:
        raise NotJsonError(f"it has {parts} brackets that open; at most {PARTS_LIMIT} are read")


def decode(text: bytes) -> object:
    """Return what a JSON text says; numbers with a point or exponent become decimals.

    Raises:
        NotJsonError: It is not UTF-8, not JSON, has a key twice, or too many arrays and objects.
    """
    refuse_many_parts(text)
    try:
        return json.loads(
            text.decode("utf-8"),
            parse_float=decimal_of,
            parse_int=integer_of,
            parse_constant=refuse_constant,
            object_pairs_hook=unique_keys,
        )
    except ValueError as exc:
        raise NotJsonError(str(exc)) from exc


def decode_texts(text: bytes, once: Collection[str]) -> object:
    """Return what a JSON text says, judging nothing but its texts.

    A number of any size and `NaN` stay unread, a byte order mark before the text is skipped.

    Args:
        text: The JSON text.
        once: Keys that stand at most once in it, if it is an object; any other may repeat.

    Raises:
        NotJsonError: It is not UTF-8, not JSON, has one of those keys twice, or too many arrays
            and objects.
    """
    refuse_many_parts(text)
    try:
        given = TEXTS_DECODER.decode(text.decode("utf-8-sig"))
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
    """Refuse a number of many digits: each of them costs time in every calculation."""
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


TEXTS_DECODER: Final = json.JSONDecoder(
    parse_float=Unread, parse_int=Unread, parse_constant=Unread, object_pairs_hook=any_keys
)
"""Made once: a stop does not wait for it."""
