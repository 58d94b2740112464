"""Addresses and codes as they stand on the wire.

A code travels in one of two forms. Standard addressing packs 0..6229 into two characters;
extended addressing spells code and subcode out in seven characters that begin with `!`. The two
cannot be confused: a standard field begins with 48 or more, `!` is 33. The characters of a field
are called the code field; an answer repeats the field of the question.

The rule which characters make a field is `fits_field`, and only there: the parser asks it
character by character, everything else asks it for a whole field. Conversions are tables or
caches, since they are on the path of every telegram.

Code bank C0249 and input selection C0248 are deliberately absent: no code is calculated with them.
A drive in which one of them is not 0 is spoken to in extended addressing (`write_prechecks`).
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Final

from lecombus.errors import CodeValueError
from lecombus.parameters import AddressForm, Code

__all__ = [
    "EXTENDED_MARK",
    "HIGHEST_STANDARD_CODE",
    "Form",
    "encode_address",
    "encode_code",
    "field_length",
    "fits_field",
    "group_reach",
    "is_code_field",
    "is_drive_address",
    "is_group_address",
    "multicast_address",
]

HIGHEST_STANDARD_CODE: Final = 6229
"""The last code of standard addressing: `u` DEL."""
EXTENDED_MARK: Final = 0x21
"""`!`, the first character of an extended code field."""

_STANDARD_LENGTH: Final = 2
_EXTENDED_LENGTH: Final = 7
_BASE: Final = 48
_PAGE: Final = 790  # codes of one tens digit of C2: 79 values of C1, ten of C2
_CAPITAL_HEX: Final = b"0123456789ABCDEF"


class Form(AddressForm):
    """The two ways a code is put on the wire."""

    STANDARD = "standard"
    EXTENDED = "extended"

    def carries(self, code: Code) -> bool:
        """Return whether this form can address a code at all."""
        if self is Form.EXTENDED:
            return True
        return code.number <= HIGHEST_STANDARD_CODE and code.subcode == 0


def encode_code(code: Code, form: AddressForm) -> bytes:
    """Return the code field: 2 characters in standard, 7 in extended addressing.

    Raises:
        CodeValueError: Standard addressing cannot carry this code or subcode.

    Source: EDB2102EN 8.3.1 "Standard addressing", "Extended addressing"; CMVLC401A 5.3.1, 5.3.4.
    """
    return _encode_code(code, form)


@lru_cache(maxsize=8192)
def _encode_code(code: Code, form: AddressForm) -> bytes:
    if form is Form.EXTENDED:
        return b"!%04X%02X" % (code.number, code.subcode)
    if not form.carries(code):
        raise CodeValueError(
            f"{code} needs extended addressing: standard addressing reaches codes 0 to "
            f"{HIGHEST_STANDARD_CODE} without subcode",
            code=str(code), value=code.number, low=0, high=HIGHEST_STANDARD_CODE,
        )  # fmt: skip
    page, rest = divmod(code.number, _PAGE)
    return bytes((rest // 10 + _BASE, rest % 10 + page * 10 + _BASE))


def field_length(first: int) -> int:
    """Return how long the code field is that begins with this character."""
    return _EXTENDED_LENGTH if first == EXTENDED_MARK else _STANDARD_LENGTH


def fits_field(start: bytes | bytearray) -> bool:
    """Return whether these characters begin (or are) a code field.

    Standard: C1 holds a tens count of 0..78, C2 a unit and a page of 0..7. On the last page only
    tens up to 69 are codes (7 * 790 + 699 = 6229). Extended: capital hexadecimal digits.

    Args:
        start: 1 to 7 characters, 7 bits each.
    """
    first = start[0]
    length = len(start)
    if first == EXTENDED_MARK:
        return length <= _EXTENDED_LENGTH and not start[1:].translate(None, _CAPITAL_HEX)
    if length > _STANDARD_LENGTH or not 48 <= first <= 126:
        return False
    return length == 1 or 48 <= start[1] <= 117 or (first <= 117 and 118 <= start[1] <= 127)


def is_code_field(field: bytes) -> bool:
    """Return whether these characters are exactly one code field."""
    return len(field) > 1 and len(field) == field_length(field[0]) and fits_field(field)


_ADDRESSES: Final = tuple(b"%02d" % address for address in range(100))


def encode_address(address: int) -> bytes:
    """Return AD1 AD2.

    Args:
        address: 0..99; multiples of ten are groups (`group_reach`).

    Raises:
        CodeValueError: Two digits cannot carry it.

    Source: EDB2102EN 8.3.1 "Controller address (AD1, AD2)"; CMVLC401A 5.2.
    """
    if not 0 <= address <= 99:
        raise CodeValueError(
            f"there is no address {address}: addresses run from 0 to 99",
            value=address, low=0, high=99,
        )  # fmt: skip
    return _ADDRESSES[address]


def is_drive_address(address: int) -> bool:
    """Return whether a single drive can have this address: 1..99 without 10, 20 .. 90."""
    return 0 < address < 100 and address % 10 != 0


def is_group_address(address: int) -> bool:
    """Return whether this address reaches a group: 0 all drives, 10, 20 .. 90 one decade each."""
    return 0 <= address < 100 and address % 10 == 0


def group_reach(address: int) -> tuple[int, ...]:
    """Return the drive addresses that a group address reaches.

    Raises:
        CodeValueError: It is not a group address.

    Source: EDB2102EN 8.3.4; CMVLC401A table 8.
    """
    if not is_group_address(address):
        raise CodeValueError(
            f"{address} is not a group address: those are 0 (all) and 10, 20 .. 90",
            value=address, low=0, high=90,
        )  # fmt: skip
    if address == 0:
        return tuple(filter(is_drive_address, range(100)))
    return tuple(range(address + 1, address + 10))


def multicast_address(members: Iterable[int], drives: Iterable[int]) -> int | None:
    """Return the address that reaches exactly these members among the roster's drives.

    Where all drives stand in one decade, that decade goes before 0: a broadcast would also reach
    drives on the cable that the roster does not know.

    Args:
        members: The members' addresses.
        drives: The addresses of all drives of the roster.

    Returns:
        10, 20 .. 90 for a decade, 0 for all drives, None if no telegram reaches exactly them.

    Source: EDB2102EN 8.3.4.
    """
    wanted = set(members)
    present = set(drives)
    decades = {address // 10 * 10 for address in wanted}
    if len(decades) == 1:
        decade = decades.pop()
        # Addresses 1..9 have no multicast of their own: 0 reaches everybody.
        if decade and wanted == {address for address in present if address // 10 * 10 == decade}:
            return decade
    return 0 if wanted and wanted == present else None
