"""The drive's side of the telegram alphabet: code fields, values, parity, from the manuals.

Lives here: how a code field of standard or extended addressing is read, how a value is written as
wire text, even parity in bit 7, and the answers a drive can give. The simulator has its own version
of all this on purpose. The master's `protocol/` must not be imported here, only its control
characters and the block check: the same mistake in both places would prove nothing.
"""

from __future__ import annotations

import re
from decimal import Decimal
from functools import lru_cache
from typing import Final

from lecombus.fieldbus.lecom.protocol.controls import ACK, ENQ, EOT, ETX, NAK, STX, bcc

__all__ = [
    "ACK",
    "ENQ",
    "EOT",
    "ETX",
    "NAK",
    "PARITY_TABLE",
    "STX",
    "bcc",
    "decimal_text",
    "read_code_field",
    "read_decimal",
    "read_hexadecimal",
    "unknown_code",
    "value_reply",
]

_EXTENDED: Final = re.compile(rb"!([0-9A-F]{4})([0-9A-F]{2})\Z")
_DECIMAL: Final = re.compile(r"-?[0-9]{1,6}(\.[0-9]{1,4})?\Z")
_HEXADECIMAL: Final = re.compile(r"H([0-9A-F]{2}|[0-9A-F]{4}|[0-9A-F]{8})\Z")
_LEAST: Final = Decimal("-214748.3648")
_MOST: Final = Decimal("214748.3647")

PARITY_TABLE: Final = bytes(n | (n.bit_count() % 2) << 7 for n in range(128)) * 2
"""Maps a character to the byte that carries it with even parity in bit 7."""


@lru_cache(maxsize=4096)
def read_code_field(field: bytes) -> tuple[int, int, bool] | None:
    """Read the code field of a telegram.

    Args:
        field: Two characters (standard) or seven (extended).

    Returns:
        Code number, subcode and whether the addressing is extended; None when it is not a code.

    Source: EDB2102EN 8.3.1, "Standard addressing" and "Extended addressing".
    """
    if len(field) == 2:
        tens, rest = field[0] - 48, field[1] - 48
        if not (0 <= tens <= 78 and 0 <= rest <= 79):
            return None
        page, ones = divmod(rest, 10)
        return page * 790 + tens * 10 + ones, 0, False
    match = _EXTENDED.match(field)
    if match is None:
        return None
    return int(match[1], 16), int(match[2], 16), True


def decimal_text(value: Decimal) -> str:
    """Write a number as VD text: no point when there is no fraction. Source: EDB2102EN 8.3.1."""
    text = format(value, "f")
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def read_decimal(text: str) -> Decimal | None:
    """Read VD text; None when it is none or lies outside -214748.3648 .. 214748.3647."""
    if _DECIMAL.match(text) is None:
        return None
    value = Decimal(text)
    return value if _LEAST <= value <= _MOST else None


def read_hexadecimal(text: str) -> tuple[int, int] | None:
    """Read VH text: (number, digits); None when it is none. Source: EDB2102EN 8.3.1."""
    match = _HEXADECIMAL.match(text)
    return None if match is None else (int(match[1], 16), len(match[1]))


@lru_cache(maxsize=4096)
def value_reply(field: bytes, text: str) -> bytes:
    """`STX C1 C2 V1..Vn ETX BCC`, also for the `?` answer. Source: EDB2102EN 8.3.2."""
    body = field + text.encode("ascii") + bytes((ETX,))
    return bytes((STX,)) + body + bytes((bcc(body),))


def unknown_code(field: bytes) -> bytes:
    """`STX C1 C2 EOT`. Source: EDB2102EN 8.3.2."""
    return bytes((STX,)) + field + bytes((EOT,))
