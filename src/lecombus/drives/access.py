"""One drive as a procedure of several reads and writes sees it, such as a backup or a restore.

A failure is an answer here, not an exception: a backup goes on without a code, a restore waits
until a line is back, a change of baud rate looks for the drive at the other rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

from lecombus.parameters import Code, Value

__all__ = ["DriveAccess", "ReadResult", "WriteResult", "is_passing"]

PASSING: Final = frozenset({
    "does-not-fit", "expired", "garbled", "line-lost", "no-answer", "not-ready", "offline",
    "queue-full", "starting", "unhealthy", "unknown", "unreachable",
})  # fmt: skip
"""Kinds of failure that say nothing of the code: a second attempt may bring an answer."""


@dataclass(frozen=True, slots=True)
class ReadResult:
    """The result of reading one code.

    Args:
        code: The code.
        value: What it reads; None where it could not be read.
        kind: Why not, as a stable word, such as `no-such-code`.
        text: Why not, for people.
    """

    code: Code
    value: Value | None
    kind: str = ""
    text: str = ""


@dataclass(frozen=True, slots=True)
class WriteResult:
    """The result of writing one code.

    Args:
        done: It was acknowledged, and read back where that was asked for.
        kind: Why not, as a stable word.
        text: Why not, for people.
    """

    done: bool
    kind: str = ""
    text: str = ""


def is_passing(kind: str) -> bool:
    """Whether a failure says nothing of the code, so that a second attempt may succeed."""
    return kind in PASSING


class DriveAccess(Protocol):
    """One drive."""

    async def read(self, code: Code) -> ReadResult:
        """Read a code."""

    async def write(self, code: Code, value: Value, *, verify: bool) -> WriteResult:
        """Write a code once; `verify`: and read it back."""
