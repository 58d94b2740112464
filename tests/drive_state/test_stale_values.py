"""A value is shown as good only for as long as the roster's periods promise."""

from __future__ import annotations

import asyncio

import anyio
import pytest

from lecombus.capacity.load import load_on
from lecombus.config import line_timing
from lecombus.drive_state.readings import Quality
from lecombus.parameters import Code
from lecombus.roster import STRETCH_MOST
from support.rosters import roster_text
from support.site_host import Plant, with_plant
from support.virtual_loop import Paused

SPEED = Code(50)
LOOK_S = 0.02


def line_of(count: int) -> str:
    """Write a roster of so many drives, each read every 0.5 s."""
    drives = [(f"d{number}", number + 11 + number // 9, "821x") for number in range(count)]
    return roster_text(drives, baud=9600, drive="cyclic: [{code: C0050, every: 500ms}]")


async def oldest_good(plant: Plant, for_s: float) -> dict[str, float]:
    """Give by drive how old its speed was at most while it was shown as good, seconds."""
    found = dict.fromkeys((drive.name for drive in plant.roster.drives), 0.0)
    until_s = plant.now_s + for_s
    due_s = plant.now_s
    while plant.now_s < until_s:
        await anyio.sleep(LOOK_S)
        if plant.now_s >= due_s:
            plant.site.supervision.watch.look()  # as the daemon does once a second
            due_s = plant.now_s + 1.0
        for name in found:
            reading = plant.site.store.reading(name, SPEED)
            if reading is not None and reading.quality is Quality.GOOD:
                found[name] = max(found[name], reading.age_s or 0.0)
    return found


@pytest.mark.parametrize("paused_s", [2.5, 4.0])
def test_a_pause_of_the_daemon_makes_no_old_value_good(paused_s: float) -> None:
    """A value 4.9 s old that is read every 0.5 s was shown as good: the pauses were a stretch."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(20.0)
        starts_s = [plant.now_s + number * (paused_s + 0.9) for number in range(6)]
        loop = asyncio.get_running_loop()
        loop.machine = Paused([(at_s, at_s + paused_s) for at_s in starts_s])  # type: ignore[attr-defined]
        oldest = await oldest_good(plant, 6 * (paused_s + 0.9) + 10.0)
        assert max(oldest.values()) <= 2 * 0.5 + 1.0
        assert plant.site.store.line().stretch < 1.05, "what is measured is as before in the end"

    with_plant(test, line_of(4))


@pytest.mark.parametrize("count", [16, 24, 31])
def test_a_value_of_a_line_with_more_reads_than_fit_is_good_for_as_long_as_its_plan_says(
    count: int,
) -> None:
    async def test(plant: Plant) -> None:
        store, watch = plant.site.store, plant.site.supervision.watch
        await plant.online()
        planned = store.line().planned_stretch
        assert planned == load_on(plant.roster.drives, line_timing(plant.roster.line)).stretch
        assert 1.2 < planned < STRETCH_MOST
        await anyio.sleep(20.0)
        for _ in range(1000):
            await anyio.sleep(LOOK_S)
            watch.look()
            for drive in plant.roster.drives:
                reading = store.reading(drive.name, SPEED)
                assert reading is not None
                assert reading.quality is Quality.GOOD, reading.reason
        assert store.line().stretch == pytest.approx(planned, rel=0.1)

    with_plant(test, line_of(count))
