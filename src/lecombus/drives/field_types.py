"""Types for the fields of data files: what a text of a file may be, and what it becomes.

Each is `Annotated` with the function that reads it, so that a dataclass with such fields is both
the grammar of a file's table and the object that the program works with.
Texts for people (`Text`) stand in every file in English and German.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from enum import StrEnum
from typing import Annotated, Any, Final

from pydantic import AliasPath, BeforeValidator, Field, WrapValidator
from pydantic.fields import FieldInfo

from lecombus.errors import CodeValueError
from lecombus.parameters import HIGHEST_DECIMAL, LOWEST_DECIMAL, Code, Value

from .yaml_models import KEY, LIST_RIGHT, TEXT_RIGHT, FileContext, Quoted, ReadBy, mistake

__all__ = [
    "NOTHING",
    "WORD_MAX",
    "BothLanguages",
    "CodeNumber",
    "DescribedCode",
    "Flag",
    "Language",
    "Number",
    "ShownCode",
    "Source",
    "Text",
    "WordCode",
    "WordNumber",
    "WordValue",
    "Words",
    "WritableCode",
    "ends",
    "milliseconds",
    "numbered",
    "read_code",
    "read_number",
    "read_words",
    "whole",
    "whole_number",
]


class Language(StrEnum):
    """A language that texts can be asked for in."""

    EN = "en"
    DE = "de"


@dataclass(frozen=True, slots=True)
class Text:
    """One text in both languages.

    Args:
        en: English.
        de: German.
    """

    en: str
    de: str

    def __str__(self) -> str:
        """Return the English text: logs and errors are in English."""
        return self.en

    def in_language(self, language: Language) -> str:
        """Return the text in a language."""
        return self.de if language is Language.DE else self.en


NOTHING: Final = Text("", "")


WORD_MAX: Final = 0xFFFF
LONGEST_MS: Final = 600_000


def read_words(given: object, *below: int | str) -> str:
    """Read a text that is not empty and has no control characters."""
    if not isinstance(given, str) or not given.strip():
        raise mistake(TEXT_RIGHT, *below)
    if not given.isprintable():
        raise mistake("a control character stands in this text: it would steer a terminal", *below)
    return str(given)


def read_code(given: object) -> Code:
    """Read a code, such as `C0150` or `C0168/1`."""
    try:
        return Code.parse(read_words(given))
    except CodeValueError as exc:
        raise mistake(str(exc)) from exc


def read_number(given: object, *below: int | str) -> Decimal:
    """Read a number that a decimal on the wire could carry: 4 decimals, 32 bits."""
    text = read_words(given, *below)
    right = f"a number from {LOWEST_DECIMAL} to {HIGHEST_DECIMAL} is right here"
    try:
        number = Decimal(text)
    except ArithmeticError as exc:
        raise mistake(right, *below) from exc
    if not number.is_finite() or not LOWEST_DECIMAL <= number <= HIGHEST_DECIMAL:
        raise mistake(f"{text}: {right}", *below)
    if number != round(number, 4):
        raise mistake(f"{text} has more than 4 decimals, which cannot be sent", *below)
    return number


def whole_number(given: object, low: int, high: int, *below: int | str) -> int:
    """Read a whole number from `low` to `high`, decimal or hexadecimal (`0x0800`)."""
    right = f"a whole number from {low} to {high} is right here"
    if not isinstance(given, str) or isinstance(given, Quoted):
        raise mistake(right, *below)
    try:
        number = int(given, 0)
    except ValueError as exc:  # also 010 and 1:30, which YAML takes for whole numbers
        raise mistake(right, *below) from exc
    if not low <= number <= high:
        raise mistake(f"{given}: {right}", *below)
    return number


def whole(low: int, high: int) -> ReadBy:
    """Mark a whole number from `low` to `high`."""
    return ReadBy(lambda given: whole_number(given, low, high))


def milliseconds(low: int = 1, high: int = LONGEST_MS) -> ReadBy:
    """Mark a time that stands in milliseconds in the file and is kept in seconds."""
    return ReadBy(lambda given: whole_number(given, low, high) / 1000)


def ends(key: str, what: str, *, equal: bool = False) -> tuple[WrapValidator, FieldInfo, FieldInfo]:
    """Return what reads a pair such as `bits: [8, 11]` into the fields `low` and `high`.

    Args:
        key: The pair's key.
        what: What is right, for errors.
        equal: Both ends may be the same.

    Returns:
        The mark of the table, of `low` and of `high`.
    """

    def check(given: Any, read: Callable[[Any], Any]) -> Any:
        pair = given.get(key) if isinstance(given, dict) else None
        if pair is not None and (not isinstance(pair, list) or len(pair) != 2):
            raise mistake(what, key)
        found = read(given)
        if pair is not None and (found.low > found.high or (found.low == found.high and not equal)):
            raise mistake(what, key)
        return found

    low, high = (Field(validation_alias=AliasPath(key, number)) for number in (0, 1))
    return WrapValidator(check), low, high


def _read_flag(given: object) -> bool:
    if isinstance(given, Quoted) or given not in ("true", "false"):
        raise mistake("true or false is right here")
    return given == "true"


def _read_both(given: object) -> Text:
    if not isinstance(given, list):
        raise mistake(LIST_RIGHT)
    if len(given) != 2:
        raise mistake("a text is given in two languages: [english, german]")
    return Text(read_words(given[0], 0), read_words(given[1], 1))


def _read_source(given: object, context: FileContext) -> str:
    return f"{context.manual} {read_words(given)}".strip()


def _read_described(given: object, context: FileContext) -> Code:
    """Read a code that must be described; while no code is known, nothing is checked."""
    code = read_code(given)
    if context.codes and code not in context.codes:
        raise mistake(f"{code} is not described", code=code)
    return code


def _read_word_code(given: object, context: FileContext) -> Code:
    code = read_code(given)
    if code not in context.codes or context.codes[code].hex_digits is None:
        raise mistake(f"{code} is not described as a word (VH)", code=code)
    return code


def _read_writable(given: object, context: FileContext) -> Code:
    code = _read_described(given, context)
    if context.codes and not context.codes[code].writable:
        raise mistake(f"{code} cannot be written", code=code)
    return code


def _read_shown(given: object, context: FileContext) -> Code:
    code = _read_described(given, context)
    info = context.codes.get(code)
    if info is not None and (info.secret or not info.readable):
        why = "is secret" if info.secret else "cannot be read"
        raise mistake(f"{code} {why}, so it is not read unasked", code=code)
    return code


def _refuse_number_twice(given: Any) -> Any:
    """Refuse a table in which two keys are one number, such as 8 and 0x8."""
    seen: set[int] = set()
    for key in given if isinstance(given, dict) else ():
        try:
            number = int(key, 0)
        except ValueError:
            continue  # refused as a key, with its place
        if number in seen:
            raise mistake(f"{number} stands here twice", key, KEY)
        seen.add(number)
    return given


numbered: Final = BeforeValidator(_refuse_number_twice)
"""Marks a table whose keys are numbers."""

Words = Annotated[str, ReadBy(read_words)]
Flag = Annotated[bool, ReadBy(_read_flag)]
CodeNumber = Annotated[Code, ReadBy(read_code)]
DescribedCode = Annotated[Code, ReadBy(_read_described, informed=True)]
WritableCode = Annotated[Code, ReadBy(_read_writable, informed=True)]
ShownCode = Annotated[Code, ReadBy(_read_shown, informed=True)]
"""A code that is read without a request: every user sees its value."""
WordCode = Annotated[Code, ReadBy(_read_word_code, informed=True)]
Number = Annotated[Decimal, ReadBy(read_number)]
BothLanguages = Annotated[Text, ReadBy(_read_both)]
Source = Annotated[str, ReadBy(_read_source, informed=True)]
"""Section of the manual; kept with the manual's name before it."""
WordNumber = Annotated[int, whole(0, WORD_MAX)]
WordValue = Annotated[Value, ReadBy(lambda given: Value.decimal(whole_number(given, 0, WORD_MAX)))]
"""A whole number that is written as a decimal."""
