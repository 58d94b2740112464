"""A whole line put together: starting, taking another roster, and keeping what is known true."""

from __future__ import annotations

import contextlib
from pathlib import Path

import anyio
import pytest

from lecombus.config import Roster, parse_roster
from lecombus.daemon import Daemon
from lecombus.drive_state.readings import DriveState, LineState, Quality
from lecombus.drives import StopAction
from lecombus.errors import ConfigError, LineClosedError, OperationError
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

AB = [("a", 11, "8200vector"), ("b", 12, "8200vector")]
STATUS, SETPOINT, ENABLE, WORD = Code(150), Code(46), Code(40), Code(135)


def test_a_site_has_tried_all_once_every_drive_was_asked_also_those_that_are_not_there() -> None:
    async def test(plant: Plant) -> None:
        plant.line.faults.absent = {12}
        assert not plant.site.tried_all()
        await until(plant.site.tried_all, within_s=10.0)
        assert plant.site.store.line().state is LineState.OPEN
        await plant.online("a")
        assert plant.state("b") is DriveState.OFFLINE

    with_plant(test, roster_text(AB))


def test_a_drive_that_answers_and_reports_a_fault_does_not_look_healthy() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert not [key for key in plant.site.store.drive("a").remarks if key.startswith("fault")]
        plant.line["a"].trip(50)
        await until(lambda: "fault" in plant.site.store.drive("a").remarks)
        assert "C0150 reads H" in plant.site.store.drive("a").remarks["fault"]
        assert not [key for key in plant.site.store.drive("b").remarks if key.startswith("fault")]

    with_plant(test, roster_text(AB))


def test_a_reloaded_roster_leaves_alone_what_did_not_change() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        before = plant.site.store.reading("a", STATUS)
        assert before is not None
        plant.apply(roster_text([*AB, ("c", 13, "8200vector")]))
        after = plant.site.store.reading("a", STATUS)
        assert after is not None
        assert (after.value, after.quality) == (before.value, Quality.GOOD)
        assert plant.state("a") is DriveState.ONLINE
        assert plant.state("c") is DriveState.STARTING

    with_plant(test, roster_text(AB))


def test_a_new_roster_is_told_by_the_drives_it_changes() -> None:
    async def test(plant: Plant) -> None:
        moved = [("b", 14, "8200vector"), ("c", 13, "8200vector")]
        changes = plant.site.apply(parse_roster(roster_text(moved), "hall-3.yaml"))
        assert str(changes) == "added=c removed=a changed=b"
        again = plant.site.apply(plant.site.roster)
        assert str(again) == "added=none removed=none changed=none"

    with_plant(test, roster_text(AB))


def test_a_new_drive_is_audited_and_comes_online() -> None:
    async def test(plant: Plant) -> None:
        await plant.online("a")
        plant.apply(roster_text(AB))
        await plant.online("b")

    with_plant(test, roster_text(AB[:1]), also=AB[1:])


def test_a_drive_taken_out_is_spoken_to_no_more() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.apply(roster_text(AB[:1]))
        await anyio.sleep(0.2)
        since_s = plant.now_s
        await anyio.sleep(20.0)
        assert plant.sent_to(12, since_s) == []
        assert plant.sent_to(11, since_s)
        with pytest.raises(OperationError, match="no drive 'b'"):
            await plant.site.operations.read("b", STATUS)

    with_plant(test, roster_text(AB, watchdog="{time: 2s, action: inhibit, configure: true}"))


@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.parametrize("writing", [True, False])
def test_a_drive_may_be_taken_out_or_changed_while_it_is_spoken_to(
    kept: bool, writing: bool
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        said = len(plant.end.sent)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(ask, plant, writing)
            await until(lambda: len(plant.end.sent) > said)
            plant.apply(roster_text(AB, drive="answer_time: 30ms") if kept else roster_text(AB[:1]))
        await anyio.sleep(10.0)
        assert plant.site.worker.is_open
        assert plant.state("a") is DriveState.ONLINE

    async def ask(plant: Plant, writing: bool) -> None:
        with contextlib.suppress(OperationError):
            if writing:
                await plant.site.operations.write("b", SETPOINT, 20)
            else:
                await plant.site.operations.read("b", STATUS)

    with_plant(test, roster_text(AB, drive="cyclic: []") if not kept else roster_text(AB))


def test_a_value_of_the_device_that_had_the_name_before_is_not_the_new_one_s() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line[12].model.readers[50] = lambda _: "12"
        plant.line[13].model.readers[50] = lambda _: "13"
        said = len(plant.end.sent)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(read_or_not, plant)
            await until(lambda: len(plant.end.sent) > said)
            assert plant.end.sent[-1].data[1:3] == b"12"
            plant.apply(roster_text([AB[0], ("b", 13, "8200vector")], drive="cyclic: []"))
        found = plant.site.store.reading("b", Code(50))
        assert found is None or found.value is None or found.value.raw == "13"

    async def read_or_not(plant: Plant) -> None:
        with contextlib.suppress(OperationError):
            await plant.site.operations.read("b", Code(50))

    with_plant(test, roster_text(AB, drive="cyclic: []"), also=[("c", 13, "8200vector")])


def test_a_roster_with_another_line_is_refused_and_nothing_changes() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        with pytest.raises(ConfigError, match="restart"):
            plant.apply(roster_text(AB[:1], baud=9600))
        assert plant.state("b") is DriveState.ONLINE

    with_plant(test, roster_text(AB))


def test_a_cadence_the_line_cannot_hold_is_remarked() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(30.0)
        plant.site.supervision.watch.look()
        assert "cannot hold the cyclic reads" in plant.site.store.line().remarks["cadence"]
        plant.apply(roster_text(AB))
        await anyio.sleep(120.0)
        plant.site.supervision.watch.look()
        assert "cadence" not in plant.site.store.line().remarks

    with_plant(test, roster_text(AB, drive="cyclic: [{code: C0150, every: 50ms}]"))


def test_what_was_not_read_while_the_line_was_lost_is_no_remark_about_its_cadence() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(30.0)
        plant.end.unplug()
        for _ in range(60):
            await anyio.sleep(1.0)
            plant.site.supervision.watch.look()
            assert "cadence" not in plant.site.store.line().remarks

    with_plant(test, roster_text(AB))


def test_drives_that_are_being_started_raise_no_alarm_about_the_cadence() -> None:
    """Their modules' own codes take half a second each: the cyclic reads of others wait."""

    async def test(plant: Plant) -> None:
        await plant.online("a")
        begun_s = plant.now_s
        while plant.now_s - begun_s < 120.0:
            await anyio.sleep(1.0)
            plant.site.supervision.watch.look()
            assert "cadence" not in plant.site.store.line().remarks
        await plant.online()

    many = [(name, 11 + place, "8200vector") for place, name in enumerate("abcdef")]
    dog = "watchdog: {time: 4s, action: quick-stop, configure: true}"
    with_plant(test, roster_text(many, drive=dog))


def test_a_line_without_answers_raises_no_alarm_about_the_cadence() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(20.0)
        plant.line.faults = Faults(lost=1.0)
        for _ in range(60):
            await anyio.sleep(0.5)
            plant.site.supervision.watch.look()
            assert "cadence" not in plant.site.store.line().remarks

    with_plant(test, roster_text(AB, drive="cyclic: [{code: C0150, every: 100ms}]"))


def test_a_drive_that_never_ends_starting_hides_the_remark_for_minutes_only() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.site.drives.get("b").health.state = DriveState.STARTING
        await anyio.sleep(60.0)
        plant.site.supervision.watch.look()
        assert "cadence" not in plant.site.store.line().remarks
        for _ in range(700):
            await anyio.sleep(1.0)
            plant.site.supervision.watch.look()
        assert "cadence" in plant.site.store.line().remarks

    with_plant(test, roster_text(AB, baud=1200, drive="cyclic: [{code: C0150, every: 50ms}]"))


def test_a_setpoint_is_known_by_what_the_drive_had_and_by_what_it_acknowledged() -> None:
    async def test(plant: Plant) -> None:
        def setpoint() -> tuple[str, str] | None:
            found = plant.site.store.motion("a").setpoint
            if found is None or found.reading.value is None:
                return None
            return found.reading.value.raw, "written" if found.written else "read"

        plant.line["a"].model.params.set(46, "12.5")
        await plant.online()
        await until(lambda: setpoint() is not None)
        assert setpoint() == ("12.5", "read")
        await plant.site.operations.write("a", SETPOINT, 20)
        assert setpoint() == ("20", "written")
        plant.line.drive_faults[11] = Faults(nak=1.0)
        await plant.site.operations.write("a", SETPOINT, 30)
        assert setpoint() == ("20", "written")
        del plant.line.drive_faults[11]
        plant.line.faults.absent = {11}
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        motion = plant.site.store.motion("a")
        assert motion.stale
        assert motion.setpoint is not None
        assert motion.setpoint.as_json()["stale"] is True

    with_plant(test, roster_text(AB))


def test_a_refused_write_leaves_what_is_known_as_it_is() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.read("a", SETPOINT)
        plant.line.drive_faults[11] = Faults(nak=1.0)
        report = await plant.site.operations.write("a", SETPOINT, 20)
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "nak")
        reading = plant.site.store.reading("a", SETPOINT)
        assert reading is not None
        assert (reading.value, reading.quality) == (Value.parse("0"), Quality.GOOD)

    with_plant(test, roster_text(AB))


def test_a_quick_stop_after_an_inhibit_does_not_lift_the_inhibit() -> None:
    """C0040 and bit 9 of the control word are one: a word known from before is out of date."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.write("a", WORD, "H0000")
        await plant.site.operations.write("a", ENABLE, 1)
        await plant.site.operations.read("a", WORD)
        await plant.site.operations.stop(StopAction.INHIBIT, "a")
        report = await plant.site.operations.stop(StopAction.QUICK_STOP, "a")
        assert report.outcome is Outcome.VERIFIED
        assert plant.line["a"].model.control & 0x0208 == 0x0208

    with_plant(test, roster_text(AB))


def test_a_control_word_whose_write_was_not_answered_is_read_before_it_is_changed() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.write("a", WORD, "H0000")
        plant.line.drive_faults[11] = Faults(lost=1.0)
        report = await plant.site.operations.write("a", WORD, "H0A00")
        assert report.outcome is Outcome.UNKNOWN, "bit 11 makes an edge of it: never repeated"
        plant.line.drive_faults.clear()
        await plant.site.operations.stop(StopAction.QUICK_STOP, "a")
        assert plant.line["a"].model.control & 0x0208 == 0x0208

    with_plant(test, roster_text(AB, drive="cyclic: []"))


def test_what_is_done_at_the_end_is_what_the_last_roster_says() -> None:
    async def test(plant: Plant) -> None:
        found = [plant.site.roster.on_shutdown]
        plant.apply(roster_text(AB, sections="on_shutdown: inhibit"))
        assert [*found, plant.site.roster.on_shutdown] == ["nothing", "inhibit"]

    with_plant(test, roster_text(AB))


def test_a_stop_at_the_end_that_cannot_be_sent_is_an_error_in_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.end.unplug()
        await until(lambda: not plant.site.worker.is_open)
        await Daemon(plant.roster, None)._stop_at_end(plant.site)

    with_plant(test, roster_text(AB, sections="on_shutdown: inhibit"))
    (text,) = [one for one in caplog.messages if "shutdown-stop" in one]
    assert "event=shutdown-stop-failed action=inhibit reason=the line is not open" in text


def test_a_roster_that_was_read_when_the_daemon_ends_is_not_applied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    roster = tmp_path / "r.yaml"
    roster.write_text(roster_text(AB))

    async def test(plant: Plant) -> None:
        daemon = Daemon(plant.roster, roster)
        daemon.runtime = plant.site

        async def read(*args: object, **kwargs: object) -> Roster:
            daemon.end()
            return parse_roster(roster_text([*AB, ("c", 13, "8200vector")]), "r.yaml")

        monkeypatch.setattr("lecombus.daemon.anyio.to_thread.run_sync", read)
        with pytest.raises(LineClosedError):
            await daemon.reload()
        assert plant.site.drives.find("c") is None

    with_plant(test, roster_text(AB))


GUARD = "{time: 2s, action: quick-stop, configure: true}"


def test_a_drive_that_gets_another_address_while_it_is_audited_is_spoken_to_there_only() -> None:
    async def test(plant: Plant) -> None:
        await until(lambda: any(b"RE" in one.data[3:5] for one in plant.sent_to(11)), within_s=20.0)
        plant.apply(roster_text([("a", 12, "8200vector")]))
        await plant.online("a")
        await anyio.sleep(2.0)
        said = len(plant.sent_to(11))
        report = await plant.site.operations.write("a", SETPOINT, 33, verify=True)
        assert report.outcome is Outcome.VERIFIED
        assert plant.line[12].text(46) == "33"
        assert len(plant.sent_to(11)) == said

    with_plant(test, roster_text([("a", 11, "8200vector")]), also=[("b", 12, "8200vector")])


def test_drives_taken_out_while_they_wait_for_their_audit_harm_nobody() -> None:
    drives = [(name, address, "8200vector") for address, name in enumerate("abcdefgh", 11)]

    async def test(plant: Plant) -> None:
        await anyio.sleep(3.0)
        plant.apply(roster_text(drives[:2], watchdog=GUARD))
        await plant.online("a", "b", within_s=60.0)
        plant.apply(roster_text(drives, watchdog=GUARD))
        await plant.online(within_s=120.0)

    with_plant(test, roster_text(drives, watchdog=GUARD))


def test_a_line_that_waits_for_a_very_slow_drive_is_not_stuck() -> None:
    """systemd ends a daemon whose line task is."""

    async def test(plant: Plant) -> None:
        plant.line.faults.absent = {12}
        worker = plant.site.worker
        progress, since_s = (0, 0), plant.now_s
        while plant.now_s < since_s + 1.0 or not plant.site.tried_all():
            now = (worker.exchanges, worker.rests)
            if now != progress:
                progress, since_s = now, plant.now_s
            assert plant.now_s - since_s <= plant.site.longest_exchange_s
            await anyio.sleep(0.1)

    with_plant(test, roster_text(AB, drive="answer_time: 10s"))
