"""What backups ask of a drive: the seam between what is to be done and how it is said.

Whoever implements it speaks with the daemon. Failures are answers here, not exceptions: a backup
goes on without a code, a restore waits until a line is back, and both must know why.

What must not live here: HTTP, files.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value

__all__ = ["Answer", "DriveAccess", "Listener", "Written", "is_passing", "wait_until_usable"]

PASSING: Final = frozenset({
    "does-not-fit", "expired", "garbled", "line-lost", "no-answer", "not-ready", "offline",
    "queue-full", "starting", "unhealthy", "unknown", "unreachable",
})  # fmt: skip
"""Kinds of failure that say nothing of the code: asking again may bring an answer."""

LOOK_AGAIN_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of reading one code.

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
class Written:
    """What came of writing one code.

    Args:
        done: It was acknowledged, and read back where that was asked for.
        kind: Why not, as a stable word.
        text: Why not, for people.
    """

    done: bool
    kind: str = ""
    text: str = ""


def is_passing(kind: str) -> bool:
    """Tell whether a failure says nothing of the code, so that asking again makes sense."""
    return kind in PASSING


class DriveAccess(Protocol):
    """One drive, in the background class."""

    async def read(self, code: Code) -> Answer:
        """Read a code."""

    async def read_many(self, codes: Sequence[Code], heard: Callable[[Answer], None]) -> None:
        """Read codes, a few at a time; `heard` is told one answer for each, in any order."""

    async def write(self, code: Code, value: Value, *, verify: bool) -> Written:
        """Write a code as part of a restore."""

    async def inhibit(self) -> Written:
        """Inhibit the drive and see that it is."""

    async def enable(self) -> Written:
        """Lift the inhibit."""

    async def why_not_usable(self) -> str:
        """Say why the drive cannot be asked just now; empty when it can."""

    async def pause(self, for_s: float) -> None:
        """Let time pass, seconds."""

    def now_s(self) -> float:
        """Give monotonic time, seconds."""


class Listener(Protocol):
    """Is told how the work goes on."""

    def advance(self, done: int, total: int) -> None:
        """So many codes are done, of so many."""

    def say(self, text: str) -> None:
        """Something that is worth a line."""


async def wait_until_usable(access: DriveAccess, patience_s: float, listener: Listener) -> str:
    """Wait until a drive can be asked.

    Args:
        access: The drive.
        patience_s: How long, seconds.
        listener: Told once when there is something to wait for, and once when it is over.

    Returns:
        Why it still cannot be asked; empty when it can.
    """
    since_s, said = access.now_s(), ""
    while why := await access.why_not_usable():
        if why != said:
            listener.say(f"waiting: {why}")
            said = why
        if access.now_s() - since_s >= patience_s:
            return why
        await access.pause(LOOK_AGAIN_S)
    if said:
        listener.say("going on")
    return ""
