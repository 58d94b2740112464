"""What a connection may send: whole requests are answered, everything else is bounded and told."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from email.utils import formatdate
from pathlib import Path

import anyio
import pytest

import lecombus.api.answers
from lecombus.api import serve
from lecombus.api.connection import PENDING_LIMIT, HttpConnection
from lecombus.api.limits import CHUNKED_LIMIT, HEAD_LIMIT, HEADERS_LIMIT, TARGET_BYTES
from lecombus.operations.operation_reports import WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.api_line import Line

pytestmark = [pytest.mark.anyio, pytest.mark.real]

GET = b"GET /readyz HTTP/1.1\r\nHost: localhost\r\n\r\n"
SETPOINT = "/v1/drives/feeder/codes/C0046"


def put(value: int, more: str = "") -> bytes:
    body = b'{"value": %d}' % value
    head = (
        f"PUT {SETPOINT} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}\r\n{more}\r\n"
    )
    return head.encode() + body


class Client:
    """A client that says bytes."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    async def say(self, data: bytes, *, end: bool = False) -> None:
        self.writer.write(data)
        if end:
            self.writer.write_eof()
        await self.writer.drain()

    async def answer(self) -> tuple[int, bytes]:
        """Read one answer; raises `IncompleteReadError` at the end."""
        head = (await self.reader.readuntil(b"\r\n\r\n")).lower()
        length = int(head.partition(b"content-length: ")[2].partition(b"\r\n")[0])
        return int(head.split()[1]), await self.reader.readexactly(length)

    async def rest(self) -> list[tuple[int, bytes]]:
        """Read every answer until the connection ends."""
        answers = []
        with contextlib.suppress(asyncio.IncompleteReadError):
            while True:
                answers.append(await self.answer())
        return answers


@asynccontextmanager
async def connected(line: Line, tmp_path: Path, *, tcp: bool = False) -> AsyncIterator[Client]:
    async with anyio.create_task_group() as tasks:
        served = await tasks.start(serve, line.app, tmp_path / "s", ("127.0.0.1", 0))
        if tcp:
            reader, writer = await asyncio.open_connection(*served.http)
        else:
            reader, writer = await asyncio.open_unix_connection(served.socket_path)
        with anyio.fail_after(15):
            yield Client(reader, writer)
        writer.close()
        tasks.cancel_scope.cancel()


def kind(answer: tuple[int, bytes]) -> tuple[int, str]:
    return answer[0], json.loads(answer[1])["type"].rpartition(":")[2]


@pytest.mark.parametrize("tcp", [False, True])
@pytest.mark.parametrize(
    "rubbish",
    [
        b"\x00\xff\x80 rubbish\r\n\r\n",
        b"BREW /pot HTTP/1.1\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET / HTTP/2.0\r\n\r\n",
        b"GET /v1/line HTTP/0.9\r\n\r\n",
        b"GET /v1/line\r\n\r\n",
        b"GET http://[/ HTTP/1.1\r\nHost: x\r\n\r\n",
        b"GET / HTTP/1.1\r\nContent-Length: minus\r\n\r\n",
        b"CONNECT localhost:80 HTTP/1.1\r\nHost: x\r\n\r\n",
    ],
)
async def test_what_came_whole_is_answered_and_then_the_rubbish_is_told(
    line: Line, tmp_path: Path, rubbish: bytes, tcp: bool
) -> None:
    async with connected(line, tmp_path, tcp=tcp) as client:
        await client.say(3 * GET + rubbish + GET)
        answers = await client.rest()
    assert [status for status, _ in answers] == [200, 200, 200, 400]
    assert kind(answers[-1]) == (400, "bad-http")


async def test_an_answer_is_dated_when_it_is_made_and_not_when_its_request_came(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 1_000_000_000.0
    monkeypatch.setattr("time.time", lambda: now_s)
    monkeypatch.setattr(
        lecombus.api.answers, "formatdate", lambda usegmt: formatdate(now_s, usegmt=usegmt)
    )
    line.ops.gate = anyio.Event()
    async with connected(line, tmp_path) as client:
        await client.say(put(7))
        await line.ops.begun.wait()
        now_s += 5.0
        line.ops.gate.set()
        head = await client.reader.readuntil(b"\r\n\r\n")
        assert head.lower().count(b"\r\ndate:") == 1
        assert f"date: {formatdate(now_s, usegmt=True)}\r\n".encode() in head
        await client.say(b"\x00rubbish\r\n\r\n")
        await client.reader.readuntil(b"HTTP/1.1 400")
        head = await client.reader.readuntil(b"\r\n\r\n")
        assert f"date: {formatdate(now_s, usegmt=True)}\r\n".encode() in head


async def test_rubbish_behind_a_write_that_is_under_way_does_not_cut_it(
    line: Line, tmp_path: Path
) -> None:
    line.ops.gate = anyio.Event()
    async with connected(line, tmp_path) as client:
        await client.say(put(7))
        await line.ops.begun.wait()
        await client.say(b"\x00rubbish\r\n\r\n")
        await anyio.sleep(0.02)
        line.ops.gate.set()
        answers = await client.rest()
    assert [status for status, _ in answers] == [200, 400]
    assert len(line.ops.asked) == 1


async def test_a_request_that_breaks_off_in_rubbish_is_not_carried_out(
    line: Line, tmp_path: Path
) -> None:
    head = f"PUT {SETPOINT} HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n".encode()
    async with connected(line, tmp_path) as client:
        await client.say(GET + head + b'c\r\n{"value": 7}\r\nrubbish\r\n')
        answers = await client.rest()
    assert [status for status, _ in answers] == [200, 400]
    assert line.ops.asked == []


@pytest.mark.parametrize("tcp", [False, True])
@pytest.mark.parametrize(
    ("endless", "says"),
    [
        (b"GET /" + b"x" * (HEAD_LIMIT + 1000), (414, "target-too-long")),
        (b"GET /" + b"x" * TARGET_BYTES + b" HTTP/1.1\r\n\r\n", (414, "target-too-long")),
        (b"GET / HTTP/1.1\r\nX: " + b"x" * (HEAD_LIMIT + 1000), (431, "head-too-big")),
        (b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * (HEADERS_LIMIT + 2), (431, "head-too-big")),
        (b"GET / HTTP/1.1\r\n" + b"a:\r\n" * 12000, (431, "head-too-big")),
        (
            b"GET / HTTP/1.1\r\nX: " + b"x" * (HEAD_LIMIT + 1000) + b"\r\n\r\n",
            (431, "head-too-big"),
        ),
        (b"GET /v1/line?" + b"a&" * 16 + b" HTTP/1.1\r\n\r\n", (400, "too-many-parameters")),
        (b"PUT /v1/x HTTP/1.1\r\nContent-Length: 8193\r\n\r\n", (413, "too-big")),
        (
            b"PUT /v1/drives/belt/codes/C0046 HTTP/1.1\r\nHost: localhost\r\n"
            b"Transfer-Encoding: chunked\r\n\r\n" + b"1\r\n \r\n" * (CHUNKED_LIMIT // 6 + 400),
            (413, "too-big"),
        ),
        (
            b"PUT /v1/drives/belt/codes/C0046 HTTP/1.1\r\nHost: localhost\r\n"
            b"Transfer-Encoding: chunked\r\n\r\n1\r\n{\r\n0\r\nX: " + b"x" * (CHUNKED_LIMIT + 500),
            (413, "too-big"),
        ),
    ],
)
async def test_a_request_ends_at_its_bounds_before_anything_of_it_is_decoded(
    line: Line, tmp_path: Path, endless: bytes, says: tuple[int, str], tcp: bool
) -> None:
    async with connected(line, tmp_path, tcp=tcp) as client:
        await client.say(GET + endless)
        answers = await client.rest()
    assert answers[0][0] == 200
    is_write = endless.startswith(b"PUT /v1/drives")
    assert kind(answers[-1]) == ((403, "read-only") if tcp and is_write else says)
    assert len(answers) == 2
    assert line.ops.asked == []


async def test_a_request_at_its_bounds_is_answered(line: Line, tmp_path: Path) -> None:
    query = b"priority=background&" + b"&".join(b"" for _ in range(15))
    head = b"GET " + SETPOINT.encode() + b"?" + query + b" HTTP/1.1\r\nHost: x\r\n"
    head += b"X: y\r\n" * (HEADERS_LIMIT - 1)
    async with connected(line, tmp_path) as client:
        await client.say(head + b"\r\n")
        assert (await client.answer())[0] == 200


async def test_a_body_that_was_answered_without_being_read_may_still_come_but_not_for_ever(
    line: Line, tmp_path: Path
) -> None:
    head = b"PUT /v1/nothing HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n"
    async with connected(line, tmp_path) as client:
        await client.say(head)
        assert (await client.answer())[0] == 404
        await client.say(b"1\r\nx\r\n0\r\n\r\n" + GET)
        assert (await client.answer())[0] == 200
        await client.say(head)
        assert (await client.answer())[0] == 404
        with contextlib.suppress(ConnectionError):
            while not client.reader.at_eof():
                await client.say(b"400\r\n" + b"x" * 1024 + b"\r\n")
                await asyncio.sleep(0)
        with contextlib.suppress(ConnectionError):
            assert await client.rest() == []


async def test_a_stop_whose_body_nobody_reads_goes_out_however_long_that_is(
    line: Line, tmp_path: Path
) -> None:
    stop = b"POST /v1/drives/feeder/verbs/quick-stop?" + b"a&" * 20 + b" HTTP/1.1\r\n"
    line.ops.gate = anyio.Event()
    async with connected(line, tmp_path) as client:
        await client.say(stop + b"Content-Length: 1000000\r\n\r\n")
        await line.ops.begun.wait()
        await client.say(b"x" * (CHUNKED_LIMIT + 3000))
        line.ops.gate.set()
        answers = await client.rest()
    assert [status for status, _ in answers] == [200]
    assert [one[0] for one in line.ops.asked] == ["verb"]


async def test_a_head_just_below_the_limit_is_taken(line: Line, tmp_path: Path) -> None:
    async with connected(line, tmp_path) as client:
        long = b"GET /readyz HTTP/1.1\r\nHost: x\r\nX: " + b"x" * (HEAD_LIMIT - 100) + b"\r\n\r\n"
        await client.say(2 * long)
        assert [(await client.answer())[0] for _ in range(2)] == [200, 200]


async def test_requests_beyond_the_limit_wait_unread_and_none_is_lost(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[HttpConnection] = []
    plain = HttpConnection.connection_made

    def connection_made(self: HttpConnection, transport: asyncio.Transport) -> None:
        made.append(self)
        plain(self, transport)

    monkeypatch.setattr(HttpConnection, "connection_made", connection_made)
    line.ops.gate = anyio.Event()
    count = 300
    async with connected(line, tmp_path) as client:
        await client.say(b"".join(put(n) for n in range(count)))
        await line.ops.begun.wait()
        await anyio.sleep(0.05)
        assert made[0]._pending == PENDING_LIMIT
        held = len(made[0]._unread)
        assert held > 0
        line.ops.gate.set()
        statuses = [(await client.answer())[0] for _ in range(count)]
        assert statuses == [200] * count
        assert [asked[3] for asked in line.ops.asked] == list(range(count))
        await client.say(GET)
        assert (await client.answer())[0] == 200


async def test_the_loop_turns_between_the_answers_of_a_flood_and_others_are_served(
    line: Line, tmp_path: Path
) -> None:
    """Between any two answers the line may speak: the worker waits for nothing but the loop."""
    page, each, floods = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n", 100, 8
    turns = reads = 0
    ended: list[int] = []

    async def count_turns() -> None:
        nonlocal turns
        while len(ended) < floods:
            turns += 1
            await asyncio.sleep(0)

    async def flood(client: Client) -> None:
        statuses = [(await client.answer())[0] for _ in range(each)]
        assert statuses == [200] * each
        ended.append(turns)
        client.writer.close()
        await client.writer.wait_closed()

    async with connected(line, tmp_path) as looking, anyio.create_task_group() as tasks:
        for _ in range(floods):
            reader, writer = await asyncio.open_unix_connection(tmp_path / "s")
            client = Client(reader, writer)
            await client.say(page * each)
            tasks.start_soon(flood, client)
        tasks.start_soon(count_turns)
        while len(ended) < floods:
            await looking.say(GET)
            assert (await looking.answer())[0] == 200
            reads += len(ended) < floods
    assert turns >= floods * each
    assert reads >= each / 2, "whoever asks once is not behind those who ask again and again"


@pytest.mark.parametrize("tcp", [False, True])
@pytest.mark.parametrize("count", [1, 3, 40])
async def test_a_client_that_says_no_more_gets_every_answer(
    line: Line, tmp_path: Path, count: int, tcp: bool
) -> None:
    async with connected(line, tmp_path, tcp=tcp) as client:
        await client.say(count * GET, end=True)
        answers = await client.rest()
    assert [status for status, _ in answers] == [200] * count


async def test_a_client_that_says_no_more_gets_the_outcome_of_its_write(
    line: Line, tmp_path: Path
) -> None:
    line.ops.gate = anyio.Event()
    async with connected(line, tmp_path) as client:
        await client.say(put(7) + b"PUT / HTTP/1.1\r\nContent-Length: 10\r\n\r\n{", end=True)
        await line.ops.begun.wait()
        await anyio.sleep(0.02)
        line.ops.gate.set()
        answers = await client.rest()
    assert [status for status, _ in answers] == [200], "the second did not come whole"


@pytest.mark.parametrize("what", ["h2c", "websocket"])
async def test_an_offer_to_speak_another_protocol_is_ignored_and_its_body_kept(
    line: Line, tmp_path: Path, what: str
) -> None:
    offer = (
        f"Connection: Upgrade, HTTP2-Settings\r\nUpgrade: {what}\r\nHTTP2-Settings: AAMAAABk\r\n"
    )
    async with connected(line, tmp_path) as client:
        look = GET.replace(b"\r\n\r\n", b"\r\n" + offer.encode() + b"\r\n")
        await client.say(put(7, offer) + look + put(8, offer) + GET)
        assert [(await client.answer())[0] for _ in range(4)] == [200] * 4
    assert [asked[3] for asked in line.ops.asked] == [7, 8]


@pytest.mark.parametrize("tcp", [False, True])
async def test_a_connect_is_answered_once_and_ends_the_connection(
    line: Line, tmp_path: Path, tcp: bool
) -> None:
    tunnel = b"CONNECT /v1/line HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n\r\n"
    async with connected(line, tmp_path, tcp=tcp) as client:
        await client.say(GET + tunnel + GET)
        answers = [status for status, _ in await client.rest()]
    assert answers == [200, 403 if tcp else 405]


@pytest.mark.parametrize(
    ("target", "status"),
    [
        ("http://localhost/v1/line", 200),
        ("http://127.0.0.1:9740/v1/line", 200),
        ("http://[::1]/v1/line", 200),
        ("http://evil.example/v1/line", 421),
        ("http://evil.example:80/v1/line", 421),
    ],
)
async def test_the_host_of_an_absolute_target_counts(
    line: Line, tmp_path: Path, target: str, status: int
) -> None:
    async with connected(line, tmp_path, tcp=True) as client:
        await client.say(f"GET {target} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        assert (await client.answer())[0] == status


@pytest.mark.parametrize("first", [b"GET /v1/line\r\n\r\n", b"POST /v1/stop HTTP/0.9\r\n\r\n"])
@pytest.mark.parametrize("tcp", [False, True])
async def test_a_request_without_http_1_is_refused(
    line: Line, tmp_path: Path, first: bytes, tcp: bool
) -> None:
    async with connected(line, tmp_path, tcp=tcp) as client:
        await client.say(first)
        answers = await client.rest()
    assert [kind(one) for one in answers] == [(400, "bad-http")]
    assert line.ops.asked == []


async def test_http_1_0_is_answered(line: Line, tmp_path: Path) -> None:
    async with connected(line, tmp_path) as client:
        await client.say(b"GET /readyz HTTP/1.0\r\nHost: localhost\r\n\r\n")
        assert (await client.answer())[0] == 200


@pytest.mark.parametrize(
    ("header", "is_foreign"),
    [
        ("Origin: http://evil.example", True),
        ("Origin: null", True),
        ("Origin: http://localhost:8080", True),
        ("Sec-Fetch-Site: cross-site", True),
        ("Sec-Fetch-Site: same-site", True),
        ("Origin: http://localhost", False),
        ("Origin: https://LOCALHOST", False),
        ("Sec-Fetch-Site: same-origin", False),
    ],
)
@pytest.mark.parametrize("is_stop", [False, True])
async def test_a_web_page_of_another_origin_is_refused_over_the_unix_socket_too(
    line: Line, tmp_path: Path, header: str, is_foreign: bool, is_stop: bool
) -> None:
    body = b'{"action": "inhibit", "target": "all"}' if is_stop else b""
    first = "POST /v1/stop" if is_stop else "GET /v1/line"
    head = f"{first} HTTP/1.1\r\nHost: localhost\r\n{header}\r\nContent-Length: {len(body)}\r\n"
    async with connected(line, tmp_path) as client:
        await client.say(head.encode() + b"\r\n" + body)
        answer = await client.answer()
    if is_foreign:
        assert kind(answer) == (403, "cross-site")
    else:
        assert answer[0] == 200
    assert bool(line.ops.asked) is (is_stop and not is_foreign)


@pytest.mark.parametrize("host", ["evil.example", "lecombus", "10.0.0.1:80"])
async def test_over_the_unix_socket_any_host_may_be_named(
    line: Line, tmp_path: Path, host: str
) -> None:
    async with connected(line, tmp_path) as client:
        await client.say(f"GET /readyz HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        assert (await client.answer())[0] == 200


async def test_head_is_answered_wherever_get_is(line: Line, tmp_path: Path) -> None:
    paths = ("/v1/line", "/v1/drives", "/v1/drives/feeder", SETPOINT, "/openapi.json", "/metrics")
    async with connected(line, tmp_path) as client:
        for path in paths:
            await client.say(f"HEAD {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
            head = await client.reader.readuntil(b"\r\n\r\n")
            assert head.startswith(b"HTTP/1.1 200"), path
            await client.say(GET)  # no body is left in between
            assert (await client.answer())[0] == 200


async def test_a_connection_that_was_reset_leaves_nothing_behind(
    line: Line, tmp_path: Path
) -> None:
    async with connected(line, tmp_path, tcp=True) as client:
        await client.say(GET)
        await client.answer()
        raw = client.writer.get_extra_info("socket")
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.writer.transport.abort()  # with a reset instead of an end
        for _ in range(100):
            await anyio.sleep(0.01)
            gc.collect()
            alive = [one for one in gc.get_objects() if isinstance(one, HttpConnection)]
            if not alive:
                break
        assert alive == [], "its timer would keep it for a minute"


@pytest.mark.parametrize("closed", [True, False])
async def test_a_write_whose_client_has_gone_before_it_is_read_is_not_carried_out(
    line: Line, tmp_path: Path, closed: bool
) -> None:
    async with connected(line, tmp_path) as client:
        with socket.socket(socket.AF_UNIX) as asking:  # the loop does not run meanwhile
            asking.connect(str(tmp_path / "s"))
            asking.sendall(put(7))
            if closed:
                asking.close()
            else:
                asking.shutdown(socket.SHUT_WR)
            await client.say(GET)
            await client.answer()
            await anyio.sleep(0.05)
    assert len(line.ops.asked) == (0 if closed else 1)


@pytest.mark.parametrize("end", ["close", "half", "nothing"])
@pytest.mark.parametrize("held_back", [False, True])
async def test_a_write_that_waits_can_be_seen_to_have_lost_its_client(
    line: Line, tmp_path: Path, end: str, held_back: bool
) -> None:
    """Also where the client sent more than is read while the write waits."""
    line.ops.gate = anyio.Event()
    async with connected(line, tmp_path) as client:
        with socket.socket(socket.AF_UNIX) as asking:
            asking.setblocking(False)
            asking.connect(str(tmp_path / "s"))
            asking.sendall(put(7) + (GET * 40 if held_back else b""))
            await line.ops.begun.wait()
            assert line.ops.is_gone is not None
            assert not line.ops.is_gone(), "a kept connection is there"
            if end == "close":
                asking.close()
            elif end == "half":
                asking.shutdown(socket.SHUT_WR)
            await client.say(GET)
            await client.answer()
            assert line.ops.is_gone() is (end == "close")
            line.ops.gate.set()
            await anyio.sleep(0.02)


async def test_who_repeats_a_write_whose_first_client_left_is_the_next_first(
    line: Line, tmp_path: Path
) -> None:
    def report(drive: str, code: Code) -> WriteReport:
        gone = line.ops.is_gone is not None and line.ops.is_gone()
        if gone:
            return WriteReport(drive, code, Outcome.REFUSED, "it left", kind="client-gone")
        return WriteReport(drive, code, Outcome.DONE)

    line.ops.report = report
    line.ops.gate = anyio.Event()
    key = "Idempotency-Key: k\r\n"
    async with connected(line, tmp_path) as client:
        with socket.socket(socket.AF_UNIX) as asking:
            asking.setblocking(False)
            asking.connect(str(tmp_path / "s"))
            asking.sendall(put(7, key))
            await line.ops.begun.wait()
        await client.say(put(7, key))
        await anyio.sleep(0.05)
        assert len(line.ops.asked) == 1, "it waits for the first one's end"
        line.ops.gate.set()
        assert (await client.answer())[0] == 200
        assert len(line.ops.asked) == 2
