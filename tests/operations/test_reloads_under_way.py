"""A reload in the middle of a write: nothing more is sent to a drive that left or is another.

After a write without an answer come its proof and, perhaps, the write once more. By then the
address may be that of another drive, and a group's multicast may reach drives that it must not.
"""

from __future__ import annotations

import asyncio

import anyio
import pytest

from lecombus.drives import StopAction
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.operations.operation_reports import GroupReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import Wanted, roster_text
from support.site_host import Plant, until, with_plant

A, B, C = ("a", 11, "821x"), ("b", 12, "821x"), ("c", 13, "821x")
MULTICAST = "groups:\n  two: {members: [a, b], multicast: yes}\n"
ONE_BY_ONE = "groups:\n  two: {members: [a, b]}\n"
ENABLE = b"\x0411\x02401"


def roster(drives: list[Wanted], groups: str = "") -> str:
    drive = "cyclic: [{code: C0150, every: 1s}], writable: [C0040, C0046]"
    return roster_text(drives, drive=drive, sections=groups)


@pytest.mark.parametrize(
    "now", [[B], [("a", 15, "821x"), B], [("a", 12, "821x"), ("b", 11, "821x")]],
    ids=["removed", "moved", "exchanged"],
)  # fmt: skip
def test_a_write_is_not_said_again_behind_a_reload_that_took_its_drive_out(
    now: list[Wanted],
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        assert (await operations.stop(StopAction.INHIBIT, "a")).outcome is Outcome.VERIFIED
        plant.line.drive_faults[11] = Faults(unheard=1.0)
        writing = asyncio.create_task(operations.write("a", Code(40), 1))
        await until(lambda: plant.is_asking(ENABLE))
        await anyio.sleep(0.02)  # it has passed the drive, and is waited for
        plant.apply(roster(now))
        said = len(plant.end.sent)
        plant.line.drive_faults[11] = Faults()
        report = await writing
        assert report.outcome is Outcome.UNKNOWN
        assert report.reason.endswith("it was sent before, and not proven")
        await anyio.sleep(3.0)
        assert not [one for one in plant.end.sent[said:] if one.data.startswith(ENABLE)]
        assert plant.line["a"].model.inhibited()

    with_plant(test, roster([A, B]))


@pytest.mark.parametrize(
    "now", [roster([A, B], ONE_BY_ONE), roster([A, B, C], ONE_BY_ONE), roster([A])],
    ids=["one by one", "another drive", "member removed"],
)  # fmt: skip
def test_a_multicast_that_waits_is_not_sent_to_a_group_that_was_changed(now: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        waits_until_s = plant.now_s + 0.3  # as a module that acknowledges early
        plant.site.schedule.hold("a", waits_until_s, plant.now_s)
        said = len(plant.end.sent)
        writing = asyncio.create_task(plant.site.operations.write_group("two", Code(46), 10))
        await anyio.sleep(0.05)
        plant.apply(now)
        report = await writing
        assert report.how == "multicast"
        assert [one.outcome for one in report.members] == [Outcome.REFUSED] * 2
        await anyio.sleep(1.0)
        assert not [one for one in plant.end.sent[said:] if one.data[1:3] == b"10"]

    with_plant(test, roster([A, B], MULTICAST))


def test_one_that_waits_is_sent_behind_a_reload_that_changes_nothing_of_it() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.site.schedule.hold("a", plant.now_s + 0.3, plant.now_s)
        writing = asyncio.create_task(plant.site.operations.write_group("two", Code(46), 10))
        await anyio.sleep(0.05)
        plant.apply(roster([A, B], MULTICAST).replace("every: 1s", "every: 2s"))
        assert (await writing).outcome is Outcome.VERIFIED

    with_plant(test, roster([A, B], MULTICAST))


def test_a_member_that_is_removed_before_it_was_read_back_keeps_no_other_from_its_outcome() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        writing: asyncio.Task[GroupReport] = asyncio.create_task(
            plant.site.operations.write_group("two", Code(46), 10)
        )
        await until(lambda: plant.is_asking(b"\x0411!002E00") or plant.is_asking(b"\x041146"))
        plant.apply(roster([A]))
        report = await writing
        ended = {one.drive: one.outcome for one in report.members}
        assert ended["a"] is Outcome.VERIFIED
        assert ended["b"] in (Outcome.UNKNOWN, Outcome.VERIFIED)

    with_plant(test, roster([A, B], MULTICAST))
