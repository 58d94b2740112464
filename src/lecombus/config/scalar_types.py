"""Types of single values: how each is read, refused in plain words, and put into the JSON Schema.

A type reads a node: it returns the value, or notes a mistake and returns `UNUSABLE`, and reading
goes on with what is usable. `_convert` gets the text as written and not the value that YAML would
make of it, and refuses by raising `WrongText`. The same object holds the JSON Schema for editors,
so the two cannot differ.

Numbers, addresses, times and codes are in `number_types`; ports, sockets, files and hosts in
`endpoint_types`.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, Final, Protocol

from lecombus.config.mistakes import Mistakes, nearest, one_of, shown
from lecombus.config.yaml_nodes import Node, Scalar, kind_of

__all__ = [
    "UNUSABLE",
    "Keyword",
    "Name",
    "ScalarType",
    "TextLine",
    "Unusable",
    "ValueType",
    "WrongText",
    "YesNo",
]


class Unusable(Enum):
    """The value of a key whose mistake has been noted already."""

    UNUSABLE = "unusable"


UNUSABLE: Final = Unusable.UNUSABLE


class WrongText(Exception):  # noqa: N818 - never leaves this room
    """A text is not what its key wants.

    Args:
        what: What is wrong, to stand behind the key and its value: "is not a whole number".
        right: What would be right.
    """

    def __init__(self, what: str, right: str) -> None:
        super().__init__(what, right)
        self.what = what
        self.right = right


class ValueType(Protocol):
    """What a key can hold.

    Attributes:
        expects: What to give, to stand behind "give": "a duration such as 2s".
        schema: The JSON Schema (2020-12) of what may be written.
    """

    expects: str
    schema: dict[str, Any]

    def read(self, node: Node, label: str, mistakes: Mistakes) -> Any:
        """Return the value of a node, or `UNUSABLE` with the mistakes noted.

        Args:
            node: What stands in the file.
            label: What the value is called in a mistake, such as a quoted key.
            mistakes: Takes what is wrong.
        """


class ScalarType(ABC):
    """A type written as a single value; arguments as the attributes of `ValueType`."""

    def __init__(self, expects: str, schema: dict[str, Any]) -> None:
        self.expects = expects
        self.schema = schema

    @abstractmethod
    def _convert(self, text: str) -> Any:
        """Return the value of a text, or raise `WrongText`."""

    def read(self, node: Node, label: str, mistakes: Mistakes) -> Any:
        """Return the value of a node, or `UNUSABLE` with the mistake noted."""
        if not isinstance(node, Scalar) or node.is_empty:
            mistakes.note(node, f"{label} is {kind_of(node)}", f"give {self.expects}")
            return UNUSABLE
        try:
            return self._convert(node.text)
        except WrongText as exc:
            mistakes.note(node, f"{label} {shown(node.text)} {exc.what}", exc.right)
            return UNUSABLE


class TextLine(ScalarType):
    """Any text on one line.

    Args:
        expects: See `ValueType`.
        longest: Most characters.
    """

    def __init__(self, expects: str, longest: int = 200) -> None:
        super().__init__(
            expects, {"type": ["string", "number"], "minLength": 1, "maxLength": longest}
        )
        self._longest = longest

    def _convert(self, text: str) -> str:
        if not text or not text.isprintable() or text != text.strip():
            raise WrongText("is not usable text", f"give {self.expects}")
        if len(text) > self._longest:
            raise WrongText(f"has {len(text)} characters", f"at most {self._longest} are taken")
        return text


class Name(ScalarType):
    """A name that is used in commands, URLs, metrics or file names.

    Args:
        of: What is named, such as "drive".
        capitals: Whether capitals and dots are usable too.
        reserved: Names that mean something else, with the remedy.
    """

    LONGEST: Final = 64

    def __init__(
        self, of: str, *, capitals: bool = False, reserved: Mapping[str, str] | None = None
    ) -> None:
        self._of = of
        self._capitals = capitals
        letters, more = ("A-Za-z0-9", "_.-") if capitals else ("a-z0-9", "_-")
        self._pattern = f"[{letters}][{letters}{more}]*"
        self._reserved = reserved or {}
        schema: dict[str, Any] = {
            "type": ["string", "integer"], "pattern": f"^{self._pattern}$",
            "maxLength": self.LONGEST,
        }  # fmt: skip
        if self._reserved:
            schema["not"] = {"enum": list(self._reserved)}
        super().__init__(f"a {of} name such as {'hall-3' if of == 'line' else 'feeder-2'}", schema)

    def _convert(self, text: str) -> str:
        if text in self._reserved:
            raise WrongText("is taken", self._reserved[text])
        if len(text) > self.LONGEST:
            raise WrongText(f"has {len(text)} characters", f"at most {self.LONGEST} are usable")
        if re.fullmatch(self._pattern, text) is None:
            raise WrongText(f"is not usable as a {self._of} name", self._right(text))
        return text

    def _right(self, text: str) -> str:
        allowed = "letters, digits, _ . -" if self._capitals else "a-z, 0-9, _ and -"
        right = f"use {allowed}, beginning with a letter or digit"
        tried = re.sub(r"[^A-Za-z0-9_-]+", "-", text if self._capitals else text.lower())
        tried = tried.strip("-_")
        return f"{right}, such as {tried}" if tried and tried not in self._reserved else right


class Keyword(ScalarType):
    """One of a few words.

    Args:
        words: The words.
        also: Other spellings, in small letters, and the word each stands for.
    """

    def __init__(self, words: Sequence[str], also: Mapping[str, str] | None = None) -> None:
        self._words = tuple(words)
        self._also = also or {}
        booleans = [
            value for word, value in (("true", True), ("false", False)) if word in self._also
        ]
        super().__init__(one_of(words), {"enum": [*words, *booleans]})

    def _convert(self, text: str) -> str:
        if text in self._words:
            return text
        if text.lower() in self._also:
            return self._also[text.lower()]
        meant = nearest(text, self._words)
        listed = f"{one_of(self._words)} would be right"
        raise WrongText("is unknown", f"did you mean `{meant}`? {listed}" if meant else listed)


class YesNo(ScalarType):
    """A switch, in all spellings of YAML 1.1 and 1.2."""

    _SPELLINGS: Final = {
        "yes": True, "true": True, "on": True, "no": False, "false": False, "off": False,
    }  # fmt: skip

    def __init__(self) -> None:
        super().__init__("true or false", {"enum": [True, False, "yes", "no", "on", "off"]})

    def _convert(self, text: str) -> bool:
        try:
            return self._SPELLINGS[text.lower()]
        except KeyError:
            raise WrongText("is neither yes nor no", "true or false would be right") from None
