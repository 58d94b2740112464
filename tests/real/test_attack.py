"""A full line while clients over TCP send whatever they can: no watchdog and no memory is lost.

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
import time
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from lecombus.tokens.secret import new_secret
from support.certificates import client_context, make_certificates
from support.children import child
from support.daemon_host import Daemon, free_port, lecombus, running, short_dir
from support.rosters import roster_text

pytestmark = [pytest.mark.real, pytest.mark.long, pytest.mark.timeout(400)]

ADDRESSES = [n for n in range(11, 50) if n % 10][:31]
DRIVES = tuple(
    (f"drive-{address}", address, "93xx" if place % 4 == 0 else "smvector")
    for place, address in enumerate(ADDRESSES)
)
"""Few of them have a 2102 module, whose audits take seconds each."""

GET = b"GET %s HTTP/1.1\r\nHost: localhost\r\n"
MARGIN = "lecombus_watchdog_margin_seconds"
FOR_S = 10.0

ATTACKS: dict[str, tuple[int, bytes]] = {
    "many headers": (64, GET % b"/v1/line" + b"a:\r\n" * 12_000 + b"\r\n"),
    "just under the bounds": (64, GET % b"/v1/line" + b"a:\r\n" * 60 + b"\r\n"),
    "many parameters": (4, GET % (b"/v1/line?" + b"a&" * 31_000) + b"\r\n"),
    "an endless body": (
        4,
        GET % b"/v1/line" + b"Content-Length: 99999999999\r\n\r\n" + b"x" * 9000,
    ),
    "chunks of one byte": (
        8,
        GET % b"/v1/line" + b"Transfer-Encoding: chunked\r\n\r\n" + b"1\r\nx\r\n" * 9000,
    ),
    "pipelined pages": (64, (GET % b"/v1/drives" + b"\r\n") * 100),
    "reads of the line": (
        64,
        (GET % b"/v1/drives/drive-11/codes/C0150?fr%65sh=true" + b"\r\n") * 100,
    ),
}
"""How many connections, and what each sends over and over without waiting for anything."""


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
def full_line(folder: Path, http: int, api: str = "") -> Iterator[Daemon]:
    """Run a daemon with 31 drives, all online.

    Args:
        folder: Where its files go.
        http: Its TCP port.
        api: More keys of `api`.
    """
    keys = "cyclic: [{code: C0150, every: 2s}, {code: C0050, every: 5s}]"
    roster = roster_text(
        DRIVES, port=folder / "port", folder=folder, http=http,
        watchdog="{time: 2s, action: inhibit}", drive=keys,
    )  # fmt: skip
    if api:
        roster = roster.replace(f"http: '127.0.0.1:{http}'", f"http: '127.0.0.1:{http}', {api}")
    (folder / "line.yaml").write_text(roster)
    with child("support.paced_line", folder / "port", "--roster", folder / "line.yaml") as line:
        line.ask("so_far")
        with running(roster, folder) as daemon:
            daemon.until_online(within_s=120.0)
            yield daemon


def least_margin(daemon: Daemon, seconds: float = FOR_S) -> float:
    """Look at all margins for a while."""
    least, end_s = float("inf"), time.monotonic() + seconds
    while time.monotonic() < end_s:
        least = min(least, *daemon.metric(MARGIN).values())
        time.sleep(0.05)
    return least


def resident_mb(daemon: Daemon) -> float:
    status = Path(f"/proc/{daemon.process.pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def test_whatever_comes_over_tcp_takes_no_watchdog_and_no_memory() -> None:
    with short_dir() as folder:
        port = free_port()
        with full_line(folder, port) as daemon:
            time.sleep(10.0)  # what audits have put off
            calm, before_mb = least_margin(daemon), resident_mb(daemon)
            missed = daemon.metric("lecombus_watchdog_misses_total")
            for name, (count, data) in ATTACKS.items():
                for reads in (True, False):
                    with Attack(port, count, data, reads=reads) as attack:
                        least = least_margin(daemon)
                    said = f"{name}, answers {'' if reads else 'not '}taken, {attack.sent} bytes"
                    assert attack.sent > len(data), said
                    assert daemon.metric("lecombus_watchdog_misses_total") == missed, said
                    assert least >= 0.8 * calm, said
                    assert resident_mb(daemon) - before_mb <= 20.0, said
            assert daemon.end() == 0


HELLO = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"

GUARDED_ATTACKS: dict[str, tuple[int, bytes]] = {
    "the beginning of a handshake": (200, HELLO),
    "rubbish": (200, b"\x00" * 20_000),
    "alerts": (64, b"\x15\x03\x03\x00\x02\x02\x28" * 1000),
}
"""What comes where TLS is expected; what is left stands in ADR 77."""


def test_whatever_comes_over_tls_takes_no_watchdog_and_no_stop() -> None:
    with short_dir() as folder:
        made, port = make_certificates(folder), free_port()
        tls = f"{{certificate: {made.path('server.pem')}, key: {made.path('server.key')}}}"
        with full_line(folder, port, f"tokens: {folder}/tokens, tls: {tls}") as daemon:
            token = folder / "plc.token"
            words = ("new", "plc", "--scope", "control", "-c", daemon.roster, "-o", token)
            assert lecombus("token", *words, within_s=60).status == 0
            time.sleep(10.0)
            before_mb = resident_mb(daemon)
            context = client_context(made)
            attacks: dict[str, Attack] = {
                name: Attack(port, *what) for name, what in GUARDED_ATTACKS.items()
            }
            attacks["whole handshakes"] = Handshakes(port, 1, context)
            headers = {"Authorization": f"Bearer {token.read_text().strip()}"}
            url = f"https://localhost:{port}"
            stop = {"action": "quick-stop", "target": "drive-11"}
            # One keeps its connection, from the address of the attack; the other comes anew.
            keeps = httpx2.Limits(keepalive_expiry=60.0)
            with httpx2.Client(
                base_url=url, headers=headers, verify=context, timeout=20, limits=keeps
            ) as plc:
                assert plc.get("/v1/line").status_code == 200
                for name, attack in attacks.items():
                    missed = daemon.metric("lecombus_watchdog_misses_total")
                    with attack:
                        time.sleep(FOR_S)
                        assert daemon.metric("lecombus_watchdog_misses_total") == missed, name
                        assert plc.post("/v1/stop", json=stop).status_code == 200, name
                        elsewhere = httpx2.HTTPTransport(verify=context, local_address="127.0.0.2")
                        with httpx2.Client(
                            base_url=url, headers=headers, transport=elsewhere, timeout=20
                        ) as other:
                            assert other.post("/v1/stop", json=stop).status_code == 200, name
                    assert attack.sent > 0, name
                    assert resident_mb(daemon) - before_mb <= 20.0, name
            assert daemon.end() == 0
