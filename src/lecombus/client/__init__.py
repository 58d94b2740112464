"""The client library: a line of drives, for programs.

    from lecombus.client import connect

    async with connect("/run/lecombus/hall-3.sock") as line:
        feeder = line.drive("feeder")
        print((await feeder.read("C0050")).number)        # Hz
        result = await feeder.write("C0046", 35.4, verify=True)
        result.check()                                    # raises unless done or verified

Async, for asyncio; needs httpx2 and anyio, and nothing of the daemon. docs/client.md
describes it; lecombus' own commands use it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lecombus.client.documents import (
    Answer,
    DriveStatus,
    Finding,
    GroupInfo,
    LineStatus,
    Quality,
    Reading,
    Why,
)
from lecombus.client.drive import Drive, Group
from lecombus.client.errors import (
    AmbiguousDaemonError,
    ClientError,
    LeaseLostError,
    NotDoneError,
    NotPermittedError,
    ProblemError,
    UnreachableError,
)
from lecombus.client.line import Line, connect
from lecombus.client.results import GroupResult, Outcome, Result, VerbResult, WriteResult

if TYPE_CHECKING:
    from lecombus.client.events import Event
    from lecombus.client.lease import Lease

__all__ = [
    "AmbiguousDaemonError",
    "Answer",
    "ClientError",
    "Drive",
    "DriveStatus",
    "Event",
    "Finding",
    "Group",
    "GroupInfo",
    "GroupResult",
    "Lease",
    "LeaseLostError",
    "Line",
    "LineStatus",
    "NotDoneError",
    "NotPermittedError",
    "Outcome",
    "ProblemError",
    "Quality",
    "Reading",
    "Result",
    "UnreachableError",
    "VerbResult",
    "Why",
    "WriteResult",
    "connect",
]


def __getattr__(name: str) -> Any:
    """Load what needs anyio when it is asked for: commands that need no event loop start faster."""
    if name == "Event":
        from lecombus.client.events import Event

        return Event
    if name == "Lease":
        from lecombus.client.lease import Lease

        return Lease
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
