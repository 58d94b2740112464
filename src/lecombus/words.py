"""The drives' control words as lecombus last saw or wrote them.

A quick stop changes one bit of the control word, and must not wait for reading it first. lecombus
is the line's only master, so the word it last read or wrote is the word the drive holds, until
the drive restarts: it is forgotten whenever a drive goes offline or is audited anew.
"""

from __future__ import annotations

from collections.abc import Iterable

from .protocol.addressing import Code
from .protocol.values import Value

__all__ = ["ControlWords"]


class ControlWords:
    """Remembers one word per drive."""

    def __init__(self) -> None:
        self._codes: dict[str, Code] = {}
        self._words: dict[str, int] = {}

    def watch(self, drive: str, code: Code) -> None:
        """Remember this code of this drive from now on."""
        self._codes[drive] = code

    def seen(self, drive: str, code: Code, value: Value) -> None:
        """Take a value that was read, or written and acknowledged."""
        if self._codes.get(drive) == code:
            number = value.number
            if isinstance(number, int):
                self._words[drive] = number

    def written(self, drives: Iterable[str], code: Code, value: Value) -> None:
        """Take a value that went to several drives at once."""
        for drive in drives:
            self.seen(drive, code, value)

    def forget(self, drive: str) -> None:
        """Nothing is known of this drive's word any more."""
        self._words.pop(drive, None)

    def get(self, drive: str) -> int | None:
        """The drive's control word, None when it is not known."""
        return self._words.get(drive)
