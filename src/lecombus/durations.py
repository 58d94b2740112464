"""Durations as people write them: `500ms`, `2s`, `1.5min`, `1h`.

A bare number is refused, since 2 could be seconds to one reader and milliseconds to the next; only
0 is the same in every unit. Seconds as float are used everywhere inside.
"""

from __future__ import annotations

import re
from decimal import Decimal
from typing import Final

__all__ = [
    "LEAST_EXPIRY_S",
    "LONGEST_EXPIRY_S",
    "DurationError",
    "format_duration",
    "parse_duration",
]

LEAST_EXPIRY_S: Final = 0.001
LONGEST_EXPIRY_S: Final = 3600.0
"""How long a request may wait for its turn, for clients that give `expires`."""

_UNITS: Final = {
    "ms": Decimal("0.001"), "s": Decimal(1), "min": Decimal(60), "h": Decimal(3600),
}  # fmt: skip
_WRITTEN: Final = re.compile(r"([+-]?)([0-9]{1,9}(?:\.[0-9]{1,6})?) ?([A-Za-zµ]*)")
_MEANT: Final = {
    "m": "write min for minutes or ms for milliseconds",
    "sec": "write s for seconds",
    "secs": "write s for seconds",
    "second": "write s for seconds",
    "seconds": "write s for seconds",
    "msec": "write ms for milliseconds",
    "millis": "write ms for milliseconds",
    "minute": "write min for minutes",
    "minutes": "write min for minutes",
    "us": "write ms for milliseconds, such as 0.5ms",
    "µs": "write ms for milliseconds, such as 0.5ms",
}


class DurationError(ValueError):
    """A text is not a duration.

    Args:
        what: What is wrong with it.
        right: What would be right.
    """

    def __init__(self, what: str, right: str) -> None:
        super().__init__(f"{what}, {right}")
        self.what = what
        self.right = right


def parse_duration(text: str) -> float:
    """Return a duration in seconds.

    Args:
        text: A number, not negative, directly followed by ms, s, min or h; or 0.

    Raises:
        DurationError: It is something else.
    """
    match = _WRITTEN.fullmatch(text)
    if match is None:
        if re.fullmatch(r"[0-9]+,[0-9]+ ?[a-z]*", text):
            raise DurationError("has a decimal comma", f"write {text.replace(',', '.')}")
        right = "write a number with ms, s, min or h, such as 500ms"
        raise DurationError("is not a duration", right)
    sign, number, unit = match.groups()
    if sign == "-" and Decimal(number):
        raise DurationError("is negative", f"write {number}{unit or 's'}")
    if not unit:
        if Decimal(number) == 0:
            return 0.0
        raise DurationError("has no unit", f"write {number}ms, {number}s, {number}min or {number}h")
    factor = _UNITS.get(unit)
    if factor is None:
        otherwise = "the units are ms, s, min and h"
        if unit.lower() in _UNITS:
            otherwise = f"write {number}{unit.lower()}"
        raise DurationError(
            f"has the unknown unit `{unit[:20]}`", _MEANT.get(unit.lower(), otherwise)
        )
    return float(Decimal(number) * factor)


def format_duration(seconds: float) -> str:
    """Write a duration the way a roster does, in the largest unit that leaves it short."""
    exact = Decimal(repr(seconds))
    if exact == 0:
        return "0s"
    for unit in ("h", "min", "s"):
        if exact >= _UNITS[unit] and (exact / _UNITS[unit]) % 1 == 0:
            return f"{int(exact / _UNITS[unit])}{unit}"
    if exact >= 1:
        return f"{exact.normalize():f}s"
    return f"{(exact / _UNITS['ms']).normalize():f}ms"
