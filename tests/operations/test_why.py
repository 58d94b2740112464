"""Why a drive does not turn is answered from what is known, and never from more than that."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import pairwise

import anyio
import pytest

from lecombus.drive_state.motion import Doing
from lecombus.drive_state.readings import DriveState
from lecombus.drives import FAMILY_NAMES, Language, StopAction, Verb, family
from lecombus.drives.faults.reasons import Reason, Weight, asked_codes, holding, reasons
from lecombus.errors import DescriptionError, OperationError
from lecombus.fieldbus.lecom.protocol.controls import STX
from lecombus.operations.findings import WhyReport, lapse_finding
from lecombus.operations.operation_reports import VerbReport
from lecombus.parameters import Code, Value
from lecombus.saved_state import State
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

FAMILIES = [
    ("vector", 11, "8200vector"), ("belt", 12, "821x"), ("pump", 13, "820x"),
    ("servo", 21, "93xx"), ("fan", 22, "smvector"),
]  # fmt: skip
SETPOINTS = {"vector": (46, 35), "belt": (46, 35), "pump": (46, 35), "servo": (141, 50),
             "fan": (1061, 35)}  # fmt: skip
TRIPS = {"vector": 50, "belt": 11, "pump": 15, "servo": 50, "fan": 36}


def names(report: WhyReport) -> list[str]:
    return [one.name for one in report.findings]


def at(drive: str, test: Callable[[Plant], Awaitable[None]]) -> None:
    """Run a test with a drive that is online and whose slow codes have been read."""

    async def main(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(3.0)
        await test(plant)

    chosen = [one for one in FAMILIES if one[0] == drive]
    with_plant(main, roster_text(chosen))


def named(plant: Plant, drive: str) -> bool:
    fault = plant.site.store.drive(drive).fault
    return fault is not None and fault.number is not None


async def run_motor(plant: Plant, drive: str) -> None:
    """Let a drive turn as its user would."""
    ops = plant.site.operations
    number, value = SETPOINTS[drive]
    await ops.write(drive, Code(135), "H0000")
    await ops.write(drive, Code(40), 1)
    await ops.write(drive, Code(number), value)
    await anyio.sleep(3.0)


@pytest.mark.parametrize("drive", list(TRIPS))
def test_a_tripped_drive_is_diagnosed_with_cause_and_remedy(drive: str) -> None:
    async def test(plant: Plant) -> None:
        await run_motor(plant, drive)
        plant.line[drive].trip(TRIPS[drive])
        await until(lambda: named(plant, drive), within_s=5.0)
        report = await plant.site.operations.why(drive, fresh=True)
        fault = family(plant.site.store.family(drive).name).fault(TRIPS[drive])
        assert fault is not None
        assert fault.meaning.en in report.answer.en
        assert report.findings[0].name == "trip"
        assert (
            report.findings[0].remedy.en
            == f"{fault.remedy.en}; then reset it (lecombus reset-fault)"
        )
        assert report.history[0].number == TRIPS[drive]
        german = report.as_json(Language.DE)
        assert fault.meaning.de in str(german["answer"])

    at(drive, test)


@pytest.mark.parametrize("drive", list(TRIPS))
def test_a_drive_that_turns_is_not_given_a_reason(drive: str) -> None:
    async def test(plant: Plant) -> None:
        await run_motor(plant, drive)
        report = await plant.site.operations.why(drive, fresh=True)
        assert [one.name for one in report.findings if one.weight is Weight.REASON] == []
        # A 93XX has no output frequency that its manual names.
        output = "" if drive == "servo" else "; its output (C0050) reads"
        assert report.answer.en.startswith(f"nothing that is known keeps it from turning{output}")
        assert report.history == ()
        assert report.history_known

    at(drive, test)


@pytest.mark.parametrize("drive", list(TRIPS))
def test_after_power_on_it_is_the_quick_stop(drive: str) -> None:
    async def test(plant: Plant) -> None:
        report = await plant.site.operations.why(drive, fresh=True)
        assert report.findings[0].name == "quick-stop-by-line"
        assert "C0135 reads H0008" in report.findings[0].shown_by

    at(drive, test)


@pytest.mark.parametrize("drive", list(TRIPS))
def test_an_inhibit_is_told_before_the_setpoint_that_is_missing_too(drive: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.site.operations.write(drive, Code(135), "H0000")
        await plant.site.operations.write(drive, Code(40), 0)
        report = await plant.site.operations.why(drive, fresh=True)
        assert report.findings[0].name == "inhibited-by-line"
        assert any(name.startswith("setpoint-zero") for name in names(report))
        assert not report.findings[0].stale

    at(drive, test)


@pytest.mark.parametrize(
    ("drive", "code", "text", "name"),
    [("vector", 1, "0", "operating-mode"), ("pump", 1, "2", "operating-mode"),
     ("servo", 5, "1000", "signal-configuration"), ("fan", 1420, "2", "control-level")],
)  # fmt: skip
def test_a_drive_that_does_not_listen_to_the_line_says_so(
    drive: str, code: int, text: str, name: str
) -> None:
    async def test(plant: Plant) -> None:
        await run_motor(plant, drive)
        plant.line[drive].model.preset(code, text)
        report = await plant.site.operations.why(drive, fresh=True)
        found = next(one for one in report.findings if one.name == name)
        assert found.weight is Weight.REASON
        assert f"reads {text}" in found.shown_by

    at(drive, test)


@pytest.mark.parametrize("terminal", range(1121, 1125))
@pytest.mark.parametrize("answer", ["other", "no-such-code"])
def test_an_smvector_without_an_enabled_network_says_which_terminal(
    terminal: int, answer: str
) -> None:
    """P121 to P124: none is 9, or the one that is has its contact open; small drives lack P124."""

    async def test(plant: Plant) -> None:
        model = plant.line["fan"].model
        if answer == "no-such-code" and terminal != 1124:
            specs = model.params.specs
            assert isinstance(specs, dict)
            del specs[1124, 0]

        async def ask() -> WhyReport:
            return await plant.site.operations.why("fan", fresh=True)

        assert not [name for name in names(await ask()) if name.startswith("network-terminal")]
        model.preset(1121, "1")
        report = await ask()
        assert report.findings[0].name == "network-terminal-unassigned"
        assert "none of P121 to P124 is 9" in report.answer.en
        assert "keiner von P121 bis P124 ist 9" in report.answer.de
        model.preset(terminal, "9")
        model.set_terminal(high=False)
        report = await ask()
        letter = "ABCD"[terminal - 1121]
        assert report.findings[0].name == f"network-terminal-{letter.lower()}-open"
        assert f"terminal TB-13{letter} " in report.answer.en
        assert "network-terminal" not in names(report)
        model.set_terminal(high=True)
        assert not [name for name in names(await ask()) if name.startswith("network-terminal")]

    at("fan", test)


@pytest.mark.parametrize("source", ["2", "5"])
def test_an_smvector_that_leaves_control_to_a_keypad_says_so(source: str) -> None:
    async def test(plant: Plant) -> None:
        plant.line["fan"].model.preset(1100, source)
        report = await plant.site.operations.why("fan", fresh=True)
        assert report.findings[0].name == "control-source"
        assert "network-terminal" not in names(report)

    at("fan", test)


@pytest.mark.parametrize(("drive", "name"), [("servo", "terminal-28"),
                                             ("vector", "inhibited-elsewhere")])  # fmt: skip
def test_an_open_terminal_is_told_from_an_inhibit_by_the_line(drive: str, name: str) -> None:
    async def test(plant: Plant) -> None:
        await run_motor(plant, drive)
        plant.line[drive].set_terminal(high=False)
        report = await plant.site.operations.why(drive, fresh=True)
        assert report.findings[0].name == name

    at(drive, test)


def test_the_relative_setpoint_counts_where_c0127_says_so() -> None:
    async def test(plant: Plant) -> None:
        await run_motor(plant, "belt")
        plant.line["belt"].model.preset(127, "1")
        report = await plant.site.operations.why("belt", fresh=True)
        assert "setpoint-zero-relative" in names(report)
        assert "setpoint-zero-absolute" not in names(report)

    at("belt", test)


def test_a_silent_drive_says_since_when_and_what_is_old_is_called_so() -> None:
    async def test(plant: Plant) -> None:
        await plant.site.operations.write("vector", Code(40), 0)
        await plant.site.operations.why("vector", fresh=True)
        plant.line.faults.absent = {11}
        await until(lambda: plant.state("vector") is DriveState.OFFLINE, within_s=30.0)
        started_s = plant.now_s
        report = await plant.site.operations.why("vector", fresh=True)
        assert plant.now_s - started_s < 1.0
        assert report.findings[0].name == "offline"
        assert "does not answer since 2026" in report.answer.en
        inhibited = next(one for one in report.findings if one.name == "inhibited-by-line")
        assert inhibited.stale

    at("vector", test)


def test_a_line_that_is_lost_comes_before_everything() -> None:
    async def test(plant: Plant) -> None:
        plant.end.unplug()
        await until(lambda: not plant.site.worker.is_open)
        report = await plant.site.operations.why("vector", fresh=True)
        assert report.findings[0].name == "line"
        assert report.as_json(Language.EN)["state"] == "offline"

    at("vector", test)


def test_what_was_never_read_proves_nothing() -> None:
    async def main(plant: Plant) -> None:
        await plant.online()
        report = await plant.site.operations.why("vector")
        assert "setpoint-zero" not in names(report)
        assert "operating-mode" not in names(report)
        assert not report.history_known

    with_plant(main, roster_text(FAMILIES[:1], drive="cyclic: []"))


def test_the_old_fault_in_the_memory_is_history_and_no_answer() -> None:
    async def test(plant: Plant) -> None:
        plant.line["vector"].trip(91)
        await until(lambda: plant.site.store.drive("vector").fault is not None)
        plant.line["vector"].model.reset_fault()
        await until(lambda: plant.site.store.drive("vector").fault is None, within_s=5.0)
        await run_motor(plant, "vector")
        report = await plant.site.operations.why("vector", fresh=True)
        assert "trip" not in names(report)
        assert [(one.number, str(one.code)) for one in report.history] == [(91, "C0161")]

    at("vector", test)


def test_an_smvector_tells_its_older_faults_too() -> None:
    async def test(plant: Plant) -> None:
        for number in (13, 36):
            plant.line["fan"].trip(number)
            await until(lambda: plant.site.store.drive("fan").fault is not None, within_s=5.0)
            plant.line["fan"].model.reset_fault()
            await until(lambda: plant.site.store.drive("fan").fault is None, within_s=5.0)
        report = await plant.site.operations.why("fan", fresh=True)
        assert [one.number for one in report.history] == [36, 13]

    at("fan", test)


def test_reading_what_matters_takes_little_line_time_and_leaves_the_slow_codes_alone() -> None:
    async def test(plant: Plant) -> None:
        started_s = plant.now_s
        await plant.site.operations.why("servo", fresh=True)
        asked = [
            one.step.code for one in plant.reports
            if one.result.started_s >= started_s and one.priority.name == "INTERACTIVE"
        ]  # fmt: skip
        assert len(asked) <= 20
        assert not {code for code in asked if 1920 <= code.number <= 1923}

    at("servo", test)


@pytest.mark.parametrize(
    ("drive", "word", "name"),
    [
        ("vector", "H0020", "ramp-held-at-zero"),
        ("belt", "H0010", "ramp-stopped"),
        ("vector", "H4000", "dc-braking-by-line"),
        ("servo", "H0020", "ramp-held-at-zero"),
        ("pump", "H4000", "dc-braking-by-line"),
        ("fan", "H4000", "dc-braking-by-line"),
    ],
)
def test_a_bit_of_the_control_word_that_holds_the_motor_is_named(
    drive: str, word: str, name: str
) -> None:
    async def test(plant: Plant) -> None:
        await run_motor(plant, drive)
        before = await plant.site.operations.why(drive, fresh=True)
        assert name not in names(before)
        await plant.site.operations.write(drive, Code(135), word)
        report = await plant.site.operations.why(drive, fresh=True)
        assert name in names(report)

    at(drive, test)


@pytest.mark.parametrize("drive", ["servo", "pump"])
def test_a_bit_that_means_something_else_there_is_not_blamed(drive: str) -> None:
    async def test(plant: Plant) -> None:
        await run_motor(plant, drive)
        word = {"servo": "H4000", "pump": "H0020"}[drive]
        await plant.site.operations.write(drive, Code(135), word)
        report = await plant.site.operations.why(drive, fresh=True)
        assert not {"dc-braking-by-line", "ramp-held-at-zero"} & set(names(report))

    at(drive, test)


def test_no_drive_and_no_such_drive() -> None:
    async def main(plant: Plant) -> None:
        with pytest.raises(OperationError, match="nobody"):
            await plant.site.operations.why("nobody", fresh=True)
        report = await plant.site.operations.why("counter")
        assert report.as_json(Language.EN)["output"] is None

    with_plant(main, roster_text([("counter", 31, "generic")]))


@pytest.mark.parametrize("name", [one for one in FAMILY_NAMES if one != "generic"])
def test_every_family_that_is_described_has_reasons(name: str) -> None:
    assert any(name in reason.families for reason in reasons())


def test_every_reason_is_of_families_that_have_its_codes_and_states() -> None:
    for reason in reasons():
        for name in reason.families:
            assert name in FAMILY_NAMES
            for one in (*reason.values, *reason.not_values):
                assert family(name).info(one.code) is not None, (reason.name, name)
        for text in (reason.text, reason.remedy):
            assert text.en
            assert text.de
        assert reason.source.startswith(("EDB2102EN", "CMVLC401A"))
        shown = {
            rule.state
            for name in reason.families
            for one in (family(name), *family(name).variants.values())
            for word in one.words.values() for rule in word.states
        }  # fmt: skip
        assert reason.states <= shown, reason.name
    assert asked_codes("generic") == ()


def test_the_weights_come_in_their_order() -> None:
    async def test(plant: Plant) -> None:
        report = await plant.site.operations.why("servo", fresh=True)
        order = [list(Weight).index(one.weight) for one in report.findings]
        assert all(one <= two for one, two in pairwise(order))

    at("servo", test)


RULE = """\
families: {all: [generic]}
reasons:
  - {name: one, families: [generic], states: [inhibited], weight: reason, text: [a, b],
     remedy: [c, d], source: "M 1"}
"""


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("[inhibited]", "[inhibted]", "reasons.yaml:3:47: inhibted is not known here"),
        ("weight: reason", "weight: heavy", "heavy is not known here; reason, hint, note are"),
        (', source: "M 1"', "", "source is missing"),
        ("states: [inhibited]", "values: [{code: C0135}]", "one of not_in"),
    ],
)
def test_a_wrong_reason_is_refused_with_its_place(old: str, new: str, why: str) -> None:
    assert len(reasons({"reasons.yaml": RULE}.__getitem__)) == 1
    with pytest.raises(DescriptionError, match=why):
        reasons({"reasons.yaml": RULE.replace(old, new, 1)}.__getitem__)


# ---- the last enable ------------------------------------------------------------------------


async def enable(plant: Plant, drive: str) -> VerbReport:
    return await plant.site.operations.verb(drive, Verb.ENABLE)


@pytest.mark.parametrize("drive", [one for one in TRIPS if one != "fan"])
def test_an_enable_that_was_taken_back_is_remembered_until_one_succeeds(drive: str) -> None:
    async def test(plant: Plant) -> None:
        model = plant.line[drive].model
        model.set_terminal(high=False)
        report = await enable(plant, drive)
        assert report.outcome is Outcome.REFUSED
        model.set_terminal(high=True)
        for fresh in (True, False):
            why = await plant.site.operations.why(drive, fresh=fresh)
            first = why.findings[0]
            assert (first.name, first.weight) == ("enable-taken-back", Weight.REASON)
            assert "was taken back: " in why.answer.en
            assert report.reason in why.answer.en
            assert report.cause in why.answer.en
            assert "lecombus enable" in first.remedy.en
            assert "inhibited-by-line" in names(why)
        last = why.as_json(Language.DE)["last_enable"]
        assert isinstance(last, dict)
        assert (last["outcome"], last["taken_back"]) == ("refused", True)
        assert str(last["time"]) in why.answer.en
        assert (last["reason"], last["cause"]) == (report.reason, report.cause)
        assert (await enable(plant, drive)).outcome is Outcome.VERIFIED
        why = await plant.site.operations.why(drive, fresh=True)
        assert not any(name.startswith("enable-") for name in names(why))
        assert why.as_json(Language.EN)["last_enable"] is None

    at(drive, test)


def test_an_enable_that_was_refused_is_remembered_with_its_remedy() -> None:
    async def test(plant: Plant) -> None:
        await plant.site.operations.write("belt", Code(1), 0)
        with pytest.raises(OperationError) as refused:
            await enable(plant, "belt")
        why = await plant.site.operations.why("belt", fresh=True)
        (found,) = [one for one in why.findings if one.name == "enable-refused"]
        assert (found.weight, found.remedy.en) == (Weight.HINT, refused.value.remedy)
        assert str(refused.value) in found.text.en
        assert "was refused: " in found.text.en
        # Enabled in another way: what was refused then explains nothing now.
        await plant.site.operations.write("belt", Code(1), 3)
        await run_motor(plant, "belt")
        why = await plant.site.operations.why("belt", fresh=True)
        assert why.last_enable is None
        await plant.site.operations.write("belt", Code(40), 0)
        assert (await plant.site.operations.why("belt", fresh=True)).last_enable is None

    drives = [one for one in FAMILIES if one[0] == "belt"]
    roster = roster_text(drives, drive="also_writable: [C0001]")

    async def main(plant: Plant) -> None:
        await plant.online()
        await test(plant)

    with_plant(main, roster)


def test_a_refused_enable_of_an_smvector_whose_network_terminal_is_open_is_remembered() -> None:
    async def test(plant: Plant) -> None:
        plant.line["fan"].model.set_terminal(high=False)
        report = await enable(plant, "fan")
        assert report.outcome is Outcome.REFUSED
        why = await plant.site.operations.why("fan", fresh=True)
        assert why.last_enable is not None
        assert why.last_enable.reason == report.reason
        assert "was refused: " in why.answer.en
        assert why.findings[0].name == "enable-refused"
        plant.line["fan"].model.set_terminal(high=True)
        assert (await enable(plant, "fan")).outcome is Outcome.VERIFIED
        assert (await plant.site.operations.why("fan")).last_enable is None

    at("fan", test)


def test_an_enable_that_a_stop_ended_is_no_refusal() -> None:
    async def test(plant: Plant) -> None:
        enabling = asyncio.create_task(enable(plant, "vector"))
        await anyio.sleep(0.05)
        await plant.site.operations.stop(StopAction.INHIBIT, "vector")
        assert (await enabling).outcome is Outcome.SUPERSEDED
        assert (await plant.site.operations.why("vector", fresh=True)).last_enable is None

    at("vector", test)


def test_an_operating_mode_that_was_not_read_is_not_called_wrong() -> None:
    """Every 82XX has C0001: a drive whose addressing was moved answers as if it had not."""
    assert not holding("8200vector", frozenset(), {}, {Code(1)})
    (found,) = holding("8200vector", frozenset(), {Code(1): Value.decimal(0)})
    assert found.name == "operating-mode"


def test_a_failed_enable_is_remembered_when_the_daemon_restarts() -> None:
    state = State()

    async def fails(plant: Plant) -> None:
        await plant.online()
        plant.line["vector"].model.set_terminal(high=False)
        assert (await enable(plant, "vector")).outcome is Outcome.REFUSED

    async def restarted(plant: Plant) -> None:
        await plant.online()
        why = await plant.site.operations.why("vector", fresh=True)
        assert why.last_enable == state.drive("vector").last_enable
        assert why.findings[0].name == "enable-taken-back", "no stop came since"
        assert "was taken back: " in why.answer.en
        plant.line["vector"].model.set_terminal(high=True)
        assert (await enable(plant, "vector")).outcome is Outcome.VERIFIED
        assert (await plant.site.operations.why("vector")).last_enable is None

    async def replaced(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        operations.accept("vector", operations.identity("vector").found)
        assert (await operations.why("vector")).last_enable is None

    roster = roster_text([one for one in FAMILIES if one[0] == "vector"])
    with_plant(fails, roster, state=state)
    kept = state.text().encode()
    state = State.parse(kept)
    with_plant(restarted, roster, state=state)
    other = State.parse(kept)
    other.drive("vector").identity = dict.fromkeys(other.drive("vector").identity, "another")
    with_plant(replaced, roster, state=other)

    async def stopped(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.stop(StopAction.QUICK_STOP, "vector")

    async def restarted_again(plant: Plant) -> None:
        await plant.online()
        why = await plant.site.operations.why("vector", fresh=True)
        assert "enable-taken-back" in names(why)[1:], "the stop is what keeps it still"

    state = State.parse(kept)
    with_plant(stopped, roster, state=state)
    with_plant(restarted_again, roster, state=State.parse(state.text().encode()))
    moved = roster_text([("vector", 17, "8200vector")])

    async def elsewhere(plant: Plant) -> None:
        assert (await plant.site.operations.why("vector")).last_enable is None

    with_plant(elsewhere, moved, state=State.parse(kept))


def test_another_drive_of_the_same_name_has_no_last_enable() -> None:
    async def test(plant: Plant) -> None:
        plant.line["vector"].model.set_terminal(high=False)
        assert (await enable(plant, "vector")).outcome is Outcome.REFUSED
        operations, roster = plant.site.operations, plant.site.roster
        plant.site.apply(roster)
        assert (await operations.why("vector")).last_enable is not None
        here = roster.drives[0]
        patient = here.model_copy(update={"answer_time_s": 0.5})
        plant.site.apply(roster.model_copy(update={"drives": (patient,)}))
        assert (await operations.why("vector")).last_enable is not None, "it is the same drive"
        other = here.model_copy(update={"address": 15})
        plant.site.apply(roster.model_copy(update={"drives": (other,)}))
        plant.site.apply(roster)
        assert (await operations.why("vector")).last_enable is None

    at("vector", test)


@pytest.mark.parametrize(("drive", "unseen"), [("vector", True), ("servo", True), ("belt", False)])
def test_a_quick_stop_of_the_watchdog_that_no_word_shows_is_the_answer_until_an_enable(
    drive: str, unseen: bool
) -> None:
    async def main(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        if drive == "vector":  # a setpoint of 0 would be the answer
            plant.line[drive].model.preset(46, "20")
        assert (await enable(plant, drive)).outcome is Outcome.VERIFIED
        plant.end.unplug()
        await anyio.sleep(4.0)
        plant.end.replug()
        await plant.online(within_s=60.0)
        motion = plant.site.store.motion
        for _ in range(2):
            assert motion(drive).doing is (Doing.UNKNOWN if unseen else Doing.STOPPED)
            await anyio.sleep(12.0)
        for told in (unseen, False):
            why = await plant.site.operations.why(drive, fresh=True)
            (lapse,) = [one for one in why.findings if one.name == "watchdog-lapsed"]
            assert ("no status word of this family shows one" in lapse.text.en) is told
            assert why.answer.en.startswith("its watchdog was fed too late") is told
            assert (await enable(plant, drive)).outcome is Outcome.VERIFIED
            assert motion(drive).doing in (Doing.ENABLED, Doing.RUNNING)

    chosen = [one for one in FAMILIES if one[0] == drive]
    watchdog = "{time: 2s, action: quick-stop, configure: true}"
    with_plant(main, roster_text(chosen, watchdog=watchdog), word_as_written=True)


def test_a_drive_that_runs_is_held_by_no_quick_stop_that_no_word_shows() -> None:
    """Its answers were lost, so its watchdog seemed to lapse; it heard every request."""

    async def main(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        await run_motor(plant, "vector")
        assert (await enable(plant, "vector")).outcome is Outcome.VERIFIED
        plant.line.faults.lost = 1.0
        await anyio.sleep(2.6)
        plant.line.faults.lost = 0.0
        await plant.online(within_s=60.0)
        await anyio.sleep(12.0)
        assert plant.line["vector"].watchdog_fired == 0
        assert plant.site.store.motion("vector").doing is Doing.RUNNING
        why = await plant.site.operations.why("vector", fresh=True)
        (lapse,) = [one for one in why.findings if one.name == "watchdog-lapsed"]
        assert "no status word of this family shows one" not in lapse.text.en

    chosen = [one for one in FAMILIES if one[0] == "vector"]
    with_plant(
        main, roster_text(chosen, watchdog="{time: 2s, action: quick-stop, configure: true}")
    )


def test_a_watchdog_that_inhibits_sets_no_quick_stop_that_no_word_shows() -> None:
    async def main(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        assert (await enable(plant, "vector")).outcome is Outcome.VERIFIED
        plant.end.unplug()
        await anyio.sleep(4.0)
        plant.end.replug()
        await plant.online(within_s=60.0)
        why = await plant.site.operations.why("vector", fresh=True)
        (lapse,) = [one for one in why.findings if one.name == "watchdog-lapsed"]
        assert "no status word of this family shows one" not in lapse.text.en

    chosen = [one for one in FAMILIES if one[0] == "vector"]
    with_plant(main, roster_text(chosen, watchdog="{time: 2s, action: inhibit, configure: true}"))


@pytest.mark.parametrize(("drive", "unseen"), [("vector", True), ("servo", True), ("belt", False)])
def test_after_a_restart_a_drive_is_not_called_enabled_before_a_word_shows_it(
    drive: str, unseen: bool
) -> None:
    """Its watchdog may have acted while lecombus did not run; it has, here."""
    chosen = [one for one in FAMILIES if one[0] == drive]
    text = roster_text(chosen, watchdog="{time: 2s, action: quick-stop, configure: true}")

    async def main(before: Plant) -> None:
        await before.online(within_s=60.0)
        assert (await enable(before, drive)).outcome is Outcome.VERIFIED
        assert before.site.store.motion(drive).doing is Doing.ENABLED
        before.end.unplug()
        await anyio.sleep(4.0)
        async with Plant(text, line=before.line) as plant:
            await plant.online(within_s=60.0)
            assert plant.line[drive].watchdog_fired == 1
            motion = plant.site.store.motion
            assert motion(drive).doing is not Doing.ENABLED
            await anyio.sleep(12.0)
            assert motion(drive).doing is (Doing.UNKNOWN if unseen else Doing.STOPPED)
            if unseen:
                assert [one.text for one in motion(drive).stops] == ["its watchdog may have acted"]
            assert (await enable(plant, drive)).outcome is Outcome.VERIFIED
            assert motion(drive).doing is Doing.ENABLED

    with_plant(main, text, word_as_written=True)


@pytest.mark.parametrize("how", ["stop", "verb", "write"])
def test_after_a_later_stop_the_enable_that_was_taken_back_no_longer_leads(how: str) -> None:
    async def test(plant: Plant) -> None:
        operations = plant.site.operations
        model = plant.line["belt"].model
        model.set_terminal(high=False)
        assert (await enable(plant, "belt")).outcome is Outcome.REFUSED
        model.set_terminal(high=True)
        assert (await operations.why("belt")).findings[0].name == "enable-taken-back"
        if how == "stop":
            await operations.stop(StopAction.INHIBIT, "belt")
        elif how == "verb":
            await operations.verb("belt", Verb.INHIBIT)
        else:
            await operations.write("belt", Code(40), 0)
        for fresh in (True, False):
            why = await operations.why("belt", fresh=fresh)
            assert why.findings[0].name == "inhibited-by-line"
            (found,) = [one for one in why.findings if one.name == "enable-taken-back"]
            assert found.weight is Weight.HINT, "it is still remembered"

    at("belt", test)


def test_an_old_command_does_not_lead_against_a_fresh_status_word() -> None:
    async def test(plant: Plant) -> None:
        operations = plant.site.operations
        await run_motor(plant, "belt")
        plant.site.store.value_read("belt", Code(40), Value.parse("0"), plant.now_s - 60.0)
        why = await operations.why("belt")
        assert "inhibited-by-c0040" not in names(why)
        assert "nothing that is known" in why.answer.en

    at("belt", test)


@pytest.mark.parametrize("drive", ["vector", "belt"])
def test_an_old_quick_stop_stays_known_only_where_no_status_word_would_show_it(drive: str) -> None:
    async def test(plant: Plant) -> None:
        operations = plant.site.operations
        await run_motor(plant, drive)
        old_s = plant.now_s - 60.0
        plant.site.store.value_read(drive, Code(135), Value.parse("H0008"), old_s)
        why = await operations.why(drive)
        assert ("quick-stop-by-line" in names(why)) is (drive == "vector")

    at(drive, test)


@pytest.mark.parametrize("drive", ["vector", "servo", "belt", "pump", "fan"])
def test_a_quick_stop_whose_words_are_not_read_again_never_looks_like_an_enable(drive: str) -> None:
    async def main(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.why(drive, fresh=True)
        for doing in (Doing.STOPPED, Doing.UNKNOWN):
            why = await plant.site.operations.why(drive)
            motion = plant.site.store.motion(drive)
            assert {"quick-stop-by-line", "quick-stop"} & set(names(why))
            assert (motion.doing, [one.text for one in motion.stops]) == (doing, ["quick stop"])
            await anyio.sleep(30.0)

    chosen = [one for one in FAMILIES if one[0] == drive]
    seldom = "cyclic: [{code: C0150, every: 1s}, {code: C0050, every: 2s}]"
    with_plant(main, roster_text(chosen, drive=seldom))


def test_a_feed_that_came_late_does_not_say_that_the_drive_has_acted() -> None:
    for unseen in (True, False):
        found = lapse_finding(1, unseen=unseen)
        assert "fed too late once" in found.text.en
        assert "may have acted then" in found.text.en
        assert "kann angesprochen haben" in found.text.de


@pytest.mark.parametrize("verb", list(Verb))
def test_a_group_is_no_drive_and_the_answer_says_so(verb: Verb) -> None:
    async def test(plant: Plant) -> None:
        with pytest.raises(OperationError) as refused:
            await plant.site.operations.verb("all", verb)
        assert refused.value.kind == "no-such-drive"
        assert "all is a group" in str(refused.value)
        assert "name one of its drives (belt)" in refused.value.remedy
        with pytest.raises(OperationError, match="is a group"):
            await plant.site.operations.why("all")

    at("belt", test)


TOLD = "the roster does not let it write"


@pytest.mark.parametrize(
    ("drive", "writable", "lacking"),
    [("vector", "[C0046]", "C0040, C0135"), ("belt", "[C0046, C0135]", "C0040"),
     ("vector", "[C0046, C0040]", "C0135")],
)  # fmt: skip
def test_an_enable_that_the_roster_takes_away_is_advised_with_all_that_it_needs(
    drive: str, writable: str, lacking: str
) -> None:
    """What `check` says is missing, `why` and the refusal say too, before anything is sent."""

    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        await operations.stop(StopAction.INHIBIT, drive)
        why = await operations.why(drive, fresh=True)
        advice = [one.remedy for one in why.findings if "lecombus enable" in one.remedy.en]
        assert advice
        for one in advice:
            assert f"{TOLD} {lacking}: first add" in one.en
            assert lacking in one.de
        began_s = plant.now_s
        with pytest.raises(OperationError) as refused:
            await operations.verb(drive, Verb.ENABLE)
        assert refused.value.kind == "not-writable"
        assert f"add {lacking} to `also_writable`" in refused.value.remedy
        sent = plant.sent_to(plant.line[drive].address, began_s)
        assert [one for one in sent if one.data[3] == STX] == []
        why = await operations.why(drive)
        assert any(f"add {lacking} to `also_writable`" in one.remedy.en for one in why.findings)

    chosen = [one for one in FAMILIES if one[0] == drive]
    with_plant(test, roster_text(chosen, drive=f"writable: {writable}"))


def test_a_setpoint_and_a_reset_that_the_roster_takes_away_are_advised_so() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.verb("vector", Verb.ENABLE)
        await anyio.sleep(3.0)
        why = await plant.site.operations.why("vector", fresh=True)
        (advice,) = [one.remedy for one in why.findings if "set-speed" in one.remedy.en]
        assert f"{TOLD} C0046: first add" in advice.en
        plant.line["vector"].trip(50)
        await until(lambda: named(plant, "vector"), within_s=5.0)
        why = await plant.site.operations.why("vector", fresh=True)
        assert f"{TOLD} C0043: first add" in why.findings[0].remedy.en

    with_plant(test, roster_text(FAMILIES[:1], drive="writable: [C0040, C0135]"))


@pytest.mark.parametrize("reason", reasons(), ids=lambda one: one.name)
def test_a_reason_that_advises_a_verb_names_it(reason: Reason) -> None:
    for remedy in (reason.remedy.en, reason.remedy.de):
        advised = [verb for verb in Verb if f"lecombus {verb}" in remedy]
        assert advised == ([] if reason.verb is None else [reason.verb])
