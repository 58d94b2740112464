"""What single values a roster knows: how each is read, refused in plain words, and put in a schema.

A kind is asked for a node and gives the value, or notes a mistake and gives `UNUSABLE`; whoever
asked goes on with what is usable. `convert` sees the text as written, never YAML's idea of it, and
refuses by raising `Wrong`. The same object gives the piece of JSON Schema that an editor needs, so
the two cannot drift apart.

Types that count or measure stand in `number_types`, those that name something outside in
`endpoint_types`.
What must not live here: which key has which kind (see `keys`), and anything that needs to look at
two values at once (see `checks`).
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
    "Choice",
    "Kind",
    "Name",
    "ScalarType",
    "Text",
    "Unusable",
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


class ScalarType(ABC):
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


class Text(ScalarType):
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
        """See `ScalarType`."""
        if not text or not text.isprintable() or text != text.strip():
            raise Wrong("is no usable text", f"give {self._expects}")
        if len(text) > self._longest:
            raise Wrong(f"has {len(text)} characters", f"at most {self._longest} are taken")
        return text

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        return {"type": ["string", "number"], "minLength": 1, "maxLength": self._longest}


class Name(ScalarType):
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
        """See `ScalarType`."""
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


class Choice(ScalarType):
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
        """See `ScalarType`."""
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


class YesNo(ScalarType):
    """A switch, in all spellings of YAML 1.1 and 1.2."""

    _SPELLINGS: Final = {
        "yes": True, "true": True, "on": True, "no": False, "false": False, "off": False,
    }  # fmt: skip
    expects = "true or false"

    def convert(self, text: str) -> bool:
        """See `ScalarType`."""
        try:
            return self._SPELLINGS[text.lower()]
        except KeyError:
            raise Wrong("is neither yes nor no", "true or false would be right") from None

    def schema(self) -> dict[str, Any]:
        """See `Kind`."""
        return {"enum": [True, False, "yes", "no", "on", "off"]}
