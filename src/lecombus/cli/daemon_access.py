"""The daemon, as a command sees it: the client library, its errors as exit statuses.

`ask` and `act` are one request each, so that a command may ask its user something between two of
them; they and `work` block and load no event loop. `connected` is for work that does several
things at a time. Answers are
kept as the text that came, so that `--json` prints decimals exactly as the daemon wrote them.
"""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from typing import Any, Final, TypeVar

import click

from lecombus.cli.arguments import DaemonOptions
from lecombus.cli.exits import CommandError, Exit
from lecombus.client.connection import (
    LEASE_HEADER,
    Json,
    finish,
    open_connection,
    problem_error,
)
from lecombus.client.documents import Answer
from lecombus.client.errors import (
    AmbiguousDaemonError,
    ClientError,
    NotPermittedError,
    ProblemError,
    UnreachableError,
)
from lecombus.client.finding import find_daemon
from lecombus.client.line import Line
from lecombus.client.requests import path_of

__all__ = [
    "LEASE_VARIABLE",
    "act",
    "ask",
    "command_errors",
    "connected",
    "drive_path",
    "group_path",
    "refuse_problem",
    "show",
    "work",
]

LEASE_VARIABLE: Final = "LECOMBUS_LEASE"
"""Holds the token of a lease, which goes with everything that is asked."""

REPEAT_FOR_S: Final = 2.0
"""A person waits for the command, and can repeat it."""

STATUS_OF_KIND: Final[Mapping[str, Exit]] = {
    "no-such-drive": Exit.USAGE,
    "no-such-group": Exit.USAGE,
    "bad-value": Exit.USAGE,
    "bad-request": Exit.USAGE,
    "not-writable": Exit.FORBIDDEN,
    "locked": Exit.FORBIDDEN,
    "not-permitted": Exit.FORBIDDEN,
    "read-only": Exit.FORBIDDEN,
    "no-such-code": Exit.FAILED,
}
STATUS_OF_HTTP: Final[Mapping[int, Exit]] = {
    400: Exit.USAGE, 401: Exit.FORBIDDEN, 403: Exit.FORBIDDEN, 404: Exit.USAGE,
    405: Exit.FORBIDDEN, 422: Exit.USAGE,
}  # fmt: skip

T = TypeVar("T")


def ask(daemon: DaemonOptions, path: str, **params: str) -> Answer:
    """Ask the daemon that a command line means for a document.

    Raises:
        CommandError: It cannot be reached, or says no.
    """
    return work(daemon, lambda line: line.ask(path, **params))


def act(
    daemon: DaemonOptions,
    method: str,
    path: str,
    document: Mapping[str, Json] | None = None,
    *,
    unsure: str = "",
) -> Answer:
    """Have something done; an outcome is an answer, whatever it is.

    Args:
        daemon: What the command line says of it.
        method: The method of the request.
        path: Its path.
        document: Its body.
        unsure: What may have happened all the same when Ctrl-C ends the wait for the answer, or
            the daemon was ended while it was under way.

    Raises:
        CommandError: The daemon cannot be reached, or says no without an outcome.
    """
    try:
        answer = work(daemon, lambda line: line.act(method, path, document))
    except KeyboardInterrupt:
        if unsure and not daemon.as_json:
            click.echo(f"interrupted: {unsure}", err=True)
        raise
    if unsure and not daemon.as_json and _names_nothing(answer.data):
        click.echo(unsure, err=True)
    return answer


def _names_nothing(report: Mapping[str, Json]) -> bool:
    """Whether it is the answer for what a daemon that was ended had begun: it knows no more."""
    is_unknown = report.get("outcome") == "unknown"
    return is_unknown and report.keys().isdisjoint(("drive", "group", "members"))


def refuse_problem(answer: Answer) -> None:
    """Refuse an answer that says that something was not done, or that this is not known.

    Raises:
        CommandError: It is such a one.
    """
    if not 200 <= answer.status < 300:
        with command_errors():
            raise problem_error(answer)


def work(daemon: DaemonOptions, do: Callable[[Line], Awaitable[T]]) -> T:
    """Connect, and do something that asks for more than one thing.

    Raises:
        CommandError: The daemon cannot be reached, or says no.
    """

    async def main() -> T:
        async with connected(daemon, blocking=True) as line:
            return await do(line)

    return finish(main())


@asynccontextmanager
async def connected(daemon: DaemonOptions, *, blocking: bool = False) -> AsyncIterator[Line]:
    """Connect to the daemon that a command line means.

    Args:
        daemon: What the command line says of it.
        blocking: Every request blocks: no event loop is needed, and nothing runs beside it.

    Raises:
        CommandError: It does not say which daemon, contradicts itself, or there is none; or
            what is asked in the block fails.
    """
    with command_errors():
        path, url = find_daemon(daemon.socket, daemon.url)
        async with open_connection(
            path, url, token_file=daemon.token_file, ca=daemon.ca, certificate=daemon.certificate,
            repeat_for_s=REPEAT_FOR_S,
            blocking=blocking,
        ) as connection:  # fmt: skip
            token = os.environ.get(LEASE_VARIABLE, "")
            if token.isascii() and token.isprintable() and token:
                connection.http.headers[LEASE_HEADER] = token
            yield Line(connection)


def drive_path(name: str) -> str:
    """Return the path of a drive, by a name that a person gave.

    Raises:
        CommandError: No drive can have this name.
    """
    with command_errors():
        return path_of("drive", name)


def group_path(name: str) -> str:
    """Return the path of a group, by a name that a person gave.

    Raises:
        CommandError: No group can have this name.
    """
    with command_errors():
        return path_of("group", name)


@contextmanager
def command_errors() -> Iterator[None]:
    """Let the library's errors end the command with the exit status that fits.

    Raises:
        CommandError: For each `ClientError`.
    """
    try:
        yield
    except ClientError as exc:
        status = _status_of(exc)
        raise CommandError(status, exc.problem, exc.remedy, exc.kind, exc.drive, exc.code) from exc


def _status_of(exc: ClientError) -> Exit:
    if isinstance(exc, ProblemError):
        return STATUS_OF_KIND.get(exc.kind) or STATUS_OF_HTTP.get(exc.status, Exit.FAILED)
    if isinstance(exc, UnreachableError):
        return Exit.UNREACHABLE
    if isinstance(exc, NotPermittedError):
        return Exit.FORBIDDEN
    return Exit.USAGE if isinstance(exc, AmbiguousDaemonError) else Exit.FAILED


def show(answer: Answer, print_it: Callable[[Any], object], *, as_json: bool) -> None:
    """Print an answer: as it came, or as a command shows it."""
    if as_json:
        click.echo(answer.text)
    else:
        print_it(answer.data)
