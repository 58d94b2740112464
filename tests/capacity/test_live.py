"""A promise beside what a running line showed: simulated lines on the virtual clock."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import anyio
import pytest

from lecombus.api.decimal_json import encode
from lecombus.capacity.facts import facts_of, roster_of
from lecombus.capacity.live import LOAD_ROOM, LivePlan, compare
from lecombus.capacity.plan import make_plan
from lecombus.drive_state.readings import DriveState
from lecombus.drives import StopAction
from lecombus.metrics.rolling_window import RollingWindow
from lecombus.parameters import Code
from lecombus.schedule import Priority
from support.rosters import make_roster, roster_text
from support.site_host import Plant, until, with_plant

WATCHED = "watchdog: {time: 2s, action: inhibit, configure: true}"
DRIVES = [("a", 1, "8200vector"), ("b", 2, "smvector"), ("c", 3, "821x")]


def carried(plant: Plant) -> Any:
    """The facts as they come out of JSON."""
    return json.loads(encode(plant.site.supervision.watch.plan_facts(plant.site.roster)))


def live_of(plant: Plant) -> LivePlan:
    found = carried(plant)
    return compare(roster_of(found["roster"]), found["measured"], found["away"])


async def work(plant: Plant, seconds: int) -> None:
    """Let a line run, looked at once a second as the daemon does."""
    for _ in range(seconds):
        plant.site.supervision.watch.look()
        await anyio.sleep(1.0)


def test_what_is_carried_plans_the_same() -> None:
    async def test(plant: Plant) -> None:
        found = roster_of(carried(plant)["roster"])
        assert make_plan(found) == make_plan(plant.roster)
        assert facts_of(found) == facts_of(plant.roster)

    drive = WATCHED + ", answer_time: 90ms, addressing: standard"
    with_plant(test, roster_text([("a", 1, "8200vector"), ("b", 2, "821x")], drive=drive))


def test_a_line_that_works_keeps_what_was_promised() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await work(plant, 330)
        for _ in range(20):
            await plant.site.operations.read("a", Code(61))
            await anyio.sleep(0.237)
        live = live_of(plant)
        assert live.beyond == ()
        assert live.window_s == 300.0
        classes = {one.name: one for one in live.classes}
        asked = classes["interactive"]
        assert asked.waits == 20
        assert asked.median_s is not None
        assert asked.most_s is not None
        assert 0.0 < asked.median_s <= 1.2 * asked.most_s <= 1.2 * asked.quiet_s
        read = classes["cyclic"]
        assert read.load is not None
        assert read.used == pytest.approx(read.load, rel=0.35)
        assert {one.drive for one in live.drives} == {"a", "b", "c"}
        assert all(one.least_s and one.promised_s <= one.least_s < 2.0 for one in live.drives)
        assert all(one.longest_s and one.longest_s >= 0.9 * one.asked_s for one in live.codes)
        assert live.slack_s is not None
        assert 0.0 < live.slack_s < 1.8

    with_plant(test, roster_text(DRIVES, drive=WATCHED))


@pytest.mark.parametrize("every", ["2s", "10s"])
def test_feeding_early_is_not_beyond_the_promise(every: str) -> None:
    """Drives that are read too seldom are fed beside, and by an idle line sooner than they must."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await work(plant, 330)
        live = live_of(plant)
        watchdog = class_of(live, "watchdog")
        assert watchdog.used > watchdog.load + LOAD_ROOM
        assert live.beyond == ()

    cyclic = f", cyclic: [{{code: C0150, every: {every}}}]"
    with_plant(test, roster_text([(f"d{at}", at, "smvector") for at in range(1, 9)],
                             drive=WATCHED + cyclic))  # fmt: skip


@pytest.mark.parametrize(("added_s", "said"), [(0.0, "within"), (0.006, "as with an adapter")])
def test_an_adapter_that_adds_to_every_answer_is_suspected(added_s: float, said: str) -> None:
    """Reads that take longer by less than the adapter may add, and by nothing else."""
    drives = [(f"d{at}", at, "smvector") for at in range(1, 9)]
    roster = make_roster(
        drives, baud=9600, line="adapter_latency: 10ms",
        drive="cyclic: [{code: C0150, every: 500ms}]",
    )  # fmt: skip
    cost_s = make_plan(roster).exchanges[0].times.usual_s - roster.line.turnaround_s + added_s
    minutes = RollingWindow(0.0)
    for number in range(16 * 100):
        minutes.exchange(Priority.CYCLIC, cost_s, 0.001, number / 16, good=True)
    found = class_of(compare(roster, json.loads(encode(minutes.as_json(100.0)))), "cyclic")
    assert said in found.verdict
    much = replace(found, used=2.0)
    assert much.verdict.endswith(")")


def test_what_stops_of_drives_that_are_away_wait_is_not_held_against_their_class() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.faults.absent = {1}
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        await plant.site.operations.stop(StopAction.INHIBIT, "a")
        stops = class_of(live_of(plant), "stop")
        assert stops.failed > 1
        assert stops.waits == 0
        await plant.site.operations.stop(StopAction.INHIBIT, "b")
        assert class_of(live_of(plant), "stop").waits == 1

    with_plant(test, roster_text(DRIVES, drive=WATCHED))


def test_what_is_beyond_the_promise_is_said() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await work(plant, 20)
        plant.power_cycle("b", 60.0)
        await work(plant, 30)
        live = live_of(plant)
        said = "\n".join(live.beyond)
        assert "watchdog" not in said
        assert "drive b: does not answer" in said
        assert " of b: " not in said
        assert " of a: " not in said
        assert {one.verdict for one in live.codes if one.drive == "b"} == {"the drive is away"}
        assert live.away == ("b",)
        assert live.failed > 0
        assert live.as_json()["beyond"] == list(live.beyond)

    with_plant(test, roster_text(DRIVES))


def test_old_measures_are_forgotten() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await work(plant, 330)  # coming online asks for much
        await plant.site.operations.read("a", Code(61))
        assert class_of(live_of(plant), "interactive").waits == 1
        await work(plant, 280)
        assert class_of(live_of(plant), "interactive").waits == 1
        await work(plant, 80)
        found = class_of(live_of(plant), "interactive")
        assert (found.waits, found.most_s, found.median_s) == (0, None, None)
        assert found.verdict == "nothing measured"

    with_plant(test, roster_text(DRIVES))


def test_an_unwatched_line_names_no_watchdog() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await work(plant, 15)
        live = live_of(plant)
        assert live.drives == ()
        assert live.slack_s is None
        watchdog = class_of(live, "watchdog")
        assert math.isinf(watchdog.quiet_s)
        assert live.as_json()["classes"][2]["quiet_s"] is None
        json.dumps(live.as_json(), allow_nan=False)

    with_plant(test, roster_text(DRIVES))


def class_of(live: LivePlan, name: str) -> Any:
    return next(one for one in live.classes if one.name == name)
