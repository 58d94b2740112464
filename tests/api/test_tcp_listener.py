"""Connections over TCP are taken in their share of time, whatever clients do."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import struct
import time
from collections.abc import Iterator

import pytest

from lecombus.api import tcp_listener
from lecombus.api.limits import TCP_UNBEGUN_LIMIT
from lecombus.api.tcp_connection import CpuShare
from lecombus.api.tcp_listener import TAKEN_AT_ONCE, TcpListener

pytestmark = [pytest.mark.anyio, pytest.mark.real]

COST_S = 0.001


class Processor:
    """A clock of processor time on which only a connection that is begun takes time."""

    def __init__(self) -> None:
        self.used_s = 0.0

    def __call__(self) -> float:
        return self.used_s


class Begun(asyncio.Protocol):
    """Connections that were begun; each is ended."""

    def __init__(self, processor: Processor, times: list[float]) -> None:
        processor.used_s += COST_S
        times.append(time.monotonic())

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.abort()


@contextlib.contextmanager
def listening() -> Iterator[socket.socket]:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        one.listen(128)
        yield one


async def until(count: int, times: list[float]) -> None:
    end_s = time.monotonic() + 10.0
    while len(times) < count:
        assert time.monotonic() < end_s
        await asyncio.sleep(0.001)


async def flood(place: tuple[str, int]) -> None:
    """Open connections one after the other, without end."""
    loop = asyncio.get_running_loop()
    while True:
        with socket.socket() as one, contextlib.suppress(OSError):
            one.setblocking(False)
            await loop.sock_connect(one, place)
            await loop.sock_recv(one, 1)


async def test_the_connections_begun_in_a_second_are_bounded_whatever_clients_do() -> None:
    """A fifth of the time, at a millisecond each: one in five milliseconds."""
    processor, times = Processor(), list[float]()
    with listening() as one:
        listener = TcpListener(
            one, CpuShare(0.2, processor), lambda: Begun(processor, times), speaks_first=True
        )
        floods = [asyncio.create_task(flood(one.getsockname())) for _ in range(32)]
        listener.begin()
        await until(60, times)
        listener.close()
        for each in floods:
            each.cancel()
        await asyncio.gather(*floods, return_exceptions=True)
    rest_s = COST_S / 0.2
    assert times[-1] - times[0] >= (len(times) - 2) * rest_s


@pytest.mark.parametrize(("end", "speaks_first", "begun"), [
    ("reset", True, 1), ("reset", False, 1), ("no more", False, 1), ("no more", True, 2),
])  # fmt: skip
async def test_no_connection_is_begun_for_a_client_that_is_gone(
    end: str, speaks_first: bool, begun: int
) -> None:
    """Without TLS one that sends no more may wait for its answer."""
    processor, times = Processor(), list[float]()
    with listening() as one, contextlib.ExitStack() as clients:
        gone = clients.enter_context(socket.create_connection(one.getsockname()))
        if end == "reset":
            gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            gone.close()
        else:
            gone.shutdown(socket.SHUT_WR)
        clients.enter_context(socket.create_connection(one.getsockname()))
        listener = TcpListener(
            one, CpuShare(1.0, processor), lambda: Begun(processor, times),
            speaks_first=speaks_first,
        )  # fmt: skip
        listener.begin()
        await until(begun, times)
        await asyncio.sleep(0.05)
        listener.close()
    assert len(times) == begun


async def test_the_next_is_one_of_the_address_with_fewest_and_too_many_are_closed() -> None:
    processor, times, begun = Processor(), list[float](), list[str]()

    class Named(Begun):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            begun.append(transport.get_extra_info("peername")[0])
            super().connection_made(transport)

    def connect(address: str) -> socket.socket:
        return socket.create_connection(one.getsockname(), source_address=(address, 0))

    with listening() as one, contextlib.ExitStack() as clients:
        for _ in range(100):
            clients.enter_context(connect("127.0.0.66"))
        clients.enter_context(connect("127.0.0.2"))
        listener = TcpListener(
            one, CpuShare(0.5, processor), lambda: Named(processor, times), speaks_first=True
        )
        listener.begin()
        await until(TCP_UNBEGUN_LIMIT, times)
        await asyncio.sleep(0.05)
        listener.close()
    turns_to_take_all = 101 // TAKEN_AT_ONCE + 1
    assert begun.index("127.0.0.2") <= turns_to_take_all
    assert len(begun) <= TCP_UNBEGUN_LIMIT + turns_to_take_all


class FullSystem:
    """A listening socket whose first connections find no file left."""

    def __init__(self, one: socket.socket) -> None:
        self._one = one
        self.errors = [OSError(errno.EMFILE, "Too many open files"), ConnectionAbortedError()]

    def __getattr__(self, name: str) -> object:
        return getattr(self._one, name)

    def accept(self) -> tuple[socket.socket, object]:
        if self.errors:
            raise self.errors.pop(0)
        return self._one.accept()


async def test_without_files_it_tries_again_and_says_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(tcp_listener, "RETRY_S", 0.05)
    processor, times = Processor(), list[float]()
    with listening() as one, socket.create_connection(one.getsockname()):
        full = FullSystem(one)
        listener = TcpListener(
            full, CpuShare(1.0, processor), lambda: Begun(processor, times),  # type: ignore[arg-type]
            speaks_first=True,
        )  # fmt: skip
        listener.begin()
        await until(1, times)
        listener.close()
    assert "event=accept-failed reason=Too-many-open-files count=1" in caplog.text
