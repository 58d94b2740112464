"""The drives of a line at either baud rate, until an interruption."""

from __future__ import annotations

from typing import Protocol

from lecombus.drives.access import DriveAccess, ReadResult, WriteResult
from lecombus.parameters import Code, Value

from .drives import RebaudDrive

__all__ = ["InterruptedRebaudError", "LineAccess", "RebaudLine"]

TRIES_MORE = 2
"""How often a read is repeated of a drive that is known to be there."""


class LineAccess(Protocol):
    """A line without a daemon; a call at another baud rate reopens its port at that rate."""

    def at(self, baud: int, drive: str, *, retries: int) -> DriveAccess:
        """Return a drive at a baud rate, bit/s; `retries`: how often a failed read is repeated."""

    async def wait(self, baud: int, for_s: float) -> None:
        """Send nothing for some seconds, with the port open at a baud rate."""


class InterruptedRebaudError(Exception):
    """The user interrupted the change: no further telegram is begun."""


class RebaudLine:
    """Reads and writes at either baud rate.

    An interruption lets the telegram under way end and is raised before the next one, so that the
    result of a telegram is always known.

    Attributes:
        access: The line; set by each procedure before its first telegram.
        interrupted: Whether the user has interrupted; set from outside.
    """

    access: LineAccess

    def __init__(self) -> None:
        self.interrupted = False

    async def read(
        self, drive: RebaudDrive, baud: int, code: Code, *, retries: int = TRIES_MORE
    ) -> ReadResult:
        """Read a code of a drive."""
        self.check_interruption()
        return await self.access.at(baud, drive.name, retries=retries).read(code)

    async def wait(self, baud: int, for_s: float) -> None:
        """Send nothing for some seconds."""
        self.check_interruption()
        await self.access.wait(baud, for_s)

    async def write(self, drive: RebaudDrive, baud: int, code: Code, number: int) -> WriteResult:
        """Write a number to a code of a drive, once."""
        self.check_interruption()
        access = self.access.at(baud, drive.name, retries=0)
        return await access.write(code, Value.decimal(number), verify=False)

    async def read_rate(self, drive: RebaudDrive, baud: int, *, retries: int = 0) -> int | None:
        """Read the number of a drive's baud rate; None: it does not answer with one."""
        answer = await self.read(drive, baud, drive.subject.code, retries=retries)
        return answer.value.whole if answer.value is not None else None

    def check_interruption(self) -> None:
        """Raise if the user has interrupted.

        Raises:
            InterruptedRebaudError: The user has.
        """
        if self.interrupted:
            raise InterruptedRebaudError
