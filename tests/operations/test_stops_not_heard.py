"""A drive that something else than the line holds is not stopped because it reads as stopped.

It was enabled by the line, its enable terminal was opened since, and it has not taken the stop: its
motor starts when the terminal is closed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import anyio
import pytest

from lecombus.drives import StopAction, Verb
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.operations.operation_reports import GroupReport, WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

FAMILIES = ["821x", "8200vector", "93xx"]
INHIBIT = StopAction.INHIBIT


def roster(family: str, line: str = "") -> str:
    return roster_text(
        [("a", 11, family), ("b", 12, family)], line=line,
        drive="cyclic: [{code: C0150, every: 1s}]",
        sections="groups:\n  two: {members: [a, b]}\n",
    )  # fmt: skip


def stopped_behind_its_terminal(
    text: str, stop: Callable[[Plant], Awaitable[GroupReport | WriteReport]], *, outcome: Outcome
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        enabled = await plant.site.operations.verb("a", Verb.ENABLE)
        assert enabled.outcome is Outcome.VERIFIED
        plant.line["a"].set_terminal(high=False)
        await anyio.sleep(3.0)
        report = await stop(plant)
        report = report.members[0] if isinstance(report, GroupReport) else report
        assert report.outcome is outcome
        if not outcome.is_good:
            assert "refused it (NAK): something else may hold it" in report.reason
            return
        plant.line["a"].set_terminal(high=True)
        await anyio.sleep(1.0)
        assert plant.line["a"].model.inhibited()

    with_plant(test, text)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_multicast_that_such_a_drive_did_not_hear_is_made_good(family: str) -> None:
    async def stop(plant: Plant) -> GroupReport:
        said = len(plant.end.sent)
        plant.line.drive_faults[11] = Faults(unheard=1.0)
        stopping = asyncio.create_task(plant.site.operations.stop(INHIBIT, "two"))
        await until(lambda: any(one.data[1:3] == b"10" for one in plant.end.sent[said:]))
        plant.line.drive_faults[11] = Faults()
        return await stopping

    stopped_behind_its_terminal(roster(family), stop, outcome=Outcome.VERIFIED)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("retries", [0, 2])
def test_a_stop_that_such_a_drive_refuses_is_not_proven(family: str, retries: int) -> None:
    async def stop(plant: Plant) -> GroupReport:
        plant.line.drive_faults[11] = Faults(nak=1.0)
        return await plant.site.operations.stop(INHIBIT, "a")

    text = roster(family, f"retries: {retries}")
    stopped_behind_its_terminal(text, stop, outcome=Outcome.UNKNOWN)


@pytest.mark.parametrize("family", FAMILIES)
def test_one_that_it_refuses_once_is_said_again_until_it_takes_it(family: str) -> None:
    """One damaged telegram, on a line that repeats nothing."""

    async def stop(plant: Plant) -> GroupReport:
        plant.line.drive_faults[11] = Faults(nak=1.0)
        stopping = asyncio.create_task(plant.site.operations.stop(INHIBIT, "a"))
        await until(lambda: any(b"\x0411\x02400" in one.data for one in plant.end.sent))
        await anyio.sleep(0.05)
        plant.line.drive_faults[11] = Faults()
        return await stopping

    stopped_behind_its_terminal(roster(family, "retries: 0"), stop, outcome=Outcome.VERIFIED)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("target", ["a", "two"])
def test_a_plain_write_that_inhibits_is_not_proven_by_what_something_else_does(
    family: str, target: str
) -> None:
    async def stop(plant: Plant) -> GroupReport | WriteReport:
        said, operations = len(plant.end.sent), plant.site.operations
        plant.line.drive_faults[11] = Faults(unheard=1.0)
        writing: asyncio.Task[GroupReport | WriteReport] = asyncio.ensure_future(
            operations.write("a", Code(40), 0)
            if target == "a"
            else operations.write_group("two", Code(40), 0)
        )
        await until(lambda: any(b"\x02" in one.data for one in plant.end.sent[said:]))
        await anyio.sleep(0.02)
        plant.line.drive_faults[11] = Faults()
        return await writing

    outcome = Outcome.DONE if target == "a" else Outcome.VERIFIED
    stopped_behind_its_terminal(roster(family), stop, outcome=outcome)


def test_of_drives_that_the_line_has_stopped_itself_none_is_stopped_again() -> None:
    """A group that is inhibited is inhibited again with one telegram."""

    async def test(plant: Plant) -> None:
        await plant.online()
        for _ in range(2):
            said = len(plant.end.sent)
            assert (await plant.site.operations.stop(INHIBIT, "two")).outcome is Outcome.VERIFIED
        assert [one.data[1:3] for one in plant.end.sent[said:] if b"\x02" in one.data] == [b"10"]

    with_plant(test, roster("821x"))
