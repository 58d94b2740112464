"""Who may be written to: the drive that was there, spoken to as it hears, with software known."""

from __future__ import annotations

import logging

import anyio
import pytest

from lecombus.drive_state.readings import DriveState, Quality
from lecombus.drives import StopAction
from lecombus.errors import OperationError
from lecombus.fieldbus.lecom.simulator.faults import parse_faults
from lecombus.fieldbus.lecom.simulator.parameters import CommError, ExtendedError, Refusal
from lecombus.parameters import Code
from lecombus.saved_state import DriveFacts, State
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

ONE = [("a", 11, "8200vector")]
WRITABLE = "writable: [C0012, C0046, C0135]"
ROSTER = roster_text(ONE, drive=WRITABLE)
MODULE, SETPOINT = Code(1810), Code(46)


def lock(plant: Plant, drive: str = "a") -> str:
    return plant.site.store.drive(drive).write_lock or ""


async def write(plant: Plant) -> Outcome:
    return (await plant.site.operations.write("a", SETPOINT, 20, verify=True)).outcome


def make_another(plant: Plant, drive: str = "a", text: str = "S33S2102I_20000") -> None:
    """Put another device in a drive's place."""
    plant.line[drive].model.params.set(1810, text)


async def leave_and_return(plant: Plant, drive: str = "a") -> None:
    plant.line[drive].power_cycle(plant.now_s, 20.0)
    await until(lambda: plant.state(drive).value == "offline")
    await plant.online(drive)


def written(plant: Plant, drive: str = "a") -> list[int]:
    return [entry.code for entry in plant.line[drive].log if entry.kind == "write"]


def test_what_a_drive_says_first_is_recorded_and_shown() -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await plant.online()
        info = plant.site.store.drive("a")
        assert info.identity["C1810"] == "33S2102I_10000"
        assert info.identity["C0200"] == "82S8212V_30000"
        assert state.drive("a").identity == dict(info.identity)
        assert state.changes == 1
        assert lock(plant) == ""
        await leave_and_return(plant)
        assert state.changes == 1, "the same again is not a news"
        assert await write(plant) is Outcome.VERIFIED

    with_plant(test, ROSTER, state=state)


def test_a_swapped_drive_is_not_written_to_until_it_is_accepted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    watchdog = "{time: 2s, action: quick-stop, configure: true}"

    async def test(plant: Plant) -> None:
        await plant.online()
        make_another(plant)
        since = len(written(plant))
        await leave_and_return(plant)
        assert "C1810 reads 33S2102I_20000, not 33S2102I_10000" in lock(plant)
        assert "lecombus accept a" in lock(plant)
        remark = plant.site.store.drive("a").remarks["watchdog"]
        assert remark.startswith("the drive's watchdog is off, the roster says quick-stop after 2")
        assert remark.endswith(": it is set when the drive may be written to again")
        with pytest.raises(OperationError) as caught:
            await write(plant)
        assert caught.value.kind == "locked"
        assert written(plant)[since:] == [], "its watchdog is not set either"
        stopped = await plant.site.operations.stop(StopAction.QUICK_STOP, "a")
        assert stopped.outcome is Outcome.VERIFIED, "a stop always goes"
        found = plant.site.operations.identity("a").found
        with pytest.raises(OperationError, match="not C1810 nonsense"):
            plant.site.operations.accept("a", {"C1810": "nonsense"})
        assert lock(plant)
        assert plant.site.operations.accept("a", found).problem == ""
        assert lock(plant) == ""
        assert await write(plant) is Outcome.VERIFIED
        await until(lambda: 1922 in written(plant)[since:])
        await leave_and_return(plant)
        assert lock(plant) == ""
        assert state.drive("a").writes_before == {"C0012": 9}

    state = State({"a": DriveFacts(writes={"C0012": 9})})
    with caplog.at_level(logging.INFO):
        with_plant(test, roster_text(ONE, drive=WRITABLE, watchdog=watchdog), state=state)
    events = [record.getMessage() for record in caplog.records]
    assert len([one for one in events if "event=drive-swapped" in one]) == 1
    assert len([one for one in events if "event=identity-accepted" in one]) == 1


def test_a_swapped_smvector_is_told_by_the_parameter_that_its_keypad_shows() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        with pytest.raises(OperationError, match=r"^P426 of a cannot take 9: "):
            await plant.site.operations.write("a", Code(1426), 9)
        plant.line["a"].model.params.set(1502, "8")
        await leave_and_return(plant)
        assert "P502 reads 8, not 25" in lock(plant)

    with_plant(test, roster_text([("a", 11, "smvector")], drive="also_writable: [C1426]"))


def test_a_drive_that_any_read_shows_to_be_another_is_audited_anew() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        make_another(plant)
        assert await write(plant) is Outcome.VERIFIED, "nobody has asked it yet"
        await plant.site.operations.read("a", Code(1810))
        assert plant.state("a") is DriveState.STARTING
        with pytest.raises(OperationError) as caught:
            await write(plant)
        assert caught.value.kind == "starting"
        await plant.online()
        assert "C1810 reads 33S2102I_20000, not 33S2102I_10000" in lock(plant)
        await plant.site.operations.read("a", Code(1810))
        assert plant.state("a") is DriveState.ONLINE, "what is known already is not a news"

    with_plant(test, ROSTER)


def test_a_record_from_before_the_start_counts() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert "C1810 reads 33S2102I_10000, not 33S2102I_09000" in lock(plant)

    state = State({"a": DriveFacts(identity={"C1810": "33S2102I_09000"})})
    with_plant(test, ROSTER, state=state)


def test_what_cannot_be_read_is_no_swap_and_stays_on_record() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()

        def refuse(subcode: int) -> str:
            raise Refusal(CommError.INVALID_CODE, ExtendedError.CODE)

        plant.line["a"].model.readers[1810] = refuse
        await leave_and_return(plant)
        assert lock(plant) == ""
        assert plant.site.state.drive("a").identity["C1810"] == "33S2102I_10000"

    with_plant(test, ROSTER)


def test_the_rosters_word_goes_before_the_record() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert lock(plant) == "", "the roster accepts it"
        assert state.drive("a").identity["C1810"] == "33S2102I_10000"
        plant.apply(ROSTER.replace(WRITABLE, f"{WRITABLE}, identity: {{C1810: OTHER}}"))
        await plant.online()
        assert "the roster says OTHER" in lock(plant)
        assert "correct `identity` in the roster" in lock(plant)
        with pytest.raises(OperationError, match="the roster says otherwise of C1810"):
            plant.site.operations.accept("a", plant.site.operations.identity("a").found)
        plant.apply(ROSTER)
        await plant.online()
        assert lock(plant) == ""

    state = State({"a": DriveFacts(identity={"C1810": "33S2102I_09000"})})
    by_roster = ROSTER.replace(WRITABLE, f"{WRITABLE}, identity: {{C1810: 33S2102I_10000}}")
    with_plant(test, by_roster, state=state)


def test_a_difference_that_a_second_look_does_not_confirm_is_none() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        asked = 0

        def once_wrong(subcode: int) -> str:
            nonlocal asked
            asked += 1
            return "S33S2102I_1000p" if asked == 1 else "S33S2102I_10000"

        plant.line["a"].model.readers[1810] = once_wrong
        await leave_and_return(plant)
        assert asked == 2
        assert lock(plant) == ""

    with_plant(test, ROSTER)


def test_a_smvector_of_other_software_is_locked_until_the_roster_accepts_it() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(1494, "1.30")
        await plant.online()
        assert "accept_software: ['1.30']" in lock(plant)
        with pytest.raises(OperationError) as caught:
            await plant.site.operations.write("a", Code(1061), 20)
        assert caught.value.kind == "locked"
        assert "P494 reads software 1.30" in str(caught.value)
        plant.apply(roster_text(drives, drive="accept_software: [1.3]"))
        await plant.online()
        assert lock(plant) == ""

    drives = [("a", 11, "smvector")]
    with_plant(test, roster_text(drives))


@pytest.mark.parametrize(("number", "value"), [(249, "4"), (248, "1")])
def test_with_a_code_bank_or_input_selection_extended_addressing_is_used(
    number: int, value: str
) -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(number, value)
        await plant.online()
        remarks = plant.site.store.drive("a").remarks
        assert f"C0{number} is {value}" in remarks["addressing-moved"]
        assert lock(plant) == ""
        assert await write(plant) is Outcome.VERIFIED
        assert plant.line["a"].model.params.text(46) == "20"
        await anyio.sleep(3.0)
        reading = plant.site.store.reading("a", Code(150))
        assert reading is not None
        assert reading.quality is Quality.GOOD
        since_s = plant.now_s
        stopped = await plant.site.operations.stop(StopAction.QUICK_STOP, "all")
        assert stopped.outcome is Outcome.VERIFIED
        group = plant.sent_to(10, since_s) + plant.sent_to(0, since_s)
        assert all(b"!" in one.data for one in group), "standard addressing would miss the drive"
        await leave_and_return(plant)
        assert "addressing-moved" not in plant.site.store.drive("a").remarks
        assert plant.site.requests.station("a").forms == plant.site.drives.get("a").entry.forms

    with_plant(test, ROSTER)


def test_where_extended_addressing_is_ruled_out_nothing_is_believed_and_nothing_written() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(249, "4")
        await plant.online()
        assert "C0249 is 4" in lock(plant)
        await anyio.sleep(3.0)
        reading = plant.site.store.reading("a", Code(150))
        assert reading is not None
        assert reading.quality is Quality.BAD
        assert "not what was asked" in str(reading.reason)
        with pytest.raises(OperationError, match="nothing is written to a"):
            await write(plant)
        plant.line["a"].model.preset(249, "0")
        await until(lambda: lock(plant) == "", within_s=600.0)
        assert await write(plant) is Outcome.VERIFIED

    with_plant(test, roster_text(ONE, drive=f"{WRITABLE}, addressing: standard"))


def test_standard_addressing_is_used_again_when_another_master_has_put_it_back() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(249, "4")
        await plant.online()
        assert "addressing-moved" in plant.site.store.drive("a").remarks
        plant.line["a"].model.preset(249, "0")
        await anyio.sleep(600.0)
        assert "addressing-moved" not in plant.site.store.drive("a").remarks
        assert plant.site.requests.station("a").forms == plant.site.drives.get("a").entry.forms

    with_plant(test, ROSTER)


def test_a_drive_whose_identity_the_line_has_no_time_for_works_all_the_same() -> None:
    """Reading a string may hold the line for longer than the others' watchdogs can wait."""
    drives = [(f"d{address}", address, "smvector") for address in range(1, 5)]
    roster = roster_text(
        drives, baud=1200, watchdog="{time: 2000ms, action: quick-stop}", line="tolerate: 0"
    )

    async def test(plant: Plant) -> None:
        for drive in plant.line.drives:
            drive.model.params.set(1425, "2000")
            drive.model.params.set(1426, "2")
        await plant.online()
        remarks = plant.site.store.drive("d1").remarks.values()
        assert any("who it is cannot be checked" in text for text in remarks), remarks
        assert plant.site.store.drive("d1").write_lock is None
        assert all(drive.watchdog_fired <= 1 for drive in plant.line.drives)

    with_plant(test, roster)


@pytest.mark.parametrize(
    ("baud", "time_ms"), [(1200, 300), (1200, 400), (1200, 500), (9600, 60), (9600, 150)]
)
def test_a_drive_whose_feed_takes_much_of_its_watchdog_time_comes_online(
    baud: int, time_ms: int
) -> None:
    """Its own feed goes before a longer exchange with it, but not for ever."""
    watchdog = f"{{time: {time_ms}ms, action: quick-stop}}"
    roster = roster_text([("a", 11, "smvector")], baud=baud, line="tolerate: 0", watchdog=watchdog)

    async def test(plant: Plant) -> None:
        plant.line["a"].model.params.set(1425, str(time_ms))
        plant.line["a"].model.params.set(1426, "2")
        await plant.online()
        assert plant.site.store.drive("a").write_lock is None
        assert plant.line["a"].watchdog_fired <= 1

    with_plant(test, roster)


def test_a_seldom_asked_drive_that_was_swapped_between_two_failures_is_locked() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(30.0)
        plant.line.faults.absent = {11}
        await until(lambda: plant.state("a").value == "degraded")
        await anyio.sleep(21.0)
        assert plant.state("a").value == "degraded"
        make_another(plant)
        plant.line.faults.absent = set()
        since = len(written(plant))
        reading = await plant.site.operations.read("a", Code(150))
        assert reading.quality is Quality.GOOD
        with pytest.raises(OperationError) as caught:
            await write(plant)
        assert caught.value.kind in ("starting", "locked")
        await until(lambda: lock(plant) != "")
        assert written(plant)[since:] == []

    seldom = f"{WRITABLE}, cyclic: [{{code: C0150, every: 20s}}]"
    with_plant(test, roster_text(ONE, drive=seldom))


def test_a_device_that_is_asked_no_more_who_it_is_may_be_written_to() -> None:
    device = [("a", 11, "generic")]

    async def test(plant: Plant) -> None:
        await plant.online()
        assert "the roster says x" in lock(plant)
        plant.apply(roster_text(device))
        await plant.online()
        assert lock(plant) == ""

    with_plant(test, roster_text(device, drive="identity: {C0200: x}"))


@pytest.mark.parametrize(
    ("family", "faults"), [("93xx", "double=0.5:10ms-100ms"), ("821x", "double=1:20ms-500ms")]
)
@pytest.mark.parametrize("recorded", [False, True])
def test_a_second_answer_is_not_taken_for_who_another_drive_is(
    family: str, faults: str, *, recorded: bool
) -> None:
    """All drives are asked at once; copies were recorded, and locked the drives later."""
    names = [f"d{one}" for one in range(8)]
    own = {name: f"{name}-250601" for name in names}
    before = {name: DriveFacts(identity={"C0201": text}) for name, text in own.items()}
    state = State(before if recorded else {})

    async def test(plant: Plant) -> None:
        for name, text in own.items():
            plant.line[name].model.params.set(201, f"S{text}")
        await plant.online(within_s=120.0)
        found = {name: state.drive(name).identity.get("C0201", "none") for name in names}
        assert not [name for name in names if found[name] not in (own[name], "none")]
        assert list(found.values()).count("none") <= 2
        assert [lock(plant, name) for name in names] == [""] * 8

    drives = [(name, 11 + place, family) for place, name in enumerate(names)]
    with_plant(test, roster_text(drives, baud=9600), faults=faults, state=state)


def test_a_drive_that_was_swapped_is_found_where_answers_come_twice() -> None:
    state = State({name: DriveFacts(identity={"C1810": "33S2102I_10000"}) for name in "ab"})

    async def test(plant: Plant) -> None:
        make_another(plant, "b")
        await plant.online()
        assert lock(plant, "a") == ""
        assert "C1810 reads 33S2102I_20000, not 33S2102I_10000" in lock(plant, "b")

    two = [("a", 11, "8200vector"), ("b", 12, "8200vector")]
    with_plant(test, roster_text(two), faults="double=1:6ms-18ms", state=state)


@pytest.mark.parametrize(
    "faults", ["double=0.3:6ms-18ms,lost=0.15", "double=0.05:20ms-100ms,lost=0.1"]
)
def test_a_swapped_drive_stays_locked_where_answers_come_twice_and_some_are_lost(
    faults: str,
) -> None:
    """What it reads could not be confirmed, counted as not read, and the lock was taken back."""
    names = [f"d{one}" for one in range(8)]

    def run(seed: int) -> None:
        async def test(plant: Plant) -> None:
            await plant.online(within_s=300.0)
            for name in names[::3]:
                make_another(plant, name)
            await replug(plant, 6.0)
            await plant.online(within_s=300.0)
            assert all(lock(plant, name) for name in names[::3])
            plant.line.faults = parse_faults(faults)
            await anyio.sleep(20.0)
            await replug(plant, 1.0)
            await plant.online(within_s=600.0)
            assert all(lock(plant, name) for name in names[::3]), seed

        drives = [(name, 11 + place, "8200vector") for place, name in enumerate(names)]
        with_plant(test, roster_text(drives, baud=9600), seed=seed, state=State())

    for seed in range(10):
        run(seed)


@pytest.mark.parametrize(
    ("family", "faults"), [("8200vector", "double=1:50ms-300ms"), ("93xx", "double=1:6ms-18ms")]
)
def test_a_moved_addressing_is_not_hidden_by_a_neighbours_second_answer(
    family: str, faults: str
) -> None:
    names = [f"d{one}" for one in range(8)]

    def run(seed: int) -> None:
        async def test(plant: Plant) -> None:
            for name in names[::3]:
                plant.line[name].model.params.set(249, "1")
            await plant.online(within_s=600.0)
            for name in names[::3]:
                assert "addressing-moved" in plant.site.store.drive(name).remarks, (seed, name)

        drives = [(name, 11 + place, family) for place, name in enumerate(names)]
        with_plant(test, roster_text(drives, baud=9600), faults=faults, seed=seed, state=State())

    for seed in range(6):
        run(seed)


async def replug(plant: Plant, after_s: float) -> None:
    plant.end.unplug()
    await anyio.sleep(after_s)
    plant.end.replug()
    await until(lambda: plant.site.worker.is_open)
    await anyio.sleep(1.0)
