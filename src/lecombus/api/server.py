"""Where the API listens: a Unix socket for everything, TCP for what its clients may.

Strategy: both are uvicorn servers inside the caller's task, without signal handlers and access
log. The sockets are made here, because their rules matter more than uvicorn's defaults: the Unix
socket is open to its owner and group only, a stale file is removed only if no process listens on
it, and it is removed at the end, each under a lock, so that two daemons that start or end together
do not remove each other's; TCP binds to loopback only, unless there are tokens and TLS.
Without tokens it answers reads. `access`, `token_access` and `limits` decide what is let
through to the application, `connection` what a connection may do.
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import grp
import logging
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import anyio
import uvicorn
from anyio.abc import TaskStatus
from starlette.types import ASGIApp

from lecombus.api.access import OwnPagesAccess, ReadOnlyAccess
from lecombus.api.answers import dated
from lecombus.api.connection import CREDENTIALS, HttpConnection, StartQueue
from lecombus.api.error_answers import answered_at_the_end
from lecombus.api.limits import (
    ACCEPT_AT_ONCE,
    TCP_LIMIT,
    TCP_WAITING_LIMIT,
    TOKENS_TCP_LIMIT,
    WRITERS_WAITING_LIMIT,
    ConnectionPlaces,
    PacedLineRequests,
    RequestLimiter,
    connection_limit,
)
from lecombus.api.tcp_connection import CpuShare, TcpConnection, fairest, timed
from lecombus.api.tcp_listener import TcpListener
from lecombus.api.tls import TlsContexts
from lecombus.api.tls_connection import TlsConnection
from lecombus.api.token_access import AllowedHosts, FailureCount, TokenAccess
from lecombus.api.token_watch import TokenWatch
from lecombus.errors import OperationError
from lecombus.operations.actions import Actor
from lecombus.roster import is_loopback

__all__ = ["Doors", "Served", "serve"]

logger = logging.getLogger(__name__)

SOCKET_MODE: Final = 0o660
BACKLOG: Final = 128
TCP_BUFFER_BYTES: Final = 32 * 1024
"""What the kernel keeps of a TCP connection that is not read; it takes twice that."""

LOCK_S: Final = 2.0
"""How long another daemon may take to make or remove its socket in the same folder; it is some
milliseconds."""

LOCK_LOOK_S: Final = 0.02

CLOSE_S: Final = 3
"""How long requests under way may take to end when the server closes."""


@dataclass(frozen=True, slots=True)
class Served:
    """Where the API listens.

    Args:
        socket_path: The Unix socket.
        http: Host and port of the TCP server, where there is one.
    """

    socket_path: Path
    http: tuple[str, int] | None

    @property
    def address(self) -> str:
        """Where HTTP is served over TCP, as one would type it; `none` where it is not."""
        if self.http is None:
            return "none"
        host, port = self.http
        return f"[{host.strip('[]')}]:{port}" if ":" in host else f"{host}:{port}"


@dataclass(frozen=True, slots=True)
class Doors:
    """Who may come in, besides those who may open the Unix socket.

    Args:
        group: The group of the Unix socket; empty: that of the daemon.
        tokens: The tokens of TCP clients; None: TCP answers reads of this machine.
        tls: Certificate and key of TCP; None: without TLS.
        hosts: What requests over TCP may name as their host, besides its addresses.
    """

    group: str = ""
    tokens: TokenWatch | None = None
    tls: TlsContexts | None = None
    hosts: tuple[str, ...] = ()

    @property
    def is_guarded(self) -> bool:
        """Whether TCP may be open to other machines."""
        return self.tokens is not None and self.tls is not None


class DaemonServer(uvicorn.Server):
    """A uvicorn server that leaves signals to the daemon."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to take connections."""
        await super().startup(sockets)
        for one in sockets or ():
            # asyncio has one number for how many it takes in a row and how many may wait.
            one.listen(BACKLOG)


class TcpServer(DaemonServer):
    """A uvicorn server whose connections are taken in the share of TCP.

    Args:
        config: How it serves.
        share: The share of the loop's time.
        has_tls: Whether its clients speak TLS.
    """

    def __init__(self, config: uvicorn.Config, share: CpuShare, *, has_tls: bool) -> None:
        super().__init__(config)
        self._share = share
        self._has_tls = has_tls
        self._listeners: list[TcpListener] = []

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to take connections."""
        await super().startup([])
        for one in sockets or ():
            listener = TcpListener(
                one, self._share, self._make_connection, speaks_first=not self._has_tls
            )
            listener.begin()
            self._listeners.append(listener)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Take no more connections, and end those that are open."""
        for listener in self._listeners:
            listener.close()
        await super().shutdown(sockets)

    def _make_connection(self) -> asyncio.BaseProtocol:
        kind: Any = self.config.http_protocol_class
        made: asyncio.BaseProtocol = kind(
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )
        return made


async def serve(
    app: ASGIApp,
    socket_path: Path,
    http: tuple[str, int] | None = None,
    *,
    doors: Doors = Doors(),
    task_status: TaskStatus[Served] = anyio.TASK_STATUS_IGNORED,
) -> None:
    """Serve until cancelled; requests under way are given a few seconds to end.

    Args:
        app: The application.
        socket_path: The Unix socket to make.
        http: Host and port for TCP; port 0 takes a free one.
        doors: Who may come in.
        task_status: Gets where it listens, once it does.

    Raises:
        OperationError: `cannot-listen` or `socket-in-use`.
    """
    with ExitStack() as resources:
        unix = resources.enter_context(unix_socket(socket_path, doors.group))
        tcp_limit = TCP_LIMIT if doors.tokens is None else TOKENS_TCP_LIMIT
        places, bound = ConnectionPlaces(connection_limit(), tcp_limit), None
        listeners = [(DaemonServer(unix_configuration(app, places)), unix)]
        if http is not None:
            tcp = resources.enter_context(tcp_socket(*http, is_guarded=doors.is_guarded))
            bound = (http[0], tcp.getsockname()[1])
            listeners.append((tcp_server(app, http[0], places, doors), tcp))
        task_status.started(Served(socket_path, bound))
        await run_until_cancelled(listeners)


async def run_until_cancelled(listeners: list[tuple[DaemonServer, socket.socket]]) -> None:
    """Run the servers; when cancelled let each end its requests, then return."""
    async with anyio.create_task_group() as shielded, anyio.create_task_group() as tasks:
        for listener, its_socket in listeners:
            shielded.start_soon(run_shielded, listener, its_socket)
        tasks.start_soon(close_when_cancelled, [listener for listener, _ in listeners])


async def run_shielded(listener: DaemonServer, its_socket: socket.socket) -> None:
    """Run one server to its own end: cancelling it half-way would cut requests."""
    with anyio.CancelScope(shield=True):
        await listener.serve([its_socket])
    assert listener.should_exit, "a server ended without being asked to: the API would be gone"


async def close_when_cancelled(listeners: list[DaemonServer]) -> None:
    """Ask the servers to end once this task is cancelled."""
    try:
        await anyio.sleep_forever()
    finally:
        for listener in listeners:
            listener.should_exit = True


def unix_configuration(app: ASGIApp, places: ConnectionPlaces) -> uvicorn.Config:
    """Return how the Unix socket is served."""
    kind = type("PlacedConnection", (HttpConnection,), {"places": places, "starts": StartQueue()})
    return configuration(OwnPagesAccess(RequestLimiter(app)), kind)


def tcp_server(app: ASGIApp, host: str, places: ConnectionPlaces, doors: Doors) -> TcpServer:
    """Return what serves TCP: all of it in one share of the loop's time."""
    share = CpuShare() if doors.tokens is None else CpuShare(choose=fairest)
    known: dict[str, Any] = {"places": places, "share": share}
    limited = RequestLimiter(PacedLineRequests(app), TCP_LIMIT, TCP_WAITING_LIMIT)
    access: ASGIApp = ReadOnlyAccess(limited, host)
    if doors.tokens is not None:
        writers = RequestLimiter(app, TOKENS_TCP_LIMIT, WRITERS_WAITING_LIMIT)
        hosts = AllowedHosts(host.strip("[]").lower(), doors.hosts)
        access = by_token = TokenAccess(
            limited, writers, doors.tokens, hosts, FailureCount(time.monotonic)
        )
        known["token_of"] = staticmethod(by_token.token_of)
    base: type[TcpConnection] = TcpConnection
    if doors.tls is not None:
        base, known["contexts"] = TlsConnection, doors.tls
    configured = configuration(timed(access, share), type("PlacedTcpConnection", (base,), known))
    return TcpServer(configured, share, has_tls=doors.tls is not None)


def configuration(app: ASGIApp, kind: type[HttpConnection]) -> uvicorn.Config:
    """Return uvicorn's configuration; what lecombus does itself or does not offer is off."""
    return uvicorn.Config(
        dated(answered_at_the_end(app)),
        log_config=None,
        log_level="error",  # a warning for each bad request: any client could fill the log
        access_log=False,
        lifespan="off",
        ws="none",
        proxy_headers=False,
        server_header=False,
        date_header=False,  # uvicorn's is the time at which the request came
        http=kind,
        backlog=ACCEPT_AT_ONCE,
        timeout_keep_alive=60,
        timeout_graceful_shutdown=CLOSE_S,
    )


@contextmanager
def unix_socket(path: Path, group: str = "") -> Iterator[socket.socket]:
    """Yield a bound Unix socket with mode 0660; its file goes at the end.

    Args:
        path: Where.
        group: Its group; empty: that of the process.

    Raises:
        OperationError: It cannot be made, or another process listens on it.
    """
    with locked_folder(path, LOCK_S) as locked:
        if not locked:
            logger.warning("event=folder-locked folder=%s reason=by another process", path.parent)
        remove_stale(path)
        listening = bound_socket(path, group)
        ours = path.stat()
    try:
        yield listening
    finally:
        listening.close()
        # A daemon that starts now removes what this one leaves behind: no need to wait for it.
        with locked_folder(path, 0.0) as locked:
            if locked and is_ours(path, ours):
                path.unlink(missing_ok=True)


def bound_socket(path: Path, group: str) -> socket.socket:
    """Return a Unix socket that listens, with mode 0660.

    Raises:
        OperationError: It cannot be made.
    """
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    # Another group: not even the group of the process may open it before it has that group.
    before = os.umask(0o777 & ~(SOCKET_MODE & 0o600 if group else SOCKET_MODE))
    try:
        listening.bind(str(path))
        if group:
            give_to_group(path, group)
        listening.listen(BACKLOG)  # here: a socket that no process listens on looks stale
    except OSError as exc:
        listening.close()
        remedy = f"make {path.parent}, writable for this user, or name another by `api.socket`"
        raise cannot_listen(str(path), exc, remedy) from exc
    except OperationError:
        listening.close()
        path.unlink(missing_ok=True)
        raise
    finally:
        os.umask(before)
    return listening


@contextmanager
def locked_folder(path: Path, wait_s: float) -> Iterator[bool]:
    """Keep other daemons from making or removing sockets beside a path.

    The folder itself is locked. A lock file would have to be removed, with the race that the lock
    must prevent. Everyone who may read the folder may lock it: so a lock that is held for longer
    than a daemon needs is ignored. A folder that cannot be locked is used without a lock.

    Args:
        path: The socket's.
        wait_s: How long to wait for another daemon, seconds.

    Yields:
        Whether it is locked, or cannot be; not: another process keeps it locked.
    """
    try:
        descriptor = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:  # it is not there, or may not be read: `bind` says what is wrong
        yield True
        return
    try:
        yield is_locked(descriptor, time.monotonic() + wait_s)
    finally:
        os.close(descriptor)


def is_locked(descriptor: int, until_s: float) -> bool:
    """Lock a folder until its descriptor is closed; see `locked_folder`."""
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until_s:
                return False
            time.sleep(LOCK_LOOK_S)
        except OSError:  # some network file systems lock no folders
            return True
        else:
            return True


def give_to_group(path: Path, group: str) -> None:
    """Give a socket to a group, and open it to that group.

    Raises:
        OperationError: There is no such group, or the process may not do that.
    """
    try:
        os.chown(path, -1, grp.getgrnam(group).gr_gid)
        path.chmod(SOCKET_MODE)
    except KeyError:
        raise OperationError(
            f"there is no group {group} for the socket {path}",
            kind="cannot-listen",
            remedy=f"make it (addgroup --system {group}), or change `api.socket_group`",
        ) from None
    except OSError as exc:
        remedy = (
            f"make the daemon's user a member of {group} (adduser lecombus {group}); under systemd "
            "SupplementaryGroups= and deploy/show-client-users.conf are needed too"
        )
        what = f"{path} to the group {group}"
        raise OperationError(
            f"cannot give {what}: {exc.strerror or exc}", kind="cannot-listen", remedy=remedy
        ) from exc


def remove_stale(path: Path) -> None:
    """Remove the socket of a process that has ended.

    Raises:
        OperationError: Another process listens there, or it is not a socket.
    """
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    except OSError as exc:
        raise cannot_listen(str(path), exc, "check the path") from exc
    if not stat.S_ISSOCK(mode):
        raise OperationError(
            f"{path} exists and is not a socket",
            kind="cannot-listen",
            remedy="remove it, or give the API another socket in the roster",
        )
    if (holder := listener_at(path)) is not None:
        raise OperationError(
            f"{path} is served by {holder}",
            kind="socket-in-use",
            remedy="one daemon per line: stop that one, or give this one another socket",
        )
    try:
        path.unlink(missing_ok=True)
    except OSError as exc:
        raise cannot_listen(str(path), exc, "remove it: no process listens on it") from exc


def listener_at(path: Path) -> str | None:
    """Return what to call the process that listens on a socket; None: there is none."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        found = probe.connect_ex(str(path))
        if found in (errno.ECONNREFUSED, errno.ENOENT):
            return None
        if found:  # such as a full backlog, or another user's socket
            return "another process"
        said = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
    pid, uid, _ = CREDENTIALS.unpack(said)
    if not pid:
        return "a process in another container"
    return f"{Actor('socket', uid, pid).find_process()} (pid {pid})"


def is_ours(path: Path, ours: os.stat_result) -> bool:
    """Whether a socket's file is still ours, and no other has taken its place."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return False
    return (found.st_dev, found.st_ino) == (ours.st_dev, ours.st_ino)


@contextmanager
def tcp_socket(host: str, port: int, *, is_guarded: bool = False) -> Iterator[socket.socket]:
    """Yield a bound TCP socket.

    Args:
        host: An address of this machine, or `localhost`.
        port: The port; 0 takes a free one.
        is_guarded: Whether its clients need tokens and TLS; else it must be loopback.

    Raises:
        OperationError: It may not be open to other machines, or cannot be bound.
    """
    if not is_guarded and not is_loopback(host):
        raise OperationError(
            f"the API does not listen on {host} without tokens and TLS",
            kind="cannot-listen",
            remedy="write `api.tokens` and `api.tls` into the roster, or listen on 127.0.0.1",
        )
    address = "127.0.0.1" if host == "localhost" else host.strip("[]")
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((address, port))
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, TCP_BUFFER_BYTES)
            listening.listen(BACKLOG)
        except OSError as exc:
            remedy = "free the port, or give the API another one in the roster"
            raise cannot_listen(f"{host}:{port}", exc, remedy) from exc
        yield listening


def cannot_listen(where: str, exc: OSError, remedy: str) -> OperationError:
    """Return the error for a place that cannot be bound."""
    return OperationError(
        f"cannot listen on {where}: {exc.strerror or exc}", kind="cannot-listen", remedy=remedy
    )
