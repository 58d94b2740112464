"""Watchdogs: audited at every start and return, armed where asked for, and never let run out."""

from __future__ import annotations

import logging
import random

import anyio
import pytest

from lecombus.config import parse_roster
from lecombus.config.warnings import find_warnings
from lecombus.drive_state.drive_runtime import Drive
from lecombus.drive_state.readings import DriveState
from lecombus.drive_state.store import DriveChanged, LineState
from lecombus.drives import StopAction
from lecombus.errors import LecombusError
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.lecom.simulator.parameters import CommError, ExtendedError, Refusal
from lecombus.operations.awaited_requests import BACK_WITHIN_S
from lecombus.parameters import Code
from lecombus.schedule import Priority
from lecombus.supervision.health import AUDIT_AFTER
from lecombus.supervision.watchdogs import OFF
from support.rosters import roster_text
from support.sim_host import code_field
from support.site_host import Plant, plainly, until, with_plant

ONE = [("a", 11, "8200vector")]
GUARD = "{time: 2s, action: quick-stop, configure: true}"
LOOK = "{time: 2s, action: quick-stop, configure: false}"

FIVE = [
    ("a", 11, "8200vector"),
    ("b", 12, "821x"),
    ("c", 13, "93xx"),
    ("d", 21, "smvector"),
    ("e", 22, "820x"),
]


def remark(plant: Plant, drive: str) -> str | None:
    return plant.site.store.drive(drive).remarks.get("watchdog")


def drop_code(plant: Plant, drive: str, number: int) -> None:
    """Let a drive answer that it has no such code."""

    def refuse(subcode: int) -> str:
        raise Refusal(CommError.INVALID_CODE, ExtendedError.CODE)

    plant.line[drive].model.readers[number] = refuse


def test_every_family_is_armed_as_the_roster_says_and_nothing_is_remarked() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        for name, _, _ in FIVE:
            assert plant.line[name].model.watchdog_setting() == (2.0, 2)
            assert remark(plant, name) is None
        assert {report.result.kind.value for report in plant.reports} == {"answered"}, (
            "a module's own codes take 500 ms and are waited for"
        )
        await anyio.sleep(30.0)
        plant.line.advance(plant.now_s)
        assert [plant.line[name].watchdog_fired for name, _, _ in FIVE] == [0] * 5

    with_plant(test, roster_text(FIVE, watchdog=GUARD))


def test_what_is_set_already_is_not_written_again() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(1923, "2000")
        plant.line["a"].model.preset(1922, "2")
        await plant.online()
        assert not [entry for entry in plant.line["a"].log if entry.kind == "write"]

    with_plant(test, roster_text(ONE, watchdog=GUARD))


def test_without_configure_a_difference_stands_as_a_remark_and_nothing_is_written() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(1923, "1000")
        plant.line["a"].model.preset(1922, "1")
        await plant.online()
        assert "inhibit after 1 s" in (remark(plant, "a") or "")
        assert "quick-stop after 2 s" in (remark(plant, "a") or "")
        assert not [entry for entry in plant.line["a"].log if entry.kind == "write"]
        feeds = plant.site.schedule.stats(plant.now_s).feeds
        assert feeds["a"].time_s == 1.0, "it is fed by what the drive really has"
        await anyio.sleep(30.0)
        plant.line.advance(plant.now_s)
        assert plant.line["a"].watchdog_fired == 0

    with_plant(test, roster_text(ONE, watchdog=LOOK, drive="cyclic: []"))


def test_a_watchdog_the_roster_does_not_name_is_remarked_and_not_fed() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(1922, "2")
        await until(lambda: "the roster names none" in (remark(plant, "a") or ""))
        assert "a" not in plant.site.schedule.stats(plant.now_s).feeds

    with_plant(test, roster_text(ONE))


def test_a_refused_setting_ends_in_a_remark_not_in_a_loop() -> None:
    async def test(plant: Plant) -> None:
        plant.line.drive_faults[11] = Faults(nak=1.0)
        await plant.online()
        assert "the drive's watchdog is off" in (remark(plant, "a") or "")

    with_plant(test, roster_text(ONE, watchdog=GUARD))


def test_a_module_that_lost_its_settings_in_a_power_failure_is_armed_again() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        drive = plant.line["a"]
        drive.power_cycle(plant.now_s, 1.5)
        assert drive.model.watchdog_setting()[1] == 0, "the module forgot"
        await until(lambda: plant.state("a") is DriveState.DEGRADED)
        await until(lambda: drive.model.watchdog_setting() == (2.0, 2))
        await plant.online("a", within_s=5.0)
        assert plant.state("b") is DriveState.ONLINE

    drives = [*ONE, ("b", 12, "8200vector")]
    with_plant(
        test, roster_text(drives, watchdog=GUARD, drive="cyclic: [{code: C0150, every: 300ms}]")
    )


@pytest.mark.parametrize("code", [1922, 1923])
@pytest.mark.parametrize("nak", [False, True])
def test_a_drive_without_watchdog_codes_gets_a_remark_and_is_online(
    code: int, *, nak: bool
) -> None:
    async def test(plant: Plant) -> None:
        plant.line.faults.nak_reads = nak
        drop_code(plant, "a", code)
        await plant.online(within_s=20.0)
        assert "cannot be seen" in (remark(plant, "a") or "")
        said = len(plant.sent_to(11))
        await anyio.sleep(30.0)
        asked = [one.data[3:5] for one in plant.sent_to(11)[said:]]
        assert b"RF" not in asked, "and it is not asked for ever"

    with_plant(test, roster_text(ONE, watchdog=GUARD))


@pytest.mark.parametrize("code", [135, 249, 1811, 1921, 150])
@pytest.mark.parametrize("nak", [False, True])
def test_a_drive_without_another_code_of_the_audit_comes_online_all_the_same(
    code: int, *, nak: bool
) -> None:
    async def test(plant: Plant) -> None:
        plant.line.faults.nak_reads = nak
        drop_code(plant, "a", code)
        await plant.online(within_s=20.0)
        assert plant.line["a"].model.watchdog_setting() == (2.0, 2)

    with_plant(test, roster_text(ONE, watchdog=GUARD))


def test_a_device_without_a_description_is_online_once_it_answers_anything() -> None:
    async def test(plant: Plant) -> None:
        drop_code(plant, "g", 150)
        await plant.online(within_s=20.0)

    with_plant(test, roster_text([("g", 11, "generic")]))


def test_a_drive_that_says_nonsense_about_its_watchdog_does_not_stop_the_others() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.readers[1923] = lambda _: "Snonsense"
        await plant.online("b")
        assert plant.state("a") is DriveState.STARTING
        assert "nonsense" in plant.site.store.drive("a").reason

    with_plant(test, roster_text([*ONE, ("b", 12, "8200vector")], watchdog=GUARD))


def test_a_returning_drive_is_audited_before_it_is_called_online() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.faults.absent = {11}
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        plant.line["a"].power_cycle(plant.now_s, 0.1)
        states: list[tuple[float, DriveState]] = []

        def note(event: object) -> None:
            if isinstance(event, DriveChanged) and event.drive == "a":
                states.append((plant.now_s, plant.state("a")))

        plant.site.store.subscribe(note)
        plant.line.faults.absent = set()
        back_s = plant.now_s
        await plant.online("a", within_s=60.0)
        assert states[0][1] is DriveState.STARTING
        assert states[-1][1] is DriveState.ONLINE
        writes = [e for e in plant.line["a"].log if e.kind == "write" and e.time_s > back_s]
        assert {entry.code for entry in writes} == {1922, 1923}
        assert all(entry.time_s < states[-1][0] for entry in writes)

    with_plant(test, roster_text(ONE, watchdog=GUARD))


def test_after_the_line_came_back_every_drive_is_audited_again() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.end.unplug()
        for name in "ab":
            plant.line[name].power_cycle(plant.now_s, 0.0)
        await anyio.sleep(1.0)
        plant.end.replug()
        await until(lambda: plant.site.worker.is_open)
        await anyio.sleep(0.2)
        assert plant.state("a") is DriveState.STARTING
        await plant.online()
        assert plant.line["a"].model.watchdog_setting() == (2.0, 2)
        assert plant.line["b"].model.watchdog_setting() == (2.0, 2)

    with_plant(test, roster_text([*ONE, ("b", 12, "8200vector")], watchdog=GUARD))


@pytest.mark.parametrize(("family", "time_code", "read"),
                         [("8200vector", 1923, False), ("smvector", 1425, True)])  # fmt: skip
def test_the_time_of_a_watchdog_that_a_module_still_has_is_not_read_again(
    family: str, time_code: int, read: bool
) -> None:
    """Its action is back at 0 if the module lost it; what an SMVector has stored proves nothing."""

    async def test(plant: Plant) -> None:
        await plant.online()
        began = len(plant.reports)
        plant.end.unplug()
        await anyio.sleep(1.0)
        plant.end.replug()
        await until(lambda: plant.site.worker.is_open)
        await plant.online()
        asked = {one.step.code for one in plant.reports[began:]}
        assert Code(time_code - 1 if family == "8200vector" else time_code + 1) in asked
        assert (Code(time_code) in asked) is read

    with_plant(test, roster_text([("a", 11, family)], watchdog=GUARD))


def test_a_time_that_another_master_changed_meanwhile_is_set_again_soon() -> None:
    """It is not read before the drive is online, so it is read soon after."""

    async def test(plant: Plant) -> None:
        await plant.online()
        plant.end.unplug()
        plant.line["a"].model.params.set(1923, "60000")
        await anyio.sleep(1.0)
        plant.end.replug()
        await until(lambda: plant.site.worker.is_open)
        await until(lambda: plant.line["a"].text(1923) == "2000", within_s=180.0)
        await plant.online()

    with_plant(test, roster_text([*ONE, ("b", 12, "8200vector")], watchdog=GUARD))


def test_a_line_that_was_lost_often_is_not_waited_for_longer_when_it_is_back() -> None:
    async def test(plant: Plant) -> None:
        for _ in range(30):
            plant.end.unplug()
            await anyio.sleep(2.0)
            plant.end.replug()
            await until(lambda: plant.site.worker.is_open)
        opened_s = plant.now_s
        await plant.online()
        assert plant.now_s - opened_s < 6.0

    with_plant(test, roster_text(ONE, watchdog=GUARD))


@pytest.mark.parametrize("open_s", [0.0, 5.0])
def test_a_line_that_flaps_fills_no_log_and_its_states_stay_right(
    caplog: pytest.LogCaptureFixture, open_s: float
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(60.0)
        caplog.clear()
        store, began_s = plant.site.store, plant.now_s
        while plant.now_s - began_s < 600.0:
            plant.end.unplug()
            await until(lambda: store.line().state is LineState.LOST)
            plant.end.replug()
            await until(lambda: store.line().state is LineState.OPEN)
            assert {plant.state(name) for name in "abcde"} == {DriveState.STARTING}
            await anyio.sleep(open_s)
            if open_s:
                assert DriveState.ONLINE in {plant.state(name) for name in "abcde"}
        said = [record.getMessage() for record in caplog.records]
        assert len(said) < 20, said
        assert "event=port-lost" in said[0]
        assert "event=port-open" in said[1]
        sums = [text for text in said if "event=port-unsteady" in text]
        assert "losses=3" in sums[0]
        assert [float(text.partition("silent_for_s=")[2].split()[0]) for text in sums] == [
            60.0, 120.0, 240.0, 480.0,
        ]  # fmt: skip
        caplog.clear()
        await plant.online()
        await anyio.sleep(70.0)
        (steady,) = [record.getMessage() for record in caplog.records if "port-" in record.msg]
        assert "event=port-open" in steady
        assert ", after " in steady
        plant.end.unplug()
        await until(lambda: store.line().state is LineState.LOST)
        assert "event=port-lost" in caplog.records[-1].getMessage()

    with caplog.at_level(logging.INFO):
        with_plant(test, roster_text(FIVE, watchdog=GUARD))


def test_a_drive_that_stays_away_when_a_flapping_line_is_back_is_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        for turn in range(10):
            plant.end.unplug()
            await anyio.sleep(0.2)
            if turn == 5:
                plant.line.drive_faults[11] = Faults(lost=1.0)
            plant.end.replug()
            await until(lambda: plant.site.worker.is_open)
            await anyio.sleep(6.0)
        assert plant.state("a") is DriveState.OFFLINE
        told = [
            one.getMessage()
            for one in caplog.records
            if "drive=a event=state" in one.msg % one.args
        ]
        assert ["to=offline" in text for text in told[1:]] == [True]

    with caplog.at_level(logging.INFO):
        with_plant(test, roster_text(FIVE, watchdog=GUARD))


def test_a_module_that_loses_its_supply_while_its_audit_waits_for_others_is_armed() -> None:
    """It is back too soon to be offline, and it was looked at before."""

    async def test(plant: Plant) -> None:
        drive, health = plant.line["a"], plant.site.drives.get("a").health
        drive.model.preset(1922, "2")
        drive.model.preset(1923, "5000")
        await until(lambda: any(one.code == 1922 for one in drive.log))
        await anyio.sleep(0.1)
        plant.power_cycle("a", 0.0)
        plant.line.faults.absent = {11}
        await until(lambda: health.misses >= 2)
        plant.line.faults.absent = set()
        await plant.online("a")
        assert DriveState.OFFLINE not in (health.state, health.logged)
        assert drive.model.watchdog_setting() == (5.0, 2)

    drives = [(name, 11 + place, "8200vector") for place, name in enumerate("abcdef")]
    guard = "{time: 5s, action: quick-stop, configure: true}"
    with_plant(test, roster_text(drives, watchdog=guard))


@pytest.mark.parametrize("stops", ["stop", "many stops", "write"])
def test_a_watchdog_whose_write_was_not_heard_is_set_behind_a_stop(stops: str) -> None:
    head = b"\x0411\x02"
    action = [head + code_field(1922, extended=extended) for extended in (False, True)]

    async def not_heard(plant: Plant) -> None:
        """Let the next write of its action pass unheard."""
        # Before the drive has heard all of the telegram, which takes 5 ms.
        await until(lambda: any(map(plant.is_asking, action)), within_s=100.0, look_s=0.001)
        plant.line.drive_faults[11] = Faults(unheard=1.0)
        said = len(plant.end.sent)
        await until(lambda: len(plant.end.sent) > said)
        plant.line.drive_faults[11] = Faults()

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(20.0)
        operations, health = plant.site.operations, plant.site.drives.get("a").health
        plant.power_cycle("a", 0.0)
        plant.line.faults.absent = {11}
        await until(lambda: health.misses >= 2)
        plant.line.faults.absent = set()
        for _ in range(5 if stops == "many stops" else 1):
            await not_heard(plant)
            assert plant.line["a"].model.watchdog_setting()[1] == 0
            if stops == "write":
                await operations.write("a", Code(40), 0)
            else:
                assert (await operations.stop(StopAction.INHIBIT, "a")).outcome.is_good
        await plant.online("a")
        assert plant.line["a"].model.watchdog_setting() == (2.0, 2)
        assert remark(plant, "a") is None

    drives = [*ONE, ("b", 12, "8200vector")]
    with_plant(test, roster_text(drives, watchdog=GUARD, drive="also_writable: [C0040]"))


def test_an_audit_asked_for_while_the_rest_is_learnt_is_not_forgotten() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert plant.site.drives.get("a").audit.running is not None, (
            "the rest is still being learnt"
        )
        plant.line["a"].power_cycle(plant.now_s, 0.0)
        plant.site.health.audits.ask(plant.site.drives.get("a"))
        await until(lambda: plant.line["a"].model.watchdog_setting() == (2.0, 2), within_s=30.0)

    with_plant(test, roster_text(ONE, watchdog=GUARD))


def test_an_audit_does_not_wait_for_what_is_learnt_when_the_line_has_time() -> None:
    async def backup(plant: Plant) -> None:
        while True:
            await plant.site.operations.read(
                "b", Code(1922), priority=Priority.BACKGROUND, timeout_s=1000.0
            )

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(5.0)
        async with anyio.create_task_group() as tasks:
            for _ in range(31):
                tasks.start_soon(backup, plant)
            plant.line.faults.absent = {11}
            await until(lambda: plant.state("a") is DriveState.OFFLINE)
            plant.line.faults.absent = set()
            await plant.online("a")
            plant.power_cycle("a", 0.0)
            plant.line.faults.absent = {11}
            await until(lambda: plant.site.drives.get("a").health.misses >= 2)
            plant.line.faults.absent = set()
            armed = plant.line["a"].model.watchdog_setting
            await until(lambda: armed() == (5.0, 2), within_s=8.0)
            await plant.online("a", within_s=4.0)
            tasks.cancel_scope.cancel()

    drives = [*ONE, ("b", 12, "8200vector")]
    guard = "{time: 5s, action: quick-stop, configure: true}"
    with_plant(test, roster_text(drives, watchdog=guard))


def test_shortened_response_is_learnt_and_the_drive_left_alone_after_each_write() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(1921, "1")
        await plant.online()
        await anyio.sleep(5.0)
        assert plant.site.requests.station("a").hold_s == 0.05
        said = len(plant.end.sent)
        for value in (20, 21, 22):
            await plant.site.operations.write("a", Code(46), value)
        mine = plant.end.sent[said:]
        writes = [one.at_s for one in mine if b"\x02" in one.data]
        for at_s in writes:
            later = [one.at_s for one in mine if one.at_s > at_s]
            assert not later or later[0] - at_s >= 0.05
        await anyio.sleep(0.1)
        plant.line.advance(plant.now_s)
        assert plant.line["a"].text(46) == "22"

    with_plant(test, roster_text(ONE, watchdog=GUARD))


def test_the_supervisor_cannot_end_silently() -> None:
    async def main() -> None:
        async with Plant(roster_text(ONE, watchdog=GUARD)) as plant:

            def fail(drive: Drive) -> None:
                raise RuntimeError(f"a mistake about {drive.name}")

            plant.site.health.audited = fail  # type: ignore[method-assign]
            await anyio.sleep(60.0)
            pytest.fail("the supervisor's error was lost")

    with pytest.raises(RuntimeError, match="mistake about a"):
        plainly(main())


ALL = [n for n in range(1, 35) if n % 10][:31]
KINDS = ("8200vector", "smvector", "93xx", "821x")
ABSENT = {5, 17, 29}


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_no_watchdog_of_31_drives_fires_in_ten_minutes_of_load_with_three_absent() -> None:
    drives = [(f"d{n}", n, KINDS[n % 4]) for n in ALL]

    async def test(plant: Plant) -> None:
        plant.line.faults.absent = set(ABSENT)
        chance = random.Random(1)
        ended = {"begun": 0, "good": 0, "failed": 0}
        started_s = plant.now_s
        async with anyio.create_task_group() as callers:
            while plant.now_s < started_s + 600.0:
                name = f"d{chance.choice(ALL)}"
                callers.start_soon(ask, plant, name, chance.choice((50, 52, 150)), ended)
                await anyio.sleep(0.01)
        plant.line.advance(plant.now_s)
        present = [drive for drive in plant.line.drives if drive.address not in ABSENT]
        assert [drive.watchdog_fired for drive in present] == [0] * len(present)
        assert all(drive.model.watchdog_setting()[1] == 2 for drive in present), "all were armed"
        assert ended["begun"] == ended["good"] + ended["failed"] >= 60_000
        assert ended["good"] > 5_000
        assert absent_share(plant, started_s + 60.0) <= 0.10

    with_plant(test, roster_text(drives, watchdog=GUARD))


async def ask(plant: Plant, name: str, code: int, ended: dict[str, int]) -> None:
    ended["begun"] += 1
    try:
        await plant.site.operations.read(name, Code(code), timeout_s=2.0)
    except LecombusError:
        ended["failed"] += 1
    else:
        ended["good"] += 1


def absent_share(plant: Plant, since_s: float) -> float:
    """The part of line time that went to absent drives."""
    spent_s = sum(
        report.result.ended_s - report.result.started_s + report.quarantined_s
        for report in plant.reports
        if report.result.started_s >= since_s and int(report.drive[1:]) in ABSENT
    )
    return spent_s / (plant.now_s - since_s)


@pytest.mark.parametrize("count", [1, 8])
def test_absent_drives_take_no_more_than_their_share_however_many(count: int) -> None:
    absent = set(ALL[:count])
    drives = [(f"d{n}", n, KINDS[n % 4]) for n in ALL[:10]]

    async def test(plant: Plant) -> None:
        plant.line.faults.absent = absent
        await until(
            lambda: all(plant.state(f"d{n}") is DriveState.OFFLINE for n in absent), within_s=60.0
        )
        since_s = plant.now_s
        await anyio.sleep(120.0)
        spent_s = sum(
            report.result.ended_s - report.result.started_s + report.quarantined_s
            for report in plant.reports
            if report.result.started_s >= since_s and int(report.drive[1:]) in absent
        )
        assert 0 < spent_s <= 0.10 * 120.0

    with_plant(test, roster_text(drives))


def test_no_watchdog_is_called_missed_of_a_drive_not_heard_since_the_port_was_opened(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def looked_at(plant: Plant, for_s: int) -> None:
        for _ in range(for_s):
            await anyio.sleep(1.0)
            plant.site.supervision.watch.look()

    async def test(plant: Plant) -> None:
        plant.line.faults.absent = {11}
        await looked_at(plant, 30)
        assert not [one for one in caplog.messages if "event=watchdog-missed" in one]
        plant.line.faults.absent = set()
        await plant.online(within_s=120)
        await looked_at(plant, 5)
        plant.line.faults.absent = {11}
        await looked_at(plant, 30)
        assert len([one for one in caplog.messages if "event=watchdog-missed" in one]) == 1

    with_plant(test, roster_text(ONE, watchdog=GUARD))


def test_drives_that_are_all_silent_are_not_told_one_by_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def offline() -> list[str]:
        return [one.split()[0] for one in caplog.messages if "to=offline" in one]

    async def test(plant: Plant) -> None:
        plant.line.faults.absent = {11, 12}
        caplog.set_level("INFO")
        await anyio.sleep(20.0)
        assert plant.site.health.is_silent
        assert plant.site.supervision.watch.wants_look_at_port()
        assert offline() == []
        assert not [one for one in caplog.messages if "audit-failed" in one]
        plant.line.faults.absent = {12}
        await plant.online("a", within_s=120)
        assert offline() == ["drive=b"], "with the first one heard it is no longer all of them"

    with_plant(test, roster_text([("a", 11, "8200vector"), ("b", 12, "8200vector")]))


def test_a_watchdog_that_ran_out_unfed_is_logged_once_per_lapse(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def missed() -> list[str]:
        return [one for one in caplog.messages if "event=watchdog-missed" in one]

    async def looked_at(plant: Plant, for_s: int) -> None:
        for _ in range(for_s):
            await anyio.sleep(1.0)
            plant.site.supervision.watch.look()

    async def test(plant: Plant) -> None:
        await plant.online()
        await looked_at(plant, 10)
        assert missed() == []
        for count in (1, 2):
            plant.line.faults.absent = {11}
            await looked_at(plant, 15)
            assert len(missed()) == count
            assert missed()[-1] == "drive=a event=watchdog-missed time_s=2"
            plant.line.faults.absent = set()
            await plant.online(within_s=60)
            await looked_at(plant, 5)

    with_plant(test, roster_text(ONE, watchdog=GUARD))


@pytest.mark.parametrize("cut", ["drives", "adapter", "adapter flaps"])
def test_one_cut_of_the_line_is_one_miss_of_each_watchdog_in_the_log_and_in_the_counter(
    caplog: pytest.LogCaptureFixture, cut: str
) -> None:
    def missed() -> dict[str, int]:
        told = [one for one in caplog.messages if "event=watchdog-missed" in one]
        return {name: len([one for one in told if f"drive={name} " in one]) for name, _, _ in FIVE}

    async def looked_at(plant: Plant, for_s: int) -> None:
        for _ in range(for_s):
            await anyio.sleep(1.0)
            plant.site.supervision.watch.look()
            plant.site.supervision.watch.wants_look_at_port()
            assert plant.site.metrics.snapshot().watchdog_misses == missed()

    async def test(plant: Plant) -> None:
        await plant.online(within_s=120)
        await looked_at(plant, 10)
        assert set(missed().values()) == {0}
        for count in (1, 2):
            if cut == "drives":
                plant.line.faults.absent = {address for _, address, _ in FIVE}
                await looked_at(plant, 40)
                plant.line.faults.absent = set()
            elif cut == "adapter":
                plant.end.unplug()
                await looked_at(plant, 20)
                plant.end.replug()
            else:
                plant.line.faults.absent = {address for _, address, _ in FIVE}
                for _ in range(4):
                    await looked_at(plant, 4)
                    plant.end.unplug()
                    await looked_at(plant, 3)
                    plant.end.replug()
                plant.line.faults.absent = set()
            await looked_at(plant, 30)
            await plant.online(within_s=120)
            assert set(missed().values()) == {count}

    with_plant(test, roster_text(FIVE, watchdog=GUARD))


def test_a_lost_port_is_logged_once_and_not_once_more_for_each_drive(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")

    async def test(plant: Plant) -> None:
        await plant.online(within_s=120)
        await anyio.sleep(70.0)
        caplog.clear()
        plant.end.unplug()
        await anyio.sleep(20.0)
        assert {plant.state(name) for name, _, _ in FIVE} == {DriveState.OFFLINE}
        plant.end.replug()
        await plant.online(within_s=120)
        events = [one.partition("event=")[2].split()[0] for one in caplog.messages]
        assert events.count("port-lost") == 1
        assert events[: events.index("port-open")] == ["port-lost"]
        states = [one for one in caplog.messages if "event=state" in one]
        assert not [one for one in states if "to=offline" in one]
        assert len([one for one in states if "from=online to=starting" in one]) == 5

    with_plant(test, roster_text(FIVE, watchdog=GUARD))


FULL = [(f"d{address}", address, "821x") for address in range(11, 20)]
FULL_ROSTER = roster_text(
    FULL, baud=9600, watchdog="{time: 900ms, action: quick-stop, configure: true}"
)
"""What a module's own code takes is more than nine such watchdogs leave."""


MIXED_ROSTER = roster_text(
    FULL, baud=9600, own={"d11": f"watchdog: {GUARD}"} | {
        name: "watchdog: {time: 900ms, action: quick-stop, configure: true}"
        for name, _, _ in FULL[1:]
    },
)  # fmt: skip


def away(plant: Plant, *addresses: int) -> None:
    for address in addresses:
        plant.line.drive_faults[address] = Faults(unheard=1.0)


def unseen(plant: Plant) -> set[str]:
    return {name for name, _, _ in FULL if "cannot be checked" in (remark(plant, name) or "")}


async def check_that_it_is_set_again(plant: Plant) -> None:
    """A module that lost its supply has lost its watchdog's settings."""
    plant.power_cycle("d11", 5.0)
    await until(lambda: plant.state("d11") is not DriveState.ONLINE)
    await plant.online("d11", within_s=60.0)
    assert plant.line["d11"].model.watchdog_setting() == (2.0, 2)
    assert remark(plant, "d11") is None


@pytest.mark.parametrize(
    ("time_ms", "is_warned"),
    [(900, True), (1100, True), (1300, True), (1400, False), (1600, False)],
)
def test_check_warns_of_the_watchdogs_that_are_not_looked_at(time_ms: int, is_warned: bool) -> None:
    roster = FULL_ROSTER.replace("900ms", f"{time_ms}ms")
    warnings = find_warnings(parse_roster(roster, "r.yaml"))
    assert any("neither checked nor set" in one for one in warnings) is is_warned

    async def test(plant: Plant) -> None:
        await plant.online(within_s=120.0)
        assert bool(unseen(plant)) is is_warned

    with_plant(test, roster)


def test_after_a_disturbance_no_time_is_spent_on_watchdogs_that_do_not_fit() -> None:
    """Others are offline then, so that each would fit, one after the other, for minutes."""

    async def test(plant: Plant) -> None:
        await plant.online(within_s=120.0)
        everybody = {name for name, _, _ in FULL}
        assert unseen(plant) == everybody
        away(plant, *range(11, 20))
        await until(
            lambda: all(plant.state(one) is DriveState.OFFLINE for one in everybody),
            within_s=60.0,
        )
        begin_s = plant.now_s
        plant.line.drive_faults.clear()
        await plant.online(within_s=20.0)
        tried = [
            one for one in plant.reports
            if one.step.code in (Code(1922), Code(1923)) and one.result.started_s > begin_s
        ]  # fmt: skip
        assert not tried
        assert unseen(plant) == everybody

    with_plant(test, FULL_ROSTER)


def test_where_others_are_away_for_longer_a_watchdog_is_looked_at() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=120.0)
        assert "cannot be checked" in (remark(plant, "d11") or "")
        away(plant, *range(12, 20))
        await anyio.sleep(BACK_WITHIN_S + 30.0)
        await check_that_it_is_set_again(plant)

    with_plant(test, MIXED_ROSTER)


def test_when_a_reload_leaves_room_the_next_audit_looks_at_the_watchdog() -> None:
    own = {"d11": f"watchdog: {GUARD}"}

    async def test(plant: Plant) -> None:
        await plant.online(within_s=120.0)
        assert "cannot be checked" in (remark(plant, "d11") or "")
        plant.apply(roster_text(FULL[:1], baud=9600, own=own))
        await anyio.sleep(1.0)
        assert "cannot be checked" in (remark(plant, "d11") or ""), "it is not audited anew"
        await check_that_it_is_set_again(plant)

    with_plant(test, MIXED_ROSTER)


def test_a_watchdog_that_was_off_is_fed_when_it_can_no_longer_be_looked_at() -> None:
    """And it is not relied upon: it may be off still."""
    alone = roster_text(
        FULL[:1], baud=9600, watchdog="{time: 900ms, action: quick-stop, configure: false}"
    )

    def asked_for_action(plant: Plant) -> bool:
        last = plant.end.sent[-1].data if plant.end.sent else b""
        return last.startswith(b"\x0411") and code_field(1922) in last

    async def test(plant: Plant) -> None:
        await until(lambda: asked_for_action(plant), within_s=60.0)
        plant.apply(FULL_ROSTER.replace("configure: true", "configure: false"))  # no room now
        await plant.online(within_s=120.0)
        assert plant.site.drives.get("d11").audit.watchdog == OFF
        model = plant.line["d11"].model
        model.preset(1923, "900")
        model.preset(1922, "2")
        away(plant, 11)
        await until(lambda: plant.state("d11") is DriveState.OFFLINE)
        plant.line.drive_faults.clear()
        await plant.online(within_s=120.0)
        assert "cannot be checked" in (remark(plant, "d11") or "")
        assert plant.site.drives.get("d11").audit.watchdog == OFF
        fired = plant.line["d11"].watchdog_fired
        await anyio.sleep(60.0)
        plant.line.advance(plant.now_s)
        assert plant.line["d11"].watchdog_fired == fired

    with_plant(test, alone, also=FULL[1:])


def test_a_watchdog_that_can_no_longer_be_looked_at_is_not_rechecked() -> None:
    """After a short silence what was known of it would be compared, and doubted again and again."""
    alone = roster_text(FULL[:1], baud=9600, watchdog=LOOK)
    own = {"d11": f"watchdog: {LOOK}"} | {
        name: "watchdog: {time: 900ms, action: quick-stop}" for name, _, _ in FULL[1:]
    }

    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        audit = plant.site.drives.get("d11").audit
        assert not audit.anew
        plant.apply(roster_text(FULL, baud=9600, own=own))
        await plant.online(within_s=120.0)
        away(plant, 11)
        await until(lambda: plant.site.drives.get("d11").health.misses >= AUDIT_AFTER)
        plant.line.drive_faults.clear()
        assert plant.state("d11") is DriveState.DEGRADED
        await until(lambda: "cannot be checked" in (remark(plant, "d11") or ""), within_s=60.0)
        assert audit is plant.site.drives.get("d11").audit
        assert audit.anew

    with_plant(test, alone, also=FULL[1:])


def test_a_shorter_watchdog_of_a_drive_that_fell_silent_keeps_no_other_from_being_set() -> None:
    """`check` is content with the roster, and what is not in it does not count."""
    own = dict.fromkeys(("d11", "d12"), f"watchdog: {GUARD}")
    roster = roster_text([*FULL[:2], ("x", 21, "8200vector")], baud=9600,
                         own=own | {"x": f"watchdog: {LOOK}"})  # fmt: skip

    async def test(plant: Plant) -> None:
        short = plant.line["x"].model
        short.preset(1923, "500")
        short.preset(1922, "2")
        await plant.online(within_s=120.0)
        assert "0.5 s" in (remark(plant, "x") or "")
        away(plant, 21)
        await until(lambda: plant.state("x") is DriveState.OFFLINE)
        await check_that_it_is_set_again(plant)

    assert not [
        one for one in find_warnings(parse_roster(roster, "r.yaml")) if "neither checked" in one
    ]
    with_plant(test, roster)
