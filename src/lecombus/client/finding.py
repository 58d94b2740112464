"""Which daemon is meant: a socket or a URL, given, from the environment, or the only one there is.

Nothing is sent here. `try_socket` connects once, to learn why the system refuses a connection.
"""

from __future__ import annotations

import os
import socket as system_socket
from pathlib import Path

import httpx2

from lecombus.client.errors import AmbiguousDaemonError, NotPermittedError, UnreachableError

__all__ = ["RUNTIME_DIR", "find_daemon", "no_daemon_at", "try_socket"]

RUNTIME_DIR = Path("/run/lecombus")
"""Where the daemons of a machine have their sockets, one a line."""


def find_daemon(socket: str | None, url: str | None) -> tuple[str, str]:
    """Return the socket's path and the URL, one of them empty.

    Args:
        socket: The path of a daemon's Unix socket.
        url: Its HTTP address. None for both: LECOMBUS_SOCKET or LECOMBUS_URL, else the only
            socket in /run/lecombus.

    Raises:
        AmbiguousDaemonError: Both are given, or it is not clear which daemon is meant.
        UnreachableError: There is none.
    """
    if socket and url:
        raise AmbiguousDaemonError("--socket and --url are both given", "give one")
    if not socket and not url:
        socket, url = os.environ.get("LECOMBUS_SOCKET"), os.environ.get("LECOMBUS_URL")
    if socket:
        return socket, ""
    if url:
        return "", _checked_url(url)
    return str(_only_socket()), ""


def try_socket(path: str) -> None:
    """Connect to a Unix socket once to learn from the system why that fails; never waits.

    httpx2 hides it behind its own errors, and its transport leaves the failed socket open.

    Raises:
        NotPermittedError: This user may not open it.
        UnreachableError: Nothing listens there.
    """
    with system_socket.socket(system_socket.AF_UNIX, system_socket.SOCK_STREAM) as trial:
        trial.setblocking(False)
        try:
            trial.connect(path)
        except BlockingIOError:
            return  # something listens, and has much to do
        except PermissionError as exc:
            raise _forbidden(path) from exc
        except OSError as exc:
            raise no_daemon_at(path) from exc


def no_daemon_at(where: str) -> UnreachableError:
    """Return the error for a place at which nothing listens."""
    problem = f"no daemon answers at {where}"
    remedy = "start it (systemctl status lecombus@NAME tells why it is not running)"
    return UnreachableError(problem, remedy)


def _checked_url(url: str) -> str:
    try:
        parsed = httpx2.URL(url)
    except httpx2.InvalidURL:
        parsed = httpx2.URL()
    if parsed.scheme in ("http", "https") and parsed.host:
        return str(parsed)  # https, also where it was written HTTPS
    raise AmbiguousDaemonError(f"`{url}` is no URL", "write it like http://127.0.0.1:9740")


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
        raise UnreachableError(problem, remedy)
    names = ", ".join(str(path) for path in sockets)
    remedy = "say which with --socket or LECOMBUS_SOCKET"
    raise AmbiguousDaemonError(f"more than one daemon runs: {names}", remedy)


def _forbidden(where: str) -> NotPermittedError:
    remedy = "ask for membership of the group lecombus (adduser YOU lecombus), then log in again"
    return NotPermittedError(f"{where} may not be opened", remedy)
