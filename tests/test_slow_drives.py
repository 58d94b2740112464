"""A drive that thinks longer than its manual says: lost at first, then waited for, and said so."""

from __future__ import annotations

import json
import logging

import anyio
import pytest

from lecombus.api.decimal_json import encode
from lecombus.capacity.facts import roster_of as running
from lecombus.capacity.plan import make_plan
from lecombus.drive_state.readings import DriveState
from lecombus.errors import OperationError
from lecombus.parameters import Code
from support.rosters import roster_text
from support.site_host import Plant, with_plant

TWO = [("a", 1, "8200vector"), ("b", 2, "8200vector")]
ADDRESS = Code(9)


LIMIT_S = 0.5
"""The manual's "up to" for a module's own codes; a drive beyond that needs its `answer_time`."""


def slow_down(plant: Plant, drive: str, factor: float, *, most_s: float = 10.0) -> None:
    """Let a drive think so many times as long as the manual says, but no longer than so long."""
    model = plant.line[drive].model
    usual = model.think_s
    model.think_s = (  # type: ignore[method-assign]
        lambda number, *, write, now_s: min(
            factor * usual(number, write=write, now_s=now_s), most_s
        )
    )


async def work(plant: Plant, seconds: int) -> None:
    for _ in range(seconds):
        plant.site.supervision.watch.look()
        await anyio.sleep(1.0)


def remarks(plant: Plant, drive: str) -> str:
    return encode(plant.site.store.drive(drive).as_json())


@pytest.mark.parametrize("factor", [3.0, 4.0])
def test_a_drive_three_times_as_slow_comes_online_and_stays(
    factor: float, caplog: pytest.LogCaptureFixture
) -> None:
    async def test(plant: Plant) -> None:
        slow_down(plant, "b", factor)
        await work(plant, 150)
        settled_s = plant.now_s
        await work(plant, 120)
        assert plant.state("b") is DriveState.ONLINE
        assert plant.misses("b", settled_s) == 0
        assert plant.misses("a", 0.0) == 0
        assert "answers later than its manual says" in remarks(plant, "b")
        assert "answers later" not in remarks(plant, "a")
        for drive, address in (("a", "1"), ("b", "2")):
            reading = await plant.site.operations.read(drive, ADDRESS)
            assert reading.value is not None
            assert reading.value.raw.strip() == address
        page = (await plant.site.metrics.fresh_page(openmetrics=False)).decode()
        ratios = dict(
            line.rsplit(" ", 1)
            for line in page.splitlines()
            if line.startswith("lecombus_drive_answer_ratio{")
        )
        by_drive = {key.split('drive="')[1][0]: float(text) for key, text in ratios.items()}
        assert by_drive["b"] > 2.0 > 1.25 > by_drive["a"]

    with caplog.at_level(logging.WARNING):
        with_plant(test, roster_text(TWO, drive="cyclic: [{code: C0150, every: 500ms}]"))
    said = [one.getMessage() for one in caplog.records if "slow-drive" in one.getMessage()]
    assert len(said) == 1
    assert "drive=b" in said[0]


def test_the_plan_of_the_running_line_reckons_with_what_was_measured() -> None:
    async def test(plant: Plant) -> None:
        slow_down(plant, "b", 3.0)
        await work(plant, 150)
        document = json.loads(encode(plant.site.supervision.watch.plan_facts(plant.site.roster)))
        plan, promised = make_plan(running(document["roster"])), make_plan(plant.roster)
        by_manual = {(one.drive, one.what): one.times for one in promised.exchanges}
        for one in plan.exchanges:
            if one.drive == "a":
                assert one.times == by_manual[one.drive, one.what]
        read = next(one for one in plan.exchanges if (one.drive, one.what) == ("b", "C0150"))
        assert read.times.usual_s > 1.5 * by_manual["b", "C0150"].usual_s
        request = plant.site.requests.cyclic_maker("b", Code(150))()
        assert read.times.usual_s == pytest.approx(request.cost_s)
        assert [row["code"] for row in document["answers"]["b"] if row["slow"]]
        assert not [row for row in document["answers"]["a"] if row["slow"]]

    with_plant(test, roster_text(TWO, drive="cyclic: [{code: C0150, every: 500ms}]"))


def test_a_code_that_is_answered_quickly_again_is_reckoned_by_the_manual() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        model = plant.line["b"].model
        usual = model.think_s
        slow_down(plant, "b", 3.0)
        await work(plant, 60)
        station = plant.site.requests.station("b")
        assert station.answer_s(Code(150)) is not None
        model.think_s = usual  # type: ignore[method-assign]
        await work(plant, 1300)
        assert station.answer_s(Code(150)) is None
        assert "C0150" not in remarks(plant, "b").partition("answers later")[2]

    with_plant(test, roster_text(TWO, drive="cyclic: [{code: C0150, every: 2s}]"))


def test_what_was_learnt_is_dropped_when_somebody_says_so_and_learnt_again() -> None:
    async def test(plant: Plant) -> None:
        slow_down(plant, "b", 3.0)
        await work(plant, 60)
        station = plant.site.requests.station("b")
        assert station.answer_s(Code(150)) is not None
        report = plant.site.operations.forget_times("b")
        assert Code(150) in {row.code for row in report.forgotten}
        assert station.answer_s(Code(150)) is None
        assert "answers later" not in remarks(plant, "b")
        assert plant.site.operations.forget_times("b").forgotten == ()
        await work(plant, 30)
        assert station.answer_s(Code(150)) is not None
        with pytest.raises(OperationError, match="no drive"):
            plant.site.operations.forget_times("c")

    with_plant(test, roster_text(TWO, drive="cyclic: [{code: C0150, every: 500ms}]"))


def test_a_new_roster_entry_begins_anew() -> None:
    async def test(plant: Plant) -> None:
        slow_down(plant, "b", 3.0)
        await work(plant, 60)
        text = roster_text(TWO, drive="cyclic: [{code: C0150, every: 500ms}], answer_time: 150ms")
        plant.apply(text)
        plant.site.supervision.watch.look()
        assert "answers later" not in remarks(plant, "b")
        await work(plant, 60)
        assert plant.state("b") is DriveState.ONLINE
        assert "answers later" not in remarks(plant, "b")

    with_plant(test, roster_text(TWO, drive="cyclic: [{code: C0150, every: 500ms}]"))


def test_all_drives_slow_are_told_apart_all_the_same() -> None:
    """Three drives that answer the same code late: each value is its own drive's."""

    async def test(plant: Plant) -> None:
        for name in "abc":
            slow_down(plant, name, 3.0)
        await work(plant, 200)
        for _ in range(3):
            for name, address in zip("abc", "123", strict=True):
                reading = await plant.site.operations.read(name, ADDRESS)
                assert reading.value is not None
                assert reading.value.raw.strip() == address
        assert {plant.state(name) for name in "abc"} == {DriveState.ONLINE}
        settled_s = plant.now_s
        await work(plant, 60)
        assert sum(plant.misses(name, settled_s) for name in "abc") == 0

    three = [*TWO, ("c", 3, "8200vector")]
    with_plant(test, roster_text(three, drive="cyclic: [{code: C0009, every: 300ms}]"))


def test_a_slow_drive_s_writes_and_watchdog_are_kept_too() -> None:
    async def test(plant: Plant) -> None:
        slow_down(plant, "b", 3.0, most_s=LIMIT_S)
        await work(plant, 240)
        assert plant.state("b") is DriveState.ONLINE
        report = await plant.site.operations.write("b", Code(46), 12, expires_s=None, verify=True)
        assert report.outcome == "verified"
        lapses = plant.site.schedule.stats(plant.now_s).feeds["b"].lapses
        await work(plant, 60)
        assert plant.site.schedule.stats(plant.now_s).feeds["b"].lapses == lapses
        assert plant.site.schedule.stats(plant.now_s).feeds["a"].lapses == 0

    watched = "watchdog: {time: 2s, action: inhibit, configure: true}"
    with_plant(test, roster_text(TWO, drive=watched))


def test_twice_the_same_virtual_line_is_twice_the_same() -> None:
    seen: list[list[tuple[float, str]]] = []

    async def test(plant: Plant) -> None:
        slow_down(plant, "b", 3.0)
        await work(plant, 60)
        seen.append([(one.result.ended_s, one.result.kind.value) for one in plant.reports])

    for _ in range(2):
        with_plant(test, roster_text(TWO), faults="late=0.05:0.2s", seed=5, spread=0.3)
    assert seen[0] == seen[1]
    assert len(seen[0]) > 50
