"""What single values a roster knows: how each is read, refused in plain words, and put in a schema.

A kind is asked for a node and gives the value, or notes a mistake and gives `UNUSABLE`; whoever
asked goes on with what is usable. `convert` sees the text as written, never YAML's idea of it, and
refuses by raising `Wrong`. The same object gives the piece of JSON Schema that an editor needs, so
the two cannot drift apart.

What must not live here: which key has which kind (see `keys`), and anything that needs to look at
two values at once (see `checks`).
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, Final, Protocol

from lecombus.config.durations import DurationError, format_duration, parse_duration
from lecombus.config.mistakes import Mistakes, did_you_mean, nearest, one_of, shown
from lecombus.config.nodes import Node, Scalar, kind_of
from lecombus.errors import CodeValueError
from lecombus.protocol.addressing import Code

__all__ = [
    "UNUSABLE",
    "Address",
    "Choice",
    "CodeKind",
    "Duration",
    "Kind",
    "Name",
    "Percent",
    "ScalarKind",
    "Text",
    "Unusable",
    "Whole",
    "WholeChoice",
    "Wrong",
    "YesNo",
]


class Unusable(Enum):
    """The value of a key whose mistake has been noted already."""

    UNUSABLE = "unusable"


UNUSABLE: Final = Unusable.UNUSABLE


class Wrong(Exception):  # noqa: N818 - never leaves this room
    """A text is not what its key wants.

    Args:
        what: What is wrong, to stand behind the key and its value: "is no whole number".
        right: What would be right.
    """

    def __init__(self, what: str, right: str) -> None:
        super().__init__(what, right)
        self.what = what
        self.right = right


class Kind(Protocol):
    """Something a key can hold."""

    @property
    def expects(self) -> str:
        """What to give, to stand behind "give": "a duration such as 2s"."""

    def read(self, node: Node, label: str, mistakes: Mistakes) -> Any:
        """Return the value of a node, or `UNUSABLE` with the mistakes noted.

        Args:
            node: What stands in the file.
            label: What the value is called in a mistake, such as a quoted key.
            mistakes: Takes what is wrong.
        """

    def schema(self) -> dict[str, Any]:
        """Return the JSON Schema (2020-12) of what may be written."""


class ScalarKind(ABC):
    """A kind written as a single value."""

    @property
    @abstractmethod
    def expects(self) -> str:
        """See `Kind`."""

    @abstractmethod
    def convert(self, text: str) -> Any:
        """Return the value of a text, or raise `Wrong`."""

    @abstractmethod
    def schema(self) -> dict[str, Any]:
        """See `Kind`."""

    def read(self, node: Node, label: str, mistakes: Mistakes) -> Any:
        """See `Kind`."""
        if not isinstance(node, Scalar) or node.is_empty:
            mistakes.note(node, f"{label} is {kind_of(node)}", f"give {self.expects}")
            return UNUSABLE
        try:
            return self.convert(node.text)
        except Wrong as exc:
            mistakes.note(node, f"{label} {shown(node.text)} {exc.what}", exc.right)
            return UNUSABLE


class Text(ScalarKind):
    """Any text on one line.

    Args:
        expects: See `Kind`.
        longest: Most characters.
    """

    def __init__(self, expects: str, longest: int = 200) -> None:
        self._expects = expects
        self._longest = longest

    @property
    def expects(self) -> str:
        """See `Kind`."""
        return self._expects

    def convert(self, text: str) -> str:
        """See `ScalarKind`."""
        if not text or not text.isprintable() or text != text.strip():
            raise Wrong("is no usable text", f"give {self._expects}")
        if len(text) > self._longest:
            raise Wrong(f"has {len(text)} characters", f"at most {self._longest} are taken")
        return text

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        return {"type": ["string", "number"], "minLength": 1, "maxLength": self._longest}


class Name(ScalarKind):
    """A name by which something is called in commands, URLs, metrics or file names.

    Args:
        of: What is named, such as "drive".
        capitals: Whether capitals and dots are usable too.
        reserved: Names that mean something else.
    """

    LONGEST: Final = 64

    def __init__(
        self, of: str, *, capitals: bool = False, reserved: Mapping[str, str] | None = None
    ) -> None:
        self._of = of
        letters = "A-Za-z0-9" if capitals else "a-z0-9"
        more = "_.-" if capitals else "_-"
        self._pattern = f"[{letters}][{letters}{more}]*"
        self._reserved = reserved or {}

    @property
    def expects(self) -> str:
        """See `Kind`."""
        return f"a {self._of} name such as {'hall-3' if self._of == 'line' else 'feeder-2'}"

    def convert(self, text: str) -> str:
        """See `ScalarKind`."""
        if text in self._reserved:
            raise Wrong("is taken", self._reserved[text])
        if len(text) > self.LONGEST:
            raise Wrong(f"has {len(text)} characters", f"at most {self.LONGEST} are usable")
        if re.fullmatch(self._pattern, text) is None:
            raise Wrong(f"is not usable as a {self._of} name", self._right(text))
        return text

    def _right(self, text: str) -> str:
        allowed = "letters, digits, _ . -" if "A" in self._pattern else "a-z, 0-9, _ and -"
        right = f"use {allowed}, beginning with a letter or digit"
        lowered = text if "A" in self._pattern else text.lower()
        tried = re.sub(r"[^A-Za-z0-9_-]+", "-", lowered).strip("-_")
        return f"{right}, such as {tried}" if tried and tried not in self._reserved else right

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        found: dict[str, Any] = {
            "type": ["string", "integer"], "pattern": f"^{self._pattern}$",
            "maxLength": self.LONGEST,
        }  # fmt: skip
        return {**found, "not": {"enum": list(self._reserved)}} if self._reserved else found


class Choice(ScalarKind):
    """One of a few words.

    Args:
        words: The words.
        also: Other spellings, in small letters, and the word each stands for.
    """

    def __init__(self, words: Sequence[str], also: Mapping[str, str] | None = None) -> None:
        self._words = tuple(words)
        self._also = also or {}

    @property
    def expects(self) -> str:
        """See `Kind`."""
        return one_of(self._words)

    def convert(self, text: str) -> str:
        """See `ScalarKind`."""
        if text in self._words:
            return text
        if text.lower() in self._also:
            return self._also[text.lower()]
        meant = nearest(text, self._words)
        listed = f"{one_of(self._words)} would be right"
        raise Wrong("is unknown", f"did you mean `{meant}`? {listed}" if meant else listed)

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        booleans = [value for word, value in (("true", True), ("false", False))
                    if word in self._also]  # fmt: skip
        return {"enum": [*self._words, *booleans]}


class YesNo(ScalarKind):
    """A switch, in all spellings of YAML 1.1 and 1.2."""

    _SPELLINGS: Final = {
        "yes": True, "true": True, "on": True, "no": False, "false": False, "off": False,
    }  # fmt: skip
    expects = "true or false"

    def convert(self, text: str) -> bool:
        """See `ScalarKind`."""
        try:
            return self._SPELLINGS[text.lower()]
        except KeyError:
            raise Wrong("is neither yes nor no", "true or false would be right") from None

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        return {"enum": [True, False, "yes", "no", "on", "off"]}


class Whole(ScalarKind):
    """A whole number.

    Args:
        low: Least allowed.
        high: Greatest allowed.
    """

    def __init__(self, low: int, high: int) -> None:
        self._low = low
        self._high = high

    @property
    def expects(self) -> str:
        """See `Kind`."""
        return f"a whole number, {self._low} to {self._high}"

    def convert(self, text: str) -> int:
        """See `ScalarKind`."""
        number = self._number(text)
        if not self._low <= number <= self._high:
            raise Wrong("is out of range", f"{self._low} to {self._high} would be right")
        return number

    def _number(self, text: str) -> int:
        if re.fullmatch(r"-?[0-9]{1,9}", text) is None:
            raise Wrong("is no whole number", f"give {self.expects}")
        if re.fullmatch(r"-?0[0-9]+", text):
            # YAML 1.1 reads 010 as 8, YAML 1.2 as 10: whichever was meant, nobody can see it.
            raise Wrong(
                "begins with 0, which some YAML readers take for octal", f"write {int(text)}"
            )
        return int(text)

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        return {"type": "integer", "minimum": self._low, "maximum": self._high}


class WholeChoice(Whole):
    """One of a few numbers, such as the baud rates."""

    def __init__(self, numbers: Sequence[int]) -> None:
        super().__init__(min(numbers), max(numbers))
        self._numbers = tuple(numbers)

    @property
    def expects(self) -> str:
        """See `Kind`."""
        return one_of(self._numbers)

    def convert(self, text: str) -> int:
        """See `ScalarKind`."""
        number = self._number(text)
        if number in self._numbers:
            return number
        meant = min(self._numbers, key=lambda known: abs(known - number))
        near = f"did you mean {meant}? " if abs(meant - number) * 4 <= meant else ""
        raise Wrong("is unknown", f"{near}{one_of(self._numbers)} would be right")

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        return {"enum": list(self._numbers)}


class Address(Whole):
    """A drive's address: 1..99 without those ending in 0, which reach groups.

    Source: EDB2102EN 8.3.1 and 8.3.4 (addresses ending in 0 are reserved for BROADCAST).
    """

    def __init__(self) -> None:
        super().__init__(1, 99)

    def convert(self, text: str) -> int:
        """See `ScalarKind`."""
        number = self._number(text)
        if 0 <= number <= 99 and number % 10 == 0:
            reach = "all drives" if number == 0 else f"the group {number + 1}..{number + 9}"
            raise Wrong(f"ends in 0 and so reaches {reach}", "1..99 without 10, 20 .. 90 are right")
        if not 1 <= number <= 99:
            raise Wrong("is out of range", "1..99 without 10, 20 .. 90 are right")
        return number

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        return {**super().schema(), "not": {"multipleOf": 10}}


class Duration(ScalarKind):
    """A time with its unit.

    Args:
        low_s: Shortest allowed, in seconds.
        high_s: Longest allowed, in seconds.
        zero: What 0 means where it is allowed below `low_s`, such as "never".
    """

    def __init__(self, low_s: float, high_s: float, zero: str = "") -> None:
        self._low_s = low_s
        self._high_s = high_s
        self._zero = zero

    @property
    def expects(self) -> str:
        """See `Kind`."""
        return "a duration such as 500ms or 2s"

    def convert(self, text: str) -> float:
        """See `ScalarKind`."""
        try:
            seconds = parse_duration(text)
        except DurationError as exc:
            raise Wrong(exc.what, exc.right) from exc
        if self._low_s <= seconds <= self._high_s or (self._zero and seconds == 0):
            return seconds
        zero = f", or 0 for {self._zero}" if self._zero else ""
        low, high = format_duration(self._low_s), format_duration(self._high_s)
        long = "long" if seconds > self._high_s else "short"
        raise Wrong(f"is too {long}", f"{low} to {high} would be right{zero}")

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        written: dict[str, Any] = {
            "type": "string", "pattern": r"^([0-9]+(\.[0-9]+)? ?(ms|s|min|h)|0)$"
        }  # fmt: skip
        return {"anyOf": [written, {"const": 0}]} if self._zero or not self._low_s else written


class Percent(ScalarKind):
    """A share, such as `10%`, kept as 0.10.

    Args:
        low: Least allowed, in percent.
        high: Greatest allowed, in percent.
    """

    def __init__(self, low: int, high: int) -> None:
        self._low = low
        self._high = high

    @property
    def expects(self) -> str:
        """See `Kind`."""
        return f"a share, {self._low}% to {self._high}%"

    def convert(self, text: str) -> float:
        """See `ScalarKind`."""
        match = re.fullmatch(r"([0-9]{1,4}(?:\.[0-9]{1,4})?) ?(%?)", text)
        if match is None:
            raise Wrong("is no share", f"give {self.expects}")
        number = float(match[1])
        if not match[2]:
            percent = number * 100 if number < 1 else number
            raise Wrong("has no percent sign", f"write {percent:g}%")
        if not self._low <= number <= self._high:
            raise Wrong("is out of range", f"{self._low}% to {self._high}% would be right")
        return number / 100

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        return {"type": "string", "pattern": r"^[0-9]+(\.[0-9]+)? ?%$"}


class CodeKind(ScalarKind):
    """A code, with its subcode after a slash."""

    expects = "a code such as C0150, C0039/1 or P425"

    def convert(self, text: str) -> Code:
        """See `ScalarKind`."""
        try:
            return Code.parse(text)
        except CodeValueError as exc:
            raise Wrong(*self._words(text)) from exc

    def _words(self, text: str) -> tuple[str, str]:
        match = re.fullmatch(r"([CcPp]?)([0-9]+)(?:/([0-9]+))?", text, re.ASCII)
        if match is None:
            return "is no code", "write it like C0150, C150, 150, C0039/1 (code/subcode) or P425"
        if match[1] in {"P", "p"} and len(match[2]) > 3:
            return "is no SMVector parameter", "P0 to P999 would be right"
        if match[3] and (len(match[3]) > 3 or int(match[3]) > 255):
            return "has a subcode out of range", "subcodes run from 0 to 255"
        return "is out of range", "codes run from 0 to 65535"

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        written = {"type": "string", "pattern": r"^([Cc]?[0-9]{1,5}|[Pp][0-9]{1,3})(/[0-9]{1,3})?$"}
        return {"anyOf": [written, {"type": "integer", "minimum": 0, "maximum": 65535}]}


def meant_or(word: str, words: Sequence[str]) -> str:
    """Return the nearest word as a question, or all of them."""
    return did_you_mean(word, words, f"{one_of(words)} would be right")
