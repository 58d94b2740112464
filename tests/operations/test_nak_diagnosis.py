"""A refusal says its likely cause, after one look that hurts nobody."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import anyio
import pytest

from lecombus.api.answers import problem_of, report_problem
from lecombus.drive_state.readings import DriveState, Quality
from lecombus.drives import StopAction
from lecombus.errors import NakError, UnknownCodeError
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.lecom.simulator.parameters import ExtendedError
from lecombus.operations.operation_reports import WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.golden import Golden
from support.rosters import roster_text
from support.site_host import Plant, with_plant

FAMILIES = [
    ("vector", 11, "8200vector"), ("belt", 12, "821x"), ("pump", 13, "820x"),
    ("servo", 21, "93xx"), ("fan", 22, "smvector"),
]  # fmt: skip
ALL = (
    "writable: [C0001, C0005, C0011, C0012, C0037, C0040, C0046, C0135, C0141]"
    ", cyclic: [{code: C0050, every: 2s}]"
)
SMV = "writable: [C0037, C0040, C0135, C0140, C1061], cyclic: [{code: C0050, every: 2s}]"


def roster(*names: str) -> str:
    drives = [one for one in FAMILIES if one[0] in names]
    text = ""
    for one in drives:
        text = text or roster_text(drives, drive=SMV if one[2] == "smvector" else ALL)
    return text


def tried(
    name: str,
    code: int,
    value: int | str,
    *,
    before: Callable[[Plant], None] = lambda plant: None,
    verify: bool = False,
    more: str = "",
) -> WriteReport:
    """Write a code of a drive that was made ready for it, and give the report."""
    reports: list[WriteReport] = []

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(5.0)  # what is read when the line has time has been read
        before(plant)
        reports.append(await plant.site.operations.write(name, Code(code), value, verify=verify))

    with_plant(test, roster(name).replace(", family:", f"{more}, family:"))
    return reports[0]


def preset(name: str, code: int, text: str) -> Callable[[Plant], None]:
    return lambda plant: plant.line[name].model.preset(code, text)


def enabled(name: str) -> Callable[[Plant], None]:
    return lambda plant: plant.line[name].model.preset(40, "1")


@pytest.mark.parametrize("name", ["vector", "belt", "pump"])
@pytest.mark.parametrize(("code", "value"), [(46, 20), (135, "H0000")])
def test_control_without_c0001_3_is_told_by_what_the_drive_says(
    name: str, code: int, value: int | str
) -> None:
    report = tried(name, code, value, before=preset(name, 1, "0"))
    assert (report.outcome, report.kind) == (Outcome.REFUSED, "nak")
    assert "C0001 is not 3" in report.cause
    assert "C0001 reads 0" in report.cause
    assert report.remedy.startswith("set C0001 to 3")
    assert "add C0001 to `also_writable`" in report.remedy, "`writable` would replace the list"
    problem = report_problem(report)
    assert problem is not None
    assert (problem.cause, problem.remedy) == (report.cause, report.remedy)


def test_a_setpoint_in_per_cent_makes_c0046_read_only() -> None:
    report = tried("belt", 46, 20, before=preset("belt", 127, "1"))
    assert "C0127 is 1" in report.cause
    assert "C0141" in report.remedy


def test_a_code_that_is_read_only_is_told_without_asking_the_drive(golden: Golden) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        report = await plant.site.operations.write("servo", Code(46), 20)
        golden(report.cause)
        sent = [one.data for one in plant.sent_to(21)]
        assert not [one for one in sent if b"68" in one[3:5]]

    with_plant(test, roster("servo"))


def test_a_value_out_of_range_is_told_with_what_is_allowed(golden: Golden) -> None:
    report = tried("vector", 46, 999, more=", unchecked: [C0046]")
    golden(report.cause, report.remedy)


def test_a_code_that_needs_inhibit_is_told_so() -> None:
    report = tried("servo", 5, 5001, before=enabled("servo"))
    assert "only while the controller is inhibited" in report.cause
    assert "inhibit the drive" in report.remedy


def test_an_820x_that_is_enabled_acknowledges_and_does_not_store() -> None:
    report = tried("pump", 12, 7, before=enabled("pump"), verify=True)
    assert (report.outcome, report.kind) == (Outcome.REFUSED, "not-in-effect")
    assert "only while the controller is inhibited, and it is not (C0150 reads" in report.cause


@pytest.mark.parametrize(
    ("level", "code", "value", "needs"),
    [("0", 1061, 20, "P420 = 2"), ("1", 140, 20, "P420 = 2"), ("2", 40, 1, "P420 = 3"),
     ("0", 37, 20, "P420 is 0")],
)  # fmt: skip
def test_an_smvector_names_the_level_of_p420_that_is_missing(
    level: str, code: int, value: int, needs: str
) -> None:
    report = tried("fan", code, value, before=preset("fan", 1420, level))
    assert needs in report.cause
    assert f"P420 reads {level}" in report.cause
    assert "P420" in report.remedy


def test_an_smvector_with_its_network_terminal_open_says_so() -> None:
    def open_terminals(plant: Plant) -> None:
        for number in (1121, 1122, 1123):
            plant.line["fan"].model.preset(number, "0")

    report = tried("fan", 1061, 20, before=open_terminals)
    assert report.outcome is Outcome.REFUSED
    assert "Network Enabled" in report.cause


def test_a_read_of_a_code_that_is_not_there_says_what_may_be_the_matter() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        with pytest.raises(UnknownCodeError) as caught:
            await plant.site.operations.read("vector", Code(4711))
        problem = problem_of(caught.value, drive="vector", code="C4711")
        assert "description of this family does not know" in problem.cause
        assert "check the number" in problem.remedy
        with pytest.raises(UnknownCodeError) as caught:
            await plant.site.operations.read("vector", Code(161, 7))
        assert "no such subcode" in caught.value.cause

    with_plant(test, roster("vector"))


def test_a_read_that_is_refused_by_nak_says_what_may_be_the_matter_and_the_drive_is_there() -> None:
    """A device of another maker that answers NAK where others say that they lack a code."""

    async def test(plant: Plant) -> None:
        plant.line.faults.nak_reads = True
        await plant.online()
        with pytest.raises(NakError) as caught:
            await plant.site.operations.read("counter", Code(4711))
        problem = problem_of(caught.value, drive="counter", code="C4711")
        assert (problem.status, problem.kind) == (409, "nak")
        assert "does not have this code, or the question was damaged" in problem.cause
        assert "check the number" in problem.remedy
        await anyio.sleep(60.0)
        assert plant.site.store.drive("counter").state is DriveState.ONLINE
        reading = plant.site.store.reading("counter", Code(6000))
        assert reading is not None
        assert (reading.quality, reading.reason) == (
            Quality.BAD, "the drive refused the read (NAK)",
        )  # fmt: skip
        outcomes = {one.result.kind.value for one in plant.reports}
        assert outcomes == {"answered"}

    drives = [("counter", 31, "generic"), ("vector", 11, "8200vector")]
    with_plant(test, roster_text(drives, drive="cyclic: [{code: C6000, every: 1s}]"))


def test_a_drive_that_is_silent_is_not_given_a_cause_of_its_own() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.drive_faults[11] = plant.line.faults.__class__(lost=1.0)
        report = await plant.site.operations.write("vector", Code(46), 20)
        assert report.cause == ""

    with_plant(test, roster("vector"))


@pytest.mark.parametrize(("name", "code"), [("fan", 1061), ("fan", 37), ("servo", 12)])
def test_a_nak_without_a_reason_may_mean_that_the_telegrams_were_damaged(
    name: str, code: int
) -> None:
    def refuse(plant: Plant) -> None:
        if name == "fan":
            plant.line[name].model.preset(1420, "3")
        refusing_all(plant, name)

    report = tried(name, code, 20, before=refuse)
    assert (report.outcome, report.kind) == (Outcome.REFUSED, "nak")
    assert report.cause.endswith("or the telegrams were damaged on the line")
    assert "refused the write twice (NAK)" in report.reason
    assert "attempt" not in report.reason


def test_a_nak_with_a_reason_is_not_said_to_be_damage() -> None:
    report = tried("fan", 37, 20, before=preset("fan", 1420, "0"))
    assert "damaged" not in report.cause


# -- what C1962 proves -------------------------------------------------------------------------


def refusing_all(plant: Plant, name: str) -> None:
    """Let a drive say NAK without a reason to writes; C1962 stays as it is."""
    plant.line.drive_faults[plant.line[name].address] = Faults(nak=1.0)


@pytest.mark.parametrize("answered", [True, False])
def test_a_number_that_a_read_of_no_such_code_left_proves_nothing(answered: bool) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        if answered:
            await operations.read("vector", Code(46))
        with pytest.raises(UnknownCodeError):
            await operations.read("vector", Code(777))
        refusing_all(plant, "vector")
        report = await operations.write("vector", Code(46), 20)
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "nak")
        assert ("no such code" in report.cause) is not answered
        assert "C1962" not in report.cause
        assert answered or report.cause.startswith("probably ")

    with_plant(test, roster("vector"))


@pytest.mark.parametrize("extended", [ExtendedError.VALUE_RANGE, ExtendedError.PARITY])
def test_a_number_of_an_access_to_another_code_is_named_as_possible_only(
    extended: ExtendedError,
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        refusing_all(plant, "vector")
        plant.line["vector"].model.extended_fault = extended
        first = await operations.write("vector", Code(37), 20)
        assert f"(C1962 reads {int(extended)})" in first.cause
        for _ in range(2):
            await anyio.sleep(11.0)  # longer than a cause is remembered
            second = await operations.write("vector", Code(12), 7)
            assert second.cause.startswith("probably ")
            assert "C1962" not in second.cause
        plant.line["vector"].model.extended_fault = ExtendedError.OPERATING_STATE
        await anyio.sleep(11.0)
        third = await operations.write("vector", Code(12), 8)
        assert "(C1962 reads 7)" in third.cause

    with_plant(test, roster("vector"))


def test_what_is_asked_does_not_depend_on_what_c1962_proves() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        with pytest.raises(UnknownCodeError):
            await operations.read("vector", Code(777))
        refusing_all(plant, "vector")
        started_s = plant.now_s
        await operations.write("vector", Code(46), 20)
        assert looks(plant, started_s) == 2, "C0068 and C1962"

    with_plant(test, roster("vector"))


# -- the look costs little ---------------------------------------------------------------------


def looks(plant: Plant, since_s: float) -> int:
    """Reads of C0068, C1962 and C0001 since a time: none of them is cyclic here."""
    return sum(
        1 for one in plant.reports
        if one.result.started_s >= since_s and one.step.kind.value == "read"
        and one.step.code in (Code(68), Code(1962), Code(1))
    )  # fmt: skip


def with_refusing(test: Callable[[Plant], Awaitable[None]]) -> None:
    """Run a test with a drive that refuses its setpoint."""

    async def main(plant: Plant) -> None:
        await plant.online()
        plant.line["vector"].model.preset(1, "0")
        await anyio.sleep(5.0)
        await test(plant)

    with_plant(main, roster("vector", "belt"))


def test_the_same_refusal_again_is_answered_from_memory() -> None:
    async def test(plant: Plant) -> None:
        started_s = plant.now_s
        first = await plant.site.operations.write("vector", Code(46), 20)
        once = looks(plant, started_s)
        assert 1 <= once <= 4
        second = await plant.site.operations.write("vector", Code(46), 20)
        assert second.cause == first.cause
        assert looks(plant, started_s) == once

    with_refusing(test)


def test_two_drives_that_refuse_one_after_the_other_are_both_asked() -> None:
    async def test(plant: Plant) -> None:
        plant.line["belt"].model.preset(1, "2")
        for name, reads in (("vector", "0"), ("belt", "2")):
            report = await plant.site.operations.write(name, Code(46), 20)
            assert f"C0001 reads {reads}" in report.cause

    with_refusing(test)


def test_a_flood_of_refused_writes_hardly_loads_the_line() -> None:
    async def test(plant: Plant) -> None:
        started_s = plant.now_s

        async def flood(base: int) -> None:
            for number in range(40):
                word = f"H{16 * (base + number):04X}"
                report = await plant.site.operations.write("vector", Code(135), word)
                assert "C0001" in report.cause

        async with anyio.create_task_group() as tasks:
            for base in (0, 100, 200, 300):
                tasks.start_soon(flood, base)
        took_s = plant.now_s - started_s
        asked = looks(plant, started_s)
        assert asked <= 16 + took_s / 0.3
        assert asked < 160 / 4

    with_refusing(test)


def test_no_look_is_made_while_a_stop_waits_and_none_holds_one_up() -> None:
    async def test(plant: Plant) -> None:
        started_s = plant.now_s
        ops = plant.site.operations
        refused = asyncio.ensure_future(ops.write("vector", Code(46), 20))
        await anyio.sleep(0.005)
        stops = [
            asyncio.ensure_future(ops.stop(StopAction.INHIBIT, name)) for name in ("vector", "belt")
        ]
        reports = [await stop for stop in stops]
        assert all(one.outcome is Outcome.VERIFIED for one in reports)
        last_stop_s = max(
            one.result.ended_s for one in plant.reports if one.priority.name == "STOP"
        )
        between = [
            one for one in plant.reports
            if started_s <= one.result.started_s < last_stop_s
            and one.step.code in (Code(68), Code(1962), Code(1))
            and one.priority.name == "CYCLIC"
        ]  # fmt: skip
        assert between == []
        assert (await refused).outcome in (Outcome.REFUSED, Outcome.SUPERSEDED)

    with_refusing(test)


def test_a_look_that_gets_no_turn_ends_in_a_second_and_the_cause_is_named_all_the_same() -> None:
    async def test(plant: Plant) -> None:
        plant.line.drive_faults[11] = plant.line.faults.__class__()
        requests = plant.site.requests
        read = requests.read

        async def never(*args: object, timeout_s: float = 10.0, **more: object) -> object:
            await anyio.sleep(timeout_s)
            return await read(*args, timeout_s=timeout_s, **more)  # type: ignore[arg-type]

        requests.read = never  # type: ignore[method-assign, assignment]
        started_s = plant.now_s
        report = await plant.site.operations.write("vector", Code(46), 20)
        assert plant.now_s - started_s < 1.5
        assert "C0001 is not 3" in report.cause

    with_refusing(test)


def test_a_group_asks_one_of_its_drives() -> None:
    async def test(plant: Plant) -> None:
        plant.line["belt"].model.preset(1, "0")
        started_s = plant.now_s
        report = await plant.site.operations.write_group("all", Code(46), 20)
        assert {one.kind for one in report.members} <= {"not-in-effect", "nak"}
        assert all("C0001" in one.cause for one in report.members)
        assert looks(plant, started_s) <= 4

    with_refusing(test)
