"""Which codes identify a drive, and when two answers are one identity.

Source: EDB2102EN 8.2 (C1810, C1811), CMVLC401A table 9 (C0200, C0201), 8.1.3 (C1099), 9.2 (P502).
"""

from __future__ import annotations

from collections.abc import Iterable

from lecombus.errors import CodeValueError
from lecombus.parameters import Code, Value

__all__ = ["identity_codes", "is_identity", "is_same_text", "text_of"]

SOFTWARE_CODES = (Code(200), Code(201))
"""Software and its date: not in the 2102 module's manual, but behind it most drives have them."""


def identity_codes(named: Iterable[Code], of_family: tuple[Code, ...]) -> tuple[Code, ...]:
    """Return what a drive is asked to know who it is.

    Args:
        named: What its roster names besides.
        of_family: What its family has; empty for a device nothing is known of.
    """
    usual = (*of_family, *SOFTWARE_CODES) if of_family else ()
    return tuple(dict.fromkeys((*usual, *named)))


def text_of(value: Value) -> str:
    """Return an identity code's value as people know it, strings without their letter."""
    number = value.number
    return number if isinstance(number, str) else value.raw


def is_identity(value: Value, text: str | None) -> bool:
    """Return whether a value is what is said of it; what is not said cannot differ."""
    return text is None or is_same_text(text_of(value), text) or value.raw == text


def is_same_text(found: str, text: str) -> bool:
    """Return whether two texts are one identity; `1.2` and `1.20` are."""
    if found == text:
        return True
    try:
        return Value.parse(found).means_same(Value.parse(text))
    except CodeValueError:
        return False
