"""Parameter values: four formats, exact both ways.

A `Value` is the text as it stands on the wire plus what that text is (its format). The number in
it is worked out only when someone asks, and then kept: most values read on a line are compared,
stored and shown as text. Decimals are `decimal.Decimal`, never a binary float.

Writing is canonical (no leading or trailing zeros, no point without fraction, no minus on zero).
Reading takes what a drive may plausibly send, as long as it has one meaning only:

* VD: 1 to 6 digits, optionally a point and 1 to 4 digits, `-` in front; leading and trailing zeros
  (`035.40`) and a minus on zero (`-0.0`, read as 0) are taken. Blanks, `+`, `5.` and `.5` are not,
  nor is a number that does not fit in 32 bits, signed, in units of 1/10000.
* VH: `H` and 2, 4 or 8 hexadecimal digits, also small ones.
* VS: `S` and 0 to 240 printable characters. At most 20 are ever sent to a drive.
* VO: letter `O` and 1 to 120 pairs of hexadecimal digits. The bytes are given in wire order: the
  manuals call the layout Intel order and then list high before low, so what words they form is
  left to the caller, who knows the block.

Parsed values are cached by text (a bounded number), since a line reads the same few again and
again. No telegram and no code is known here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from decimal import Context, Decimal, Inexact, InvalidOperation
from enum import StrEnum
from functools import lru_cache
from typing import Final

from lecombus.errors import CodeValueError

__all__ = [
    "HEX_DIGITS",
    "HIGHEST_DECIMAL",
    "HIGHEST_VALUE_CHARS",
    "LOWEST_DECIMAL",
    "SENDABLE_STRING_CHARS",
    "USUAL_DECIMALS",
    "DecimalLimits",
    "Format",
    "Json",
    "Value",
    "ValueFormatError",
]

Json = None | bool | int | Decimal | str | list["Json"] | dict[str, "Json"]
"""What may stand in a document: no float, so that no decimal is ever rounded by accident."""

LOWEST_DECIMAL: Final = Decimal("-214748.3648")
HIGHEST_DECIMAL: Final = Decimal("214748.3647")
HEX_DIGITS: Final = (2, 4, 8)
"""How many hexadecimal digits a word is sent with."""
SENDABLE_STRING_CHARS: Final = 20
"""Longest string sent to a drive. Source: EDB2102EN 8.3.1 (it prints 12, 20 and 240)."""
HIGHEST_VALUE_CHARS: Final = 241
"""Longest value text: a format letter and 240 characters."""

_EXACT: Final = Context(prec=28, traps=[Inexact, InvalidOperation])
_VD: Final = re.compile(r"(-?\d{1,6})(?:\.(\d{1,4}))?", re.ASCII)
_VH: Final = re.compile(r"H(?:[0-9A-Fa-f]{2}|[0-9A-Fa-f]{4}|[0-9A-Fa-f]{8})")
_VS: Final = re.compile(r"S[ -~]{0,240}")
_VO: Final = re.compile(r"O(?:[0-9A-Fa-f]{2}){1,120}")
_GIVEN: Final = re.compile(r"[+-]?\d{1,400}(?:\.\d{1,400})?", re.ASCII)


@dataclass(frozen=True, slots=True)
class DecimalLimits:
    """Which decimal numbers a protocol can send.

    Args:
        low: The lowest.
        high: The highest.
        places: How many digits may follow the point.
    """

    low: Decimal
    high: Decimal
    places: int


USUAL_DECIMALS: Final = DecimalLimits(LOWEST_DECIMAL, HIGHEST_DECIMAL, 4)
"""A signed 32-bit count of 1/10000. Source: EDB2102EN 8.3.1; CMVLC401A 5.4."""


class Format(StrEnum):
    """The formats of a parameter value. Source: EDB2102EN 8.3.1; CMVLC401A 5.4."""

    VD = "VD"
    VH = "VH"
    VS = "VS"
    VO = "VO"


class ValueFormatError(CodeValueError):
    """A value's text is in none of the four formats."""


@dataclass(frozen=True, slots=True)
class Value:
    """One parameter value; two are equal when their texts are.

    Make one with `decimal`, `hexadecimal` or `parse`, which check it.

    Args:
        format: What the text is.
        raw: The text as on the wire, with its format letter: `35.4`, `H0900`, `S33S2102I`.
    """

    format: Format
    raw: str
    _number: Decimal | int | str | bytes | None = field(
        default=None, init=False, repr=False, compare=False
    )

    def __str__(self) -> str:
        """Return the text as on the wire."""
        return self.raw

    @property
    def number(self) -> Decimal | int | str | bytes:
        """What the text means: VD a Decimal, VH an int, VS the text after `S`, VO bytes."""
        number = self._number
        if number is None:
            number = _number_of(self.format, self.raw)
            object.__setattr__(self, "_number", number)
        return number

    @property
    def quantity(self) -> Decimal | int | None:
        """The number; None where it is text or octets."""
        number = self.number
        return None if isinstance(number, (str, bytes)) else number

    @property
    def whole(self) -> int | None:
        """The number where it is a whole one, None where it is not."""
        number = self.quantity
        return int(number) if number is not None and number == int(number) else None

    @property
    def word(self) -> int | None:
        """The number of a VH value, None of any other."""
        number = self.number
        return number if isinstance(number, int) else None

    def means_same(self, other: Value) -> bool:
        """Whether two values mean the same, such as `35.4` and `35.40`, or `8` and `H0008`."""
        return self.raw == other.raw or self.number == other.number

    @classmethod
    def decimal(cls, number: Decimal | int | str, limits: DecimalLimits = USUAL_DECIMALS) -> Value:
        """Make a VD value.

        Args:
            number: The number, or a text such as `-35.4`.
            limits: Which numbers can be sent.

        Raises:
            CodeValueError: It is not a decimal, out of range, or has too many decimals.

        Source: EDB2102EN 8.3.1 "ASCII decimal format (VD)"; CMVLC401A 5.4.
        """
        given = _decimal_of(number)
        low, high, places = limits.low, limits.high, limits.places
        if not low <= given <= high:
            raise CodeValueError(
                f"{number} does not fit: decimals run from {low} to {high}",
                value=number, low=low, high=high,
            )  # fmt: skip
        try:
            exact = given.quantize(Decimal(1).scaleb(-places), context=_EXACT)
        except (Inexact, InvalidOperation) as exc:
            most = f"at most {places} digits" if places else "no digit"
            raise CodeValueError(
                f"{number} cannot be sent exactly: {most} may follow the point", value=number
            ) from exc
        text = format(exact, "f")
        text = text.rstrip("0").rstrip(".") if places else text
        return cls(Format.VD, "0" if text == "-0" else text)

    @classmethod
    def hexadecimal(cls, number: int, digits: int) -> Value:
        """Make a VH value.

        Args:
            number: 0..16**digits - 1; negative numbers are the caller's two's complement.
            digits: 2 (byte), 4 (word) or 8 (double word).

        Raises:
            CodeValueError: The digits are another number, or do not hold the number.

        Source: EDB2102EN 8.3.1 "ASCII hexadecimal format (VH)"; CMVLC401A 5.4.
        """
        if digits not in HEX_DIGITS:
            raise CodeValueError(
                f"{digits} hexadecimal digits are not sent: 2, 4 or 8 are", value=digits
            )
        high = 16**digits - 1
        if not 0 <= number <= high:
            raise CodeValueError(
                f"{number} does not fit in {digits} hexadecimal digits: 0 to {high} do",
                value=number, low=0, high=high,
            )  # fmt: skip
        return cls(Format.VH, f"H{number:0{digits}X}")

    @classmethod
    def parse(cls, raw: str | bytes) -> Value:
        """Read a value's text as it stands on the wire.

        Raises:
            ValueFormatError: It is in none of the four formats.
        """
        # latin-1 takes every byte, and no format takes what is not ASCII.
        return _parse(raw.decode("latin-1") if isinstance(raw, bytes) else raw)


@lru_cache(maxsize=4096)
def _parse(text: str) -> Value:
    letter = text[:1]
    if letter == "H" and _VH.fullmatch(text):
        return Value(Format.VH, text)
    if letter == "S" and _VS.fullmatch(text):
        return Value(Format.VS, text)
    if letter == "O" and _VO.fullmatch(text):
        return Value(Format.VO, text)
    match = _VD.fullmatch(text)
    # Only six digits before the point can be too many for the 32 bits behind a decimal.
    if match and (match.end(1) < 6 or LOWEST_DECIMAL <= Decimal(text) <= HIGHEST_DECIMAL):
        return Value(Format.VD, text)
    raise ValueFormatError(
        f"{text!r} is not a value: a decimal such as -35.4, H with 2, 4 or 8 hexadecimal digits, "
        "S with text, or O with pairs of hexadecimal digits is",
        value=text,
    )


def _number_of(form: Format, raw: str) -> Decimal | int | str | bytes:
    if form is Format.VD:
        number = Decimal(raw)
        return number if number else number.copy_abs()  # "-0.0" is 0
    if form is Format.VH:
        return int(raw[1:], 16)
    return raw[1:] if form is Format.VS else bytes.fromhex(raw[1:])


def _decimal_of(number: Decimal | int | str) -> Decimal:
    if isinstance(number, str) and _GIVEN.fullmatch(number) is None:
        raise CodeValueError(f"{number!r} is not a decimal such as -35.4", value=number)
    if isinstance(number, bool | float):
        # A float has lost the exact number before it came here; passing one is a programming error.
        raise TypeError(f"decimals are exact: give a Decimal, int or str, not {number!r}")
    given = Decimal(number)
    if not given.is_finite():
        raise CodeValueError(f"{number} is not a number that can be sent", value=number)
    return given
