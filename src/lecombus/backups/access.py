"""What backups and restores ask of a drive and of its daemon besides reads and writes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

from lecombus.drives.access import DriveAccess, ReadResult, WriteResult
from lecombus.parameters import Code

__all__ = ["Listener", "RestoreAccess", "wait_until_usable"]

LOOK_AGAIN_S: Final = 1.0


class RestoreAccess(DriveAccess, Protocol):
    """One drive behind a daemon, in the background class."""

    async def read_many(self, codes: Sequence[Code], heard: Callable[[ReadResult], None]) -> None:
        """Read codes, a few at a time; `heard` is called with one answer for each, in any order."""

    async def inhibit(self) -> WriteResult:
        """Inhibit the drive and see that it is."""

    async def enable(self) -> WriteResult:
        """Lift the inhibit."""

    async def why_not_usable(self) -> str:
        """Return why the drive cannot be asked now; empty when it can."""

    async def pause(self, for_s: float) -> None:
        """Wait, seconds."""

    def now_s(self) -> float:
        """Return monotonic time, seconds."""


class Listener(Protocol):
    """Is called with the progress of the work."""

    def advance(self, done: int, total: int) -> None:
        """So many codes are done, of so many."""

    def say(self, text: str) -> None:
        """Something that is worth a line."""


async def wait_until_usable(access: RestoreAccess, patience_s: float, listener: Listener) -> str:
    """Wait until a drive can be asked.

    Args:
        access: The drive.
        patience_s: How long, seconds.
        listener: Called once when the wait begins, and once when it ends.

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
