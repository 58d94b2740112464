"""What is wrong with a roster, where, and what would be right.

A roster is read to its end even if parts are wrong: every reader and check of this room is given
one `Mistakes` and notes into it; nothing is raised until all of them have run. The result is one
`RosterError` whose text is one line per mistake, `FILE:LINE:COLUMN: what, right`, in the order of
the file; editors and terminals can jump to these.

The words for a mistake are put together here too (`shown`, `nearest`, `one_of`), so that all have
one form: the wrong text is quoted as in the file, shortened and on one line, and the remedy follows
after a comma.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from typing import Final, Protocol

from lecombus.errors import ConfigError

__all__ = [
    "Mistake",
    "Mistakes",
    "Position",
    "RosterError",
    "Spot",
    "did_you_mean",
    "nearest",
    "one_of",
    "shown",
]

_SHOWN_LENGTH: Final = 60
"""Longest piece of a file quoted in a message."""
MOST_MISTAKES: Final = 500
"""With so many the reading stops: looking for the nearest right word takes time for each."""
_MOST_WORDS: Final = 200
"""Most words compared with a wrong one."""


class Position(Protocol):
    """Anything that stands somewhere in a file."""

    @property
    def line(self) -> int:
        """The line, from 1."""

    @property
    def column(self) -> int:
        """The column in characters, from 1."""


@dataclass(frozen=True, slots=True)
class Spot:
    """A position without a node; by default the beginning of the file."""

    line: int = 1
    column: int = 1


@dataclass(frozen=True, slots=True, order=True)
class Mistake:
    """One thing that is wrong in a roster.

    Args:
        file: The file as it was named by the user.
        line: From 1.
        column: In characters, from 1.
        what: What is wrong.
        right: What would be right.
    """

    file: str
    line: int
    column: int
    what: str
    right: str

    def __str__(self) -> str:
        """Return `FILE:LINE:COLUMN: what, right`."""
        return f"{self.file}:{self.line}:{self.column}: {self.what}, {self.right}"


class RosterError(ConfigError):
    """A roster cannot be used.

    Args:
        mistakes: All of them, at least one; sorted by place here.
    """

    def __init__(self, mistakes: Iterable[Mistake]) -> None:
        self.mistakes: tuple[Mistake, ...] = tuple(sorted(set(mistakes)))
        first = self.mistakes[0]
        super().__init__("\n".join(map(str, self.mistakes)))
        self.file = first.file
        self.where = f"{first.line}:{first.column}"


class Mistakes:
    """Collects the mistakes of one file.

    Args:
        file: The file as it was named by the user.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self._found: set[Mistake] = set()

    def __bool__(self) -> bool:
        """Whether anything is wrong so far."""
        return bool(self._found)

    def note(self, place: Position, what: str, right: str) -> None:
        """Take a mistake; the same one at the same place (by way of an alias) counts once.

        Raises:
            RosterError: There are `MOST_MISTAKES` now: the file is hardly a roster.
        """
        self._found.add(Mistake(self.file, place.line, place.column, what, right))
        if len(self._found) >= MOST_MISTAKES:
            last = max(self._found)
            what = f"after {MOST_MISTAKES} mistakes no more are looked for"
            right = "correct these first"
            self._found.add(Mistake(self.file, last.line, last.column + 1, what, right))
            raise self.error()

    def fatal(self, place: Position, what: str, right: str) -> RosterError:
        """Return the error for a mistake after which nothing else can be checked.

        It stands alone: other mistakes may be its consequence.
        """
        return RosterError([Mistake(self.file, place.line, place.column, what, right)])

    def error(self) -> RosterError:
        """Return the error for all that was found; there must be something."""
        return RosterError(self._found)


def shown(text: str) -> str:
    """Quote a piece of the file: on one line, printable, and not too long."""
    flat = "".join(char if char.isprintable() else " " for char in text[: _SHOWN_LENGTH + 1])
    return f"`{flat}`" if len(flat) <= _SHOWN_LENGTH else f"`{flat[:_SHOWN_LENGTH]}..`"


def one_of(words: Iterable[object]) -> str:
    """Return `a, b or c`."""
    *most, last = map(str, words)
    return f"{', '.join(most)} or {last}" if most else last


def nearest(word: str, words: Iterable[str]) -> str | None:
    """Return the one of `words` that `word` was probably meant to be."""
    folded = {known.casefold(): known for known in islice(words, _MOST_WORDS)}
    close = difflib.get_close_matches(word[:_SHOWN_LENGTH].casefold(), folded, n=1, cutoff=0.6)
    return folded[close[0]] if close else None


def did_you_mean(word: str, words: Iterable[str], otherwise: str) -> str:
    """Return `did you mean X?`, or `otherwise` where nothing is near."""
    meant = nearest(word, words)
    return otherwise if meant is None else f"did you mean `{meant}`?"
