"""How a command ends: exit statuses, and the problems that lead to them.

A command that cannot go on raises `CommandError` with one `Problem` for each thing that is wrong;
`entry` prints them one a line and exits. No command prints errors itself or calls `sys.exit`.
"""

from __future__ import annotations

import errno
from dataclasses import asdict, dataclass
from enum import IntEnum

__all__ = ["CommandError", "Exit", "Problem", "status_of_cause"]


class Exit(IntEnum):
    """The exit statuses of every command."""

    DONE = 0
    FAILED = 1
    """The drive or the line refused or failed."""
    USAGE = 2
    """The command line or the roster is wrong."""
    UNREACHABLE = 3
    """The daemon cannot be reached."""
    FORBIDDEN = 4
    """The daemon or the system does not permit it."""
    INTERRUPTED = 130
    """Ctrl-C, as shells count it."""
    PIPE_CLOSED = 141
    """The reader of the output is gone, as shells count it."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong.

    Args:
        problem: What is wrong.
        remedy: What the user can do about it.
        kind: A stable word for programs, where there is one.
        drive: The drive concerned, where there is one.
        code: The code concerned, where there is one.
    """

    problem: str
    remedy: str = ""
    kind: str = ""
    drive: str = ""
    code: str = ""

    def __str__(self) -> str:
        """Return it as one line."""
        text = " ".join(self.problem.split())
        if not self.remedy:
            return text
        return text.rstrip(".") + (" " if text.endswith("?") else "; ") + self.remedy

    def as_json(self) -> dict[str, str]:
        """Return the parts that say something."""
        return {key: text for key, text in asdict(self).items() if text}


class CommandError(Exception):
    """A command ends without having done what was asked.

    Args:
        status: The exit status.
        problem: What is wrong, and further parts of a `Problem`.
    """

    def __init__(
        self,
        status: Exit,
        problem: str,
        remedy: str = "",
        kind: str = "",
        drive: str = "",
        code: str = "",
    ) -> None:
        self.status = status
        self.problems: tuple[Problem, ...] = (Problem(problem, remedy, kind, drive, code),)
        super().__init__(str(self.problems[0]))

    @classmethod
    def of(cls, status: Exit, *problems: Problem) -> CommandError:
        """Return an error of several problems, one line each."""
        error = cls(status, "\n".join(map(str, problems)))
        error.problems = problems
        return error


def status_of_cause(error: BaseException) -> Exit:
    """Return how a failure counts: a port that may not be opened is a matter of permission.

    pyserial's errors are an OSError with a number, and no PermissionError.
    """
    cause = error.__cause__
    if isinstance(cause, OSError) and cause.errno in (errno.EACCES, errno.EPERM):
        return Exit.FORBIDDEN
    return Exit.FAILED
