"""What the restore of a backup may write, and that nothing else is opened by it."""

from __future__ import annotations

import pytest

from lecombus.errors import OperationError
from lecombus.parameters import Code
from lecombus.schedule import Outcome, Priority
from support.rosters import roster_text
from support.site_host import Plant, with_plant

DOG = "{time: 5s, action: inhibit, configure: true}"
OPEN = roster_text(
    [("a", 11, "8200vector"), ("b", 12, "93xx")], watchdog=DOG, drive="restore: true"
)
SHUT = roster_text([("a", 11, "8200vector")])


def test_a_setting_that_is_not_writable_is_restored_where_the_roster_permits_it() -> None:
    async def test(plant: Plant) -> None:
        await plant.online("a")
        write = plant.site.operations.write
        with pytest.raises(OperationError, match="not writable"):
            await write("a", Code(11), 60)
        report = await write(
            "a", Code(2011), 60, verify=True, restoring=True, urgency=Priority.BACKGROUND
        )
        assert report.outcome is Outcome.VERIFIED
        assert plant.line.drives[0].text(2011) == "60"

    with_plant(test, OPEN)


@pytest.mark.parametrize(
    ("drive", "code", "value", "why"),
    [
        ("a", 46, "20", "process value"),
        ("a", 40, "1", "process value"),
        ("a", 9, "12", "address"),
        ("a", 14, "1", "no description"),
        ("a", 1923, "60", "the roster sets it"),
        ("b", 3, "2", "saves"),
    ],
)
def test_a_restore_opens_nothing_but_settings(drive: str, code: int, value: str, why: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online(drive)
        with pytest.raises(OperationError, match=why) as caught:
            await plant.site.operations.write(drive, Code(code), value, restoring=True)
        assert caught.value.kind == "not-writable"

    with_plant(test, OPEN)


def test_only_the_value_that_saves_the_starting_set_is_written_to_save() -> None:
    async def test(plant: Plant) -> None:
        await plant.online("b")
        report = await plant.site.operations.write("b", Code(3), "1", restoring=True)
        assert report.outcome is Outcome.DONE

    with_plant(test, OPEN)


def test_without_the_rosters_word_nothing_is_restored() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        rights = plant.site.operations.restore_rights("a")
        assert (rights.permitted, rights.owned) == (False, ())
        assert "restore: true" in rights.remedy
        with pytest.raises(OperationError, match="does not let a be restored"):
            await plant.site.operations.write("a", Code(11), 60, restoring=True)

    with_plant(test, SHUT)
