"""The TCP end on real sockets: every byte passes, every loss shows, errors say what to do."""

from __future__ import annotations

import asyncio
import errno
import os
import selectors
import socket
import struct
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import anyio
import pytest

from lecombus.errors import LineLostError
from lecombus.fieldbus.port import Parity, PortSettings
from lecombus.line import tcp_port
from lecombus.line.event_loop import run
from lecombus.line.tcp_port import TcpPort, host_and_port, open_tcp
from support.heard import Heard

pytestmark = pytest.mark.clock

EVERY_BYTE = bytes(range(256))


class Server:
    """A device server that takes one connection; the test speaks for the drives."""

    def __init__(self, family: socket.AddressFamily = socket.AF_INET) -> None:
        host = "127.0.0.1" if family == socket.AF_INET else "::1"
        self._listener = socket.create_server((host, 0), family=family)
        self.number = self._listener.getsockname()[1]
        self.url = f"socket://{host if family == socket.AF_INET else '[::1]'}:{self.number}"
        self.peer = socket.socket()

    def accept(self) -> None:
        self.peer.close()
        self._listener.settimeout(5)
        self.peer, _ = self._listener.accept()
        self.peer.setblocking(False)

    async def take(self, count: int) -> bytes:
        taken = bytearray()
        with anyio.fail_after(5):
            while len(taken) < count:
                await anyio.wait_readable(self.peer)
                taken += self.peer.recv(65536)
        return bytes(taken)

    def reset(self) -> None:
        self.peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.peer.close()

    def close(self) -> None:
        self.peer.close()
        self._listener.close()


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    made.close()


def with_port(
    server: Server,
    body: Callable[[TcpPort, Heard], Awaitable[None]],
    *,
    parity: Parity = "line",
) -> Heard:
    """Run `body` with an open port, abort it, and give the loop time to say something false."""

    async def main() -> Heard:
        recorder = Heard()
        port = await open_tcp(
            PortSettings(server.url, framing="8N1" if parity == "line" else "7E1", line="hall-3"),
            recorder,
        )
        server.accept()
        try:
            await body(port, recorder)
        finally:
            port.abort()
            await anyio.sleep(0.01)
        return recorder

    return run(main)


def refused(url: str) -> str:
    """Give the message with which opening fails."""

    async def main() -> None:
        await open_tcp(PortSettings(url, line="hall-3"), Heard())

    with pytest.raises(LineLostError) as caught:
        run(main)
    assert caught.value.line == "hall-3"
    return str(caught.value)


def test_every_byte_passes_both_ways_unchanged(server: Server) -> None:
    async def body(port: TcpPort, recorder: Heard) -> None:
        port.write(EVERY_BYTE)
        assert await server.take(256) == EVERY_BYTE
        server.peer.sendall(EVERY_BYTE)
        await recorder.until(lambda: len(recorder.data) >= 256)
        assert recorder.data == EVERY_BYTE

    with_port(server, body)


def test_an_ipv6_address_in_brackets_is_reached() -> None:
    server = Server(socket.AF_INET6)

    async def body(port: TcpPort, _recorder: Heard) -> None:
        port.write(b"\x04")
        assert await server.take(1) == b"\x04"
        assert f"([::1]:{server.number})" in port.describe()

    with_port(server, body)
    server.close()


@pytest.mark.parametrize(
    ("parity", "carries", "framing"), [("line", True, "8N1"), ("port", False, "7E1")]
)
def test_who_makes_parity_is_told(
    server: Server, parity: Parity, carries: bool, framing: str
) -> None:
    async def body(port: TcpPort, _recorder: Heard) -> None:
        assert port.carries_parity is carries
        assert port.describe().startswith(f"{server.url} (127.0.0.1:{server.number})")
        assert framing in port.describe()

    with_port(server, body, parity=parity)


def test_a_server_that_closes_is_a_loss_told_once(server: Server) -> None:
    async def body(port: TcpPort, recorder: Heard) -> None:
        server.peer.close()
        await recorder.until(lambda: bool(recorder.losses), within_s=1.0)
        await anyio.sleep(0.02)
        with pytest.raises(LineLostError, match="closed"):
            port.write(b"\x04")
        port.discard_input()

    recorder = with_port(server, body)
    (loss,) = recorder.losses
    assert isinstance(loss, LineLostError)
    assert loss.line == "hall-3"
    assert "ended the connection; is another client" in str(loss)


def test_what_came_before_the_end_is_given_on(server: Server) -> None:
    async def body(_port: TcpPort, recorder: Heard) -> None:
        server.peer.sendall(b"last words")
        server.peer.close()
        await recorder.until(lambda: bool(recorder.losses))
        assert recorder.data == b"last words"

    with_port(server, body)


def test_a_reset_connection_is_a_loss_told_once(server: Server) -> None:
    async def body(_port: TcpPort, recorder: Heard) -> None:
        server.reset()
        await recorder.until(lambda: bool(recorder.losses), within_s=1.0)

    (loss,) = with_port(server, body).losses
    assert "Connection reset by peer" in str(loss)


def test_writing_to_a_killed_server_ends_in_one_loss(server: Server) -> None:
    async def body(port: TcpPort, recorder: Heard) -> None:
        server.reset()
        while not recorder.losses:
            try:
                port.write(b"\x0411460\x05")
            except LineLostError:
                await recorder.until(lambda: bool(recorder.losses), within_s=1.0)
            await asyncio.sleep(0)

    assert len(with_port(server, body).losses) == 1


def test_a_server_that_takes_no_bytes_is_a_loss(server: Server) -> None:
    async def body(port: TcpPort, recorder: Heard) -> None:
        with pytest.raises(LineLostError, match="closed"):  # noqa: PT012
            while True:
                port.write(bytes(1 << 20))
        await recorder.until(lambda: bool(recorder.losses), within_s=1.0)

    (loss,) = with_port(server, body).losses
    assert "takes no more bytes" in str(loss)


def test_nothing_is_told_after_abort(server: Server) -> None:
    async def body(port: TcpPort, recorder: Heard) -> None:
        server.peer.sendall(b"late")
        port.abort()
        port.abort()
        await anyio.sleep(0.02)
        with pytest.raises(LineLostError, match="closed"):
            port.write(b"\x04")
        assert recorder.data == b""

    assert with_port(server, body).losses == []


def test_discarded_input_is_never_given_on(server: Server) -> None:
    async def body(port: TcpPort, recorder: Heard) -> None:
        server.peer.sendall(b"old")  # on the loopback it has arrived when this returns
        port.discard_input()
        server.peer.sendall(b"new")
        await recorder.until(lambda: bool(recorder.data))
        assert recorder.data == b"new"

    with_port(server, body)


def test_what_lies_in_the_kernel_is_given_on_when_it_is_looked_at(server: Server) -> None:
    """The loop has no turn meanwhile: nothing is awaited between the bytes and the look."""

    async def body(port: TcpPort, heard: Heard) -> None:
        port.look()
        assert not heard.data
        server.peer.send(b"answer")
        assert port._transport is not None
        sock = port._transport.get_extra_info("socket")
        with selectors.DefaultSelector() as selector:
            selector.register(sock.fileno(), selectors.EVENT_READ)
            assert selector.select(5.0)
        port.look()
        assert bytes(heard.data) == b"answer"
        server.peer.close()
        port.look()
        port.abort()
        port.look()

    with_port(server, body)


def test_discarding_at_the_end_of_the_connection_still_ends_in_a_loss(server: Server) -> None:
    async def body(port: TcpPort, recorder: Heard) -> None:
        server.reset()
        port.discard_input()
        await recorder.until(lambda: bool(recorder.losses), within_s=1.0)

    assert len(with_port(server, body).losses) == 1


def test_the_kernel_watches_a_silent_server(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched: list[dict[str, int]] = []
    watch = tcp_port._watch

    def note(sock: socket.socket) -> None:
        watch(sock)
        options = ("TCP_NODELAY", "TCP_KEEPIDLE", "TCP_USER_TIMEOUT")
        tcp = socket.IPPROTO_TCP
        watched.append({name: sock.getsockopt(tcp, getattr(socket, name)) for name in options})
        watched[0]["SO_KEEPALIVE"] = sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)

    monkeypatch.setattr(tcp_port, "_watch", note)

    async def body(_port: TcpPort, _recorder: Heard) -> None:
        pass

    with_port(server, body)
    (found,) = watched
    assert found.pop("TCP_KEEPIDLE") <= 5
    assert found.pop("TCP_USER_TIMEOUT") <= 10_000
    assert found == {"TCP_NODELAY": 1, "SO_KEEPALIVE": 1}


def test_200_openings_leave_no_descriptor_behind(server: Server) -> None:
    async def main() -> tuple[int, int]:
        counts = []
        for _ in range(200):
            port = await open_tcp(PortSettings(server.url), Heard())
            server.accept()
            port.abort()
            await asyncio.sleep(0.0)
            counts.append(len(list(Path("/proc/self/fd").iterdir())))  # noqa: ASYNC240
        return counts[0], counts[-1]

    first, last = run(main)
    assert first == last


def test_a_refused_connection_says_what_to_check(server: Server) -> None:
    server.close()
    assert refused(server.url) == (
        f"{server.url}: connection refused; is the device server running and is that its port?"
    )


def test_a_host_that_does_not_answer_is_given_up_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A full backlog drops connection requests without a word, as an absent host does."""
    monkeypatch.setattr(tcp_port, "CONNECT_TIMEOUT_S", 0.1)
    with socket.socket() as full, socket.socket() as queued:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        queued.connect(full.getsockname())
        message = refused(f"socket://127.0.0.1:{full.getsockname()[1]}")
    assert "no answer within 0.1 s; check host and network" in message


def test_an_address_of_a_host_that_does_not_answer_does_not_keep_it_from_its_other_one(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name with an IPv6 address that leads nowhere, and an IPv4 address that is right."""
    with socket.socket() as full, socket.socket() as queued:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        queued.connect(full.getsockname())
        places = (full.getsockname(), ("127.0.0.1", server.number))
        found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", place) for place in places]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_args, **_kwargs: found)
        server.url = "socket://server:4001"

        async def body(port: TcpPort, recorder: Heard) -> None:
            port.write(b"\x04")
            assert await server.take(1) == b"\x04"

        with_port(server, body)


def test_a_host_without_an_address_says_so() -> None:
    assert "cannot be resolved" in refused("socket://no-such-host.invalid:4001")


@pytest.mark.parametrize(
    "url",
    [
        "socket://server",
        "socket://:4001",
        "socket://server:0",
        "socket://server:70000",
        "socket://server:serial",
        "socket://server:4001/path",
        "socket://user@server:4001",
        "socket:server:4001",
        "socket://[::1:4001",
    ],
)
def test_a_url_of_another_form_says_which_is_right(url: str) -> None:
    assert "not of the form socket://HOST:PORT, PORT in 1..65535" in refused(url)


def test_host_and_port_are_taken_apart() -> None:
    assert host_and_port("socket://server.example:4001") == ("server.example", 4001)
    assert host_and_port("socket://[fe80::1]:23") == ("fe80::1", 23)


def test_a_connection_that_ends_while_it_is_made_is_a_failed_opening_and_no_loss() -> None:
    async def main() -> list[Exception | None]:
        recorder = Heard()
        port = TcpPort(recorder, PortSettings("socket://server:4001"))
        port.data_received(b"Port already in use")
        port.connection_lost(ConnectionResetError(104, "Connection reset by peer"))
        with pytest.raises(LineLostError, match="reset by peer"):
            port.begin()
        assert recorder.data == b""
        return recorder.losses

    assert run(main) == []


def test_cancelling_an_opening_leaves_no_connection(server: Server) -> None:
    async def main() -> None:
        with anyio.move_on_after(0) as scope:
            await open_tcp(PortSettings(server.url), Heard())
        assert scope.cancelled_caught

    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    run(main)
    assert len(os.listdir("/proc/self/fd")) == before  # noqa: PTH208


def test_a_server_that_the_service_may_not_reach_names_the_drop_in(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def forbidden(*args: object, **kwargs: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(asyncio.BaseEventLoop, "create_connection", forbidden)
    assert "drop-in device-server.conf" in refused(server.url)
