"""Types of single values that count or measure: numbers, addresses, times, shares, codes.

All of them read the text as written: only plain decimal digits are numbers here, and none of YAML's
own forms (octal 010, sexagesimal 11:30, hexadecimal, floats).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from lecombus.config.mistakes import one_of
from lecombus.config.scalar_types import ScalarType, WrongText
from lecombus.durations import DurationError, format_duration, parse_duration
from lecombus.errors import CodeValueError
from lecombus.fieldbus.protocols import Fieldbus
from lecombus.parameters import Code, ParameterRules

__all__ = ["Address", "CodeType", "Duration", "Percent", "Size", "Whole", "WholeChoice"]


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
            raise WrongText("is not a whole number", f"give {self.expects}")
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
    """A drive's address.

    Args:
        fieldbus: The protocol, which says which there are.
    """

    def __init__(self, fieldbus: Fieldbus) -> None:
        super().__init__(fieldbus.lowest_address, fieldbus.highest_address)
        self.schema.update(fieldbus.address_schema)
        self._wrong = fieldbus.wrong_address

    def _convert(self, text: str) -> int:
        number = self._number(text)
        wrong = self._wrong(number)
        if wrong is not None:
            raise WrongText(*wrong)
        return number

    def _without_0(self, number: int) -> str:
        wrong = self._wrong(number)  # 010 would be a group without its 0, too
        return f"write {number}" if wrong is None else wrong[1]


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


class Size(ScalarType):
    """An amount of data with its unit, kept in bytes.

    Args:
        low: Least allowed, in MB.
        high: Greatest allowed, in MB.
    """

    def __init__(self, low: int, high: int) -> None:
        super().__init__(
            "a size such as 256MB", {"type": "string", "pattern": "^[0-9]{1,6} ?(MB|GB)$"}
        )
        self._low = low
        self._high = high

    def _convert(self, text: str) -> int:
        match = re.fullmatch(r"([0-9]{1,6}) ?(MB|GB)", text, re.ASCII)
        if match is None:
            raise WrongText("is not a size", f"give {self.expects}")
        size = int(match[1]) * (1000 if match[2] == "GB" else 1)
        if not self._low <= size <= self._high:
            raise WrongText("is out of range", f"{self._low}MB to {self._high}MB would be right")
        return size * 1_000_000


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
            raise WrongText("is not a share", f"give {self.expects}")
        number = float(match[1])
        if not match[2]:
            percent = number * 100 if number < 1 else number
            raise WrongText("has no percent sign", f"write {percent:g}%")
        if not self._low <= number <= self._high:
            raise WrongText("is out of range", f"{self._low}% to {self._high}% would be right")
        return number / 100


class CodeType(ScalarType):
    """A code, with its subcode after a slash.

    Args:
        rules: The protocol's, which say which there are.
    """

    def __init__(self, rules: ParameterRules) -> None:
        self._rules = rules
        written = {"type": "string", "pattern": r"^([Cc]?[0-9]{1,5}|[Pp][0-9]{1,3})(/[0-9]{1,3})?$"}
        number = {"type": "integer", "minimum": 0, "maximum": rules.highest_code}
        super().__init__("a code such as C0150, C0039/1 or P425", {"anyOf": [written, number]})

    def _convert(self, text: str) -> Code:
        try:
            code = Code.parse(text)
        except CodeValueError as exc:
            raise WrongText(*self._words(text)) from exc
        if not self._rules.carries(code):
            raise WrongText(*self._words(text))
        return code

    def _words(self, text: str) -> tuple[str, str]:
        match = re.fullmatch(r"([CcPp]?)([0-9]+)(?:/([0-9]+))?", text, re.ASCII)
        if match is None:
            return "is not a code", "write it like C0150, C150, 150, C0039/1 (code/subcode) or P425"
        if match[1] in {"P", "p"} and len(match[2]) > 3:
            return "is no SMVector parameter", "P0 to P999 would be right"
        if match[3] and (len(match[3]) > 3 or int(match[3]) > self._rules.highest_subcode):
            return (
                "has a subcode out of range",
                f"subcodes run from 0 to {self._rules.highest_subcode}",
            )
        return "is out of range", f"codes run from 0 to {self._rules.highest_code}"
