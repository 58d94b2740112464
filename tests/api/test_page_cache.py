"""A page that is kept: rendered once for many, and never wrong about how things are."""

from __future__ import annotations

import time

import anyio
import anyio.lowlevel
import httpx2
import pytest

from lecombus.api.read_routes import KEEPS_S, PageCache
from lecombus.drive_state.readings import DriveState
from lecombus.parameters import Value
from support.api_line import FREQUENCY, Line

pytestmark = [pytest.mark.anyio, pytest.mark.clock]


class Press:
    """Renders a number that goes up, as slowly as it is told."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.changes = 0
        self.made = 0
        self.gate: anyio.Event | None = None
        self.page = PageCache(self._render, lambda: self.changes, lambda: self.now_s)

    async def _render(self) -> bytes:
        self.made += 1
        number = self.made
        if self.gate is not None:
            await self.gate.wait()
        return b"%d" % number


async def test_a_page_is_kept_so_long_and_no_longer() -> None:
    press = Press()
    assert await press.page.get() == b"1"
    press.now_s += KEEPS_S * 0.9
    assert await press.page.get() == b"1"
    press.now_s += KEEPS_S * 0.2
    assert await press.page.get() == b"2"


async def test_a_change_makes_it_anew_at_once() -> None:
    press = Press()
    await press.page.get()
    press.changes += 1
    assert await press.page.get() == b"2"


async def test_a_crowd_waits_for_one_rendering_and_who_comes_after_a_change_for_the_next() -> None:
    press = Press()
    press.gate = anyio.Event()
    got: list[bytes] = []

    async def ask() -> None:
        got.append(await press.page.get())

    async with anyio.create_task_group() as tasks:
        for _ in range(50):
            tasks.start_soon(ask)
        await anyio.wait_all_tasks_blocked()
        press.changes += 1
        press.now_s += 0.01
        tasks.start_soon(ask)
        await anyio.wait_all_tasks_blocked()
        press.gate.set()
    assert set(got) == {b"1", b"2"}
    assert got[0] == b"1", "it waited for the one it asked for"
    assert press.made == 2, "one more for all who must not see what was before the change"


async def test_a_client_that_goes_away_while_it_is_rendered_leaves_it_to_the_next() -> None:
    press = Press()
    press.gate = anyio.Event()
    with anyio.move_on_after(0.01):
        await press.page.get()
    press.gate = None
    with anyio.fail_after(5):
        assert await press.page.get() == b"2"


async def test_what_happened_to_a_drive_is_in_the_list_at_once(line: Line) -> None:
    transport = httpx2.ASGITransport(app=line.app)
    async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client:

        async def feeder() -> dict:  # type: ignore[type-arg]
            return (await client.get("/v1/drives")).json()["drives"][0]  # type: ignore[no-any-return]

        assert (await feeder())["values"][0]["quality"] == "good"
        line.store.value_written("feeder", FREQUENCY, 0.0)
        assert (await feeder())["values"][0]["quality"] == "bad"
        line.store.value_read("feeder", FREQUENCY, Value.parse("12.0"), time.monotonic())
        line.store.value_failed("feeder", FREQUENCY, "no answer")
        assert (await feeder())["values"][0]["reason"] == "no answer"
        line.store.drive_state("feeder", DriveState.OFFLINE, "silent")
        assert (await feeder())["state"] == "offline"


@pytest.mark.parametrize("turns", range(8))
async def test_a_drive_that_leaves_while_the_page_is_rendered_is_left_out(
    client: httpx2.AsyncClient, line: Line, turns: int
) -> None:
    """A reload may take it out between two values."""
    got: list[httpx2.Response] = []

    async def ask() -> None:
        got.append(await client.get("/v1/drives"))

    async with anyio.create_task_group() as tasks:
        tasks.start_soon(ask)
        for _ in range(turns):
            await anyio.lowlevel.checkpoint()
        line.store.remove_drive("belt")
    assert got[0].status_code == 200, got[0].text
    assert "feeder" in [one["drive"] for one in got[0].json()["drives"]]
