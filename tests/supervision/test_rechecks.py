"""A watchdog that lost its settings while its drive stayed online is found, and put in order."""

from __future__ import annotations

import anyio
import pytest

from lecombus.drive_state.readings import DriveState
from lecombus.parameters import Code
from lecombus.schedule import Priority
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

SMVECTOR, VECTOR = [("a", 1, "smvector")], [("a", 1, "8200vector")]
ACTION = {"smvector": Code(1426), "8200vector": Code(1922)}
ROUND_S = 300.0


def watched(configure: str) -> str:
    return f"watchdog: {{time: 2s, action: quick-stop, configure: {configure}}}"


def asked(plant: Plant, code: Code, since_s: float) -> list[float]:
    return [
        one.result.started_s
        for one in plant.reports
        if one.step.code == code and one.result.started_s > since_s
        and one.priority is Priority.BACKGROUND
    ]  # fmt: skip


def test_a_watchdog_that_was_switched_off_at_the_keypad_is_set_again() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        params = plant.line["a"].model.params
        await anyio.sleep(1.0)
        assert params.text(1426) == "2"
        params.set(1426, "0")
        await until(lambda: plant.state("a") is DriveState.STARTING, within_s=2.5 * ROUND_S)
        assert "its watchdog was changed from quick-stop after 2 s to off" in (
            plant.site.store.drive("a").reason
        )
        await plant.online(within_s=60.0)
        assert params.text(1426) == "2"

    with_plant(test, roster_text(SMVECTOR, drive=watched("true")))


def test_one_that_the_roster_does_not_let_be_set_is_remarked() -> None:
    async def test(plant: Plant) -> None:
        params = plant.line["a"].model.params
        params.set(1426, "2")
        params.set(1425, "2000")
        await plant.online(within_s=60.0)
        assert "watchdog" not in plant.site.store.drive("a").remarks
        params.set(1425, "4000")
        await until(
            lambda: "watchdog" in plant.site.store.drive("a").remarks, within_s=2.5 * ROUND_S
        )
        assert "quick-stop after 4 s" in plant.site.store.drive("a").remarks["watchdog"]
        await plant.online(within_s=60.0)
        found_s = plant.now_s
        await anyio.sleep(3.0 * ROUND_S)
        assert plant.state("a") is DriveState.ONLINE, "it is said once, and not doubted for ever"
        assert asked(plant, ACTION["smvector"], found_s)

    with_plant(test, roster_text(SMVECTOR, drive=watched("false")))


def test_modules_whose_codes_take_long_are_asked_for_a_hundredth_of_the_line() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=600.0)
        began_s = plant.now_s
        await anyio.sleep(4000.0)
        starts = asked(plant, ACTION["8200vector"], began_s)
        took_s = sum(
            one.result.ended_s - one.result.started_s
            for one in plant.reports
            if one.priority is Priority.BACKGROUND and one.result.started_s > began_s + ROUND_S
        )
        assert len(starts) >= 4
        assert took_s < 0.015 * 4000.0
        assert plant.site.schedule.stats(plant.now_s).feeds["v1"].lapses == 0

    drives = [(f"v{number}", number, "8200vector") for number in range(1, 7)]
    with_plant(test, roster_text(drives, drive="cyclic: [], " + watched("true")))


@pytest.mark.parametrize("configure", ["true", "false"])
@pytest.mark.parametrize("drives", [SMVECTOR, VECTOR], ids=["smvector", "8200vector"])
def test_times_of_a_watchdog_that_is_off_in_drive_and_roster_are_no_difference(
    caplog: pytest.LogCaptureFixture, drives: list[tuple[str, int, str]], configure: str
) -> None:
    caplog.set_level("INFO")
    time_code = 1425 if drives is SMVECTOR else 1923

    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(time_code, "4000")
        await plant.online(within_s=60.0)
        assert "watchdog" not in plant.site.store.drive("a").remarks
        plant.line["a"].model.preset(time_code, "7000")
        await anyio.sleep(2.5 * ROUND_S)
        assert "watchdog" not in plant.site.store.drive("a").remarks
        assert plant.state("a") is DriveState.ONLINE
        assert not [one for one in caplog.messages if "off" in one and "watchdog" in one]
        assert plant.line["a"].text(time_code) == "7000", "nothing needs to be set"

    off = f"watchdog: {{time: 2s, action: none, configure: {configure}}}"
    with_plant(test, roster_text(drives, drive=off))


def test_a_time_that_alone_was_changed_is_set_again() -> None:
    """The action is as it was: without more the audit took the time for what was known."""

    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        plant.line["a"].model.params.set(1923, "60000")
        await until(lambda: plant.line["a"].text(1923) == "2000", within_s=2.5 * ROUND_S)
        await plant.online(within_s=60.0)

    with_plant(test, roster_text(VECTOR, drive=watched("true")))


@pytest.mark.parametrize("late", ["supply", "line"])
def test_a_watchdog_that_passed_unfed_is_looked_at_at_once(late: str) -> None:
    """The supply fails while others' time-outs take the line: no answer of the drive is missed."""

    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        await anyio.sleep(10.0)
        params = plant.line["a"].model.params
        assert params.text(1922) == "2"
        states = []
        if late == "supply":
            params.set(1922, "0")
        began_s = plant.now_s
        plant.site.drives.get("a").feed.lapses -= 1  # one more was counted since the last look
        plant.site.supervision.watch.look()
        for _ in range(100):
            await anyio.sleep(0.1)
            states.append(plant.state("a"))
        assert len(asked(plant, Code(1922), began_s)) == 1
        assert params.text(1922) == "2"
        assert (DriveState.STARTING in states) is (late == "supply")
        await plant.online(within_s=60.0)

    with_plant(test, roster_text(VECTOR, drive=watched("true")))


def test_drives_whose_supply_failed_for_two_seconds_have_their_watchdogs_again() -> None:
    """Some of them miss no answer: the others' time-outs take the line meanwhile."""
    names = [f"v{number}" for number in range(1, 9)]

    async def looked_at(plant: Plant, for_s: int) -> None:
        for _ in range(for_s):
            await anyio.sleep(1.0)
            plant.site.supervision.watch.look()

    def forgotten(plant: Plant) -> list[str]:
        return [name for name in names if plant.line[name].model.params.text(1922) != "2"]

    async def test(plant: Plant) -> None:
        await plant.online(within_s=120.0)
        await looked_at(plant, 30)
        assert forgotten(plant) == []
        for name in names:
            plant.power_cycle(name, 2.2)
        await looked_at(plant, 60)
        assert forgotten(plant) == []
        await plant.online(within_s=10.0)

    drives = [(name, number, "8200vector") for number, name in enumerate(names, 1)]
    with_plant(test, roster_text(drives, drive=watched("true")))
