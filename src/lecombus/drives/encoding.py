"""From what a user gives to what the wire needs.

Strategy: the code's description decides the format; without one the value itself does (a number
is a decimal, `H0008` a word, `O..` octets). Values are exact all the way: a binary float is
refused, because what it stands for has been lost already. Whether the manual allows the value is
asked apart from that (`check_allowed`): a setting of the drive may change the range, and what was
read from a drive can be written back whatever the manual says.

Source: EDB2102EN 8.3.1, CMVLC401A 5.4 (formats; drives accept no strings).
"""

from __future__ import annotations

from decimal import Decimal

from lecombus.errors import CodeValueError
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Format, Value

from .codes import CodeInfo
from .family import Family

__all__ = ["check_allowed", "encode_for"]


def encode_for(family: Family, code: Code, given: Decimal | int | str) -> Value:
    """Make the value that is written to a code.

    Args:
        family: The drive's family.
        code: The code to be written.
        given: A number, or a text: a decimal such as `-35.4`, `H0008`, or `O` with octets.

    Raises:
        CodeValueError: It is not a value, not one this code can take, or a string (drives accept
            none). `code` and `value` are filled in.
    """
    if isinstance(given, bool) or not isinstance(given, (Decimal, int, str)):
        raise _refused(code, given, "a number or a text such as 35.4 or H0008 is right")
    if isinstance(given, str):
        given = given.strip()
    info = family.info(code)
    if info is not None and info.format is Format.VS:
        raise _refused(code, given, "drives send strings and accept none")
    try:
        value = _by_format(info, given) if info is not None else _by_itself(given)
    except CodeValueError as exc:
        raise CodeValueError(
            f"{code}: {exc}", code=str(code), value=given, low=exc.low, high=exc.high
        ) from exc
    if info is not None and value.format is not info.format:
        raise _refused(code, given, f"{info.name} is sent as {_spoken(info)}")
    if value.format is Format.VS:
        raise _refused(code, given, "drives send strings and accept none")
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
    info, number = family.info(code), value.number
    if info is None or isinstance(number, str | bytes) or info.may_be(number):
        return
    raise CodeValueError(
        f"{info.name} is {info.allowed}",
        code=str(code), value=number, low=info.low, high=info.high,
    )  # fmt: skip


def _by_format(info: CodeInfo, given: Decimal | int | str) -> Value:
    """Encode for a described code; a number for a word becomes its hexadecimal text."""
    if info.format is not Format.VH:
        return _by_itself(given)
    assert info.hex_digits is not None
    if isinstance(given, str) and given[:1].upper() == "H":
        given = _word(given)
    number = _by_itself(given).number
    if not isinstance(number, Decimal) or number != number.to_integral_value():
        raise CodeValueError(f"{given} is no whole number; {_spoken(info)} is right")
    return Value.hexadecimal(int(number), info.hex_digits)


def _by_itself(given: Decimal | int | str) -> Value:
    if not isinstance(given, str):
        return Value.decimal(given)
    letter = given[:1].upper()
    if letter in ("H", "O"):
        return Value.parse(given.upper())
    if letter == "S":
        return Value.parse(given)
    return Value.decimal(given)


def _word(text: str) -> int:
    number = Value.parse(text.upper()).number
    assert isinstance(number, int)
    return number


def _spoken(info: CodeInfo) -> str:
    if info.format is Format.VH:
        return f"a word: a whole number, or H with {info.hex_digits} hexadecimal digits"
    return "a decimal number" if info.format is Format.VD else "octets, such as O01FF"


def _refused(code: Code, given: object, why: str) -> CodeValueError:
    return CodeValueError(f"{code} cannot be set to {given!r}: {why}", code=str(code), value=given)
