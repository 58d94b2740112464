"""Repeats after a connection broke, on whole lines: never twice, and nothing after a stop.

The connection breaks before the daemon has read the request, or after it has carried it out. Time
is virtual; only the socket between library and application is missing.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable

import anyio
import httpx2
import pytest

from lecombus.client import Line, Outcome
from lecombus.client.connection import Connection
from support.api_line import app_of
from support.rosters import roster_text
from support.site_host import Plant, Telegram, with_plant

ROSTER = roster_text([("a", 11, "8200vector")])
WRITE = b"\x02"

Between = Callable[[Line], Awaitable[object]]


class Cut(httpx2.AsyncBaseTransport):
    """Loses the first request that acts, or its answer.

    Args:
        inner: The daemon.
        before: It is lost before the daemon has it.
        between: What happens until it is repeated.
    """

    def __init__(self, inner: httpx2.AsyncBaseTransport, before: bool, between: Between) -> None:
        self._inner = inner
        self._before = before
        self._between = between
        self.line: Line | None = None
        self.cut = 0

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        if request.method == "GET" or self.cut or request.url.path == "/v1/stop":
            return await self._inner.handle_async_request(request)
        self.cut += 1
        if not self._before:
            await self._inner.handle_async_request(request)
        assert self.line is not None
        await self._between(self.line)
        raise httpx2.RemoteProtocolError("server disconnected", request=request)


@contextlib.asynccontextmanager
async def behind(plant: Plant, *, before: bool, between: Between) -> AsyncIterator[Line]:
    app = app_of(plant)
    await anyio.sleep(1.0)  # the daemon is not asked in the moment of its start
    cut = Cut(httpx2.ASGITransport(app), before, between)
    async with httpx2.AsyncClient(transport=cut, base_url="http://localhost") as http:
        cut.line = Line(Connection(http, "here"))
        yield cut.line


async def nothing(line: Line) -> None:
    await anyio.sleep(0.2)


async def a_stop(line: Line) -> None:
    await anyio.sleep(0.2)
    (await line.stop()).check()


def writes(plant: Plant, since_s: float) -> list[Telegram]:
    return [one for one in plant.sent_to(11, since_s) if WRITE in one.data]


@pytest.fixture(autouse=True)
def _clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lecombus.client.connection.now_s", anyio.current_time)


@pytest.mark.parametrize("before", [True, False])
def test_a_write_is_carried_out_once(before: bool) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        async with behind(plant, before=before, between=nothing) as line:
            since_s = plant.now_s
            assert (await line.drive("a").write("C0046", 20)).outcome is Outcome.DONE
            assert len(writes(plant, since_s)) == 1

    with_plant(test, ROSTER)


def test_an_enable_that_was_lost_starts_nothing_after_a_stop() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        async with behind(plant, before=True, between=a_stop) as line:
            result = await line.drive("a").enable()
            assert (result.outcome, result.drive) == (Outcome.SUPERSEDED, "a")
            word = await line.drive("a").read("C0135")
            assert int(word.number) & 0x8, "the quick stop stands"

    with_plant(test, ROSTER)


def test_an_enable_that_was_done_before_the_stop_is_answered_and_not_done_again() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        async with behind(plant, before=False, between=a_stop) as line:
            assert (await line.drive("a").enable()).outcome is Outcome.VERIFIED
            assert int((await line.drive("a").read("C0135")).number) & 0x8, "the quick stop stands"

    with_plant(test, ROSTER)


def test_a_setpoint_that_was_lost_is_not_sent_after_a_stop() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        async with behind(plant, before=True, between=a_stop) as line:
            since_s = plant.now_s
            assert (await line.drive("a").write("C0046", 20)).outcome is Outcome.SUPERSEDED
            assert not [one for one in writes(plant, since_s) if b"046" in one.data]

    with_plant(test, ROSTER)


def test_what_expired_while_the_connection_was_broken_is_not_sent() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        async with behind(plant, before=True, between=nothing) as line:
            result = await line.drive("a").write("C0046", 20, expires_s=0.1)
            assert result.outcome is Outcome.EXPIRED

    with_plant(test, ROSTER)
