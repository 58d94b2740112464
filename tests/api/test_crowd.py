"""Many clients at once: bounded, and never in the way of a stop."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import anyio
import anyio.lowlevel
import httpx
import pytest
from anyio.abc import SocketStream

from lecombus.api import crowd, serve
from support.api_line import Line

pytestmark = [pytest.mark.anyio, pytest.mark.real]

SETPOINT = "/v1/drives/feeder/codes/C0046"
STOP = {"action": "inhibit", "target": "all"}
LIMIT = 4


@asynccontextmanager
async def serving(line: Line, path: Path) -> AsyncIterator[httpx.AsyncClient]:
    transport = httpx.AsyncHTTPTransport(uds=str(path))
    async with (
        anyio.create_task_group() as tasks,
        httpx.AsyncClient(transport=transport, base_url="http://lecombus") as client,
    ):
        await tasks.start(serve, line.app, path, None)
        yield client
        tasks.cancel_scope.cancel()


async def test_waiting_writes_refuse_further_ones_but_no_look_at_the_store_and_no_stop(
    line: Line,
) -> None:
    behind = crowd.Crowd(line.app, LIMIT)
    transport = httpx.ASGITransport(app=behind)
    line.ops.gate = anyio.Event()
    async with (
        httpx.AsyncClient(transport=transport, base_url="http://localhost") as client,
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
        line.ops.gate.set()
        assert (await client.post("/v1/stop", json=STOP)).status_code == 200
    assert [one[0] for one in line.ops.asked] == ["write"] * LIMIT + ["stop"]


async def test_what_ended_makes_room_again(line: Line) -> None:
    transport = httpx.ASGITransport(app=crowd.Crowd(line.app, 1))
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        for _ in range(3):
            assert (await client.put(SETPOINT, json={"value": 1})).status_code == 200


async def test_connections_held_for_nothing_do_not_keep_out_a_stop(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crowd, "CONNECTION_LIMIT", LIMIT)
    path = tmp_path / "s"
    async with serving(line, path) as client, AsyncExitStack() as held:
        idle: list[SocketStream] = []
        for _ in range(3 * LIMIT):
            stream = await anyio.connect_unix(str(path))
            idle.append(await held.enter_async_context(stream))
        assert (await client.post("/v1/stop", json=STOP)).status_code == 200
        with pytest.raises(anyio.EndOfStream):  # the one held longest was closed
            await idle[0].receive()


async def write(client: httpx.AsyncClient) -> None:
    assert (await client.put(SETPOINT, json={"value": 1})).status_code == 200
