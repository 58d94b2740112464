"""A minute after a disturbance has ended, a line is as it was before it."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from itertools import pairwise

import anyio
import pytest

from lecombus.drive_state.readings import DriveState
from lecombus.fieldbus.lecom.protocol.telegrams import MAX_ANSWER_CHARS
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.parameters import Code
from support.disturbances import AFTER_S, LINES, PATTERNS, Picture, look, mixed_roster
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant
from support.virtual_loop import Paused

QUICK = [
    (31, "paused a quarter of a second, run as long"),
    (12, "starved: one step in five up to 60 ms late"),
    (12, "10 % of answers 0.2 s late"),
    (31, "5 % late"),
    (12, "all answers 0.2 s late"),
    (8, "60 % lost"),
    (8, "late, lost, noisy and paused"),
]
LATE_ONLY = [name for name, one in PATTERNS.items() if one.machine and not one.faults]


def check(size: int, name: str) -> None:
    """Look at a line, disturb it, and look again a minute later."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(30.0)
        before = await look(plant, 10)
        assert before.worse_than(Picture(wrote_s={"": 0.3})) == []
        await PATTERNS[name].happen(plant)
        for _ in range(int(AFTER_S)):
            plant.site.supervision.watch.look()
            await anyio.sleep(1.0)
        assert (await look(plant, 11)).worse_than(before) == []

    with_plant(test, mixed_roster(*LINES[size]), seed=3, spread=0.3)


@pytest.mark.parametrize(("size", "name"), QUICK)
def test_a_minute_after_a_disturbance_all_is_as_before(size: int, name: str) -> None:
    check(size, name)


@pytest.mark.long
@pytest.mark.parametrize("size", LINES)
@pytest.mark.parametrize("name", PATTERNS)
def test_after_every_disturbance_on_every_line(size: int, name: str) -> None:
    check(size, name)


def test_31_slow_drives_are_online_a_minute_after_the_port_is_back() -> None:
    """Their modules' own codes take up to 500 ms, and half the line's time goes to feeding."""
    drives = [(f"d{one}", 1 + one + one // 9, "820x") for one in range(31)]
    guard = "{time: 4s, action: quick-stop, configure: true}"

    async def test(plant: Plant) -> None:
        await plant.online(within_s=240.0)
        plant.end.unplug()
        await anyio.sleep(10.0)
        plant.end.replug()
        await until(lambda: plant.site.worker.is_open)
        await plant.online(within_s=60.0)

    with_plant(test, roster_text(drives, baud=9600, watchdog=guard), seed=3, spread=0.3)


@pytest.mark.parametrize("name", LATE_ONLY)
def test_no_answer_is_missed_because_the_daemon_was_late(name: str) -> None:
    """The drives do nothing wrong, so nothing is lost, no drive changes state, and none is slow."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(5.0)
        began = len(plant.reports)
        states: set[DriveState] = set()
        tell = plant.site.store.drive_state

        def told(drive: str, state: DriveState, reason: str = "") -> None:
            states.add(state)
            tell(drive, state, reason)

        plant.site.store.drive_state = told  # type: ignore[method-assign]
        await replace(PATTERNS[name], lasts_s=30.0).happen(plant)
        reports = plant.reports[began:]
        assert {one.result.kind for one in reports} == {ResultKind.ANSWERED}
        assert len(reports) > 50
        assert states <= {DriveState.ONLINE}
        for drive in plant.roster.drives:
            assert not plant.site.requests.station(drive.name).measured.slow.reads

    with_plant(test, mixed_roster(*LINES[8]), seed=3, spread=0.3)


def test_a_value_that_lay_in_the_kernel_is_not_shown_as_fresh() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        loop, site = asyncio.get_running_loop(), plant.site
        reading = asyncio.ensure_future(site.operations.read("d1", Code(46)))
        await until(lambda: plant.is_asking(b"\x040246"))
        loop.machine = Paused([(plant.now_s, plant.now_s + 5.0)])  # type: ignore[attr-defined]
        found = await reading
        assert found.value is not None
        assert (found.age_s or 0.0) > 4.5

    with_plant(test, mixed_roster(*LINES[8]), seed=3)


@pytest.mark.parametrize("baud", [9600, 19200])
def test_an_answer_without_end_silences_the_line_no_longer_than_the_longest_answer(
    baud: int,
) -> None:
    """5000 characters take 5.2 s at 9600 baud; the next telegram's EOT ends them."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(5.0)
        plant.line.drive_faults = {2: Faults(endless=1.0)}
        began = len(plant.reports)
        await until(lambda: any(one.drive == "b" for one in plant.reports[began:]))
        plant.line.drive_faults = {}
        await anyio.sleep(5.0)
        sent = [one.at_s for one in plant.end.sent if one.at_s > plant.now_s - 5.2]
        longest_s = MAX_ANSWER_CHARS * 10.0 / baud
        assert max(b - a for a, b in pairwise(sent)) < longest_s + 0.3
        answers = [one for one in plant.reports[began:] if one.drive == "a"]
        assert sum(one.result.kind is not ResultKind.ANSWERED for one in answers) <= 1
        assert plant.state("a") is DriveState.ONLINE
        assert plant.state("b") is DriveState.ONLINE

    two = [("a", 1, "8200vector"), ("b", 2, "8200vector")]
    with_plant(test, roster_text(two, baud=baud, drive="cyclic: [{code: C0150, every: 200ms}]"))
