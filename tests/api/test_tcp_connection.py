"""What a client over TCP may do: anything, for nothing of it lasts."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import anyio
import pytest
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from lecombus.api import limits, serve, tcp_connection
from lecombus.api.tcp_connection import CpuShare
from lecombus.schedule import Priority
from support.api_line import Line
from support.virtual_loop import run

pytestmark = [pytest.mark.anyio, pytest.mark.real]

GET = b"GET /readyz HTTP/1.1\r\nHost: localhost\r\n\r\n"
FRESH = b"GET /v1/drives/feeder/codes/C0046?fresh=true HTTP/1.1\r\nHost: localhost\r\n\r\n"
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@asynccontextmanager
async def serving(line: Line, tmp_path: Path) -> AsyncIterator[tuple[str, int]]:
    async with anyio.create_task_group() as tasks:
        served = await tasks.start(serve, line.app, tmp_path / "s", ("127.0.0.1", 0))
        with anyio.fail_after(15):
            yield served.http
        tasks.cancel_scope.cancel()


async def answer(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    head = (await reader.readuntil(b"\r\n\r\n")).lower()
    length = int(head.partition(b"content-length: ")[2].partition(b"\r\n")[0])
    return int(head.split()[1]), await reader.readexactly(length)


async def test_a_write_that_was_refused_streams_its_body_into_a_connection_that_ends(
    line: Line, tmp_path: Path
) -> None:
    async with serving(line, tmp_path) as place:
        reader, writer = await asyncio.open_connection(*place)
        head = b"PUT /v1/drives/feeder/codes/C0046 HTTP/1.1\r\nHost: localhost\r\n"
        writer.write(head + b"Content-Length: 8000\r\n\r\n" + b"x" * 4000)
        status, said = await answer(reader)
        assert (status, json.loads(said)["type"]) == (403, "urn:lecombus:problem:read-only")
        sent = 0
        with contextlib.suppress(ConnectionError):
            while sent < 100_000_000:
                writer.write(b"x" * 65536)
                await writer.drain()
                sent += 65536
        assert sent < 20_000_000, "what the kernel's buffers take, and no more"
        writer.close()
    assert line.ops.asked == []


async def test_a_client_that_still_sends_reads_why_it_was_refused(
    line: Line, tmp_path: Path
) -> None:
    """With a reset it would see `connection reset` instead of the problem document."""
    async with serving(line, tmp_path) as place:
        for _ in range(20):
            reader, writer = await asyncio.open_connection(*place)
            writer.write(b"POST /v1/stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 60\r\n\r\n")
            await asyncio.sleep(0.002)
            writer.write(b"x" * 60)
            assert (await answer(reader))[0] == 403
            assert await reader.read() == b""
            writer.close()


async def test_the_last_answer_of_a_connection_comes_whole_also_to_a_slow_client(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As over a slow network, where the kernel takes little at a time."""
    size, made = 400_000, tcp_connection.TcpConnection.connection_made

    def with_little_room(
        connection: tcp_connection.TcpConnection, transport: asyncio.Transport
    ) -> None:
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 32768)
        made(connection, transport)

    async def big(request: object) -> Response:
        return Response(b"x" * size)

    monkeypatch.setattr(tcp_connection.TcpConnection, "connection_made", with_little_room)
    monkeypatch.setattr(tcp_connection, "LINGER_S", 0.05)
    line.app.router.routes.append(Route("/big", big))
    async with serving(line, tmp_path) as place:
        client = socket.socket()
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
        client.setblocking(False)
        await asyncio.get_running_loop().sock_connect(client, place)
        reader, writer = await asyncio.open_connection(sock=client, limit=4096)
        writer.write(b"GET /big HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        await reader.readuntil(b"\r\n\r\n")
        taken = 0
        with contextlib.suppress(ConnectionError):
            while data := await reader.read(4096):
                taken += len(data)
                await asyncio.sleep(0.002)
        writer.close()
    assert taken == size


class Inner(asyncio.Transport):
    """A transport whose buffer empties at a time; notes when it was cut."""

    def __init__(self, empty_at_s: float) -> None:
        super().__init__()
        self.empty_at_s = empty_at_s
        self.cut_at_s = 0.0

    def get_write_buffer_size(self) -> int:
        return int(asyncio.get_running_loop().time() < self.empty_at_s)

    def is_closing(self) -> bool:
        return False

    def resume_reading(self) -> None:
        pass

    def write_eof(self) -> None:
        pass

    def abort(self) -> None:
        self.cut_at_s = asyncio.get_running_loop().time()


@pytest.mark.parametrize(("sends_s", "cut_s"), [(0, 1), (3.5, 5), (1000, 10)])
def test_a_connection_that_ends_is_cut_some_time_after_all_was_sent(
    sends_s: float, cut_s: float
) -> None:
    async def work() -> None:
        began_s = asyncio.get_running_loop().time()
        inner = Inner(began_s + sends_s)
        transport = tcp_connection.LingeringTransport(inner)
        transport.close()
        assert transport.is_closing()
        await asyncio.sleep(30)
        assert inner.cut_at_s - began_s == pytest.approx(cut_s)

    run(work())


@pytest.mark.parametrize(
    "said",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(b"GET / HTTP/1.1\r\nX: ", id="half a head"),
        pytest.param(GET + b"GET / HTTP", id="half a second head"),
        pytest.param(GET[:-2] + b"Content-Length: 9\r\n\r\n", id="no body"),
    ],
)
async def test_a_client_that_keeps_the_daemon_waiting_is_cut(
    line: Line, tmp_path: Path, said: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp_connection, "PATIENCE_S", 0.05)
    async with serving(line, tmp_path) as place:
        reader, writer = await asyncio.open_connection(*place)
        writer.write(said)
        with contextlib.suppress(ConnectionResetError):
            await reader.read()
        writer.close()


async def test_a_client_that_takes_no_answer_is_cut_and_one_that_waits_for_the_line_is_not(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp_connection, "PATIENCE_S", 0.1)
    line.ops.gate = anyio.Event()
    async with serving(line, tmp_path) as place:
        patient, patient_writer = await asyncio.open_connection(*place)
        patient_writer.write(FRESH)
        with socket.socket() as deaf:
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.setblocking(False)
            loop = asyncio.get_running_loop()
            await loop.sock_connect(deaf, place)
            page = b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n"
            with pytest.raises(ConnectionError):
                await loop.sock_sendall(deaf, page * 1_000_000)
        line.ops.gate.set()
        assert (await answer(patient))[0] == 200
        patient_writer.close()


async def test_there_are_few_places_and_the_one_idle_longest_goes(
    line: Line, tmp_path: Path
) -> None:
    async with serving(line, tmp_path) as place:
        held: list[Streams] = []
        for _ in range(limits.TCP_LIMIT + 5):
            reader, writer = await asyncio.open_connection(*place)
            writer.write(GET)
            assert (await answer(reader))[0] == 200
            held.append((reader, writer))
        for reader, _ in held[:5]:
            with contextlib.suppress(ConnectionResetError):
                assert await reader.read() == b""
        for reader, writer in held[5:]:
            writer.write(GET)
            assert (await answer(reader))[0] == 200
        for _, writer in held:
            writer.close()


async def test_nothing_over_tcp_is_begun_out_of_its_turn_not_even_what_looks_like_a_stop(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[object] = []
    plain = CpuShare.take

    def take(self: CpuShare, client: object, begin: object) -> None:
        taken.append(client)
        plain(self, client, begin)  # type: ignore[arg-type]

    monkeypatch.setattr(CpuShare, "take", take)
    async with serving(line, tmp_path) as place:
        reader, writer = await asyncio.open_connection(*place)
        writer.write(b"GET /v1/stop HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert (await answer(reader))[0] == 405
        assert len(taken) == 2, "the slice that was parsed, and the request in it"
        writer.close()


async def test_clients_that_are_gone_leave_nothing_in_the_share(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shares: list[CpuShare] = []
    plain = CpuShare.__init__

    def made(self: CpuShare) -> None:
        plain(self)
        shares.append(self)

    monkeypatch.setattr(CpuShare, "__init__", made)
    async with serving(line, tmp_path) as place:
        shares[0].spend(0.2)  # nothing is begun for a second
        for _ in range(40):
            _, writer = await asyncio.open_connection(*place)
            writer.write(GET * 3)
            await writer.drain()
            writer.transport.abort()
        for _ in range(100):
            await anyio.sleep(0.01)
            if len(shares[0]._waiting) <= limits.TCP_LIMIT:
                break
        assert len(shares[0]._waiting) <= limits.TCP_LIMIT


@pytest.mark.parametrize(
    ("path", "waits"),
    [
        ("/v1/drives/feeder/codes/C0046?fresh=true", True),
        ("/v1/drives/feeder/codes/C0046?fr%65sh=true", True),
        ("/v1/drives/feeder/why?lang=de&fresh=true", True),
        ("/v1/drives/feeder/why?lang=de", False),
        ("/v1/line", False),
        ("/v1/line/addresses/21/codes/C0150", True),
    ],
)
def test_what_may_need_the_line_is_seen_before_it_is_decoded(path: str, waits: bool) -> None:
    path, _, query = path.partition("?")
    scope = {"method": "GET", "path": path, "query_string": query.encode()}
    assert limits.needs_line(scope) is waits


async def test_reads_of_the_line_begin_with_a_gap_between_them_and_looks_do_not_wait() -> None:
    begun: list[tuple[bytes, float]] = []
    now = asyncio.get_running_loop().time

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        begun.append((scope["query_string"], now()))

    paced = limits.PacedLineRequests(app, 0.05)

    async def ask(query: bytes) -> None:
        scope = {"type": "http", "method": "GET", "path": "/v1/line", "query_string": query}
        await paced(scope, None, None)  # type: ignore[arg-type]

    async with anyio.create_task_group() as tasks:
        for query in (b"fresh=true", b"fresh=true", b"fresh=true", b""):
            tasks.start_soon(ask, query)
    assert [query for query, _ in begun] == [b"fresh=true", b"", b"fresh=true", b"fresh=true"]
    reads = [at_s for query, at_s in begun if query]
    assert all(at_s - reads[0] >= 0.05 * place - 1e-6 for place, at_s in enumerate(reads))


@pytest.mark.parametrize(
    ("header", "status"),
    [
        (b"Origin: http://evil.example", 403),
        (b"Origin: null", 403),
        (b"Origin: http://localhost:3000", 403),
        (b"Origin: http://localhost", 200),
        (b"Sec-Fetch-Site: cross-site", 403),
        (b"Sec-Fetch-Site: same-site", 403),
        (b"Sec-Fetch-Site: same-origin", 200),
        (b"Sec-Fetch-Site: none", 200),
        (b"User-Agent: Prometheus/3.5.0", 200),
    ],
)
async def test_what_a_browser_asks_for_another_page_is_refused(
    line: Line, tmp_path: Path, header: bytes, status: int
) -> None:
    async with serving(line, tmp_path) as place:
        reader, writer = await asyncio.open_connection(*place)
        writer.write(GET[:-2] + header + b"\r\n\r\n")
        found, said = await answer(reader)
        assert found == status
        if status == 403:
            assert json.loads(said)["type"] == "urn:lecombus:problem:cross-site"
            assert await reader.read() == b""
        writer.close()


@pytest.mark.parametrize("host", ["localhost:8080", "127.0.0.1:1", "[::1]:9740", "LOCALHOST"])
async def test_a_forwarded_port_is_this_machine(line: Line, tmp_path: Path, host: str) -> None:
    async with serving(line, tmp_path) as place:
        reader, writer = await asyncio.open_connection(*place)
        request = f"GET /readyz HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n\r\n"
        writer.write(request.encode())
        assert (await answer(reader))[0] == 200
        writer.close()


async def test_why_reads_in_the_background_over_tcp(line: Line, tmp_path: Path) -> None:
    """It is a dozen reads in one request, and halved the margin of the watchdogs."""
    why = b"GET /v1/drives/feeder/why?fresh=true HTTP/1.1\r\nHost: localhost\r\n\r\n"
    async with serving(line, tmp_path) as place:
        reader, writer = await asyncio.open_connection(*place)
        writer.write(why)
        assert (await answer(reader))[0] == 200
        writer.close()
        local, to_local = await asyncio.open_unix_connection(tmp_path / "s")
        to_local.write(why)
        assert (await answer(local))[0] == 200
        to_local.close()
    assert line.ops.asked == [
        ("why", "feeder", True, Priority.BACKGROUND),
        ("why", "feeder", True, Priority.INTERACTIVE),
    ]


async def test_fresh_values_are_read_in_the_background_over_tcp(line: Line, tmp_path: Path) -> None:
    """A module's own code takes as long as ten feeds, and anybody may ask for it there."""
    asked = FRESH.replace(b"fresh=true", b"fresh=true&priority=interactive")
    read_as = []
    async with serving(line, tmp_path) as place:
        local = asyncio.open_unix_connection(tmp_path / "s")
        for opened in (asyncio.open_connection(*place), local):
            reader, writer = await opened
            writer.write(asked)
            await answer(reader)
            writer.close()
            read_as.append(line.ops.read_as)
    assert read_as == [(Priority.BACKGROUND, 45.0), (Priority.INTERACTIVE, 10.0)]
