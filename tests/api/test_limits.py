"""Many clients at once: bounded, and never in the way of a stop."""

from __future__ import annotations

import asyncio
import resource
import socket
from collections import deque
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from types import SimpleNamespace

import anyio
import anyio.lowlevel
import httpx2
import pytest
from anyio.abc import SocketStream

from lecombus.api import limits, serve
from lecombus.api.connection import HttpConnection
from support.api_line import Line

pytestmark = [pytest.mark.anyio, pytest.mark.real]

SETPOINT = "/v1/drives/feeder/codes/C0046"
STOP = {"action": "inhibit", "target": "all"}
LIMIT = 4


@asynccontextmanager
async def serving(
    line: Line, path: Path, http: tuple[str, int] | None = None
) -> AsyncIterator[httpx2.AsyncClient]:
    transport = httpx2.AsyncHTTPTransport(uds=str(path))
    async with (
        anyio.create_task_group() as tasks,
        httpx2.AsyncClient(transport=transport, base_url="http://lecombus") as client,
    ):
        served = await tasks.start(serve, line.app, path, http)
        client.headers["x-port"] = str(served.http[1] if served.http else 0)
        yield client
        tasks.cancel_scope.cancel()


async def test_waiting_writes_refuse_further_ones_but_no_look_at_the_store_and_no_stop(
    line: Line,
) -> None:
    behind = limits.RequestLimiter(line.app, LIMIT)
    transport = httpx2.ASGITransport(app=behind)
    line.ops.gate = anyio.Event()
    async with (
        httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client,
        anyio.create_task_group() as waiting,
    ):
        for _ in range(LIMIT):
            waiting.start_soon(write, client)
        while len(line.ops.asked) < LIMIT:
            await anyio.lowlevel.checkpoint()
        refused = await client.put(SETPOINT, json={"value": 2})
        assert refused.status_code == 503
        assert refused.json()["type"] == "urn:lecombus:problem:queue-full"
        assert refused.headers["retry-after"] == "1"
        assert (await client.get(SETPOINT, params={"fresh": "true"})).status_code == 503
        assert (await client.get(SETPOINT)).status_code == 200
        lease = {"targets": ["feeder"], "time": "1s", "counter": 1}
        assert (await client.put("/v1/leases/plc", json=lease)).status_code == 200
        line.ops.gate.set()
        assert (await client.post("/v1/stop", json=STOP)).status_code == 200
    assert [one[0] for one in line.ops.asked] == ["write"] * LIMIT + ["stop"]


async def test_what_ended_makes_room_again(line: Line) -> None:
    transport = httpx2.ASGITransport(app=limits.RequestLimiter(line.app, 1))
    async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client:
        for _ in range(3):
            assert (await client.put(SETPOINT, json={"value": 1})).status_code == 200


async def test_connections_held_for_nothing_do_not_keep_out_a_stop(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "CONNECTION_LIMIT", LIMIT)
    path = tmp_path / "s"
    async with serving(line, path) as client, AsyncExitStack() as held:
        idle: list[SocketStream] = []
        for _ in range(3 * LIMIT):
            stream = await anyio.connect_unix(str(path))
            idle.append(await held.enter_async_context(stream))
        assert (await client.post("/v1/stop", json=STOP)).status_code == 200
        with pytest.raises(anyio.EndOfStream):  # the one held longest was closed
            await idle[0].receive()


async def test_looking_over_tcp_never_takes_a_place_from_the_unix_socket(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "CONNECTION_LIMIT", LIMIT)
    path = tmp_path / "s"
    async with serving(line, path, ("127.0.0.1", 0)) as client, AsyncExitStack() as held:
        mine = await held.enter_async_context(await anyio.connect_unix(str(path)))
        looking = []
        for _ in range(3 * LIMIT):
            stream = await anyio.connect_tcp("127.0.0.1", int(client.headers["x-port"]))
            looking.append(await held.enter_async_context(stream))
        with anyio.fail_after(15):
            for stream in looking[: 2 * LIMIT]:
                with pytest.raises((anyio.EndOfStream, anyio.BrokenResourceError)):
                    await stream.receive()
            await mine.send(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
            assert (await mine.receive()).startswith(b"HTTP/1.1 200")
            assert (await client.post("/v1/stop", json=STOP)).status_code == 200


class Wire(asyncio.Transport):
    """A transport that remembers being cut; closing it takes for ever."""

    def __init__(self, family: socket.AddressFamily) -> None:
        super().__init__()
        self._family = family
        self.cut = 0

    def get_extra_info(self, name: str, default: object = None) -> object:
        return SimpleNamespace(family=self._family) if name == "socket" else default

    def abort(self) -> None:
        self.cut += 1


def taken(
    places: limits.ConnectionPlaces,
    wire: Wire,
    *,
    busy: bool = False,
    address: str = "127.0.0.1",
    known: bool = False,
) -> HttpConnection:
    one = HttpConnection.__new__(HttpConnection)
    one.client, one.is_known = (address, 5000), known
    one.transport = wire
    one.pipeline = deque()
    one.is_local = wire.get_extra_info("socket") == SimpleNamespace(family=socket.AF_UNIX)
    one._running = SimpleNamespace(response_complete=not busy, more_body=False)
    places.take(one)
    return one


async def test_a_connection_that_is_being_closed_is_not_chosen_again() -> None:
    places = limits.ConnectionPlaces(2)
    wires = [Wire(socket.AF_UNIX) for _ in range(5)]
    for wire in wires:
        taken(places, wire)
    assert [wire.cut for wire in wires] == [1, 1, 1, 0, 0]


async def test_a_place_is_found_for_the_unix_socket_even_when_all_are_busy() -> None:
    places = limits.ConnectionPlaces(3)
    unix, tcp, late, stopping = (
        Wire(socket.AF_UNIX), Wire(socket.AF_INET), Wire(socket.AF_INET6), Wire(socket.AF_UNIX),
    )  # fmt: skip
    for wire in (unix, tcp, late, stopping):
        taken(places, wire, busy=True)
    assert [wire.cut for wire in (unix, tcp, late, stopping)] == [0, 1, 0, 0]
    one_more = Wire(socket.AF_INET)
    taken(places, one_more)
    assert one_more.cut == 1


async def test_a_flood_from_one_address_takes_no_place_from_others() -> None:
    places = limits.ConnectionPlaces(100, 4)
    quiet, plc = Wire(socket.AF_INET), Wire(socket.AF_INET)
    taken(places, plc, address="192.0.2.1", known=True)
    taken(places, quiet, address="192.0.2.2")
    flood = [Wire(socket.AF_INET) for _ in range(20)]
    for wire in flood:
        taken(places, wire, address="192.0.2.66")
    assert (quiet.cut, plc.cut) == (0, 0)
    assert sum(wire.cut for wire in flood) == 18


async def test_a_client_with_a_valid_token_keeps_its_place_beside_many_addresses() -> None:
    places = limits.ConnectionPlaces(100, 4)
    plc, again = Wire(socket.AF_INET), Wire(socket.AF_INET)
    taken(places, plc, address="192.0.2.1", known=True)
    taken(places, again, address="192.0.2.1", known=True)
    for number in range(20):
        taken(places, Wire(socket.AF_INET), address=f"192.0.2.{number + 10}")
    assert (plc.cut, again.cut) == (0, 0)


@pytest.mark.parametrize(
    ("files", "limit"),
    [(64, 8), (256, 64), (1024, 640), (1 << 20, 640), (resource.RLIM_INFINITY, 640)],
)
def test_the_limit_leaves_open_files_for_the_line(
    monkeypatch: pytest.MonkeyPatch, files: int, limit: int
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (files, files))
    assert limits.connection_limit() == limit


async def write(client: httpx2.AsyncClient) -> None:
    assert (await client.put(SETPOINT, json={"value": 1})).status_code == 200
