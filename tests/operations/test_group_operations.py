"""Groups: one telegram where that reaches exactly the members, a report for each."""

from __future__ import annotations

import asyncio

import anyio
import anyio.lowlevel
import pytest

from lecombus.drive_state.readings import DriveState
from lecombus.errors import OperationError, QueueFullError
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.parameters import Code
from lecombus.schedule import Outcome, Priority
from operations.groups import (
    CAUTIOUS,
    ENABLE,
    INHIBIT,
    MODULE,
    PLAIN,
    ROSTER,
    SETPOINT,
    STATUS,
    WORD,
    WRITABLE,
    written,
)
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant


def test_a_group_that_is_a_decade_goes_out_as_one_telegram_and_every_member_is_read_back() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        said = len(plant.end.sent)
        report = await plant.site.operations.write_group("teens", SETPOINT, 20)
        assert (report.how, report.outcome) == ("multicast", Outcome.VERIFIED)
        assert [member.outcome for member in report.members] == [Outcome.VERIFIED] * 3
        assert written(plant, said) == [b"10"]
        assert [plant.line[name].text(46) for name in "abc"] == ["20"] * 3

    with_plant(test, ROSTER)


@pytest.mark.parametrize(
    ("code", "value"), [(SETPOINT, 20), (ENABLE, 1), (WORD, 0), (WORD, "H0208"), (PLAIN, 60)]
)
def test_what_is_no_stop_goes_one_by_one_where_other_drives_may_hear_a_multicast(
    code: Code, value: int | str
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        said = len(plant.end.sent)
        report = await plant.site.operations.write_group("teens", code, value)
        assert (report.how, report.outcome) == ("one-by-one", Outcome.DONE)
        assert b"10" not in written(plant, said)
        said = len(plant.end.sent)
        report = await plant.site.operations.write_group("teens", ENABLE, 0)
        assert (report.how, report.outcome) == ("multicast", Outcome.VERIFIED)
        assert written(plant, said) == [b"10"]
        assert (await plant.site.operations.stop(INHIBIT, "teens")).how == "multicast"

    with_plant(test, CAUTIOUS)


def test_another_group_goes_out_one_by_one() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        said = len(plant.end.sent)
        report = await plant.site.operations.write_group("two", SETPOINT, 20)
        assert (report.how, report.outcome) == ("one-by-one", Outcome.DONE)
        assert written(plant, said) == [b"11", b"12"]

    with_plant(test, ROSTER)


def test_a_member_the_multicast_did_not_reach_is_named() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.drive_faults[12] = Faults(unheard=1.0)
        asked = asyncio.create_task(plant.site.operations.write_group("teens", SETPOINT, 20))
        await until(lambda: bool(written(plant, 0)) and written(plant, 0)[-1] == b"10")
        await anyio.sleep(0.02)
        plant.line.drive_faults.clear()
        report = await asked
        outcomes = {member.drive: member.outcome for member in report.members}
        assert outcomes == {"a": Outcome.VERIFIED, "b": Outcome.REFUSED, "c": Outcome.VERIFIED}
        assert report.outcome is Outcome.REFUSED
        assert {member.kind for member in report.members} == {"", "not-in-effect"}

    with_plant(test, ROSTER)


def test_an_edge_said_by_multicast_that_reads_otherwise_may_still_have_happened() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        report = await plant.site.operations.write_group("teens", WORD, "H0A00")
        assert report.how == "multicast"
        for name in "abc":
            plant.line[name].model.readers[135] = lambda _: "H0200"
        report = await plant.site.operations.write_group("teens", WORD, "H0A00")
        assert {member.outcome for member in report.members} == {Outcome.UNKNOWN}

    with_plant(test, ROSTER)


def test_a_multicast_that_was_not_sent_says_why_for_every_member() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        busy = [asyncio.create_task(plant.site.operations.read("a", STATUS)) for _ in range(9)]
        await anyio.sleep(0.001)
        report = await plant.site.operations.write_group("teens", MODULE, 1, expires_s=0.03)
        assert {(one.outcome, one.kind) for one in report.members} == {(Outcome.EXPIRED, "expired")}
        setting = asyncio.create_task(plant.site.operations.write_group("teens", SETPOINT, 20))
        await anyio.lowlevel.checkpoint()
        await plant.site.operations.stop(INHIBIT, "a")
        report = await setting
        kinds = {(one.outcome, one.kind) for one in report.members}
        assert kinds == {(Outcome.SUPERSEDED, "superseded")}
        await asyncio.gather(*busy)
        report_task = asyncio.create_task(plant.site.operations.write_group("teens", MODULE, 1))
        await anyio.sleep(0.001)
        plant.end.unplug()
        report = await report_task
        assert {one.kind for one in report.members} == {"line-lost"}

    with_plant(test, ROSTER)


def test_digits_for_a_word_are_refused_for_a_group_before_anything_is_sent() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        said = len(plant.end.sent)
        for group in ("teens", "two"):
            with pytest.raises(OperationError, match=r"H0208 \(520\) or decimal 208 \(H00D0\)"):
                await plant.site.operations.write_group(group, WORD, "0208")
        assert written(plant, said) == []

    with_plant(test, ROSTER)


def test_one_member_that_may_not_be_written_keeps_everything_from_being_sent() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.faults.absent = {13}
        for _ in range(2):
            with pytest.raises(Exception, match="c"):
                await plant.site.operations.read("c", STATUS)
        assert plant.state("c") is DriveState.OFFLINE
        said = len(plant.end.sent)
        with pytest.raises(OperationError, match="c is offline"):
            await plant.site.operations.write_group("teens", SETPOINT, 20)
        assert written(plant, said) == []

    with_plant(test, ROSTER)


def fill(plant: Plant, *, leave: int) -> None:
    """Fill the interactive queue up to a few places."""
    requests = plant.site.requests
    station = requests.station("d")
    for _ in range(2000 - leave):
        requests.worker.submit(requests.maker.read(station, STATUS, Priority.INTERACTIVE))


def test_a_queue_that_fills_up_half_way_leaves_no_member_without_a_report() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        fill(plant, leave=1)
        report = await plant.site.operations.write_group("two", MODULE, 1)
        first, second = report.members
        assert (first.drive, first.outcome) == ("a", Outcome.DONE)
        assert (second.drive, second.outcome, second.kind) == ("b", Outcome.REFUSED, "queue-full")
        assert plant.line["b"].text(1920) != "1"
        assert report.outcome is Outcome.REFUSED

    with_plant(test, ROSTER)


def test_a_queue_that_is_full_from_the_beginning_is_an_error_and_nothing_is_sent() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        fill(plant, leave=0)
        with pytest.raises(QueueFullError):
            await plant.site.operations.write_group("two", MODULE, 1)

    with_plant(test, ROSTER)


def test_groups_that_do_not_exist_are_named_with_those_that_do() -> None:
    async def test(plant: Plant) -> None:
        with pytest.raises(OperationError, match="no group 'x'") as caught:
            await plant.site.operations.write_group("x", SETPOINT, 20)
        assert "teens" in caught.value.remedy
        with pytest.raises(OperationError) as caught:
            await plant.site.operations.stop(INHIBIT, "x")
        assert caught.value.kind == "no-such-drive"
        assert {info.name for info in plant.site.operations.groups()} == {"teens", "two", "all"}

    with_plant(test, ROSTER)


@pytest.mark.parametrize(
    ("time_ms", "code", "how"),
    [
        (1104, SETPOINT, "multicast"),
        (1104, ENABLE, "one-by-one"),
        (1400, ENABLE, "multicast"),
    ],
)
def test_a_group_is_written_to_one_by_one_where_the_watchdogs_leave_no_room_for_a_multicast(
    time_ms: int, code: Code, how: str
) -> None:
    """It feeds no drive, and two 820X may be left alone after it; C0040 takes them 230 ms, too."""
    roster = roster_text(
        [("a", 1, "820x"), ("b", 2, "820x")], drive=WRITABLE,
        watchdog=f"{{time: {time_ms}ms, action: quick-stop, configure: true}}",
        sections="groups: {all: {multicast: yes}}",
    )  # fmt: skip

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(10.0)
        report = await plant.site.operations.write_group("all", code, 1, verify=True)
        assert (report.how, report.outcome) == (how, Outcome.VERIFIED)
        await anyio.sleep(5.0)
        assert [plant.line[name].model.watchdog_fired for name in "ab"] == [0, 0]

    with_plant(test, roster)
