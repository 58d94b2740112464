"""Types of single values that count or measure: numbers, addresses, times, shares, codes.

All of them read the text as written: only plain decimal digits are numbers here, and none of YAML's
own forms (octal 010, sexagesimal 11:30, hexadecimal, floats).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

from lecombus.config.mistakes import one_of
from lecombus.config.scalar_types import ScalarType, WrongText
from lecombus.durations import DurationError, format_duration, parse_duration
from lecombus.errors import CodeValueError
from lecombus.parameters import Code

__all__ = ["Address", "CodeType", "Duration", "Percent", "Whole", "WholeChoice"]


class Whole(ScalarType):
    """A whole number.

    Args:
        low: Least allowed.
        high: Greatest allowed.
    """

    def __init__(self, low: int, high: int) -> None:
        schema = {"type": "integer", "minimum": low, "maximum": high}
        super().__init__(f"a whole number, {low} to {high}", schema)
        self._low = low
        self._high = high

    def _convert(self, text: str) -> int:
        number = self._number(text)
        if not self._low <= number <= self._high:
            raise WrongText("is out of range", f"{self._low} to {self._high} would be right")
        return number

    def _number(self, text: str) -> int:
        if re.fullmatch(r"-?[0-9]{1,9}", text) is None:
            raise WrongText("is no whole number", f"give {self.expects}")
        if re.fullmatch(r"-?0[0-9]+", text):
            # YAML 1.1 reads 010 as 8, YAML 1.2 as 10: which was meant cannot be seen.
            raise WrongText(
                "begins with 0, which some YAML readers take for octal", self._without_0(int(text))
            )
        return int(text)

    def _without_0(self, number: int) -> str:
        """Return the remedy for a number with a leading 0: the number, if it would be right."""
        fits = self._low <= number <= self._high
        return f"write {number}" if fits else f"{self._low} to {self._high} would be right"


class WholeChoice(Whole):
    """One of a few numbers, such as the baud rates."""

    def __init__(self, numbers: Sequence[int]) -> None:
        super().__init__(min(numbers), max(numbers))
        self._numbers = tuple(numbers)
        self.expects = one_of(numbers)
        self.schema = {"enum": list(numbers)}

    def _convert(self, text: str) -> int:
        number = self._number(text)
        if number in self._numbers:
            return number
        meant = min(self._numbers, key=lambda known: abs(known - number))
        near = f"did you mean {meant}? " if abs(meant - number) * 4 <= meant else ""
        raise WrongText("is unknown", f"{near}{one_of(self._numbers)} would be right")


class Address(Whole):
    """A drive's address: 1..99 without those ending in 0, which reach groups.

    Source: EDB2102EN 8.3.1 and 8.3.4 (addresses ending in 0 are reserved for BROADCAST).
    """

    _RIGHT: Final = "1..99 without 10, 20 .. 90 are right"

    def __init__(self) -> None:
        super().__init__(1, 99)
        self.schema["not"] = {"multipleOf": 10}

    def _convert(self, text: str) -> int:
        number = self._number(text)
        if 0 <= number <= 99 and number % 10 == 0:
            reach = "all drives" if number == 0 else f"the group {number + 1}..{number + 9}"
            raise WrongText(f"ends in 0 and so reaches {reach}", self._RIGHT)
        if not 1 <= number <= 99:
            raise WrongText("is out of range", self._RIGHT)
        return number

    def _without_0(self, number: int) -> str:
        # 010 would be a group without its 0, too.
        return f"write {number}" if number % 10 and number < 100 else self._RIGHT


class Duration(ScalarType):
    """A time with its unit.

    Args:
        low_s: Shortest allowed, in seconds.
        high_s: Longest allowed, in seconds.
        zero: What 0 means where it is allowed below `low_s`, such as "never".
    """

    def __init__(self, low_s: float, high_s: float, zero: str = "") -> None:
        written: dict[str, Any] = {
            "type": "string", "pattern": r"^([0-9]+(\.[0-9]+)? ?(ms|s|min|h)|0)$"
        }  # fmt: skip
        super().__init__(
            "a duration such as 500ms or 2s",
            {"anyOf": [written, {"const": 0}]} if zero or not low_s else written,
        )
        self._low_s = low_s
        self._high_s = high_s
        self._zero = zero

    def _convert(self, text: str) -> float:
        try:
            seconds = parse_duration(text)
        except DurationError as exc:
            raise WrongText(exc.what, exc.right) from exc
        if self._low_s <= seconds <= self._high_s or (self._zero and seconds == 0):
            return seconds
        zero = f", or 0 for {self._zero}" if self._zero else ""
        low, high = format_duration(self._low_s), format_duration(self._high_s)
        long = "long" if seconds > self._high_s else "short"
        raise WrongText(f"is too {long}", f"{low} to {high} would be right{zero}")


class Percent(ScalarType):
    """A share, such as `10%`, kept as 0.10.

    Args:
        low: Least allowed, in percent.
        high: Greatest allowed, in percent.
    """

    def __init__(self, low: int, high: int) -> None:
        schema = {"type": "string", "pattern": r"^[0-9]+(\.[0-9]+)? ?%$"}
        super().__init__(f"a share, {low}% to {high}%", schema)
        self._low = low
        self._high = high

    def _convert(self, text: str) -> float:
        match = re.fullmatch(r"([0-9]{1,4}(?:\.[0-9]{1,4})?) ?(%?)", text)
        if match is None:
            raise WrongText("is no share", f"give {self.expects}")
        number = float(match[1])
        if not match[2]:
            percent = number * 100 if number < 1 else number
            raise WrongText("has no percent sign", f"write {percent:g}%")
        if not self._low <= number <= self._high:
            raise WrongText("is out of range", f"{self._low}% to {self._high}% would be right")
        return number / 100


class CodeType(ScalarType):
    """A code, with its subcode after a slash."""

    def __init__(self) -> None:
        written = {"type": "string", "pattern": r"^([Cc]?[0-9]{1,5}|[Pp][0-9]{1,3})(/[0-9]{1,3})?$"}
        number = {"type": "integer", "minimum": 0, "maximum": 65535}
        super().__init__("a code such as C0150, C0039/1 or P425", {"anyOf": [written, number]})

    def _convert(self, text: str) -> Code:
        try:
            return Code.parse(text)
        except CodeValueError as exc:
            raise WrongText(*self._words(text)) from exc

    def _words(self, text: str) -> tuple[str, str]:
        match = re.fullmatch(r"([CcPp]?)([0-9]+)(?:/([0-9]+))?", text, re.ASCII)
        if match is None:
            return "is no code", "write it like C0150, C150, 150, C0039/1 (code/subcode) or P425"
        if match[1] in {"P", "p"} and len(match[2]) > 3:
            return "is no SMVector parameter", "P0 to P999 would be right"
        if match[3] and (len(match[3]) > 3 or int(match[3]) > 255):
            return "has a subcode out of range", "subcodes run from 0 to 255"
        return "is out of range", "codes run from 0 to 65535"
