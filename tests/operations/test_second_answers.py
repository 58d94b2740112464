"""A stop is not said to be verified because of a second copy of a neighbour's answer.

Lines on which answers are delivered twice, up to 3 s late, or on which two drives have one address;
some drives are dead. `late_answer` is at its default.
"""

from __future__ import annotations

import anyio
import pytest

from lecombus.drives import StopAction
from lecombus.operations.reports import GroupReport
from lecombus.readings import LineState
from lecombus.schedule import Outcome
from lecombus.simulator.faults import parse_faults
from support.site_host import Plant, roster_of, with_plant

FAMILIES = ("8200vector", "821x", "822x", "smvector", "93xx", "8200vector", "820x", "824x")
DRIVES = [(f"d{n}", 11 + n, family) for n, family in enumerate(FAMILIES)]
DEAD = ("d3", "d5")

DOUBLES = ["double=1:20ms-3s", "double=1:20ms-500ms", "double=0.5:10ms-100ms", "twins=13"]


def stopped(faults: str, seed: int, action: StopAction, dead_for_s: float) -> GroupReport:
    """Stop all drives of a line, some of which have been dead for a time."""
    reports: list[GroupReport] = []

    async def test(plant: Plant) -> None:
        await plant.online(within_s=600.0)
        plant.line.faults = parse_faults(faults)
        await anyio.sleep(2.0)
        for name in DEAD:
            plant.line[name].present = False
        await anyio.sleep(dead_for_s)
        reports.append(await plant.site.operations.stop(action, "all"))

    with_plant(test, roster_of(DRIVES), seed=seed)
    return reports[0]


@pytest.mark.parametrize("dead_for_s", [0.0, 0.4, 5.0])
@pytest.mark.parametrize("action", StopAction)
@pytest.mark.parametrize("faults", DOUBLES)
def test_a_dead_drive_is_never_said_to_be_stopped(
    faults: str, action: StopAction, dead_for_s: float
) -> None:
    for seed in range(3):
        report = stopped(faults, seed, action, dead_for_s)
        ended = {one.drive: one.outcome for one in report.members}
        assert not [name for name in DEAD if ended[name] is Outcome.VERIFIED], (seed, report)
        living = [name for name in ended if name not in DEAD and ended[name] is Outcome.VERIFIED]
        assert len(living) == len(DRIVES) - len(DEAD), (seed, report)


@pytest.mark.long
@pytest.mark.parametrize("faults", DOUBLES)
def test_nor_in_many_lines(faults: str) -> None:
    for seed in range(100, 200):
        for action in StopAction:
            for dead_for_s in (0.0, 0.3, 2.0):
                report = stopped(faults, seed, action, dead_for_s)
                wrong = [one for one in report.members
                         if one.drive in DEAD and one.outcome is Outcome.VERIFIED]  # fmt: skip
                assert not wrong, (seed, action, dead_for_s, report)


def remarks(faults: str, seconds: float = 20.0) -> tuple[dict[str, str], str]:
    found: dict[str, str] = {}
    line: list[str] = []

    async def test(plant: Plant) -> None:
        await plant.online(within_s=600.0)
        assert plant.site.store.line().state is LineState.OPEN
        plant.line.faults = parse_faults(faults)
        for _ in range(int(seconds)):
            await anyio.sleep(1.0)
            plant.site.note_cadence()
        for name, _, _ in DRIVES:
            text = plant.site.store.drive(name).remarks.get("second-answers")
            if text:
                found[name] = text
        line.append(plant.site.store.line().remarks.get("second-answers", ""))

    with_plant(test, roster_of(DRIVES, drive=", cyclic: [{code: C0150, every: 3s}]"))
    return found, line[0]


def test_two_drives_at_one_address_are_a_remark() -> None:
    found, line = remarks("twins=13")
    assert list(found) == ["d2"]
    assert found["d2"].startswith("two drives at address 13? second answers came after its own, ")
    assert not line


def test_answers_that_come_twice_from_everybody_are_a_remark_of_the_line() -> None:
    found, line = remarks("double=1:20ms-3s")
    assert not found
    assert "that nobody asked for: two drives at one address, an adapter" in line


def test_a_healthy_line_has_no_such_remark() -> None:
    assert remarks("lost=0.05,late=0.05:0.4s") == ({}, "")
