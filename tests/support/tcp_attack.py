"""A full line, and clients over TCP that send whatever they can.

The simulated drives are a process of their own, as in `test_load`; the clients here only use
sockets, so that nothing of them is limited by a client library.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import ssl
import threading
from collections.abc import Iterator
from pathlib import Path

from lecombus.tokens.secret import new_secret
from support.children import Child, child
from support.daemon_host import Daemon, running
from support.rosters import roster_text

__all__ = ["DRIVES", "GET", "Attack", "Handshakes", "full_line", "resident_mb"]

ADDRESSES = [n for n in range(11, 50) if n % 10][:31]
DRIVES = tuple(
    (f"drive-{address}", address, "93xx" if place % 4 == 0 else "smvector")
    for place, address in enumerate(ADDRESSES)
)
"""Few of them have a 2102 module, whose audits take seconds each."""

GET = b"GET %s HTTP/1.1\r\nHost: localhost\r\n"


class Attack:
    """Sends from entering until leaving; connections that are cut are opened again."""

    def __init__(self, port: int, count: int, data: bytes, *, reads: bool = True) -> None:
        self._port, self._count, self._data, self._reads = port, count, data, reads
        self._selector = selectors.DefaultSelector()
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.sent = 0

    def __enter__(self) -> Attack:
        self._thread.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._ends.set()
        self._thread.join()
        for key in list(self._selector.get_map().values()):
            self._drop(key.fileobj)  # type: ignore[arg-type]
        self._selector.close()

    def _run(self) -> None:
        # The lowest priority: what counts is what is sent, not who else wants a processor.
        os.sched_setscheduler(threading.get_native_id(), os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)
        while not self._ends.is_set():
            with contextlib.suppress(OSError):
                while len(self._selector.get_map()) < self._count:
                    self._open()
            for key, events in self._selector.select(0.05):
                assert isinstance(key.fileobj, socket.socket)
                self._go_on(key.fileobj, key.data, events)

    def _open(self) -> None:
        one = socket.create_connection(("127.0.0.1", self._port), timeout=1.0)
        one.setblocking(False)
        self._selector.register(one, selectors.EVENT_READ | selectors.EVENT_WRITE, [0])

    def _go_on(self, one: socket.socket, at: list[int], events: int) -> None:
        try:
            if events & selectors.EVENT_READ and self._reads and not one.recv(1 << 18):
                self._drop(one)
            elif events & selectors.EVENT_WRITE:
                count = one.send(memoryview(self._data)[at[0] :])
                at[0] = (at[0] + count) % len(self._data)
                self.sent += count
        except BlockingIOError:
            pass
        except OSError:
            self._drop(one)

    def _drop(self, one: socket.socket) -> None:
        self._selector.unregister(one)
        one.close()


class Handshakes(Attack):
    """Makes whole handshakes over and over, each with a request that carries a wrong token."""

    def __init__(self, port: int, count: int, tls: ssl.SSLContext) -> None:
        super().__init__(port, count, b"")
        self._tls = tls

    def _run(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)
        request = GET % b"/v1/line" + f"Authorization: Bearer {new_secret()}\r\n\r\n".encode()
        while not self._ends.is_set():
            with contextlib.suppress(OSError):
                plain = socket.create_connection(("127.0.0.1", self._port), timeout=1.0)
                with plain, self._tls.wrap_socket(plain, server_hostname="localhost") as one:
                    one.sendall(request)
                    self.sent += len(request)
                    one.recv(1 << 12)


@contextlib.contextmanager
def full_line(
    folder: Path, http: int, api: str = "", more: str = ""
) -> Iterator[tuple[Daemon, Child]]:
    """Run a daemon with 31 drives, all online; it and the drives have a processor before others.

    Args:
        folder: Where its files go.
        http: Its TCP port.
        api: More keys of `api`.
        more: More tables of the roster.
    """
    keys = "cyclic: [{code: C0150, every: 2s}, {code: C0050, every: 5s}]"
    roster = roster_text(
        DRIVES, port=folder / "port", folder=folder, http=http,
        watchdog="{time: 2s, action: inhibit}", drive=keys,
    )  # fmt: skip
    if api:
        roster = roster.replace(f"http: '127.0.0.1:{http}'", f"http: '127.0.0.1:{http}', {api}")
    roster += more
    (folder / "line.yaml").write_text(roster)
    with child("support.paced_line", folder / "port", "--roster", folder / "line.yaml") as line:
        line.ask("so_far")
        with running(roster, folder) as daemon:
            prefer(daemon.process.pid, line.process.pid)
            daemon.until_online(within_s=120.0)
            yield daemon, line


def prefer(*processes: int) -> None:
    """Give processes the processor before all others, where this user may.

    What is looked at is the time that the daemon takes, not who else uses the computer.
    """
    for process in processes:
        for thread in Path(f"/proc/{process}/task").iterdir():
            with contextlib.suppress(PermissionError):
                os.sched_setscheduler(int(thread.name), os.SCHED_RR, os.sched_param(1))


def resident_mb(daemon: Daemon) -> float:
    status = Path(f"/proc/{daemon.process.pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024
