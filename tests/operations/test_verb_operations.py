"""Verbs on simulated drives of every family: what they do, and what stands in their way."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from decimal import Decimal
from typing import Any

import anyio
import pytest

from lecombus.drive_state.readings import DriveState
from lecombus.drives import FAMILY_NAMES, StopAction, Verb
from lecombus.errors import ExchangeError, LineError, OperationError
from lecombus.fieldbus.lecom.simulator.families.f82xx import Drive82XX
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.operations.operation_reports import VerbReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

DESCRIBED = [name for name in FAMILY_NAMES if name != "generic"]
WATCHDOG = "{time: 2s, action: quick-stop, configure: true}"
WORD = Code(135)
FULL = {"93xx": 3000.0, "smvector": 60.0}
FAULT_NUMBER = 11


def with_drive(test: Callable[[Plant], Awaitable[None]], kind: str, **keys: Any) -> None:
    """Run a test with one drive of a family, `a`, that is online."""

    async def main(plant: Plant) -> None:
        await plant.online()
        await test(plant)

    with_plant(main, roster_text([("a", 11, kind)], **{"watchdog": WATCHDOG} | keys))


async def do(plant: Plant, verb: Verb, **keys: Any) -> VerbReport:
    return await plant.site.operations.verb("a", verb, **keys)


async def refused(plant: Plant, verb: Verb, **keys: Any) -> OperationError:
    said = len(written(plant))
    with pytest.raises(OperationError) as caught:
        await do(plant, verb, **keys)
    assert len(written(plant)) == said, "it is refused before anything is sent"
    return caught.value


def written(plant: Plant) -> list[bytes]:
    """Telegrams that write."""
    return [one.data for one in plant.end.sent if b"\x02" in one.data]


# ---- a day in the life of a drive -----------------------------------------------------------


@pytest.mark.parametrize("kind", DESCRIBED)
def test_a_tripped_drive_is_reset_enabled_and_brought_to_speed_with_verbs_only(kind: str) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.trip(FAULT_NUMBER)
        reset = await do(plant, Verb.RESET_FAULT)
        assert reset.outcome is Outcome.VERIFIED
        assert "inhibited" in reset.states
        assert f"fault {FAULT_NUMBER}" in reset.reason
        assert "lecombus enable a" in reset.reason
        speed = await do(plant, Verb.SET_SPEED, value=Decimal(50), unit="%", verify=True)
        assert speed.outcome is Outcome.VERIFIED
        assert speed.reading is not None
        assert drive.motor.output == 0.0
        rest = "zero_speed" if kind == "93xx" else "output_frequency_0"
        assert rest in speed.states
        enable = await do(plant, Verb.ENABLE)
        assert enable.outcome is Outcome.VERIFIED
        assert not {"inhibited", "quick_stop", "fault"} & set(enable.states)
        await anyio.sleep(60.0)
        assert drive.motor.output == FULL.get(kind, 50.0) / 2
        stop = await do(plant, Verb.QUICK_STOP)
        assert (stop.outcome, stop.states) == (Outcome.VERIFIED, ("quick_stop",))
        await anyio.sleep(60.0)
        assert drive.motor.output == 0.0
        assert (await do(plant, Verb.ENABLE)).outcome is Outcome.VERIFIED
        inhibit = await do(plant, Verb.INHIBIT)
        assert (inhibit.outcome, inhibit.states) == (Outcome.VERIFIED, ("inhibited",))

    with_drive(test, kind)


@pytest.mark.parametrize("in_sets", [False, True])
@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("kind", ["821x", "822x", "824x"])
def test_half_speed_is_half_of_what_the_parameter_set_in_use_allows(
    kind: str, normalized: bool, in_sets: bool
) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        assert isinstance(drive, Drive82XX)
        if in_sets:
            drive.put_choice_in_sets()
        drive.params.set(2127 if in_sets else 127, str(int(normalized)))
        drive.params.set(2011, "25")
        await plant.site.operations.write("a", WORD, "H1000")
        speed = await do(plant, Verb.SET_SPEED, value=Decimal(50), unit="%")
        assert speed.written == ((Code(141), "50") if normalized else (Code(46), "12.5"),)
        await do(plant, Verb.ENABLE)
        await until(lambda: drive.motor.output == 12.5, within_s=60.0)
        await do(plant, Verb.SET_SPEED, value=Decimal(25), unit="Hz")
        await until(lambda: drive.motor.output == 25.0, within_s=60.0)
        error = await refused(plant, Verb.SET_SPEED, value=Decimal(30), unit="Hz")
        assert "C2011 = 25 Hz" in error.remedy
        await plant.site.operations.write("a", WORD, 0)
        await do(plant, Verb.SET_SPEED, value=Decimal(30), unit="Hz")

    with_drive(test, kind)


def test_percent_of_8200_vector_needs_parameter_sets_that_agree() -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        done = await do(plant, Verb.SET_SPEED, value=Decimal(50), unit="%")
        assert done.written == ((Code(46), "25"),)
        drive.params.set(4011, "25")
        error = await refused(plant, Verb.SET_SPEED, value=Decimal(50), unit="%")
        assert "C0011 = 50 Hz, C2011 = 50 Hz, C4011 = 25 Hz" in str(error)
        assert (await do(plant, Verb.SET_SPEED, value=Decimal(40), unit="Hz")).written

    with_drive(test, "8200vector")


@pytest.mark.parametrize("kind", DESCRIBED)
def test_a_reset_never_starts_a_motor_that_has_its_setpoint(kind: str) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        await do(plant, Verb.SET_SPEED, value=Decimal(50), unit="%")
        await do(plant, Verb.ENABLE)
        await anyio.sleep(60.0)
        drive.trip(FAULT_NUMBER)
        await anyio.sleep(30.0)
        turned: list[float] = []
        resetting = asyncio.create_task(do(plant, Verb.RESET_FAULT))
        while not resetting.done():
            await anyio.sleep(0.01)
            turned.append(abs(drive.motor.output))
        assert (await resetting).outcome is Outcome.VERIFIED
        await anyio.sleep(10.0)
        assert max(turned) == 0.0
        assert drive.motor.output == 0.0

    with_drive(test, kind)


def test_820x_has_its_watchdog_again_before_a_reset_is_called_done() -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.trip(FAULT_NUMBER)
        resetting = asyncio.create_task(do(plant, Verb.RESET_FAULT))
        await until(lambda: plant.state("a") is not DriveState.ONLINE)
        assert drive.params.text(1922) == "0", "the module has forgotten its settings"
        report = await resetting
        assert report.outcome is Outcome.VERIFIED
        assert plant.state("a") is DriveState.ONLINE
        assert (drive.params.text(1922), drive.params.text(1923)) == ("2", "2000")

    with_drive(test, "820x")


def test_820x_that_restarts_too_fast_to_be_missed_has_its_watchdog_again_all_the_same() -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.boot_s = 0.05  # type: ignore[misc]
        drive.trip(FAULT_NUMBER)
        report = await do(plant, Verb.RESET_FAULT)
        assert report.outcome is Outcome.VERIFIED
        assert (drive.params.text(1922), drive.params.text(1923)) == ("2", "2000")

    with_drive(test, "820x", drive="cyclic: []")


def test_820x_that_does_not_come_back_is_unknown_in_time_for_whoever_asked() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.trip(FAULT_NUMBER)
        resetting = asyncio.create_task(do(plant, Verb.RESET_FAULT))
        await until(lambda: plant.state("a") is not DriveState.ONLINE)
        plant.line.faults.absent = {11}
        begun_s = plant.now_s
        report = await resetting
        assert report.outcome is Outcome.UNKNOWN
        assert "was made to restart and is offline since" in report.reason
        assert plant.now_s - begun_s < 55.0

    with_drive(test, "820x")


def test_without_a_fault_a_reset_sends_nothing() -> None:
    async def test(plant: Plant) -> None:
        said = len(written(plant))
        report = await do(plant, Verb.RESET_FAULT)
        assert report.outcome is Outcome.VERIFIED
        assert "no fault is active: nothing was sent" in report.reason
        assert len(written(plant)) == said

    with_drive(test, "8200vector")


@pytest.mark.parametrize("kind", [one for one in DESCRIBED if one != "820x"])
def test_a_fault_whose_cause_lasts_is_told_as_not_reset(kind: str) -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.trip(FAULT_NUMBER, stays=True)
        report = await do(plant, Verb.RESET_FAULT)
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "not-in-effect")
        assert "still there or has come again" in report.reason
        assert "fault" in report.states
        assert plant.line["a"].model.inhibited()

    with_drive(test, kind)


@pytest.mark.parametrize("kind", ["824x", "93xx"])
def test_where_c0043_is_not_there_the_edge_of_the_control_word_resets(kind: str) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.params._specs.pop((43, 0))
        drive.params._numbers.discard(43)
        drive.trip(FAULT_NUMBER)
        report = await do(plant, Verb.RESET_FAULT)
        assert report.outcome is Outcome.VERIFIED
        assert [raw for _, raw in report.written] == ["H0A08", "H0208"]
        assert drive.fault == 0

    with_drive(test, kind)


# ---- what stands in the way -----------------------------------------------------------------


@pytest.mark.parametrize("kind", DESCRIBED)
def test_a_tripped_drive_is_not_enabled(kind: str) -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.trip(FAULT_NUMBER)
        assert (await refused(plant, Verb.ENABLE)).kind == "fault-active"

    with_drive(test, kind)


@pytest.mark.parametrize(
    ("kind", "setting", "value"),
    [("820x", 1, "0"), ("821x", 1, "1"), ("8200vector", 1, "0"), ("93xx", 5, "1000"),
     ("smvector", 1420, "1")],
)  # fmt: skip
def test_a_setting_that_keeps_the_line_out_is_named_before_anything_is_sent(
    kind: str, setting: int, value: str
) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.control = 0x0208
        drive.preset(setting, value)
        for verb, keys in (
            (Verb.ENABLE, {}), (Verb.SET_SPEED, {"value": Decimal(10), "unit": "%"})
        ):  # fmt: skip
            error = await refused(plant, verb, **keys)
            assert (error.kind, error.code) == ("setting", str(Code(setting)))

    with_drive(test, kind)


@pytest.mark.parametrize("kind", [one for one in DESCRIBED if one != "smvector"])
def test_an_enable_against_an_open_terminal_is_taken_back(kind: str) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        await do(plant, Verb.SET_SPEED, value=Decimal(50), unit="%")
        drive.set_terminal(high=False)
        report = await do(plant, Verb.ENABLE)
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "not-in-effect")
        assert "terminal" in report.cause
        assert "inhibited again" in report.remedy
        drive.set_terminal(high=True)
        await anyio.sleep(10.0)
        assert drive.motor.output == 0.0, "whoever closes the terminal does not start the motor"

    with_drive(test, kind)


async def silence_for_the_watchdog(plant: Plant) -> None:
    """Let the drive's watchdog act, and wait until it is online again."""
    plant.end.unplug()
    await anyio.sleep(4.0)
    plant.line.advance(asyncio.get_running_loop().time())
    plant.end.replug()
    await plant.online(within_s=60.0)


@pytest.mark.parametrize("word", ["state", "written", "changes"])
@pytest.mark.parametrize("action", ["quick-stop", "inhibit"])
@pytest.mark.parametrize("kind", DESCRIBED)
def test_an_enable_lifts_what_the_watchdog_did_whatever_the_control_word_reads(
    kind: str, action: str, word: str
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        drive = plant.line["a"].model
        await do(plant, Verb.SET_SPEED, value=Decimal(50), unit="%")
        assert (await do(plant, Verb.ENABLE)).outcome is Outcome.VERIFIED
        await silence_for_the_watchdog(plant)
        assert drive.inhibited() or drive.stop_wanted()
        assert drive.read_control_word() == "H0000" or word == "state"
        report = await do(plant, Verb.ENABLE)
        assert report.outcome is Outcome.VERIFIED
        assert report.proof is not None
        read, _, hint = report.reason.partition("; ")
        assert read == f"{report.proof.code} reads {report.proof.raw}"
        unseen = kind in ("8200vector", "93xx")
        assert hint == ("a quick stop at a terminal would not show in it" if unseen else "")
        assert report.proof.shows == "enabled"
        assert report.written
        await anyio.sleep(10.0)
        assert drive.motor.output > 0.0

    watchdog = f"{{time: 2s, action: {action}, configure: true}}"
    roster = roster_text([("a", 11, kind)], watchdog=watchdog)
    with_plant(test, roster, word_as_written=word == "written", only_changes=word == "changes")


@pytest.mark.parametrize("kind", [one for one in DESCRIBED if one not in ("8200vector", "93xx")])
def test_a_quick_stop_that_the_control_word_does_not_lift_is_told_and_taken_back(
    kind: str,
) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        assert (await do(plant, Verb.ENABLE)).outcome is Outcome.VERIFIED
        shown = drive.readers[68]
        drive.readers[68] = lambda code: f"H{int(shown(code)[1:], 16) | 0x1000:04X}"
        report = await do(plant, Verb.ENABLE)
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "not-in-effect")
        assert "C0068 reads H" in report.reason
        assert "a quick stop holds it that C0135 does not lift" in report.cause
        assert "check the terminal for quick stop" in report.remedy
        assert "inhibited again" in report.remedy
        assert drive.inhibited()
        why = await plant.site.operations.why("a", fresh=True)
        assert "quick-stop" in [one.name for one in why.findings]

    with_drive(test, kind)


@pytest.mark.parametrize("inhibited", [False, True])
@pytest.mark.parametrize("kind", ["820x", "821x", "smvector"])
def test_an_enable_is_taken_back_by_a_quick_stop_where_an_inhibit_could_drop_the_load(
    kind: str, inhibited: bool
) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        assert (await do(plant, Verb.ENABLE)).outcome is Outcome.VERIFIED
        await do(plant, Verb.INHIBIT if inhibited else Verb.QUICK_STOP)
        shown = drive.readers[68]
        drive.readers[68] = lambda code: f"H{int(shown(code)[1:], 16) | 0x1000:04X}"
        report = await do(plant, Verb.ENABLE)
        assert report.outcome is Outcome.REFUSED
        again = "it was inhibited again" if inhibited else "it was put into quick stop again"
        assert again in report.remedy
        assert drive.inhibited() is inhibited
        assert inhibited or drive.stop_wanted()
        assert (await plant.site.operations.why("a")).findings[0].name == "enable-taken-back"

    with_drive(test, kind, drive="stop_fallback: none")


@pytest.mark.parametrize("kind", [one for one in DESCRIBED if one != "smvector"])
def test_an_inhibit_that_only_c0068_or_c0040_shows_is_no_enable(kind: str) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        assert (await do(plant, Verb.ENABLE)).outcome is Outcome.VERIFIED
        shown = drive.readers[68]
        drive.readers[68] = lambda code: f"H{int(shown(code)[1:], 16) & ~0x0100:04X}"
        report = await do(plant, Verb.ENABLE)
        assert (report.outcome, "C0068 reads H" in report.reason) == (Outcome.REFUSED, True)
        drive.readers[68] = shown
        assert (await do(plant, Verb.ENABLE)).outcome is Outcome.VERIFIED
        drive.readers[40] = lambda _: "0"
        report = await do(plant, Verb.ENABLE)
        assert (report.outcome, "C0040 reads 0" in report.reason) == (Outcome.REFUSED, True)

    with_drive(test, kind)


def test_a_drive_that_is_away_or_locked_is_stopped_and_nothing_else() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(1494, "1.30")
        await plant.online()
        assert "nothing is written" in str(await refused(plant, Verb.ENABLE))
        assert (await do(plant, Verb.INHIBIT)).outcome is Outcome.VERIFIED
        plant.line.faults.absent = {11}
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        assert (await refused(plant, Verb.SET_SPEED, value=Decimal(1), unit="Hz")).kind == "offline"
        stop = await do(plant, Verb.QUICK_STOP)
        assert stop.outcome is Outcome.UNKNOWN
        assert "emergency stop circuit" in stop.remedy

    with_plant(test, roster_text([("a", 11, "smvector")]))


def test_a_roster_that_allows_no_writes_allows_no_verbs_but_stops() -> None:
    async def test(plant: Plant) -> None:
        error = await refused(plant, Verb.SET_SPEED, value=Decimal(10), unit="Hz")
        assert error.kind == "not-writable"
        assert (await do(plant, Verb.QUICK_STOP)).outcome is Outcome.VERIFIED

    with_drive(test, "8200vector", drive="writable: []")


def test_generic_and_unknown_drives_have_no_verbs() -> None:
    async def test(plant: Plant) -> None:
        for verb in (Verb.ENABLE, Verb.RESET_FAULT, Verb.SET_SPEED):
            keys = {"value": Decimal(1), "unit": "Hz"} if verb is Verb.SET_SPEED else {}
            assert (await refused(plant, verb, **keys)).kind == "no-verb"
        assert (await refused(plant, Verb.INHIBIT)).kind == "no-stop"
        with pytest.raises(OperationError, match="no drive 'nonsense'"):
            await plant.site.operations.verb("nonsense", Verb.ENABLE)

    with_drive(test, "generic", watchdog="")


def test_without_a_line_nothing_is_said() -> None:
    async def test(plant: Plant) -> None:
        plant.end.unplug()
        await until(lambda: not plant.site.worker.is_open)
        for verb in (Verb.ENABLE, Verb.INHIBIT):
            with pytest.raises(LineError):
                await do(plant, verb)

    with_drive(test, "8200vector")


def test_a_line_lost_half_way_leaves_the_outcome_unknown() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.control = 0x0208
        enabling = asyncio.create_task(do(plant, Verb.ENABLE))
        said = len(written(plant))
        await until(lambda: len(written(plant)) > said)
        await anyio.sleep(0.06)
        plant.end.unplug()
        report = await enabling
        assert report.outcome is Outcome.UNKNOWN
        assert report.remedy

    with_drive(test, "8200vector", drive="cyclic: []", watchdog="")


# ---- with others on the line ----------------------------------------------------------------


@pytest.mark.parametrize("after_s", [0.05, 0.10, 0.15, 0.20])
@pytest.mark.parametrize("action", list(StopAction))
def test_a_stop_ends_a_verb_wherever_it_is(action: StopAction, after_s: float) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.control = 0x0208
        enabling = asyncio.create_task(do(plant, Verb.ENABLE))
        await anyio.sleep(after_s)
        stop = await plant.site.operations.stop(action, "a")
        report = await enabling
        assert stop.outcome is Outcome.VERIFIED
        assert report.outcome in (Outcome.SUPERSEDED, Outcome.UNKNOWN)
        await anyio.sleep(5.0)
        assert drive.control & 0x0208, "the stop stands"

    with_drive(test, "8200vector", drive="cyclic: []", watchdog="")


@pytest.mark.parametrize("after_s", [0.0, 0.03, 0.06, 0.09, 0.12])
def test_a_control_word_another_client_writes_meanwhile_is_not_undone(after_s: float) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.control = 0x0208
        enabling = asyncio.create_task(do(plant, Verb.ENABLE))
        await anyio.sleep(after_s)
        await plant.site.operations.write("a", WORD, "H420C")
        await enabling
        assert drive.control & 0x4004 == 0x4004

    with_drive(test, "8200vector", drive="cyclic: []", watchdog="")


@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.1])
@pytest.mark.parametrize(("code", "text"), [(40, "0"), (135, "H0008"), (135, "H0200")])
@pytest.mark.parametrize("kind", DESCRIBED)
def test_a_plain_write_that_means_stop_is_not_undone_by_an_enable(
    kind: str, code: int, text: str, after_s: float
) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.control = 0x0208
        enabling = asyncio.create_task(do(plant, Verb.ENABLE))
        await anyio.sleep(after_s)
        await plant.site.operations.write("a", Code(code), text)
        assert (await enabling).outcome is Outcome.SUPERSEDED
        assert drive.inhibited() or drive.stop_wanted()

    with_drive(test, kind, drive="cyclic: []", watchdog="")


def test_a_group_write_that_means_stop_is_not_undone_by_an_enable() -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.control = 0x0208
        enabling = asyncio.create_task(do(plant, Verb.ENABLE))
        await anyio.sleep(0.05)
        await plant.site.operations.write_group("all", Code(40), "0")
        assert (await enabling).outcome is Outcome.SUPERSEDED
        assert drive.inhibited()

    with_drive(test, "8200vector", drive="cyclic: []", watchdog="")


@pytest.mark.parametrize(("code", "text"), [(40, "1"), (135, "H0000")])
@pytest.mark.parametrize("kind", [name for name in DESCRIBED if name != "820x"])
def test_a_reset_goes_no_further_behind_a_write_that_lifts_its_inhibit(
    kind: str, code: int, text: str
) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        await do(plant, Verb.SET_SPEED, value=Decimal(50), unit="%")
        drive.trip(FAULT_NUMBER)
        resetting = asyncio.create_task(do(plant, Verb.RESET_FAULT))
        before = plant.site.drives.get("a").lasting.stops_and_writes
        await until(lambda: plant.site.drives.get("a").lasting.stops_and_writes > before)
        await plant.site.operations.write("a", Code(code), text)
        report = await resetting
        assert report.outcome is Outcome.SUPERSEDED
        assert not report.written
        assert drive.fault == FAULT_NUMBER
        assert drive.motor.output == 0.0

    with_drive(test, kind)


@pytest.mark.parametrize("kind", [name for name in DESCRIBED if name != "820x"])
def test_a_reset_ends_inhibited_though_somebody_lifts_the_inhibit_at_the_drive(kind: str) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.trip(FAULT_NUMBER)
        resetting = asyncio.create_task(do(plant, Verb.RESET_FAULT))
        await until(lambda: not drive.fault)
        drive.control = 0
        drive.steer()
        report = await resetting
        assert report.outcome is Outcome.VERIFIED
        assert "inhibited" in report.states
        assert drive.inhibited()

    with_drive(test, kind)


@pytest.mark.parametrize("kind", [name for name in DESCRIBED if name != "smvector"])
def test_an_enable_that_cannot_be_seen_is_taken_back(kind: str) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        await do(plant, Verb.INHIBIT)
        enabling = asyncio.create_task(do(plant, Verb.ENABLE))
        await until(lambda: not drive.control & 0x0200)
        plant.line.faults = Faults(lost=1.0)
        await anyio.sleep(1.5)
        plant.line.faults = Faults()
        report = await enabling
        assert report.outcome is Outcome.UNKNOWN
        assert "it was inhibited again" in report.remedy
        assert drive.inhibited()

    with_drive(test, kind, drive="cyclic: []", watchdog="")


def test_one_enable_or_reset_at_a_time() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.trip(FAULT_NUMBER)
        first = asyncio.create_task(do(plant, Verb.RESET_FAULT))
        await anyio.sleep(0.01)
        with pytest.raises(OperationError, match="reset-fault of a is under way") as caught:
            await do(plant, Verb.ENABLE)
        assert caught.value.kind == "busy"
        assert (await first).outcome is Outcome.VERIFIED
        assert (await do(plant, Verb.ENABLE)).outcome is Outcome.VERIFIED

    with_drive(test, "8200vector")


def test_lost_acknowledgements_do_not_make_a_verb_lie() -> None:
    async def test(plant: Plant) -> None:
        drive, proven = plant.line["a"].model, 0
        for _ in range(6):
            drive.control = 0x0208
            plant.line.drive_faults[11] = Faults(lost=0.2)
            report = None
            with contextlib.suppress(ExchangeError, OperationError):  # it could not be read
                report = await do(plant, Verb.ENABLE)
            plant.line.drive_faults.clear()
            if report is not None and report.outcome is Outcome.VERIFIED:
                assert not drive.control & 0x0208
                proven += 1
            await plant.online()
        assert proven

    with_drive(test, "8200vector", watchdog="")


def test_what_expires_is_not_written() -> None:
    async def test(plant: Plant) -> None:
        report = await do(plant, Verb.SET_SPEED, value=Decimal(10), unit="Hz", expires_s=0.02)
        assert report.outcome is Outcome.EXPIRED
        assert plant.line["a"].model.params.text(46) == "0"

    with_drive(test, "8200vector")


def test_a_drive_that_runs_without_the_line_is_not_said_to_be_enabled_by_it() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line["servo"].model.preset(5, "2000")
        report = await plant.site.operations.verb("servo", Verb.ENABLE)
        assert report.outcome is Outcome.VERIFIED
        assert "enabled already, and not by the line: C0005 of servo reads 2000" in report.reason
        assert "C0005 that ends in 1" in report.remedy
        assert report.written == ()

    with_plant(test, roster_text([("servo", 21, "93xx")]))
