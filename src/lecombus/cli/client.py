"""The daemon, as a command sees it: HTTP over its Unix socket or a URL.

`connect` finds it: `--socket` or `--url`, else LECOMBUS_SOCKET or LECOMBUS_URL, else the only
socket in /run/lecombus. Answers are kept as the text that came, so that `--json` prints decimals
exactly as the daemon wrote them. A problem document (RFC 9457) becomes a `CommandError` with the
exit status that fits; so does every way in which a daemon cannot be reached.
"""

from __future__ import annotations

import json
import os
import socket as system_socket
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import click
import httpx2

from lecombus.cli.arguments import DaemonOptions
from lecombus.cli.document_rows import kind_of
from lecombus.cli.exits import CommandError, Exit
from lecombus.parameters import Json

__all__ = [
    "RUNTIME_DIR",
    "DaemonAnswer",
    "DaemonClient",
    "answer_of",
    "connect",
    "connect_async",
    "find_daemon",
    "path_of",
    "sent",
    "unreachable",
]

RUNTIME_DIR = Path("/run/lecombus")
"""Where the daemons of a machine have their sockets, one a line."""

LONGEST_NAME = 64
"""Characters of a drive's or a group's name in a roster."""

LOCAL = "http://localhost"
"""What a request over a socket calls the machine."""

CONNECT_WITHIN_S = 10.0
TIMEOUT = httpx2.Timeout(CONNECT_WITHIN_S, read=60.0)
"""Seconds; a write to a silent drive or a group read back member by member takes its time."""

STATUS_OF_KIND: Mapping[str, Exit] = {
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
_STATUS_OF_HTTP: Mapping[int, Exit] = {
    400: Exit.USAGE, 401: Exit.FORBIDDEN, 403: Exit.FORBIDDEN, 404: Exit.USAGE,
    405: Exit.FORBIDDEN, 422: Exit.USAGE,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class DaemonAnswer:
    """What the daemon answered.

    Args:
        text: The JSON document as it came.
        data: The same, read; decimals as `Decimal`.
    """

    text: str
    data: Any

    def show(self, print_it: Callable[[Any], object], *, as_json: bool) -> None:
        """Print it: as it came, or as a command shows it."""
        if as_json:
            click.echo(self.text)
        else:
            print_it(self.data)


class DaemonClient:
    """A running daemon.

    Args:
        client: Speaks HTTP with it.
        where: How it was found, for messages.
    """

    def __init__(self, client: httpx2.Client, where: str) -> None:
        self._client = client
        self.where = where

    def get(self, path: str, **params: str) -> DaemonAnswer:
        """Ask for a document.

        Raises:
            CommandError: The daemon cannot be reached, or says no.
        """
        return self._call("GET", path, params=params)

    def put(self, path: str, document: Mapping[str, Json]) -> DaemonAnswer:
        """Write.

        Raises:
            CommandError: The daemon cannot be reached, or says no without an outcome.
        """
        return self._call("PUT", path, document=document)

    def post(self, path: str, document: Mapping[str, Json]) -> DaemonAnswer:
        """Ask for an action.

        Raises:
            CommandError: The daemon cannot be reached, or says no without an outcome.
        """
        return self._call("POST", path, document=document)

    def _call(
        self,
        method: str,
        path: str,
        *,
        params: Mapping[str, str] | None = None,
        document: Mapping[str, Json] | None = None,
    ) -> DaemonAnswer:
        try:
            response = self._client.request(method, path, params=params, **sent(document))
        except httpx2.HTTPError as exc:
            raise unreachable(exc, self.where) from exc
        return answer_of(response, self.where)


@contextmanager
def connect(daemon: DaemonOptions) -> Iterator[DaemonClient]:
    """Connect to the daemon that a command line means.

    Raises:
        CommandError: It does not say which daemon, contradicts itself, or there is none.
    """
    path, base = _reach(daemon)
    transport = httpx2.HTTPTransport(uds=path) if path else None
    client = httpx2.Client(
        base_url=base or LOCAL, transport=transport, timeout=TIMEOUT, trust_env=False
    )
    with client:
        yield DaemonClient(client, path or base)


@asynccontextmanager
async def connect_async(daemon: DaemonOptions) -> AsyncIterator[tuple[httpx2.AsyncClient, str]]:
    """Connect for work that asks several things at once.

    Returns:
        The client, and where the daemon is, for messages.

    Raises:
        CommandError: It does not say which daemon, contradicts itself, or there is none.
    """
    path, base = _reach(daemon)
    transport = httpx2.AsyncHTTPTransport(uds=path) if path else None
    client = httpx2.AsyncClient(
        base_url=base or LOCAL, transport=transport, timeout=TIMEOUT, trust_env=False
    )
    async with client:
        yield client, path or base


def path_of(kind: Literal["drive", "group"], name: str) -> str:
    """Return the path of a drive or a group, by a name that a person gave.

    Raises:
        CommandError: No name is like this, and in a path it would mean something else.
    """
    if name in ("", ".", "..") or "/" in name or len(name) > LONGEST_NAME:
        shown = name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME]}..."
        problem = f"there is no {kind} `{shown}`"
        remedy = f"`lecombus {'status' if kind == 'drive' else 'check'}` shows the {kind}s"
        raise CommandError(Exit.USAGE, problem, remedy, f"no-such-{kind}")
    return f"/v1/{kind}s/{quote(name, safe='')}"


def answer_of(response: httpx2.Response, where: str) -> DaemonAnswer:
    """Read an answer; a write's outcome is one, whatever its status.

    Raises:
        CommandError: The daemon says no, or it is no daemon.
    """
    data = _read_json(response, where)
    if response.is_success or (isinstance(data, dict) and data.get("outcome")):
        return DaemonAnswer(response.text, data)
    raise _refused(response.status_code, data)


def _reach(daemon: DaemonOptions) -> tuple[str, str]:
    """Return the socket's path and the URL, one of them empty; something listens at the socket."""
    path, base = find_daemon(daemon.socket, daemon.url)
    if path:
        _knock(path)
    return path, base


def _knock(path: str) -> None:
    """Connect to a Unix socket once for the system's own word on why that fails.

    httpx2 hides it behind its own errors, and its transport leaves the failed socket open.
    """
    with system_socket.socket(system_socket.AF_UNIX, system_socket.SOCK_STREAM) as knocking:
        knocking.settimeout(CONNECT_WITHIN_S)
        try:
            knocking.connect(path)
        except PermissionError as exc:
            raise _forbidden(path) from exc
        except OSError as exc:
            raise _no_daemon_at(path) from exc


def find_daemon(socket: str | None, url: str | None) -> tuple[str, str]:
    """Return the socket's path and the URL, one of them empty.

    Raises:
        CommandError: Both are given, or none and it is not clear which daemon is meant.
    """
    if socket and url:
        raise CommandError(Exit.USAGE, "--socket and --url are both given", "give one")
    if not socket and not url:
        socket, url = os.environ.get("LECOMBUS_SOCKET"), os.environ.get("LECOMBUS_URL")
    if socket:
        return socket, ""
    if url:
        return "", _checked_url(url)
    return str(_only_socket()), ""


def _checked_url(url: str) -> str:
    try:
        parsed = httpx2.URL(url)
    except httpx2.InvalidURL:
        parsed = httpx2.URL()
    if parsed.scheme in ("http", "https") and parsed.host:
        return url
    raise CommandError(Exit.USAGE, f"`{url}` is no URL", "write it like http://127.0.0.1:9740")


def _only_socket() -> Path:
    try:
        sockets = sorted(path for path in RUNTIME_DIR.glob("*.sock") if path.is_socket())
    except PermissionError as exc:
        raise _forbidden(str(RUNTIME_DIR)) from exc
    if len(sockets) == 1:
        return sockets[0]
    if not sockets:
        problem = f"no daemon has its socket in {RUNTIME_DIR}"
        remedy = "start one (systemctl start lecombus@NAME), or say where it is with --socket"
        raise CommandError(Exit.UNREACHABLE, problem, remedy)
    names = ", ".join(str(path) for path in sockets)
    remedy = "say which with --socket or LECOMBUS_SOCKET"
    raise CommandError(Exit.USAGE, f"more than one daemon runs: {names}", remedy)


def _forbidden(where: str) -> CommandError:
    remedy = "ask for membership of the group lecombus (adduser YOU lecombus), then log in again"
    return CommandError(Exit.FORBIDDEN, f"{where} may not be opened", remedy)


def unreachable(exc: httpx2.HTTPError, where: str) -> CommandError:
    """Say why a daemon could not be spoken with."""
    if isinstance(exc, httpx2.TimeoutException):
        problem = f"the daemon at {where} does not answer in time"
        return CommandError(Exit.UNREACHABLE, problem, "look at its log")
    if isinstance(exc, httpx2.ReadError | httpx2.RemoteProtocolError | httpx2.WriteError):
        problem = f"the daemon at {where} ended before it answered"
        remedy = "what was asked may have happened; look at its log, then ask again"
        return CommandError(Exit.UNREACHABLE, problem, remedy)
    return _no_daemon_at(where)


def _no_daemon_at(where: str) -> CommandError:
    problem = f"no daemon answers at {where}"
    remedy = "start it (systemctl status lecombus@NAME tells why it is not running)"
    return CommandError(Exit.UNREACHABLE, problem, remedy)


def _read_json(response: httpx2.Response, where: str) -> Any:
    try:
        return json.loads(response.text, parse_float=Decimal)
    except ValueError as exc:
        problem = f"what answers at {where} is not lecombus (HTTP status {response.status_code})"
        raise CommandError(Exit.UNREACHABLE, problem, "look at the address and the port") from exc


def _refused(http_status: int, data: Any) -> CommandError:
    document: Mapping[str, Any] = data if isinstance(data, dict) else {}

    def text(*keys: str) -> str:
        return next((str(document[key]) for key in keys if document.get(key)), "")

    kind = kind_of(document)
    status = STATUS_OF_KIND.get(kind) or _STATUS_OF_HTTP.get(http_status, Exit.FAILED)
    problem = text("detail", "title") or f"the daemon refused (HTTP status {http_status})"
    cause = text("cause")
    if cause and cause not in problem:
        problem = f"{problem} ({cause})"
    return CommandError(status, problem, text("remedy"), kind, text("drive"), text("code"))


def sent(document: Mapping[str, Json] | None) -> dict[str, Any]:
    """Return how a document is sent with a request; None: without a body."""
    if document is None:
        return {}
    return {"content": body_text(document), "headers": {"content-type": "application/json"}}


def body_text(document: Mapping[str, Json]) -> str:
    """Write a flat document with its decimals exactly as they were given.

    `api.decimal_json` would do, but its room imports the HTTP server, 0.2 s before `stop` is sent.
    """
    members = (
        f"{json.dumps(key)}: "
        + (format(value, "f") if isinstance(value, Decimal) else json.dumps(value))
        for key, value in document.items()
    )
    return "{" + ", ".join(members) + "}"
