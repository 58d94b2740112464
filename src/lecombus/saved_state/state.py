"""What is kept of each drive, and its form in the file.

Strategy: plain mutable facts that their owner changes in place and reports by `touch`;
the form on disk is made and read here alone, and is checked as strictly as a roster, because the
file is a border: a person or a failing disk may have changed it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Annotated, Final

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

__all__ = ["VERSION", "DriveFacts", "Moved", "NewerStateError", "State", "StateFormatError"]

VERSION: Final = 1

FORMER_MOST: Final = 100
"""Drives remembered that are not in the roster now: a typing error must not cost their counts."""

Count = Annotated[int, Field(ge=0)]


def _plain(text: str) -> str:
    """Refuse what no drive says and what would steer a terminal."""
    if not text.isprintable():
        raise ValueError("a control character")
    return text


PlainText = Annotated[str, AfterValidator(_plain)]


class StateFormatError(ValueError):
    """The text is no state file."""


class NewerStateError(ValueError):
    """A later lecombus wrote it: nothing of it is touched."""


@dataclass(slots=True)
class Moved:
    """A drive was given another address than the roster says.

    Args:
        address: The address it was given.
        at: When, RFC 3339.
        confirmed: It was found there; else it was found nowhere.
    """

    address: Annotated[int, Field(ge=1, le=99)]
    at: PlainText
    confirmed: bool


@dataclass(slots=True)
class DriveFacts:
    """What is kept of one drive.

    Args:
        identity: What it said of itself when it was accepted, by code.
        accepted_at: When that was, RFC 3339; empty before.
        writes: Writes that may have reached its memory, by code, never reset.
        writes_before: The same when the present device was accepted in place of another.
        moved: Where it was moved to, as long as the roster says otherwise.
    """

    identity: dict[PlainText, PlainText] = field(default_factory=dict)
    accepted_at: PlainText = ""
    writes: dict[PlainText, Count] = field(default_factory=dict)
    writes_before: dict[PlainText, Count] = field(default_factory=dict)
    moved: Moved | None = None


@dataclass(slots=True)
class _Document:
    version: int
    drives: dict[str, DriveFacts]


_ADAPTER: Final = TypeAdapter(_Document)


class State:
    """Everything kept of one line's drives.

    Args:
        drives: The facts by the drives' names.

    Attributes:
        counted: Called for each write that was counted: drive, code and the count now.
    """

    def __init__(self, drives: dict[str, DriveFacts] | None = None) -> None:
        self._drives = drives if drives is not None else {}
        self.changes = 0
        self.counted: Callable[[str, str, int], None] | None = None

    def drive(self, name: str) -> DriveFacts:
        """Return what is kept of a drive; empty facts for one that is new."""
        return self._drives.setdefault(name, DriveFacts())

    def count(self, drive: str, code: str) -> None:
        """Count a write that may have reached a drive's memory."""
        writes = self.drive(drive).writes
        writes[code] = writes.get(code, 0) + 1
        self.touch()
        if self.counted is not None:
            self.counted(drive, code, writes[code])

    def touch(self) -> None:
        """Say that something was changed, so that it is written."""
        self.changes += 1

    def bound(self, names: Iterable[str]) -> None:
        """Drop the facts of the drives that left the roster longest ago, beyond a hundred.

        Args:
            names: The drives of the roster.
        """
        present = set(names)
        for name in present & self._drives.keys():
            self._drives[name] = self._drives.pop(name)  # to the end: the latest in the roster
        former = [name for name in self._drives if name not in present]
        for name in former[: max(0, len(former) - FORMER_MOST)]:
            del self._drives[name]
            self.touch()

    def text(self) -> str:
        """Return the file's content."""
        drives = {name: asdict(facts) for name, facts in self._drives.items()}
        return json.dumps({"version": VERSION, "drives": drives}, indent=1, ensure_ascii=False)

    @classmethod
    def parse(cls, text: bytes) -> State:
        """Read a file's content.

        Raises:
            NewerStateError: A later version wrote it.
            StateFormatError: It is no state file.
        """
        try:
            document = _ADAPTER.validate_json(text, strict=True)
        except ValidationError as exc:
            _refuse_newer(text)
            first = exc.errors()[0]
            place = ".".join(str(part) for part in first["loc"]) or "the whole"
            raise StateFormatError(f"{place}: {first['msg']}") from exc
        if document.version != VERSION:
            _refuse_newer(text)
            raise StateFormatError(f"version: {document.version} was never written")
        return cls(document.drives)


def _refuse_newer(text: bytes) -> None:
    """Return whether it is a file of a later version, not a damaged one."""
    try:
        version = json.loads(text)["version"]
    except (ValueError, TypeError, KeyError, LookupError, RecursionError):
        return
    if isinstance(version, int) and version > VERSION:
        raise NewerStateError(f"it is of version {version}, this lecombus knows {VERSION}")
