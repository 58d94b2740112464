"""Stored parameters: not written when they are there already, not too often, counted for ever."""

from __future__ import annotations

from decimal import Decimal

import anyio
import pytest

from lecombus.drives import family
from lecombus.errors import OperationError
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.lecom.simulator.receiver import ReceivedRequest
from lecombus.operations.operation_reports import WriteReport
from lecombus.operations.wear import counts, wears
from lecombus.parameters import Code
from lecombus.saved_state import State
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, with_plant

TWO = [("a", 11, "8200vector"), ("b", 12, "8200vector")]
RAMP, SETPOINT, ENABLE, UNKNOWN = Code(12), Code(46), Code(40), Code(469)
LIMIT = "stored_writes: {burst: 3, every: 10min}"
WRITABLE = f"cyclic: [], {LIMIT}, writable: [C0012, C0037, C0040, C0043, C0046, C0469, C2012]"
ROSTER = roster_text(TWO, drive=WRITABLE)


async def write(plant: Plant, value: object, code: Code = RAMP, **more: bool) -> WriteReport:
    return await plant.site.operations.write("a", code, value, **more)  # type: ignore[arg-type]


def worn(plant: Plant, number: int = 12) -> int:
    """How often the simulated drive's own memory was written."""
    return plant.line["a"].model.params.wear.get((number, 0), 0)


def counted(plant: Plant, drive: str = "a") -> dict[str, int]:
    return {one.code: one.writes for one in plant.site.operations.wear(drive).codes}


def test_what_is_there_already_is_not_written() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert (await write(plant, 7)).outcome is Outcome.DONE
        again = await write(plant, "7.0")
        assert (again.outcome, again.reason) == (Outcome.DONE, "already there, not written")
        assert again.reading is not None
        assert again.reading.value is not None
        assert again.reading.value.number == Decimal(7)
        assert (await write(plant, 7, verify=True)).outcome is Outcome.VERIFIED
        assert worn(plant) == 1
        assert counted(plant) == {"C0012": 1}

    with_plant(test, ROSTER)


def test_setpoints_and_switches_are_always_sent_and_never_counted() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        for _ in range(5):
            for code, value in ((SETPOINT, 20), (ENABLE, 1)):
                report = await write(plant, value, code)
                assert (report.outcome, report.reason) == (Outcome.DONE, "")
        sent = [one for one in plant.sent_to(11) if b"\x02" in one.data]
        assert len(sent) == 10
        assert counted(plant) == {}

    with_plant(test, ROSTER)


def test_a_code_is_written_no_oftener_than_the_roster_allows() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        for value in (1, 2, 3):
            assert (await write(plant, value)).outcome is Outcome.DONE
        with pytest.raises(OperationError, match="stored in the drive at every write") as caught:
            await write(plant, 4)
        assert caught.value.kind == "too-many-writes"
        assert caught.value.retry_after_s == pytest.approx(600, abs=2)
        assert "10min" in caught.value.remedy
        assert worn(plant) == 3
        assert (await write(plant, 3)).reason == "already there, not written"
        assert (await write(plant, 4, Code(2012))).outcome is Outcome.DONE, "another code"
        await anyio.sleep(caught.value.retry_after_s or 0.0)
        assert (await write(plant, 4)).outcome is Outcome.DONE
        with pytest.raises(OperationError):
            await write(plant, 5)
        await anyio.sleep(3600)
        for value in (1, 2, 3):
            assert (await write(plant, value)).outcome is Outcome.DONE

    with_plant(test, ROSTER)


def test_without_a_limit_nothing_is_refused() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        for value in range(50):
            assert (await write(plant, value)).outcome is Outcome.DONE

    with_plant(test, ROSTER.replace("every: 10min", "every: 0"))


def test_a_write_whose_answer_was_lost_counts_and_a_refused_one_does_not() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert (await write(plant, 5000)).outcome is Outcome.REFUSED
        assert counted(plant) == {}

        def lose_from_the_write_on(at_s: float, heard: ReceivedRequest) -> None:
            if heard.text is not None:
                plant.line.drive_faults[11] = Faults(lost=1.0)

        plant.line.on_request = lose_from_the_write_on
        assert (await write(plant, 9)).outcome is Outcome.UNKNOWN
        assert counted(plant)["C0012"] >= 1
        assert worn(plant) <= counted(plant)["C0012"]

    with_plant(test, ROSTER)


def test_a_group_writes_only_to_the_members_that_hold_another_value() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await write(plant, 7)
        report = await plant.site.operations.write_group("pair", RAMP, 7)
        assert [one.reason for one in report.members] == ["already there, not written", ""]
        assert (counted(plant), counted(plant, "b")) == ({"C0012": 1}, {"C0012": 1})
        report = await plant.site.operations.write_group("pair", RAMP, 7)
        assert report.outcome is Outcome.DONE
        assert (counted(plant), counted(plant, "b")) == ({"C0012": 1}, {"C0012": 1})
        for value in (1, 2):
            await write(plant, value)
        with pytest.raises(OperationError, match="C0012 of a"):
            await plant.site.operations.write_group("pair", RAMP, 8)
        assert counted(plant, "b") == {"C0012": 1}, "nothing was sent to any member"

    drives = [*TWO, ("c", 13, "8200vector")]
    groups = "\ngroups: {pair: {members: [a, b]}}"
    with_plant(test, roster_text(drives, drive=WRITABLE, sections=groups))


def test_a_multicast_of_a_stored_parameter_counts_for_every_member() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        report = await plant.site.operations.write_group("all", RAMP, 7)
        assert (report.how, report.outcome) == ("multicast", Outcome.VERIFIED)
        again = await plant.site.operations.write_group("all", RAMP, 7)
        assert {one.reason for one in again.members} == {"already there, not written"}
        assert (counted(plant), counted(plant, "b")) == ({"C0012": 1}, {"C0012": 1})

    with_plant(test, roster_text(TWO, drive=WRITABLE, sections="\ngroups: {all: {multicast: yes}}"))


def test_counts_go_on_from_before_and_stand_on_the_metrics_page() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await write(plant, 7)
        await write(plant, 3, UNKNOWN)
        page = (await plant.site.metrics.fresh_page(openmetrics=False)).decode()
        label = 'lecombus_parameter_writes_total{line="test",drive="a",code='
        assert f'{label}"C0012"}} 42' in page
        assert f'{label}"other"}} 0' in page, "the drive has no C0469 and said so"
        report = plant.site.operations.wear("a")
        assert (report.codes[0].writes, report.codes[0].to_this_device) == (42, 2)

    state = State()
    state.drive("a").writes["C0012"] = 41
    state.drive("a").writes_before["C0012"] = 40
    with_plant(test, ROSTER, state=state)


def test_a_93xx_wears_when_it_saves_and_only_then() -> None:
    servo, other = family("93xx"), family("generic")
    assert not wears(servo, RAMP)
    assert wears(servo, Code(3))
    assert not counts(other, RAMP), "nothing is known of it: its setpoint may be anywhere"
    assert counts(family("821x"), UNKNOWN)
    assert not wears(family("821x"), UNKNOWN)
    assert not wears(family("821x"), Code(1923)), "the module forgets it"
