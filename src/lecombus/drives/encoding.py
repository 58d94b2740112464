"""From what a user gives to the value that is written.

The code's description decides the format; without one, the format that the code was last read in;
without that, the value itself (a number is a decimal, `H0008` a word, `O..` octets). Values are
exact: a binary float is refused, because the decimal that was meant is lost. `check_allowed`
compares with the manual's range separately: a setting of the drive may change the range, and what
was read from a drive can be written back in any case.

A text of digits is refused where a word is written: the `0208` of a manual means H0208, and as a
decimal it is H00D0, which enables a drive instead of stopping it. Numbers are taken as they are.

Source: EDB2102EN 8.3.1, CMVLC401A 5.4 (formats; drives accept no strings).
"""

from __future__ import annotations

import re
from decimal import Decimal
from typing import Final

from lecombus.errors import CodeValueError
from lecombus.parameters import Code, DecimalLimits, Format, Value, rules_of

from .code_info import CodeInfo
from .family import Family

__all__ = ["check_allowed", "encode_for"]

_WORD: Final = re.compile(r"(?:H|0X)([0-9A-F]+)", re.ASCII)
"""A word as a user writes it, in capitals."""
_DIGITS: Final = re.compile(r"([+-]?)([0-9]+)(\.[0-9]*)?", re.ASCII)
_LEADING_ZERO: Final = re.compile(r"0[0-9]+", re.ASCII)
_MOST_DIGITS: Final = 12
"""More than any word has in decimal."""


def encode_for(
    family: Family, code: Code, given: Decimal | int | str, *, last_read: Value | None = None
) -> Value:
    """Make the value that is written to a code.

    Args:
        family: The drive's family.
        code: The code to be written.
        given: A number, or a text: a decimal such as `-35.4`, a word such as `H0008` or `0x0008`,
            or `O` with octets.
        last_read: What the code read last, which decides the format if it is not described;
            None where it was never read.

    Raises:
        CodeValueError: It is not a value, not one this code can take, text that could be a word
            and a decimal, or a string (drives accept none). `code` and `value` are filled in.
    """
    if isinstance(given, bool) or not isinstance(given, (Decimal, int, str)):
        raise _refused(family, code, given, "a number or a text such as 35.4 or H0008 is right")
    if isinstance(given, str):
        given = given.strip()
    info = family.info(code)
    if info is not None and info.format is Format.VS:
        raise _refused(family, code, given, "drives send strings and accept none")
    digits = _word_digits(info, last_read)
    try:
        if digits:
            value = _word(given, digits)
        else:
            if info is None and last_read is None:
                _refuse_leading_zero(given)
            value = _by_itself(given, rules_of(family.protocol).decimals)
    except CodeValueError as exc:
        raise CodeValueError(
            f"{family.spoken(code)}: {exc}", code=str(code), value=given, low=exc.low, high=exc.high
        ) from exc
    if info is not None and value.format is not info.format:
        raise _refused(family, code, given, f"{info.name} is sent as {_spoken(info)}")
    if value.format is Format.VS:
        raise _refused(family, code, given, "drives send strings and accept none")
    return value


def check_allowed(family: Family, code: Code, value: Value) -> None:
    """Refuse a value that the manual does not allow: range, step or selection.

    Args:
        family: The drive's family.
        code: The code to be written.
        value: What `encode_for` made. Where nothing is described, anything is allowed.

    Raises:
        CodeValueError: It is not one of the values there are; the message says which are.
    """
    info, number = family.info(code), value.quantity
    if info is None or number is None or info.may_be(number):
        return
    raise CodeValueError(
        f"{info.name} is {info.allowed}",
        code=str(code), value=number, low=info.low, high=info.high,
    )  # fmt: skip


def _word_digits(info: CodeInfo | None, last_read: Value | None) -> int | None:
    """Return the number of hexadecimal digits a code is sent with, None where it is not a word."""
    if info is not None:
        return info.hex_digits if info.format is Format.VH else None
    if last_read is not None and last_read.format is Format.VH:
        return len(last_read.raw) - 1
    return None


def _word(given: Decimal | int | str, digits: int) -> Value:
    """Make a word of a number, or of text that says that it is hexadecimal."""
    if not isinstance(given, str):
        if isinstance(given, Decimal) and (
            # A short number with an exponent could be a megabyte once written out.
            not given.is_finite() or given.adjusted() > _MOST_DIGITS or given % 1
        ):
            raise CodeValueError(f"{given} is not a whole number; {_word_form(digits)} is right")
        return Value.hexadecimal(int(given), digits)
    match = _WORD.fullmatch(given.upper())
    if match is None:
        raise CodeValueError(_readings(given, digits))
    if len(match[1]) > digits:
        raise CodeValueError(f"{given} is too long; {_word_form(digits)} is right")
    return Value.hexadecimal(int(match[1], 16), digits)


def _readings(text: str, digits: int) -> str:
    """Return what digits without a sign of their base could mean as a word, and how to write it."""
    match = _DIGITS.fullmatch(text)
    if match is None or match[1] == "-" or (match[3] or "").strip(".0"):
        return f"{text!r} is not a word; {_word_form(digits)} is right"
    number, highest = int(match[2]), 16**digits - 1
    decimal = f"H{number:0{digits}X}" if number <= highest else ""
    plain = not match[1] and match[3] is None
    word = f"H{int(match[2], 16):0{digits}X}" if plain and len(match[2]) <= digits else ""
    written = f"{word} or 0x{word[1:]}"
    if word and word == decimal:
        return f"{text} does not say that it is hexadecimal; write {written}"
    if word and decimal:
        return (
            f"{text} could be {word} ({int(word[1:], 16)}) or decimal {number} ({decimal}); "
            f"write {written}, or {decimal}"
        )
    if word:
        return f"{text} could be {word} ({int(word[1:], 16)}); write {written}"
    if decimal:
        return f"{text} could be decimal {number} ({decimal}); write {decimal}"
    return f"{text} is too long for a word; {_word_form(digits)} is right"


def _refuse_leading_zero(given: Decimal | int | str) -> None:
    """Refuse what looks like a word's digits for a code whose format is not known."""
    if isinstance(given, str) and _LEADING_ZERO.fullmatch(given):
        number = int(given)
        raise CodeValueError(
            f"{given} could be a word (H{given}) or decimal {number}, and the format "
            f"of this code is not known; write H with 2, 4 or 8 digits, or {number}"
        )


def _by_itself(given: Decimal | int | str, decimals: DecimalLimits) -> Value:
    if not isinstance(given, str):
        return Value.decimal(given, decimals)
    capitals = given.upper()
    if capitals.startswith("0X"):
        return Value.parse(f"H{capitals[2:]}")
    if capitals[:1] in ("H", "O"):
        return Value.parse(capitals)
    if capitals[:1] == "S":
        return Value.parse(given)
    return Value.decimal(given, decimals)


def _word_form(digits: int) -> str:
    return f"H or 0x with up to {digits} hexadecimal digits, such as H{8:0{digits}X},"


def _spoken(info: CodeInfo) -> str:
    return "a decimal number" if info.format is Format.VD else "octets, such as O01FF"


def _refused(family: Family, code: Code, given: object, why: str) -> CodeValueError:
    return CodeValueError(
        f"{family.spoken(code)} cannot be set to {given!r}: {why}", code=str(code), value=given
    )
