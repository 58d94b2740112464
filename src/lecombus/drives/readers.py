"""Small readers that many sections of a data file use: codes, choices, flags, sources, bits.

They stand between `document`, which knows places but no meaning, and `sections` and
`code_entries`, which know what a family is made of.
"""

from __future__ import annotations

from decimal import Decimal
from enum import StrEnum
from typing import TypeVar

from lecombus.errors import CodeValueError
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import HIGHEST_DECIMAL, LOWEST_DECIMAL

from .document import Item, Table
from .texts import Text

__all__ = [
    "WORD_MAX",
    "read_choice",
    "read_code_number",
    "read_decimal",
    "read_flag",
    "read_items",
    "read_numbers",
    "read_source",
    "read_span",
    "read_text",
]

WORD_MAX = 0xFFFF

E = TypeVar("E", bound=StrEnum)


def read_code_number(item: Item) -> Code:
    """Read a code, such as `C0150` or `C0168/1`."""
    try:
        return Code.parse(item.text())
    except CodeValueError as exc:
        item.fail(str(exc))


def read_choice(item: Item, choices: type[E]) -> E:
    """Read one of a few words."""
    try:
        return choices(item.text())
    except ValueError:
        item.fail(f"{item.text()} is not known here; {', '.join(choices)} are")


def read_flag(table: Table, key: str) -> bool:
    """Read a yes or no that is no where it is missing."""
    item = table.get(key)
    return item.flag() if item else False


def read_source(table: Table, manual: str) -> str:
    """Read where an entry stands in its manual."""
    return f"{manual} {table.take('source').text()}".strip()


def read_decimal(item: Item) -> Decimal:
    """Read a number that a decimal on the wire could carry: 4 decimals, 32 bits."""
    right = f"a number from {LOWEST_DECIMAL} to {HIGHEST_DECIMAL} is right here"
    try:
        number = Decimal(item.text())
    except ArithmeticError:
        item.fail(right)
    if not number.is_finite() or not LOWEST_DECIMAL <= number <= HIGHEST_DECIMAL:
        item.fail(f"{item.text()}: {right}")
    if number != round(number, 4):
        item.fail(f"{item.text()} has more than 4 decimals, which cannot be sent")
    return number


def read_text(item: Item) -> Text:
    """Read a text in both languages: `[english, german]`."""
    both = item.items()
    if len(both) != 2:
        item.fail("a text is given in two languages: [english, german]")
    return Text(both[0].text(), both[1].text())


def read_items(table: Table, key: str) -> list[Item]:
    """Read a list that may be missing."""
    item = table.get(key)
    return item.items() if item else []


def read_numbers(table: Table, key: str, highest: int) -> tuple[int, ...]:
    """Read the numbers of bits, such as `free: [2, 3]`; none where the key is missing."""
    return tuple(item.integer(0, highest) for item in read_items(table, key))


def read_span(table: Table, highest: int) -> tuple[int, int]:
    """Read the lowest and the highest bit of a field."""
    bits = table.take("bits").items()
    if len(bits) != 2:
        table.fail("bits is the lowest and the highest bit: [8, 11]")
    low = bits[0].integer(0, highest)
    return low, bits[1].integer(low, highest)
