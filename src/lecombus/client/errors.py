"""What the client library raises: transport, refused questions, and mistakes of the caller.

A write that the daemon or the drive refuses is not an error: it is a result with an outcome
(`results`). `NotDoneError` is raised only where a program asks for it with `check`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lecombus.client.results import Result

__all__ = [
    "AmbiguousDaemonError",
    "ClientError",
    "LeaseLostError",
    "NotDoneError",
    "NotPermittedError",
    "ProblemError",
    "UnreachableError",
]


class ClientError(Exception):
    """What all errors of this library have in common.

    Args:
        problem: What is wrong.
        remedy: What to do about it; empty where nothing is known.
        kind: A stable word for programs, as in docs/api.md; empty where there is none.
        drive: The drive concerned; empty where there is none.
        code: The code concerned; empty where there is none.
    """

    def __init__(
        self, problem: str, remedy: str = "", kind: str = "", drive: str = "", code: str = ""
    ) -> None:
        super().__init__(f"{problem}; {remedy}" if remedy else problem)
        self.problem = problem
        self.remedy = remedy
        self.kind = kind
        self.drive = drive
        self.code = code


class AmbiguousDaemonError(ClientError):
    """It does not follow from socket, URL and environment which daemon is meant."""


class NotPermittedError(ClientError):
    """The system does not let this user open the daemon's socket or the token's file."""


class UnreachableError(ClientError):
    """The daemon cannot be reached, does not answer in time, or is not lecombus.

    After a write it means that nothing was sent: a write whose answer was lost has the outcome
    `unknown`.
    """


class ProblemError(ClientError):
    """The daemon answered with a problem document (RFC 9457).

    Args:
        status: The HTTP status.
        problem: What is wrong, and the further parts of `ClientError`.
        cause: The likely cause; empty where none is known.
    """

    def __init__(
        self,
        status: int,
        problem: str,
        remedy: str = "",
        kind: str = "",
        drive: str = "",
        code: str = "",
        cause: str = "",
    ) -> None:
        if cause and cause not in problem:
            problem = f"{problem} ({cause})"
        super().__init__(problem, remedy, kind, drive, code)
        self.status = status
        self.cause = cause


class NotDoneError(ClientError):
    """A write, a verb or a stop that was checked ended as neither `done` nor `verified`.

    Args:
        result: How it ended.
        what: What it was, in words.
    """

    def __init__(self, result: Result, what: str) -> None:
        said = "; ".join(part for part in (result.reason, result.cause) if part)
        problem = f"{what}: {result.outcome}" + (f", {said}" if said else "")
        super().__init__(problem, result.remedy, result.kind)
        self.result = result


class LeaseLostError(ClientError):
    """The lease ended before the block that held it: the drives are stopped by lecombus."""
