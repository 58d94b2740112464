"""Another address: asked first, written once, found again, followed; or put back, or said."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

import anyio
import pytest

from lecombus.config import DriveEntry
from lecombus.drive_state.readings import DriveState
from lecombus.drives import StopAction, Verb
from lecombus.errors import OperationError
from lecombus.fieldbus.lecom.simulator.drive import SimDrive
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.lecom.simulator.receiver import ReceivedRequest
from lecombus.fieldbus.requests import Station
from lecombus.operations.awaited_requests import CAME_S, IS_GONE
from lecombus.operations.operation_reports import WriteReport
from lecombus.parameters import Code, Value
from lecombus.saved_state import State
from lecombus.schedule import Outcome, Request
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

DRIVES = [("a", 11, "8200vector"), ("b", 12, "8200vector"), ("v", 21, "smvector")]
ALLOW = "allow_address_change: true"
GROUPS = "\ngroups: {teens: {members: [a, b]}}"
ROSTER = roster_text(DRIVES, drive=ALLOW, sections=GROUPS)
WRITES = roster_text(DRIVES, drive=f"{ALLOW}, also_writable: [C0040, C0135]")


async def ready(plant: Plant) -> None:
    await plant.online()
    await plant.site.operations.stop(StopAction.INHIBIT, "all")


async def change(plant: Plant, address: int, drive: str = "a") -> WriteReport:
    return await plant.site.operations.readdress(drive, address)


async def refused(plant: Plant, address: int, drive: str = "a") -> OperationError:
    written = [one for one in plant.end.sent if b"\x02" in one.data]
    with pytest.raises(OperationError) as caught:
        await change(plant, address, drive)
    assert [one for one in plant.end.sent if b"\x02" in one.data] == written, "nothing is changed"
    return caught.value


def remark(plant: Plant, drive: str = "a") -> str:
    return plant.site.store.drive(drive).remarks.get("address", "")


def entry(plant: Plant, drive: str = "a") -> DriveEntry:
    found = plant.site.roster.drive(drive)
    assert found is not None
    return found


@pytest.mark.parametrize(("drive", "number"), [("a", 9), ("v", 1410)])
def test_a_drive_is_found_at_its_new_address_and_followed(drive: str, number: int) -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await ready(plant)
        old = entry(plant, drive).address
        report = await change(plant, 35, drive)
        assert (report.outcome, report.code) == (Outcome.VERIFIED, Code(number))
        assert "address: 35" in report.remedy
        assert plant.line[drive].address == 35
        assert "moved to address 35 at 20" in remark(plant, drive)
        await plant.online(drive, within_s=20)
        assert plant.site.store.drive(drive).address == 35
        assert remark(plant, drive), "it stands until the roster says the same"
        since_s = plant.now_s
        stopped = await plant.site.operations.stop(StopAction.QUICK_STOP, drive)
        assert stopped.outcome is Outcome.VERIFIED
        assert plant.sent_to(old, since_s) == []
        writes = [
            one for one in plant.line[drive].log if one.kind == "write" and one.code == number
        ]
        assert len(writes) == 1
        assert state.drive(drive).moved is not None

    with_plant(test, ROSTER, state=state)


def test_groups_are_judged_anew_and_the_roster_ends_the_remark() -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)
        assert plant.site.roster.groups["teens"].multicast_address == 10
        await change(plant, 22)
        await plant.online()
        groups = {one.name: one.multicast_address for one in plant.site.operations.groups()}
        assert groups["teens"] is None, "its decade's multicast would no longer reach it"
        plant.apply(ROSTER.replace("address: 11", "address: 22"))
        assert plant.state("a") is DriveState.ONLINE, "nothing changed for it"
        assert remark(plant) == ""

    with_plant(test, ROSTER)


def test_after_a_reload_with_the_old_address_the_remark_says_where_it_is() -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)
        await change(plant, 22)
        await plant.online()
        plant.apply(ROSTER)
        assert entry(plant).address == 11
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        assert "moved to address 22" in remark(plant)
        plant.line["a"].model.preset(9, "11")  # at the keypad
        await plant.online("a")
        assert remark(plant) == "", "it is where the roster says"

    with_plant(test, ROSTER)


def test_moved_on_and_back_the_roster_still_says_what_its_file_says() -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)
        await change(plant, 22)
        await plant.online("a", within_s=20)
        report = await change(plant, 35)
        assert "after a restart to 11 again" in report.remedy
        await plant.online("a", within_s=20)
        assert "the roster says 11" in remark(plant)
        report = await change(plant, 11)
        assert (report.outcome, report.remedy) == (Outcome.VERIFIED, "")
        await plant.online("a", within_s=20)
        assert remark(plant) == "", "it is home"

    with_plant(test, ROSTER)


def test_after_a_restart_the_remark_is_still_there() -> None:
    state = State()

    async def before(plant: Plant) -> None:
        await ready(plant)
        await change(plant, 22)

    async def after(plant: Plant) -> None:
        plant.line["a"].model.preset(9, "22")
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        assert "moved to address 22" in remark(plant)

    with_plant(before, ROSTER, state=state)
    with_plant(after, ROSTER, state=State.parse(state.text().encode()))


def test_what_can_be_seen_before_is_refused_before() -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)
        for address in (0, 10, 90, 100, -1):
            assert (await refused(plant, address)).kind == "bad-value"
        assert (await refused(plant, 12)).kind == "address-taken"
        assert (await refused(plant, 11)).kind == "address-taken"
        error = await refused(plant, 44)
        assert error.kind == "address-taken", "a device that the roster does not know answers"
        plant.apply(ROSTER.replace(ALLOW, ""))
        await plant.online()
        assert (await refused(plant, 35)).kind == "not-permitted"

    with_plant(test, ROSTER, also=[("stranger", 44, "generic")])


@pytest.mark.parametrize("left_s", [0.0, 0.01, 0.1])
def test_nothing_is_changed_for_a_client_that_left_before_it_was_written(left_s: float) -> None:
    """What is read first takes a while, and another change may be under way before it."""

    async def test(plant: Plant) -> None:
        await ready(plant)
        gone_s = plant.now_s + left_s
        IS_GONE.set(lambda: plant.now_s >= gone_s)
        assert (await refused(plant, 35)).kind == "client-gone"
        assert plant.line["a"].address == 11

    with_plant(test, ROSTER)


def test_a_change_of_address_that_waits_for_its_turn_is_not_sent_when_its_client_leaves() -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)
        left: list[bool] = []
        IS_GONE.set(lambda: bool(left))
        submit = plant.site.worker.submit

        def leaves(request: Request) -> None:
            submit(request)
            if request.writes:
                left.append(True)

        plant.site.worker.submit = leaves  # type: ignore[method-assign]
        report = await change(plant, 35)
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "client-gone")
        assert plant.line["a"].address == 11

    with_plant(test, ROSTER)


def test_a_damaged_answer_at_the_new_address_is_somebody_too() -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)
        plant.line.drive_faults[44] = Faults(noise=1.0)
        assert (await refused(plant, 44)).kind == "address-taken"

    with_plant(test, ROSTER, also=[("stranger", 44, "generic")])


def test_a_drive_that_turns_is_left_where_it_is() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        write = plant.site.operations.write
        await write("a", Code(135), "H0000")
        await write("a", Code(40), 1)
        await write("a", Code(46), 20)
        assert (await refused(plant, 35)).kind == "not-stopped"
        await anyio.sleep(3.0)
        await plant.site.operations.stop(StopAction.INHIBIT, "a")
        report = await change(plant, 35)
        assert report.outcome is Outcome.VERIFIED
        assert plant.line["a"].model.motor.speed != 0.0
        assert "whether its motor still turns it does not measure" in report.reason

    with_plant(test, ROSTER)


Meanwhile = Callable[[Plant], Awaitable[object]]


async def enabled_at_the_keypad(plant: Plant) -> None:
    plant.line["a"].model.preset(40, "1")
    plant.line["a"].model.preset(135, "H0000")


async def enabled_by_plain_writes(plant: Plant) -> None:
    for code, value in ((135, "H0000"), (40, 1)):
        assert (await plant.site.operations.write("a", Code(code), value)).outcome is Outcome.DONE


@pytest.mark.parametrize("meanwhile", [enabled_at_the_keypad, enabled_by_plain_writes])
def test_one_that_runs_when_its_address_was_saved_is_left_where_it_is(meanwhile: Meanwhile) -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await ready(plant)

        async def saver() -> None:
            await meanwhile(plant)
            await anyio.sleep(1.0)

        state.saver = saver
        with pytest.raises(OperationError) as caught:
            await change(plant, 35)
        assert caught.value.kind == "not-stopped"
        assert plant.line["a"].address == 11
        assert (state.drive("a").moved, remark(plant)) == (None, "")

    with_plant(test, WRITES, state=state)


def test_nor_is_it_written_behind_a_write_that_may_enable_the_drive() -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await ready(plant)
        submit = plant.site.worker.submit
        writing: list[asyncio.Task[WriteReport]] = []

        def enables(request: Request) -> None:
            submit(request)
            if request.writes and not writing:
                ask = plant.site.operations.write("a", Code(40), 1)
                writing.append(asyncio.create_task(ask))

        plant.site.worker.submit = enables  # type: ignore[method-assign]
        with pytest.raises(OperationError, match="a write came that may have enabled it"):
            await change(plant, 35)
        assert (await writing[0]).outcome is Outcome.DONE
        assert plant.line["a"].address == 11
        assert state.drive("a").moved is None

    with_plant(test, WRITES, state=state)


def test_it_is_not_enabled_while_its_address_changes_and_the_other_way_round() -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await ready(plant)
        enable = partial(plant.site.operations.verb, "a", Verb.ENABLE)

        async def saver() -> None:
            with pytest.raises(OperationError, match="readdress of a is under way") as caught:
                await enable()
            assert caught.value.kind == "busy"

        state.saver = saver
        assert (await change(plant, 35)).outcome is Outcome.VERIFIED
        await plant.online("a")
        enabling = asyncio.create_task(enable())
        await anyio.sleep(0.0)
        assert (await refused(plant, 36)).kind == "busy"
        assert (await enabling).outcome is Outcome.VERIFIED

    with_plant(test, WRITES, state=state)


def test_a_drive_that_refuses_stays() -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)
        plant.line.drive_faults[11] = Faults(nak=1.0)
        report = await change(plant, 35)
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "nak")
        assert plant.line["a"].address == 11
        assert remark(plant) == ""

    with_plant(test, ROSTER)


def test_a_write_that_was_not_heard_changes_nothing_and_that_is_found_out() -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)
        heard = plant.line["a"].model.writers.get(9)
        assert heard is None

        def deaf_to_writes(at_s: float, one: ReceivedRequest) -> None:
            plant.line.drive_faults[11] = Faults(unheard=1.0 if one.text is not None else 0.0)

        plant.line.on_request = deaf_to_writes
        report = await change(plant, 35)
        assert report.outcome is Outcome.REFUSED
        assert "nothing was changed" in report.reason
        assert plant.state("a") is DriveState.ONLINE or plant.state("a") is DriveState.DEGRADED

    with_plant(test, ROSTER)


def test_a_drive_that_moves_only_at_its_next_start_is_put_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)
        drive = plant.line["a"]
        monkeypatch.setattr(
            SimDrive, "address", property(lambda self: 11 if self is drive else self._address)
        )
        report = await change(plant, 35)
        assert report.outcome is Outcome.REFUSED
        assert "11 was written back" in report.reason
        assert drive.text(9) == "11"
        assert remark(plant) == ""

    with_plant(test, ROSTER)


def test_a_drive_found_nowhere_is_said_with_what_to_do_and_remembered() -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await ready(plant)

        def vanish_at_the_write(at_s: float, one: ReceivedRequest) -> None:
            if one.text is not None and one.address == 11:
                plant.line["a"].present = False

        plant.line.on_request = vanish_at_the_write
        report = await change(plant, 35)
        assert (report.outcome, report.kind) == (Outcome.UNKNOWN, "no-answer")
        assert "neither there nor at 11" in report.reason
        assert "keypad" in report.remedy
        assert entry(plant).address == 11
        assert "35 was written as its address" in remark(plant)
        moved = state.drive("a").moved
        assert moved is not None
        assert not moved.confirmed
        plant.line.on_request = None
        plant.line["a"].present = True
        plant.line["a"].model.preset(9, "11")
        await until(lambda: plant.state("a") is DriveState.ONLINE, within_s=120)
        assert remark(plant) == "", "it is where it was"

    with_plant(test, ROSTER, state=state)


def test_a_daemon_that_ends_behind_the_write_leaves_word_of_it() -> None:
    state = State()

    async def cut_off(plant: Plant) -> None:
        await ready(plant)
        async with anyio.create_task_group() as tasks:

            def end_at_the_write(at_s: float, one: ReceivedRequest) -> None:
                if one.text is not None and one.address == 11:
                    tasks.cancel_scope.cancel()

            plant.line.on_request = end_at_the_write
            await change(plant, 35)
        assert state.drive("a").moved is not None

    async def next_run(plant: Plant) -> None:
        assert "35 was written as its address" in remark(plant)
        await until(lambda: plant.state("a") is DriveState.ONLINE, within_s=120)
        assert remark(plant) == "", "here it has taken nothing, and is where it was"

    with_plant(cut_off, ROSTER, state=state)
    with_plant(next_run, ROSTER, state=state)


def test_what_changed_nothing_leaves_the_address_before_as_it_was_remembered() -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await ready(plant)
        assert (await change(plant, 35)).outcome is Outcome.VERIFIED
        await until(lambda: plant.state("a") is DriveState.ONLINE)
        await plant.site.operations.stop(StopAction.INHIBIT, "a")
        moved = state.drive("a").moved
        plant.line.drive_faults[35] = Faults(nak=1.0)
        report = await change(plant, 36)
        assert report.outcome is Outcome.REFUSED
        assert moved is not None
        assert state.drive("a").moved == moved

    with_plant(test, ROSTER, state=state)


@pytest.mark.parametrize("first", [False, True])
def test_a_reload_before_a_write_that_is_refused_leaves_no_remark_of_it(*, first: bool) -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await ready(plant)
        if not first:
            assert (await change(plant, 35)).outcome is Outcome.VERIFIED
            await until(lambda: plant.state("a") is DriveState.ONLINE)
            await plant.site.operations.stop(StopAction.INHIBIT, "a")
        text = ROSTER if first else ROSTER.replace("address: 11", "address: 35")

        async def saver() -> None:
            plant.apply(text.replace(GROUPS, ""))
            assert "36 was written as its address" in remark(plant)

        state.saver = saver
        plant.line.drive_faults[plant.line["a"].address] = Faults(nak=1.0)
        assert (await change(plant, 36)).outcome is Outcome.REFUSED
        assert (state.drive("a").moved, remark(plant)) == (None, "")

    with_plant(test, ROSTER, state=state)


def test_nor_does_a_reload_that_takes_the_drive_out() -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await ready(plant)

        async def saver() -> None:
            plant.apply(roster_text(DRIVES[1:], drive=ALLOW))

        state.saver = saver
        assert (await refused(plant, 36)).kind == "no-such-drive"
        assert state.drive("a").moved is None
        plant.apply(ROSTER)
        assert remark(plant) == ""

    with_plant(test, ROSTER, state=state)


def test_a_line_that_is_lost_behind_the_write_leaves_the_outcome_open() -> None:
    async def test(plant: Plant) -> None:
        await ready(plant)

        def cut_at_the_write(at_s: float, one: ReceivedRequest) -> None:
            if one.text is not None and one.address == 11:
                plant.end.unplug()

        plant.line.on_request = cut_at_the_write
        report = await change(plant, 35)
        assert (report.outcome, report.kind) == (Outcome.UNKNOWN, "no-answer")
        assert "35 was written to it" in report.reason
        assert "35 was written as its address" in remark(plant)

    with_plant(test, ROSTER)


@pytest.mark.parametrize(
    ("drive", "code"),
    [("a", 9), ("a", 125), ("a", 1410), ("v", 1410), ("v", 1411), ("v", 1403), ("v", 9),
     ("g", 9), ("g", 125), ("g", 1410), ("g", 1411), ("a", 248), ("v", 249)],
)  # fmt: skip
def test_no_plain_write_moves_a_drive_whatever_the_roster_says(drive: str, code: int) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        with pytest.raises(OperationError, match="never written like other codes") as caught:
            await plant.site.operations.write(drive, Code(code), 1)
        assert caught.value.kind == "not-writable"
        assert ("readdress" in caught.value.remedy) == (code not in (248, 249))

    listed = ", writable: [C0009, C0125, C1410, C1411, C1403, C0248, C0249]"
    drives = [*DRIVES, ("g", 31, "generic")]
    with_plant(test, roster_text(drives, drive=ALLOW + listed))


def test_a_code_bank_of_another_makers_device_is_a_code_like_any_other() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert (await plant.site.operations.write("g", Code(249), 1)).outcome is Outcome.DONE

    with_plant(test, roster_text([("g", 31, "generic")], drive="writable: [C0249]"))


KEEPS = [("a", 11, "93xx"), ("s", 12, "820x")]
KEEPS_ROSTER = roster_text(KEEPS, drive=ALLOW)


def test_a_drive_that_must_be_told_to_save_is_told_and_is_there_after_its_next_start() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        await plant.site.operations.stop(StopAction.INHIBIT, "all")
        report = await change(plant, 35)
        assert report.outcome is Outcome.VERIFIED
        assert report.reason.endswith("it saved that")
        plant.power_cycle("a")
        await anyio.sleep(20.0)
        assert plant.line["a"].address == 35

    with_plant(test, KEEPS_ROSTER)


def test_one_that_does_not_say_that_it_saved_is_found_all_the_same_and_that_is_said() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        await plant.site.operations.stop(StopAction.INHIBIT, "all")
        write = plant.site.requests.write

        async def deaf(station: Station, code: Code, value: Value, **more: Any) -> Any:
            if code == Code(3):
                return Outcome.UNKNOWN, "no answer in time"
            return await write(station, code, value, **more)

        plant.site.requests.write = deaf  # type: ignore[method-assign]
        report = await change(plant, 35)
        assert report.outcome is Outcome.VERIFIED
        assert "did not say that it did" in report.reason
        assert "C0003 = 1" in report.remedy
        assert "address: 35" in report.remedy

    with_plant(test, KEEPS_ROSTER)


def test_a_line_that_is_lost_before_the_save_does_not_hide_that_the_drive_has_moved() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        await plant.site.operations.stop(StopAction.INHIBIT, "all")
        write = plant.site.requests.write

        async def cut(station: Station, code: Code, value: Value, **more: Any) -> Any:
            if code == Code(3):
                plant.end.unplug()
                await anyio.sleep(1.0)
            return await write(station, code, value, **more)

        plant.site.requests.write = cut  # type: ignore[method-assign]
        report = await change(plant, 35)
        assert report.outcome is Outcome.VERIFIED
        assert "did not say that it did" in report.reason
        assert entry(plant).address == 35

    with_plant(test, KEEPS_ROSTER)


def test_an_820x_must_be_inhibited_for_it_stores_nothing_in_quick_stop() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        await plant.site.operations.write("s", Code(135), "H0000")
        await plant.site.operations.write("s", Code(40), 1)
        await plant.site.operations.stop(StopAction.QUICK_STOP, "s")
        error = await refused(plant, 35, "s")
        assert error.kind == "not-stopped"
        assert "would not store its address" in str(error)
        await plant.site.operations.stop(StopAction.INHIBIT, "s")
        report = await change(plant, 35, "s")
        assert report.outcome is Outcome.VERIFIED
        plant.power_cycle("s")
        await anyio.sleep(20.0)
        assert plant.line["s"].address == 35

    with_plant(test, KEEPS_ROSTER)


def test_a_stop_that_came_while_it_waited_for_its_turn_ends_it() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        CAME_S.set(plant.now_s)
        await anyio.sleep(0.1)
        await plant.site.operations.stop(StopAction.INHIBIT, "all")
        assert (await change(plant, 35)).outcome is Outcome.SUPERSEDED
        assert entry(plant).address == 11
        CAME_S.set(None)
        assert (await change(plant, 35)).outcome is Outcome.VERIFIED

    with_plant(test, ROSTER)
