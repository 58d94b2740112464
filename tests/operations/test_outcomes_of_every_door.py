"""The six outcomes of a write, at every door by which a write comes: the same words everywhere.

Through the client library and the real HTTP application, on whole lines of simulated drives. The
doors are a plain write, a group's, a verb, a write of a restore, and another address.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import anyio
import anyio.lowlevel
import httpx2
import pytest

from lecombus.client import Line, Outcome, WriteResult
from lecombus.client.connection import Connection
from lecombus.fieldbus.lecom.simulator.faults import Faults
from support.api_line import app_of
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

DRIVES = [("a", 11, "8200vector"), ("b", 12, "8200vector")]
ROSTER = roster_text(
    DRIVES, drive="restore: true, allow_address_change: true",
    sections="\ngroups: {pair: {members: [a, b]}}",
)  # fmt: skip

SETTING = "/v1/drives/a/codes/C0012"

WRITE = b"\x02"
"""Stands in every telegram that writes, and in no question."""

BESIDE: list[asyncio.Task[None]] = []
"""What runs beside a test; a task that nothing holds may be dropped."""

Door = Callable[[Line, dict[str, Any]], Awaitable[Any]]


async def plain(line: Line, more: dict[str, Any]) -> Any:
    return await line.drive("a").write("C0046", 20, **more)


async def group(line: Line, more: dict[str, Any]) -> Any:
    return await line.group("pair").write("C0046", 20, **more)


async def verb(line: Line, more: dict[str, Any]) -> Any:
    return await line.drive("a").set_speed(20, "Hz", **more)


async def enable(line: Line, more: dict[str, Any]) -> Any:
    more.pop("verify", None)
    return await line.drive("a").enable(**more)


async def restored(line: Line, more: dict[str, Any]) -> Any:
    document: dict[str, Any] = {"value": 7, "restore": True}
    document |= {"verify": more["verify"]} if "verify" in more else {}
    document |= {"expires": f"{more['expires_s'] * 1000:.0f}ms"} if "expires_s" in more else {}
    return await result_of(line, "PUT", SETTING, document)


async def address(line: Line, more: dict[str, Any]) -> Any:
    return await result_of(line, "POST", "/v1/drives/a/address", {"address": 35})


async def result_of(line: Line, method: str, path: str, document: dict[str, Any]) -> Any:
    return await line.result(method, path, document, WriteResult.of, {"drive": "a"})


DOORS: dict[str, Door] = {
    "plain": plain, "group": group, "verb": verb, "enable": enable, "restore": restored,
    "address": address,
}  # fmt: skip


@contextlib.asynccontextmanager
async def behind_http(plant: Plant) -> AsyncIterator[Line]:
    """The line as a program sees it."""
    transport = httpx2.ASGITransport(app_of(plant))
    async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as http:
        yield Line(Connection(http, "here"))


async def nothing(plant: Plant, line: Line) -> None:
    """The line is in order."""


async def nak(plant: Plant, line: Line) -> None:
    """The drive refuses every write."""
    plant.line.drive_faults[11] = Faults(nak=1.0)


async def lost(plant: Plant, line: Line) -> None:
    """The drive does what is written to it, and from then on none of its answers arrives."""
    before = len(plant.end.sent)

    async def lose() -> None:
        await until(lambda: any(WRITE in one.data for one in plant.end.sent[before:]))
        plant.line.drive_faults |= {11: Faults(lost=1.0), 35: Faults(lost=1.0)}

    BESIDE.append(asyncio.create_task(lose()))


async def closed(plant: Plant, line: Line) -> None:
    """The roster does not allow it any more."""
    text = ROSTER.replace("restore: true, allow_address_change: true", "writable: []")
    plant.apply(text)
    await plant.online()


async def gone(plant: Plant, line: Line) -> None:
    """The line is lost."""
    plant.end.unplug()
    await until(lambda: not plant.site.worker.is_open)


Situation = Callable[[Plant, Line], Awaitable[None]]
V = {"verify": True}

ROWS: list[tuple[str, Situation, dict[str, Any], str]] = [
    *((door, nothing, {}, "done") for door in ("plain", "group", "verb", "restore")),
    *((door, nothing, V, "verified") for door in ("plain", "group", "verb", "restore")),
    ("enable", nothing, {}, "verified"),
    ("address", nothing, {}, "verified"),
    *((door, nak, V, "refused") for door in DOORS),
    *((door, closed, V, "refused") for door in DOORS),
    *((door, gone, V, "refused") for door in DOORS),
    *((door, lost, V, "unknown") for door in DOORS),
]


@pytest.mark.parametrize(
    ("door", "situation", "more", "outcome"),
    [pytest.param(*row, id=f"{row[0]}-{row[1].__name__}-{row[3]}") for row in ROWS],
)
def test_an_outcome_comes_out_of_every_door(
    door: str, situation: Situation, more: dict[str, Any], outcome: str
) -> None:
    async def test(plant: Plant) -> None:
        async with behind_http(plant) as line:
            await plant.online()
            if door == "address":
                await line.stop("all", "inhibit")
            await situation(plant, line)
            result = await DOORS[door](line, dict(more))
            assert (result.outcome, result.answer.data["outcome"]) == (outcome, outcome), result
            if not result.is_good:
                assert result.reason
            members = getattr(result, "members", ())
            if outcome in ("done", "verified"):
                assert all(one.is_good for one in members)

    with_plant(test, ROSTER)


@pytest.mark.parametrize("door", ["plain", "group", "verb", "enable", "restore"])
def test_what_is_not_sent_in_time_is_expired(door: str) -> None:
    async def test(plant: Plant) -> None:
        async with behind_http(plant) as line:
            await plant.online()
            await until(lambda: plant.is_asking(b"\x0411"))
            result = await DOORS[door](line, {"expires_s": 0.001})
            assert result.outcome is Outcome.EXPIRED, result

    with_plant(test, roster_text(DRIVES, baud=1200, drive="restore: true",
                                 sections="\ngroups: {pair: {members: [a, b]}}"))  # fmt: skip


@pytest.mark.parametrize("door", list(DOORS))
def test_what_waits_when_a_stop_comes_is_superseded(door: str) -> None:
    results: list[Any] = []

    async def test(plant: Plant) -> None:
        async with behind_http(plant) as line, anyio.create_task_group() as tasks:
            await plant.online()
            if door == "address":
                await line.stop("all", "inhibit")

            async def ask() -> None:
                results.append(await DOORS[door](line, {}))

            await until(lambda: plant.is_asking(b"\x0411"))
            tasks.start_soon(ask)
            for _ in range(20):  # it is asked for, and waits
                await anyio.lowlevel.checkpoint()
            await line.stop("all")
        (result,) = results
        assert result.outcome is Outcome.SUPERSEDED, result

    with_plant(test, ROSTER)
