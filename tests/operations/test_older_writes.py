"""A write that is said again, because it was not answered, undoes no later one that went out first.

A multicast waits for no late acknowledgement, and where a drive knows one addressing form only, the
proof of a write may have to wait longer than another write does.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable

import anyio
import pytest

from lecombus.drives import StopAction, Verb
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

DRIVE = "cyclic: [{code: C0150, every: 60s}], writable: [C0040, C0046, C0135]"
GROUPS = "groups:\n  two: {members: [a, b], multicast: yes}\n"


def roster(family: str, drive: str = DRIVE) -> str:
    return roster_text([("a", 11, family), ("b", 12, family)], drive=drive, sections=GROUPS)


async def unheard_until_read(plant: Plant, code: int, value: int | str) -> asyncio.Task[object]:
    """Write to a drive that hears nothing until it was asked for its value once."""
    begin_s = plant.now_s
    plant.line.drive_faults[11] = Faults(unheard=1.0)
    writing = asyncio.create_task(plant.site.operations.write("a", Code(code), value))

    async def heals() -> None:
        await until(lambda: b"\x0411%s\x05" % READ_AS[code] in said(plant, begin_s))
        await anyio.sleep(0.02)
        plant.line.drive_faults[11] = Faults()

    plant.healing = asyncio.create_task(heals())  # type: ignore[attr-defined]
    await anyio.sleep(0.01)
    return writing


READ_AS = {40: b"40", 46: b"46", 135: b"=5"}


def said(plant: Plant, since_s: float) -> list[bytes]:
    return [one.data for one in plant.end.sent if one.at_s >= since_s]


def check(text: str, older: tuple[int, int | str], later: str, then: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations, (code, value) = plant.site.operations, older
        stopped = await operations.stop(StopAction.INHIBIT, "two")
        assert stopped.outcome is Outcome.VERIFIED
        begin_s = plant.now_s
        writing = await unheard_until_read(plant, code, value)
        laters: dict[str, Awaitable[object]] = {
            "group": operations.write_group("two", Code(code), then),
            "plain": operations.write("a", Code(code), then),
            "word": operations.write("a", Code(135), then),
        }
        for name, one in laters.items():
            if name != later:
                one.close()  # type: ignore[attr-defined]
        report = await laters[later]
        assert report.outcome.is_good  # type: ignore[attr-defined]
        ended = await writing
        await anyio.sleep(3.0)
        if (code, then) == (46, "10"):
            assert plant.line["a"].text(46) == "10"
        else:
            assert plant.line["a"].model.inhibited()
        telegram = b"\x0411\x02%s%s\x03" % (READ_AS[code], str(value).encode())
        times = sum(one.startswith(telegram) for one in said(plant, begin_s))
        assert times == 1, "it was not said again"
        assert ended.outcome is Outcome.UNKNOWN  # type: ignore[attr-defined]
        assert "it was sent before, and not proven" in ended.reason  # type: ignore[attr-defined]

    with_plant(test, text)


@pytest.mark.parametrize(("older", "then"), [((40, 1), "0"), ((46, 40), "10")])
def test_an_older_write_is_not_said_again_behind_a_multicast(
    older: tuple[int, int | str], then: str
) -> None:
    check(roster("821x"), older, "group", then)


@pytest.mark.parametrize("family", ["93xx", "smvector"])
@pytest.mark.parametrize(
    ("older", "later", "then"),
    [((40, 1), "plain", "0"), ((40, 1), "word", "H0200"), ((135, "H0000"), "plain", "H0200")],
)
def test_an_older_write_is_not_said_again_behind_one_that_stops_the_drive(
    older: tuple[int, int | str], later: str, then: str, family: str
) -> None:
    drive = DRIVE.replace("C0046, ", "") + ", addressing: standard"
    check(roster(family, drive), older, later, then)


@pytest.mark.parametrize("family", ["821x", "8200vector", "93xx"])
@pytest.mark.parametrize(
    ("older", "later", "word"),
    [
        ((135, "H0008"), (40, "0"), 0x0208),
        ((135, "H0008"), (135, "H0000"), 0x0000),
        ((40, "0"), (40, "1"), 0x0000),
    ],
)
def test_a_stop_without_acknowledgement_is_not_said_again_behind_a_later_write_of_the_group(
    older: tuple[int, str], later: tuple[int, str], word: int, family: str
) -> None:
    """It would lift the inhibit, or stop the drive behind its start."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(5.0)
        operations = plant.site.operations
        for name in "ab":
            assert (await operations.verb(name, Verb.ENABLE)).outcome is Outcome.VERIFIED
        plant.line.drive_faults[11] = Faults(lost=1.0)  # it hears the write; its answer is lost
        writing = asyncio.create_task(operations.write("a", Code(older[0]), older[1]))
        await anyio.sleep(0.05)
        plant.line.drive_faults[11] = Faults()
        await anyio.sleep(0.2)
        begin_s = plant.now_s
        report = await operations.write_group("two", Code(later[0]), later[1])
        assert report.outcome is Outcome.VERIFIED
        ended = await writing
        await anyio.sleep(3.0)
        assert plant.line["a"].text(135) == f"H{word:04X}"
        telegrams = said(plant, begin_s)
        group = next(at for at, one in enumerate(telegrams) if one.startswith(b"\x0410\x02"))
        assert not any(one.startswith(b"\x0411\x02") for one in telegrams[group:])
        assert ended.outcome is Outcome.UNKNOWN

    with_plant(test, roster(family))


def test_an_inhibit_without_acknowledgement_is_said_again_behind_a_later_quick_stop() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        writing = await unheard_until_read(plant, 40, "0")
        assert (await operations.write("a", Code(135), "H0008")).outcome.is_good
        assert (await writing).outcome.is_good  # type: ignore[attr-defined]
        assert plant.line["a"].model.inhibited()

    with_plant(test, roster("93xx", DRIVE.replace("C0046, ", "") + ", addressing: standard"))


@pytest.mark.parametrize("later", [(40, "0"), (135, "H0008")])
def test_a_groups_quick_stop_that_waits_is_sent_behind_a_stop_of_some_of_its_members(
    later: tuple[int, str],
) -> None:
    """It is the only stop of the others."""
    drives = [("a", 11, "8200vector"), ("b", 12, "8200vector"), ("c", 21, "8200vector")]
    groups = "groups:\n  two: {members: [a, b], multicast: yes}\n"
    groups += "  every: {members: [a, b, c], multicast: yes}\n"

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(5.0)
        operations = plant.site.operations
        assert (await operations.verb("c", Verb.ENABLE)).outcome is Outcome.VERIFIED
        plant.site.schedule.hold("c", plant.now_s + 0.05, plant.now_s)  # as after a write
        group = asyncio.create_task(operations.write_group("every", Code(135), "H0008"))
        await anyio.sleep(0.001)
        assert (await operations.write_group("two", Code(later[0]), later[1])) is not None
        await group
        assert plant.line["c"].text(135) == "H0008"

    with_plant(test, roster_text(drives, drive=DRIVE, sections=groups))
