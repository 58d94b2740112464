"""Stops of one drive, of a group, of all: first of all, proven, and none lost."""

from __future__ import annotations

import asyncio
import itertools

import anyio
import anyio.lowlevel
import pytest

from lecombus.drive_state.readings import DriveState
from lecombus.drives import FAMILY_NAMES, StopAction
from lecombus.errors import NoReplyError, OperationError
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.lecom.simulator.line import build
from lecombus.fieldbus.requests import StepKind
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome
from operations.groups import (
    ENABLE,
    GROUPS,
    INHIBIT,
    MIXED,
    QUICK,
    ROSTER,
    STATUS,
    TEENS,
    WORD,
    WRITABLE,
    written,
)
from support.drives import presets
from support.rosters import make_roster, roster_text
from support.site_host import Plant, until, with_plant


def test_all_members_are_told_to_stop_before_the_first_is_asked_whether_it_did() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        said = len(plant.end.sent)
        report = await plant.site.operations.stop(INHIBIT, "two")
        assert (report.how, report.outcome) == ("one-by-one", Outcome.VERIFIED)
        stops = [one.data[1:3] + one.data[3:4] for one in plant.end.sent[said:]]
        assert stops[:2] == [b"11\x02", b"12\x02"]

    with_plant(test, ROSTER)


def test_a_stop_of_a_decade_is_one_telegram_and_is_proven_by_every_member() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.write_group("teens", ENABLE, 1)
        said = len(plant.end.sent)
        report = await plant.site.operations.stop(INHIBIT, "teens")
        assert (report.how, report.outcome) == ("multicast", Outcome.VERIFIED)
        assert written(plant, said) == [b"10"]
        assert [plant.line[name].text(40) for name in "abc"] == ["0"] * 3

    with_plant(test, ROSTER)


def test_a_member_the_stop_did_not_reach_is_stopped_alone() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.write_group("teens", ENABLE, 1)
        plant.line.drive_faults[12] = Faults(unheard=1.0)
        said = len(plant.end.sent)
        stopping = asyncio.create_task(plant.site.operations.stop(INHIBIT, "teens"))
        await until(lambda: b"10" in written(plant, said))
        await anyio.sleep(0.02)
        plant.line.drive_faults.clear()
        report = await stopping
        assert report.outcome is Outcome.VERIFIED
        assert written(plant, said) == [b"10", b"12"]
        assert plant.line["b"].text(40) == "0"

    with_plant(test, ROSTER)


def test_stopping_all_with_a_device_nobody_describes_stops_the_others_and_says_so() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        report = await plant.site.operations.stop(INHIBIT, "all")
        assert report.how == "one-by-one", "a broadcast would reach the device too"
        kinds = {member.drive: member.kind for member in report.members}
        assert kinds == {"a": "", "b": "", "c": "", "d": "", "g": "no-stop"}
        codes = {member.drive: str(member.code) for member in report.members}
        assert (codes["a"], codes["g"]) == ("C0040", "None"), "nothing was written to it"
        assert [plant.line[name].text(40) for name in "abcd"] == ["0"] * 4
        with pytest.raises(OperationError) as caught:
            await plant.site.operations.stop(INHIBIT, "g")
        assert caught.value.kind == "no-stop"

    with_plant(test, ROSTER)


def test_a_stop_is_sent_to_a_drive_that_is_offline_but_after_those_that_are_not() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.drive_faults[11] = Faults(lost=1.0)
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        said, since_s = len(plant.end.sent), plant.now_s
        report = await plant.site.operations.stop(INHIBIT, "two")
        assert written(plant, said)[0] == b"12", "who can be stopped at once is stopped first"
        assert b"11" in written(plant, said), "its hearing may be well"
        assert plant.line["a"].text(40) == "0"
        assert [member.drive for member in report.members] == ["a", "b"]
        assert [m.outcome for m in report.members] == [Outcome.UNKNOWN, Outcome.VERIFIED]
        assert plant.now_s - since_s < 3.0

    often = roster_text(TEENS, drive="cyclic: [{code: C0150, every: 200ms}]", sections=GROUPS)
    with_plant(test, often)


def test_a_stop_goes_to_a_drive_that_was_not_audited_yet() -> None:
    async def test(plant: Plant) -> None:
        await until(lambda: plant.site.worker.is_open)
        report = await plant.site.operations.stop(QUICK, "a")
        assert report.outcome is Outcome.VERIFIED
        assert plant.line["a"].model.control & 0x0008

    with_plant(test, ROSTER)


def test_a_quick_stop_that_became_an_inhibit_is_reported_as_one() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.site.drives.get("a").control_word.forget()
        plant.line["a"].model.readers[135] = lambda _: "Snone"
        report = await plant.site.operations.stop(QUICK, "a")
        assert report.outcome is Outcome.VERIFIED
        assert report.members[0].code == ENABLE
        assert "quick-stop needs C0135, which reads none" in report.members[0].reason
        assert plant.line["a"].text(40) == "0"

    with_plant(test, ROSTER)


@pytest.mark.parametrize("kind", ["820x", "821x", "822x", "824x", "8200vector"])
def test_a_quick_stop_the_terminals_do_not_leave_to_us_is_an_inhibit_at_once(kind: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        drive = plant.line["a"].model
        drive.preset(40, "1")
        drive.preset(1, "0")
        begun_s = plant.now_s
        report = await plant.site.operations.stop(QUICK, "a")
        assert plant.now_s - begun_s < 1.0
        assert report.outcome is Outcome.VERIFIED
        assert "quick-stop was refused by the drive (NAK); inhibit: C0150" in (
            report.members[0].reason
        )
        assert drive.control & 0x0200

    with_plant(test, roster_text([("a", 11, kind)]))


@pytest.mark.parametrize("action", [QUICK, INHIBIT])
@pytest.mark.parametrize("kind", [name for name in FAMILY_NAMES if name != "generic"])
def test_a_running_drive_of_every_family_ends_in_a_stop_that_is_proven(
    kind: str, action: StopAction
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        drive = plant.line["a"].model
        drive.preset(1061 if kind == "smvector" else 141 if kind == "93xx" else 46, "20")
        drive.preset(135, "H0000")
        await anyio.sleep(30.0)
        assert abs(drive.motor.output) > 0.0
        report = await plant.site.operations.stop(action, "a")
        assert report.outcome is Outcome.VERIFIED
        held = "command held, " if action is QUICK and kind in ("8200vector", "93xx") else ""
        assert report.members[0].reason.startswith(f"{action}: {held}C0")
        proof = report.members[0].proof
        assert proof is not None
        assert f"{proof.code} reads {proof.raw}" in report.members[0].reason
        shows = "inhibited" if action is INHIBIT else "command held" if held else "quick stop"
        assert proof.shows == shows
        await anyio.sleep(30.0)
        assert drive.motor.speed == 0.0

    with_plant(test, roster_text([("a", 11, kind)]))


def test_a_stop_that_is_not_proven_says_how_to_stop_the_drive_all_the_same() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.faults.absent = {11}
        report = await plant.site.operations.stop(INHIBIT, "a")
        assert report.outcome is Outcome.UNKNOWN
        assert "the motor may turn: use the emergency stop circuit" in report.members[0].remedy

    with_plant(test, ROSTER)


def test_a_stop_is_never_superseded_by_another() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        stops = [plant.site.operations.stop(action, "two") for action in (QUICK, INHIBIT, QUICK)]
        reports = await asyncio.gather(*stops)
        assert [report.outcome for report in reports] == [Outcome.VERIFIED] * 3
        assert plant.line["a"].model.control & 0x0208 == 0x0208

    with_plant(test, ROSTER)


@pytest.mark.parametrize(("code", "value"), [(ENABLE, 0), (WORD, "H0200")])
def test_a_quick_stop_does_not_lift_an_inhibit_that_is_just_being_written(
    code: Code, value: int | str
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.write("a", WORD, "H0000")
        await plant.site.operations.read("a", WORD)
        said = len(plant.end.sent)
        writing = asyncio.create_task(plant.site.operations.write("a", code, value))
        await until(lambda: len(plant.end.sent) > said)
        report = await plant.site.operations.stop(QUICK, "a")
        assert (await writing).outcome is Outcome.DONE
        assert report.outcome is Outcome.VERIFIED
        assert plant.line["a"].model.control & 0x0208 == 0x0208

    with_plant(test, ROSTER)


def test_nor_one_that_is_just_going_out_to_its_group() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.write_group("teens", WORD, "H0000")
        said = len(plant.end.sent)
        writing = asyncio.create_task(plant.site.operations.write_group("teens", ENABLE, 0))
        await until(lambda: b"10" in written(plant, said))
        await plant.site.operations.stop(QUICK, "a")
        assert (await writing).outcome is Outcome.VERIFIED
        assert plant.line["a"].model.control & 0x0208 == 0x0208

    with_plant(test, ROSTER)


def test_nor_does_a_quick_stop_of_the_group_made_from_a_word_read_before_the_inhibit() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.write_group("teens", WORD, "H0000")
        for name in "abc":
            await plant.site.operations.read(name, WORD)
        said = len(plant.end.sent)
        reading = asyncio.create_task(plant.site.operations.read("a", WORD))
        await until(lambda: len(plant.end.sent) > said)
        inhibiting = asyncio.create_task(plant.site.operations.stop(INHIBIT, "a"))
        await until(lambda: b"11" in written(plant, said))
        await plant.site.operations.stop(QUICK, "teens")
        await reading
        assert b"10" not in written(plant, said), "one word for all would have lifted it"
        assert (await inhibiting).outcome is Outcome.VERIFIED
        assert plant.line["a"].model.control & 0x0208 == 0x0208

    with_plant(test, ROSTER)


# ---- a line that is not as it should be -----------------------------------------------------

SIX = [(name, 31 + n, "8200vector") for n, name in enumerate("pqrstu")]


def told_at_s(plant: Plant, since: int) -> dict[bytes, float]:
    """When each address was first written to since the so-manieth telegram."""
    found: dict[bytes, float] = {}
    for one in plant.end.sent[since:]:
        if b"\x02" in one.data:
            found.setdefault(one.data[1:3], one.at_s)
    return found


@pytest.mark.parametrize("action", [QUICK, INHIBIT])
@pytest.mark.parametrize("known", [False, True])
def test_drives_that_are_silent_keep_the_living_ones_from_their_stop_once_at_most(
    action: StopAction, known: bool
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(1.0)  # nothing is under way any more
        plant.line.faults.absent = {31, 32}
        if known:
            for drive in ("p", "q"):
                with pytest.raises(Exception, match=drive):
                    await plant.site.operations.read(drive, STATUS)
        for name in "pqrstu":
            plant.site.drives.get(name).control_word.forget()
        said, since_s = len(plant.end.sent), plant.now_s
        await plant.site.operations.stop(action, "six")
        first = told_at_s(plant, said)
        living = max(first[b"%d" % address] for address in (33, 34, 35, 36)) - since_s
        # Four living drives take 0.1 s, 0.2 s with reading the word; an attempt in vain 0.13 s.
        assert living < (0.25 if known else 0.4)

    groups = "groups:\n  six: {members: [p, q, r, s, t, u]}\n"
    with_plant(test, roster_text([*SIX, ("v", 37, "8200vector")], drive=WRITABLE, sections=groups))


def test_a_drive_that_was_deaf_for_two_seconds_is_stopped_all_the_same() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.write("a", ENABLE, 1)
        plant.line.drive_faults[11] = Faults(unheard=1.0)
        stopping = asyncio.create_task(plant.site.operations.stop(INHIBIT, "a"))
        await anyio.sleep(2.0)
        plant.line.drive_faults.clear()
        report = await stopping
        assert report.outcome is Outcome.VERIFIED
        assert plant.line["a"].text(40) == "0"

    with_plant(test, ROSTER)


@pytest.mark.parametrize("retries", [0, 2])
@pytest.mark.parametrize("kind", ["8200vector", "smvector"])
def test_a_deaf_drive_is_stopped_as_soon_also_where_answers_may_come_very_late(
    kind: str, retries: int
) -> None:
    """A proof whose answer was lost may not be read for 10 s, and kept the stop back so long."""

    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.drive_faults[11] = Faults(unheard=1.0)
        said, since_s = len(plant.end.sent), plant.now_s
        stopping = asyncio.create_task(plant.site.operations.stop(INHIBIT, "a"))
        await anyio.sleep(2.0)
        plant.line.drive_faults.clear()
        await anyio.sleep(0.6)
        assert plant.line["a"].model.inhibited()
        await stopping
        at_s = [one.at_s - since_s for one in plant.end.sent[said:] if b"\x02" in one.data]
        assert max(b - a for a, b in itertools.pairwise(at_s[:10])) < 0.6

    line = f"late_answer: 10s, retries: {retries}"
    with_plant(test, roster_text([("a", 11, kind)], drive="", line=line))


def test_many_stops_of_one_drive_are_said_as_few_and_all_are_told() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        said = len(plant.end.sent)
        stops = [plant.site.operations.stop(INHIBIT, "a") for _ in range(120)]
        gone = asyncio.create_task(plant.site.operations.stop(INHIBIT, "a"))
        await anyio.lowlevel.checkpoint()
        gone.cancel()
        other = asyncio.create_task(plant.site.operations.stop(INHIBIT, "b"))
        reports = await asyncio.gather(*stops)
        assert {report.outcome for report in reports} == {Outcome.VERIFIED}
        assert (await other).outcome is Outcome.VERIFIED
        assert written(plant, said).count(b"11") <= 2

    with_plant(test, ROSTER)


def test_many_stops_of_a_decade_are_said_as_few_telegrams() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        said = len(plant.end.sent)
        reports = await asyncio.gather(
            *(plant.site.operations.stop(INHIBIT, "teens") for _ in range(50))
        )
        assert {report.outcome for report in reports} == {Outcome.VERIFIED}
        assert len(written(plant, said)) <= 3

    with_plant(test, ROSTER)


def test_a_stop_of_a_drive_that_leaves_the_roster_meanwhile_is_reported() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        stopping = asyncio.create_task(plant.site.operations.stop(INHIBIT, "a"))
        await anyio.lowlevel.checkpoint()
        plant.apply(roster_text(MIXED[1:], drive=WRITABLE))
        report = await stopping
        assert report.outcome is Outcome.VERIFIED
        assert report.members[0].reading is None

    with_plant(test, ROSTER)


def test_a_control_word_that_cannot_be_one_makes_an_inhibit_of_the_quick_stop() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line["a"].model.readers[135] = lambda _: "H00010004"
        plant.site.drives.get("a").control_word.forget()
        report = await plant.site.operations.stop(QUICK, "a")
        assert (report.outcome, report.members[0].code) == (Outcome.VERIFIED, ENABLE)

    with_plant(test, ROSTER)


def test_a_quick_stop_of_a_decade_goes_one_by_one_while_a_control_word_is_being_written() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.write_group("teens", WORD, "H0000")
        writing = asyncio.create_task(plant.site.operations.write("b", ENABLE, 0))
        await anyio.lowlevel.checkpoint()
        word = plant.site.drives.get("b").control_word
        word.seen(WORD, Value.parse("H0000"))  # a read that was under way
        report = await plant.site.operations.stop(QUICK, "teens")
        await writing
        assert (report.how, report.outcome) == ("one-by-one", Outcome.VERIFIED)

    with_plant(test, ROSTER)


def test_a_quick_stop_whose_word_may_not_be_read_now_becomes_an_inhibit_and_does_not_wait() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(5.0)  # no module's own code, which holds the line for half a second
        plant.site.drives.get("c").control_word.forget()
        plant.line.drive_faults[13] = Faults(lost=1.0)
        with pytest.raises(NoReplyError):  # after a repetition in the other form
            await plant.site.operations.read("c", WORD)
        plant.line.drive_faults.clear()
        said, since_s = len(plant.end.sent), plant.now_s
        report = await plant.site.operations.stop(QUICK, "c")
        assert (report.outcome, report.members[0].code) == (Outcome.VERIFIED, ENABLE)
        assert told_at_s(plant, said)[b"13"] - since_s < 0.1, "an old answer may come for 0.5 s"

    with_plant(test, ROSTER)


@pytest.mark.parametrize("action", StopAction, ids=str)
def test_the_proof_of_a_stop_waits_until_a_module_that_acknowledges_early_hears_again(
    action: StopAction,
) -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.params.set(1921, "1")
        station = plant.site.requests.station
        await plant.online(within_s=60.0)
        await until(lambda: station("a").answers_early, within_s=60.0)
        before, began_s = len(plant.reports), plant.now_s
        report = await plant.site.operations.stop(action, "a")
        assert report.outcome is Outcome.VERIFIED
        assert plant.now_s - began_s < 1.0
        said = [one for one in plant.reports[before:] if one.step.kind is StepKind.WRITE]
        assert len(said) == 1
        assert plant.line["a"].model.stop_wanted()

    with_plant(test, roster_text([("a", 1, "820x")], drive="cyclic: []"))


@pytest.mark.parametrize("action", [QUICK, INHIBIT])
def test_a_stop_of_all_lets_no_watchdog_act_whoever_was_spoken_to_last(action: StopAction) -> None:
    """The proofs of 31 drives take 1.3 s, and nothing else feeds them meanwhile."""
    addresses = [one for one in range(1, 35) if one % 10]
    roster = make_roster(
        [(f"d{one}", one, "8200vector") for one in addresses], baud=19200,
        watchdog="{time: 2s, action: inhibit, configure: true}",
    )  # fmt: skip
    drives = [(one.name, one.address, one.family) for one in roster.drives]
    line = build(
        drives, baud=19200, seed=3, spread=0.5,
        overrides={one.name: presets(one) for one in roster.drives},
    )  # fmt: skip

    def acted() -> int:
        return sum(drive.model.watchdog_fired for drive in line.drives)

    async def test(plant: Plant) -> None:
        await anyio.sleep(120.0)
        assert all(plant.site.store.state(name) is DriveState.ONLINE for name, *_ in drives)
        for _ in range(4):
            for name, *_ in reversed(drives):  # those that were spoken to last are proven last
                await plant.site.operations.read(name, Code(150))
            before = acted()
            report = await plant.site.operations.stop(action, "all")
            assert (report.how, report.outcome) == ("multicast", Outcome.VERIFIED)
            assert acted() == before
            await anyio.sleep(31.0)

    with_plant(test, roster, line=line, latency_s=0.012)
