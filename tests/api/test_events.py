"""`GET /v1/events` over real sockets: who reads gets what happens, who does not read is cut."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import anyio
import httpx2
import pytest
from starlette.types import Message, Receive, Scope, Send

from lecombus.api import event_readers, serve
from lecombus.api.event_readers import BYTES_AT_ONCE, Reader
from lecombus.api.limits import ConnectionPlaces
from lecombus.event_stream import BYTES_LIMIT
from lecombus.operations.actions import ACTOR
from lecombus.operations.operation_reports import GroupFacts
from lecombus.parameters import Json
from lecombus.tokens import grants
from support.api_line import Line
from support.guarded_door import guarded_door

pytestmark = [pytest.mark.anyio, pytest.mark.real]

EVENTS = "/v1/events"


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_readers, "ROUND_S", 0.005)
    monkeypatch.setattr(event_readers, "HALF_CLOSED_IDLE_S", 0.02)


@dataclass(frozen=True)
class Frame:
    """One server-sent event as a browser takes it."""

    id: str
    kind: str
    data: Json


class Client:
    """One connection that reads events."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer
        self.last_id = ""
        self.comments = 0
        self._text = ""

    async def open(self, query: str = "", *headers: str, method: str = "GET") -> bytes:
        """Ask for events; gives the head of the answer."""
        rows = (f"{method} {EVENTS}{query} HTTP/1.1", "Host: localhost", *headers, "", "")
        self.writer.write("\r\n".join(rows).encode())
        return await self.reader.readuntil(b"\r\n\r\n")

    async def piece(self) -> str:
        """One chunk of the answer; empty at its end."""
        size = int(await self.reader.readline(), 16)
        return (await self.reader.readexactly(size + 2))[:-2].decode()

    async def next(self) -> Frame:
        """The next event, as the WHATWG's rules for an event stream say."""
        while True:
            while "\n\n" not in self._text:
                piece = await self.piece()
                assert piece, "the answer ended"
                self._text += piece
            block, _, self._text = self._text.partition("\n\n")
            fields: dict[str, str] = {}
            for row in block.split("\n"):
                name, _, value = row.partition(":")
                fields[name] = value.removeprefix(" ")
                self.comments += not name
            self.last_id = fields.get("id", self.last_id)
            if "data" in fields:
                return Frame(self.last_id, fields["event"], json.loads(fields["data"]))

    async def until_open(self) -> None:
        """Read to the id that the answer begins with."""
        while not self.last_id:
            self._text += await self.piece()
            for row in self._text.split("\n"):
                if row.startswith("id: "):
                    self.last_id = row[4:]


Connect = Callable[[], Awaitable[Client]]


@asynccontextmanager
async def serving(line: Line, tmp_path: Path, *, tcp: bool = False) -> AsyncIterator[Connect]:
    """Serve a line; gives what connects a client to it."""
    writers: list[asyncio.StreamWriter] = []

    async with anyio.create_task_group() as tasks:
        served = await tasks.start(serve, line.app, tmp_path / "s", ("127.0.0.1", 0))
        tasks.start_soon(line.readers.run)

        async def connect() -> Client:
            streams = (
                asyncio.open_connection(*served.http) if tcp
                else asyncio.open_unix_connection(served.socket_path)
            )  # fmt: skip
            reader, writer = await streams
            writers.append(writer)
            return Client(reader, writer)

        with anyio.fail_after(20):
            yield connect
        for writer in writers:
            writer.close()
        tasks.cancel_scope.cancel()


async def until(condition: Callable[[], bool]) -> None:
    while not condition():  # noqa: ASYNC110 - what is waited for is another program's state
        await asyncio.sleep(0.005)


def held_readers() -> list[Reader]:
    """Readers that take memory."""
    gc.collect()
    return [one for one in gc.get_objects() if isinstance(one, Reader)]


def publish(line: Line, count: int, *, kind: str = "value", drive: str = "feeder") -> None:
    for number in range(count):
        line.events.publish(kind, drive, {"n": number})


@pytest.mark.parametrize("tcp", [False, True])
async def test_events_come_as_they_happen(line: Line, tmp_path: Path, tcp: bool) -> None:
    async with serving(line, tmp_path, tcp=tcp) as connect:
        client = await connect()
        head = await client.open()
        assert head.startswith(b"HTTP/1.1 200")
        assert b"content-type: text/event-stream\r\n" in head
        assert b"cache-control: no-store\r\n" in head
        await client.until_open()
        publish(line, 1)
        first = await client.next()
        assert (first.kind, first.data) == ("value", {"n": 0})
        publish(line, 2, kind="trip")
        assert [(await client.next()).kind for _ in range(2)] == ["trip", "trip"]
        assert line.events.readers == 1
        client.writer.close()
        publish(line, 1)
        await until(lambda: not len(line.readers))


@pytest.mark.parametrize("way", ["header", "query", "both"])
async def test_who_comes_back_gets_what_it_missed(line: Line, tmp_path: Path, way: str) -> None:
    async with serving(line, tmp_path) as connect:
        client = await connect()
        await client.open()
        await client.until_open()
        publish(line, 1)
        last = (await client.next()).id
        client.writer.close()
        await until(lambda: not len(line.readers))
        publish(line, 3)
        again = await connect()
        query = {"header": "", "query": f"?last_event_id={last}", "both": "?last_event_id=run-2"}
        headers = [] if way == "query" else [f"Last-Event-ID: {last}"]
        await again.open(query[way], *headers)
        assert [(await again.next()).data for _ in range(3)] == [{"n": n} for n in range(3)]


async def test_who_has_had_no_event_can_come_back_all_the_same(line: Line, tmp_path: Path) -> None:
    async with serving(line, tmp_path) as connect:
        client = await connect()
        await client.open()
        await client.until_open()
        client.writer.close()
        publish(line, 1)
        again = await connect()
        await again.open("", f"Last-Event-ID: {client.last_id}")
        assert (await again.next()).data == {"n": 0}


async def test_what_cannot_be_given_is_a_gap(line: Line, tmp_path: Path) -> None:
    async with serving(line, tmp_path) as connect:
        client = await connect()
        await client.open("?kind=trip&drive=belt", "Last-Event-ID: other-5")
        gap = await client.next()
        assert gap.kind == "gap"
        assert isinstance(gap.data, dict)
        assert gap.data["missed"] is None
        publish(line, 1, kind="trip", drive="belt")
        assert (await client.next()).kind == "trip"


async def test_a_filter_by_drive_group_and_kind(line: Line, tmp_path: Path) -> None:
    async with serving(line, tmp_path) as connect:
        wanted = {"?drive=belt": [1, 3], "?drive=feeder,belt&kind=value": [0, 1],
                  "?drive=conveyors": [0, 1, 2, 3], "?kind=line,trip": [2, 3]}  # fmt: skip
        clients = {query: await connect() for query in wanted}
        for query, client in clients.items():
            await client.open(query)
            await client.until_open()
        line.events.publish("value", "feeder", {"n": 0})
        line.events.publish("value", "belt", {"n": 1})
        line.events.publish("trip", "feeder", {"n": 2})
        line.events.publish("line", "", {"n": 3})
        for query, client in clients.items():
            got = [(await client.next()).data for _ in wanted[query]]
            assert got == [{"n": number} for number in wanted[query]], query


async def test_an_answer_ends_when_a_reload_changes_the_group_that_it_is_about(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The client comes back with its last id, and reads of the drives that the group has now."""
    monkeypatch.setattr(event_readers, "LOOK_S", 0.02)
    async with serving(line, tmp_path) as connect:
        client, other = await connect(), await connect()
        await client.open("?drive=conveyors")
        await other.open("?drive=feeder")
        await client.until_open()
        await other.until_open()
        publish(line, 1)
        assert (await client.next()).data == {"n": 0}
        monkeypatch.setattr(line.ops, "groups", lambda: (GroupFacts("conveyors", ("belt",), None),))
        await until(lambda: len(line.readers) == 1)
        publish(line, 1)
        line.events.publish("value", "belt", {"n": 0, "of": "belt"})
        assert await client.piece() == ""
        again = await connect()
        await again.open(f"?drive=conveyors&last_event_id={client.last_id}")
        assert (await again.next()).data == {"n": 0, "of": "belt"}


async def test_a_token_for_a_group_sees_no_drive_that_a_reload_took_out_of_it(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_readers, "LOOK_S", 0.02)
    async with guarded_door(line, tmp_path) as door:
        await door.give("reader", "read", targets=("conveyors",))
        async with door.client("reader") as client, client.stream("GET", EVENTS) as answer:
            parts = answer.aiter_text()
            await anext(parts)
            monkeypatch.setattr(
                line.ops, "groups", lambda: (GroupFacts("conveyors", ("belt",), None),)
            )
            await until(lambda: not len(line.readers))
            publish(line, 1)
            assert "feeder" not in "".join([part async for part in parts])


@pytest.mark.parametrize(
    ("query", "status", "said"),
    [
        ("?kind=stat", 422, "did you mean state?"),
        ("?drive=feedr", 404, "did you mean feeder?"),
        ("?drvie=feeder", 422, "did you mean drive?"),
        ("?drive=feeder&drive=belt", 422, "give it once"),
    ],
)
async def test_a_wrong_query_is_refused(
    client: httpx2.AsyncClient, query: str, status: int, said: str
) -> None:
    answer = await client.get(f"{EVENTS}{query}")
    assert (answer.status_code, answer.json()["remedy"]) == (status, said)


async def test_head_has_no_events(client: httpx2.AsyncClient, line: Line) -> None:
    answer = await client.head(EVENTS)
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/event-stream"
    assert line.events.readers == 0


async def test_a_token_for_some_drives_sees_only_these(line: Line, tmp_path: Path) -> None:
    granted = grants.granted([grants.Scope.READ], ["belt"])
    app = line.app

    async def limited(scope: object, receive: object, send: object) -> None:
        ACTOR.set(replace(ACTOR.get(), grant=granted))
        await app(scope, receive, send)  # type: ignore[arg-type]

    line.app = limited  # type: ignore[assignment]
    async with serving(line, tmp_path) as connect:
        assert (await (await connect()).open("?drive=feeder")).startswith(b"HTTP/1.1 403")
        client = await connect()
        await client.open()
        await client.until_open()
        line.events.publish("value", "feeder", {"n": 0})
        line.events.publish("write", "", {"n": 1}, ("feeder", "belt"))
        line.events.publish("value", "belt", {"n": 2})
        line.events.publish("line", "", {"n": 3})
        assert [(await client.next()).data for _ in range(2)] == [{"n": 2}, {"n": 3}]


async def test_an_answer_ends_when_its_client_may_read_no_more(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the door for tokens does it: `send` ends the answer, and raises."""
    monkeypatch.setattr(event_readers, "LOOK_S", 0.02)
    app, revoked = line.app, asyncio.Event()

    async def by_token(scope: Scope, receive: Receive, send: Send) -> None:
        async def send_while_valid(message: Message) -> None:
            if message.get("more_body") and revoked.is_set():
                await send({"type": "http.response.body", "body": b"", "more_body": False})
                raise asyncio.CancelledError
            await send(message)

        with contextlib.suppress(asyncio.CancelledError):
            await app(scope, receive, send_while_valid)

    line.app = by_token  # type: ignore[assignment]
    async with serving(line, tmp_path, tcp=True) as connect:
        client = await connect()
        await client.open()
        await client.until_open()
        publish(line, 1)
        assert (await client.next()).data == {"n": 0}
        revoked.set()
        await until(lambda: not len(line.readers))
        publish(line, 1)
        assert await client.piece() == ""


async def test_an_idle_connection_carries_comments_and_its_place(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_readers, "IDLE_S", 0.02)
    async with serving(line, tmp_path) as connect:
        client = await connect()
        await client.open("?kind=trip")
        await client.until_open()
        publish(line, 5)
        last = f"run-{line.events.next - 1}"
        while client.last_id != last:
            for row in (await client.piece()).split("\n"):
                if row.startswith("id: "):
                    client.last_id = row[4:]


async def test_a_reader_that_takes_nothing_is_cut_and_the_others_go_on(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_readers, "STALLED_S", 0.3)
    async with serving(line, tmp_path) as connect:
        silent, reading = await connect(), await connect()
        await silent.open()
        silent.reader._limit = 1  # type: ignore[attr-defined]  # asyncio reads no more than it must
        await reading.open()
        taken = 0

        async def read() -> None:
            nonlocal taken
            while True:
                await reading.next()
                taken += 1

        task = asyncio.create_task(read())
        while line.events.dropped == 0:
            line.events.publish("value", "feeder", {"text": "x" * 2000})
            await asyncio.sleep(0.001)
        assert len(line.readers) == 1
        count = line.events.published["value"]
        await until(lambda: taken == count)
        task.cancel()


async def test_a_reader_behind_the_oldest_event_is_cut_and_comes_back_to_a_gap(
    line: Line, tmp_path: Path
) -> None:
    async with serving(line, tmp_path) as connect:
        client = await connect()
        await client.open()
        await client.until_open()
        line.events._events_limit = 10
        publish(line, 30)  # at once, before the reader's turn
        await until(lambda: line.events.dropped == 1)
        assert await client.reader.read() == b""
        again = await connect()
        await again.open("", f"Last-Event-ID: {client.last_id}")
        gap = await again.next()
        assert (gap.kind, gap.data["missed"]) == ("gap", 20)  # type: ignore[index,call-overload]
        assert (await again.next()).data == {"n": 20}


async def test_two_hundred_readers_of_which_fifty_read_nothing_stay_within_bounds(
    line: Line, tmp_path: Path
) -> None:
    """Each of the others gets every event; what is held for all is bounded."""
    async with serving(line, tmp_path) as connect:
        clients = [await connect() for _ in range(200)]
        for number, client in enumerate(clients):
            await client.open()
            await client.until_open()
            if number % 4 == 0:
                client.reader._limit = 1  # type: ignore[attr-defined]
        readers = tuple(line.readers._readers)
        assert len(readers) == 200
        held: list[int] = []

        async def read(client: Client) -> None:
            for number in range(200):
                frame = await client.next()
                assert isinstance(frame.data, dict)
                assert frame.data["n"] == number

        async with anyio.create_task_group() as tasks:
            for number, client in enumerate(clients):
                if number % 4:
                    tasks.start_soon(read, client)
            for number in range(200):
                line.events.publish("value", "feeder", {"n": number, "text": "x" * 500})
                if number % 20 == 0:
                    await asyncio.sleep(0.02)
                    held.append(max(one.outlet.backlog for one in readers))
                    assert line.events.kept_bytes <= BYTES_LIMIT
        assert max(held) <= 2 * BYTES_AT_ONCE
        assert line.events.published["value"] == 200
        for client in clients:
            client.writer.close()
        await until(lambda: not len(line.readers))
        del readers
        await until(lambda: not held_readers())


@pytest.mark.parametrize("tcp", [False, True])
async def test_there_are_only_so_many_readers(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tcp: bool
) -> None:
    monkeypatch.setattr(event_readers, "TCP_READERS_LIMIT" if tcp else "READERS_LIMIT", 3)
    async with serving(line, tmp_path, tcp=tcp) as connect:
        clients = [await connect() for _ in range(4)]
        heads = [await client.open() for client in clients]
        assert [head[9:12] for head in heads] == [b"200", b"200", b"200", b"503"]
        assert b"retry-after: 5" in heads[-1].lower()
        clients[0].writer.close()
        publish(line, 1)
        await until(lambda: len(line.readers) == 2)
        assert (await (await connect()).open()).startswith(b"HTTP/1.1 200")


async def test_readers_take_no_place_of_those_who_ask(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_readers, "READERS_LIMIT", 300)
    async with serving(line, tmp_path) as connect:
        for _ in range(260):  # more than requests may be under way
            await (await connect()).open()
        asking = await connect()
        asking.writer.write(b"GET /readyz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert (await asking.reader.readline()).startswith(b"HTTP/1.1 200")


async def test_a_reader_makes_room_when_there_is_no_connection_left(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = ConnectionPlaces.__init__
    monkeypatch.setattr(ConnectionPlaces, "__init__", lambda self, *limits: made(self, 3))
    async with serving(line, tmp_path) as connect:
        clients = [await connect() for _ in range(3)]
        for client in clients:
            await client.open()
        stopping = await connect()
        stopping.writer.write(
            b"POST /v1/stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 40\r\n\r\n"
            b'{"action": "inhibit", "target": "all"}  '
        )
        assert (await stopping.reader.readline()).startswith(b"HTTP/1.1 200")
        await until(lambda: len(line.readers) == 2)


@pytest.mark.parametrize("tcp", [False, True])
async def test_answers_end_in_order_when_lecombus_ends(
    line: Line, tmp_path: Path, tcp: bool
) -> None:
    async with serving(line, tmp_path, tcp=tcp) as connect:
        client = await connect()
        await client.open()
        await client.until_open()
        publish(line, 1, kind="write")
        line.readers.close()
        assert (await client.next()).kind == "write"
        assert await client.piece() == ""
        assert len(line.readers) == 0
        again = await connect()
        await again.open()
        assert await again.piece() == ""


async def test_recording_ends_some_time_after_the_last_reader(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_readers, "KEPT_S", 0.05)
    async with serving(line, tmp_path) as connect:
        client = await connect()
        await client.open()
        await client.until_open()
        client.writer.close()
        publish(line, 1)
        await until(lambda: not len(line.readers))
        await until(lambda: not line.events.is_recording)
        again = await connect()
        await again.open("", f"Last-Event-ID: {client.last_id}")
        assert (await again.next()).kind == "gap"
