"""Stopping drives that do not answer, on the full line of config/full.yaml."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import anyio
import pytest

from lecombus.config import load_roster
from lecombus.drive_state.readings import DriveState
from lecombus.drives import StopAction
from lecombus.operations.operation_reports import GroupReport
from lecombus.schedule import Outcome
from support.site_host import Plant, until, with_plant

FULL = Path(__file__).parents[2] / "config" / "full.yaml"


def fired(plant: Plant) -> dict[str, int]:
    plant.line.advance(plant.now_s)
    return {drive.name: drive.watchdog_fired for drive in plant.line.drives}


async def all_online(plant: Plant) -> None:
    names = [drive.name for drive in plant.roster.drives]
    await until(
        lambda: all(plant.state(name) is DriveState.ONLINE for name in names), within_s=600.0
    )
    await anyio.sleep(10.0)


def take_away(plant: Plant, names: set[str]) -> None:
    """Switch drives off."""
    plant.line.advance(plant.now_s)
    plant.line.faults.absent = {one.address for one in plant.roster.drives if one.name in names}


def others(found: dict[str, int], gone: set[str]) -> dict[str, int]:
    return {name: count for name, count in found.items() if name not in gone}


def judge(report: GroupReport, gone: set[str]) -> None:
    """Whoever is there is proven to be stopped, and of the others it is said what to do."""
    for member in report.members:
        if member.drive in gone:
            assert member.outcome is Outcome.UNKNOWN
            assert "not read back" in member.reason
            assert "emergency stop" in member.remedy
        else:
            assert member.outcome is Outcome.VERIFIED


async def stop_twice(plant: Plant, action: StopAction, target: str, gone: set[str]) -> None:
    """Stop and stop again; nobody else may suffer."""
    before = fired(plant)
    for _ in range(2):
        report = await plant.site.operations.stop(action, target)
        able = tuple(member for member in report.members if member.kind != "no-stop")
        assert len(able) > 1 or able[0].drive == target
        judge(replace(report, members=able), gone)
        await anyio.sleep(0.7)
    assert others(fired(plant), gone) == others(before, gone)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("action", list(StopAction))
def test_stopping_a_drive_that_died_lets_no_other_watchdog_act(action: StopAction) -> None:
    async def test(plant: Plant) -> None:
        await all_online(plant)
        take_away(plant, {"infeed-3"})
        await stop_twice(plant, action, "infeed-3", {"infeed-3"})

    with_plant(test, load_roster(FULL))


INFEEDS = {"infeed-2", "infeed-5", "infeed-9"}
TEN = {"infeed-1", "infeed-4", "infeed-6", "infeed-7", "infeed-8", "conveyor-1", "conveyor-5",
       "winder-2", "pump-3", "agitator"}  # fmt: skip


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("target", "gone"),
    [("pump-1", {"pump-1"}), ("infeed", INFEEDS), ("all", TEN)],
    ids=["an 820X", "a group with three", "all with ten"],
)
def test_stopping_absent_drives_lets_no_watchdog_of_the_others_act(
    target: str, gone: set[str]
) -> None:
    async def test(plant: Plant) -> None:
        await all_online(plant)
        take_away(plant, gone)
        await until(
            lambda: all(plant.state(name) is DriveState.OFFLINE for name in gone), within_s=60.0
        )
        await anyio.sleep(5.0)
        await stop_twice(plant, StopAction.INHIBIT, target, gone)

    with_plant(test, load_roster(FULL))
