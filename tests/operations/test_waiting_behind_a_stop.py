"""A stop ends every write that waits for its drive: a setting behind it could undo it."""

from __future__ import annotations

import asyncio

import anyio
import anyio.lowlevel
import pytest

from lecombus.drives import StopAction, Verb
from lecombus.errors import OperationError
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.operations.awaited_requests import CAME_S
from lecombus.operations.operation_reports import VerbReport, WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome, Priority
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

WRITABLE = (
    "restore: true, allow_address_change: true, cyclic: [{code: C0150, every: 1s}], "
    "unchecked: [C0777], writable: [C0001, C0011, C0012, C0040, C0046, C0127, C0135, C0777, C1920]"
)
GROUP = "groups:\n  two: {members: [a, b], multicast: yes}\n"
DRIVES = [("a", 11, "821x"), ("b", 12, "821x"), ("c", 13, "821x")]
ROSTER = roster_text(DRIVES, drive=WRITABLE, sections=GROUP)
SHARED = roster_text(DRIVES[:2], drive=WRITABLE, sections=GROUP)
"""The group's writes go out as multicasts."""
QUICK, INHIBIT = StopAction.QUICK_STOP, StopAction.INHIBIT
NOT_DONE = "the write that was to stop it was not done, or that is not known"


async def busy(plant: Plant) -> list[asyncio.Task[object]]:
    """Let the line have something to do, so that what is asked for now waits."""
    reads = [asyncio.ensure_future(plant.site.operations.read("c", Code(150))) for _ in range(20)]
    await anyio.sleep(0.03)
    return reads  # type: ignore[return-value]


@pytest.mark.parametrize("action", [QUICK, INHIBIT])
@pytest.mark.parametrize(
    ("code", "value"),
    [(1, 0), (127, 1), (777, 5), (11, 60), (12, 7), (46, 20), (135, "H0000"), (1920, 1)],
)
def test_a_stop_ends_it_whatever_it_is(code: int, value: int | str, action: StopAction) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        reads = await busy(plant)
        before = list(plant.line["a"].log)
        writing = asyncio.create_task(plant.site.operations.write("a", Code(code), value))
        other = asyncio.create_task(plant.site.operations.write("b", Code(777), 5))
        await anyio.lowlevel.checkpoint()
        stop = await plant.site.operations.stop(action, "a")
        assert stop.outcome is Outcome.VERIFIED
        written = await writing
        assert (written.outcome, written.kind) == (Outcome.SUPERSEDED, "superseded")
        assert "ended by a stop of the drive" in written.reason
        assert "ask for it again if it is still wanted" in written.remedy
        await asyncio.gather(*reads)
        await anyio.sleep(2.0)
        since = [one for one in plant.line["a"].log if one not in before and one.kind == "write"]
        assert {one.code for one in since} <= {40, 135}, "only the stop itself"
        assert (await other).kind != "superseded", "another drive's goes on"

    with_plant(test, ROSTER)


@pytest.mark.parametrize("target", ["a", "two"])
def test_a_stop_ends_it_also_where_the_drive_holds_the_value_already(target: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations, ramp = plant.site.operations, Code(12)
        await operations.write_group("two", ramp, 7)
        reads = await busy(plant)

        async def write_again() -> list[WriteReport]:
            if target == "a":
                return [await operations.write("a", ramp, 7)]
            return list((await operations.write_group("two", ramp, 7)).members)

        again = asyncio.create_task(write_again())
        await anyio.lowlevel.checkpoint()
        stop = await operations.stop(INHIBIT, "a")
        assert stop.outcome is Outcome.VERIFIED
        ended = {one.drive: one for one in await again}
        assert (ended["a"].outcome, ended["a"].kind) == (Outcome.SUPERSEDED, "superseded")
        if target == "two":
            assert ended["b"].reason == "already there, not written", "another drive's goes on"
        await asyncio.gather(*reads)

    with_plant(test, ROSTER)


SETTINGS = [(1, 0, True), (127, 1, True), (777, 5, True), (11, 60, True), (1920, 1, False)]
"""Code, value, and whether it could move the drive; 1 and 11 are stored, and read first."""


async def stop_plainly(plant: Plant, target: str, code: int, value: str) -> None:
    """Stop a drive, or a group, by a plain write."""
    operations = plant.site.operations
    if target == "a":
        assert (await operations.write("a", Code(code), value)).outcome is Outcome.DONE
        return
    report = await operations.write_group(target, Code(code), value)
    assert report.outcome in (Outcome.DONE, Outcome.VERIFIED), report


@pytest.mark.parametrize("after_s", [0.0, 0.05])
@pytest.mark.parametrize("stop", [(40, "0"), (135, "H0008")])
@pytest.mark.parametrize(("code", "value", "moves"), SETTINGS)
def test_so_does_a_plain_write_that_stops_if_it_could_move_the_drive(
    code: int, value: int, moves: bool, stop: tuple[int, str], after_s: float
) -> None:
    """Not a setting that moves nothing: a PLC may write its stop ten times a second."""

    async def test(plant: Plant) -> None:
        await plant.online()
        reads = await busy(plant)
        before = len(plant.line["a"].log)
        writing = asyncio.create_task(plant.site.operations.write("a", Code(code), value))
        other = asyncio.create_task(plant.site.operations.write("b", Code(777), 5))
        await anyio.sleep(after_s)
        await stop_plainly(plant, "a", *stop)
        report = await writing
        await asyncio.gather(*reads)
        await anyio.sleep(2.0)
        log = [one for one in list(plant.line["a"].log)[before:] if one.kind != "read"]
        stopped_at = next(at for at, one in enumerate(log) if one.code == stop[0])
        behind = [one for one in log[stopped_at:] if one.code == code]
        assert bool(behind) is not moves
        if moves and not [one for one in log[:stopped_at] if one.code == code]:
            assert (report.outcome, report.kind) == (Outcome.SUPERSEDED, "superseded")
        assert (await other).kind != "superseded", "another drive's goes on"

    with_plant(test, ROSTER)


@pytest.mark.parametrize("roster", [ROSTER, SHARED])
@pytest.mark.parametrize("target", ["a", "two"])
@pytest.mark.parametrize("code", [1, 127, 777])
def test_so_does_one_that_stops_a_group_and_ends_what_a_group_waits_for(
    code: int, target: str, roster: str
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        reads = [asyncio.ensure_future(plant.site.operations.read("b", Code(46)))
                 for _ in range(20)]  # fmt: skip
        await anyio.sleep(0.03)
        before = {name: len(plant.line[name].log) for name in "ab"}
        writing = asyncio.create_task(plant.site.operations.write_group("two", Code(code), 1))
        await anyio.lowlevel.checkpoint()
        await stop_plainly(plant, target, 135, "H0008")
        await writing
        await asyncio.gather(*reads)
        await anyio.sleep(2.0)
        for name in "a" if target == "a" else "ab":
            log = [one for one in list(plant.line[name].log)[before[name] :] if one.kind != "read"]
            stopped_at = next(at for at, one in enumerate(log) if one.code == 135)
            assert not [one for one in log[stopped_at:] if one.code == code]

    with_plant(test, roster)


@pytest.mark.parametrize("target", ["a", "two"])
@pytest.mark.parametrize("stop", [(40, "0"), (135, "H0008")])
@pytest.mark.parametrize(("code", "values"), [(1, (2, 0)), (127, (1, 0)), (11, (60, 70))])
def test_a_stop_that_is_only_said_again_ends_no_setting(
    code: int, values: tuple[int, int], stop: tuple[int, str], target: str
) -> None:
    """A PLC says its stop ten times a second; settings of a drive that stands are still written."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await stop_plainly(plant, target, *stop)

        async def say_again() -> None:
            while True:
                await stop_plainly(plant, target, *stop)
                await anyio.sleep(0.02)

        again = asyncio.create_task(say_again())
        await anyio.sleep(0.5)
        for value in values:
            report = await plant.site.operations.write("a", Code(code), value)
            assert report.outcome is Outcome.DONE, report
            assert plant.line["a"].text(code) == str(value)
        again.cancel()

    with_plant(test, SHARED)


def test_a_stop_behind_an_enable_is_not_only_said_again() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        await stop_plainly(plant, "a", 135, "H0008")
        assert (await operations.verb("a", Verb.ENABLE)).outcome is Outcome.VERIFIED
        writing = asyncio.create_task(operations.write("a", Code(1), 0))
        await anyio.lowlevel.checkpoint()
        await stop_plainly(plant, "a", 135, "H0008")
        assert (await writing).outcome is Outcome.SUPERSEDED

    with_plant(test, SHARED)


def test_a_group_is_inhibited_although_a_member_was_stopped_meanwhile() -> None:
    """The later of two plain stops is not ended by the earlier one: it is the stronger."""

    async def test(plant: Plant) -> None:
        await plant.online()
        inhibiting = asyncio.create_task(plant.site.operations.write_group("two", Code(40), 0))
        await stop_plainly(plant, "a", 135, "H0008")
        assert (await inhibiting).outcome in (Outcome.DONE, Outcome.VERIFIED)
        assert all(plant.line[name].model.inhibited() for name in "ab")

    with_plant(test, ROSTER)


def test_a_write_asked_for_after_the_stop_goes_out() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        stopping = asyncio.create_task(plant.site.operations.stop(INHIBIT, "a"))
        await anyio.lowlevel.checkpoint()
        report = await plant.site.operations.write("a", Code(1920), 1)
        assert (await stopping).outcome is Outcome.VERIFIED
        assert report.outcome is Outcome.DONE

    with_plant(test, ROSTER)


@pytest.mark.parametrize("code", [12, 1920])
@pytest.mark.parametrize("target", ["a", "two", "all"])
def test_a_stop_ends_what_a_group_waits_for(code: int, target: str) -> None:
    """C0012 is stored, so that every member is read before it is written."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await busy(plant)
        before = {name: len(plant.line[name].log) for name in "ab"}
        writing = asyncio.create_task(plant.site.operations.write_group("two", Code(code), 1))
        await anyio.lowlevel.checkpoint()
        assert (await plant.site.operations.stop(INHIBIT, target)).outcome is Outcome.VERIFIED
        report = await writing
        ended = {one.drive: one.outcome for one in report.members}
        assert ended["a"] is Outcome.SUPERSEDED
        await anyio.sleep(2.0)
        for name in "a" if target == "a" else "ab":
            log = list(plant.line[name].log)[before[name] :]
            assert not [one for one in log if one.code == code and one.kind != "read"]
        assert plant.line["a"].text(code) != "1"

    with_plant(test, ROSTER)


@pytest.mark.parametrize("after_s", [0.0, 0.01, 0.03, 0.05])
def test_a_stop_ends_a_stored_setting_while_it_is_read_first(after_s: float) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        writing = asyncio.create_task(plant.site.operations.write("a", Code(12), 7))
        await anyio.sleep(after_s)
        stop = asyncio.create_task(plant.site.operations.stop(QUICK, "a"))
        written = await writing
        said = [one.text for one in plant.line["a"].log if one.kind == "write" and one.code == 12]
        assert (written.outcome is Outcome.SUPERSEDED) is (not said)
        assert not said or after_s >= 0.03
        assert (await stop).outcome is Outcome.VERIFIED

    with_plant(test, ROSTER)


def test_a_stop_ends_a_restore_that_is_between_two_writes() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        await operations.stop(INHIBIT, "a")
        mark = operations.restore_rights("a").stops
        first = await operations.write(
            "a", Code(12), 7, verify=True, restoring=True, unless_stopped_since=mark
        )
        assert first.outcome is Outcome.VERIFIED
        await operations.stop(QUICK, "b")
        second = await operations.write(
            "a", Code(11), 60, restoring=True, unless_stopped_since=mark
        )
        assert second.outcome is Outcome.DONE, "another drive was stopped"
        await operations.stop(QUICK, "a")
        third = await operations.write("a", Code(12), 8, restoring=True, unless_stopped_since=mark)
        assert (third.outcome, third.kind) == (Outcome.SUPERSEDED, "superseded")
        assert plant.line["a"].text(12) == "7"

    with_plant(test, ROSTER)


def test_a_mark_of_stops_from_before_a_restart_allows_no_write() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        mark = plant.site.operations.restore_rights("a").stops
        other_run = f"00000000{mark[8:]}"
        found = await plant.site.operations.write("a", Code(12), 9, unless_stopped_since=other_run)
        assert (found.outcome, found.kind) == (Outcome.SUPERSEDED, "superseded")
        assert "lecombus was started again" in found.reason
        assert found.reason.endswith("nothing was sent")
        assert plant.line["a"].text(12) != "9"

    with_plant(test, ROSTER)


@pytest.mark.parametrize("which", ["none", "empty", "of another drive", "cut", "newline"])
def test_what_is_no_mark_of_stops_of_the_drive_is_refused(which: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        mark = plant.site.operations.restore_rights("a").stops
        wrong = {
            "none": "ff00-3",
            "empty": "",
            "of another drive": plant.site.operations.restore_rights("b").stops,
            "cut": mark[:-1],
            "newline": f"{mark}\n",
        }
        with pytest.raises(OperationError, match="is not a mark of a: nothing was sent") as caught:
            await plant.site.operations.write("a", Code(12), 9, unless_stopped_since=wrong[which])
        assert caught.value.kind == "bad-request"
        assert "`GET /v1/drives/a/restore`" in caught.value.remedy
        assert plant.line["a"].text(12) != "9"

    with_plant(test, ROSTER)


def test_a_stop_ends_a_change_of_address_before_it_is_written() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.stop(INHIBIT, "a")
        moving = asyncio.create_task(plant.site.operations.readdressing.change("a", 19))
        await anyio.sleep(0.05)
        assert (await plant.site.operations.stop(QUICK, "a")).outcome is Outcome.VERIFIED
        report = await moving
        assert report.outcome is Outcome.SUPERSEDED
        assert plant.line["a"].address == 11

    with_plant(test, ROSTER)


def test_a_watchdog_that_is_being_set_is_set_behind_the_stop() -> None:
    async def test(plant: Plant) -> None:
        await until(
            lambda: any(one.data[3:] == b"" or b"\x02" in one.data for one in plant.sent_to(11))
        )
        assert (await plant.site.operations.stop(INHIBIT, "a")).outcome is Outcome.VERIFIED
        await plant.online()
        assert plant.line["a"].text(1922) == "2"
        assert "watchdog" not in plant.site.store.drive("a").remarks

    watchdog = "{time: 2s, action: quick-stop, configure: true}"
    with_plant(test, roster_text([("a", 11, "821x")], watchdog=watchdog))


@pytest.mark.parametrize("verb", [Verb.ENABLE, Verb.SET_SPEED])
def test_a_stop_ends_the_step_of_a_verb_that_waits(verb: Verb) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        reports: list[VerbReport | WriteReport] = []

        async def act() -> None:
            more = {"value": 20, "unit": "Hz"} if verb is Verb.SET_SPEED else {}
            reports.append(await plant.site.operations.verb("a", verb, **more))  # type: ignore[arg-type]

        acting = asyncio.create_task(act())
        await anyio.sleep(0.02)
        assert (await plant.site.operations.stop(INHIBIT, "a")).outcome is Outcome.VERIFIED
        await acting
        assert reports[0].outcome is Outcome.SUPERSEDED
        assert plant.line["a"].model.inhibited()

    with_plant(test, ROSTER)


@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.5, 1.5])
@pytest.mark.parametrize("by", ["stop", "write"])
@pytest.mark.parametrize("crowd", ["before", "behind"])
@pytest.mark.parametrize("verb", [Verb.ENABLE, Verb.SET_SPEED, Verb.RESET_FAULT])
def test_a_verb_that_waits_to_read_ends_with_the_stop_and_not_when_the_line_comes_to_it(
    verb: Verb, crowd: str, by: str, after_s: float
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        if verb is Verb.RESET_FAULT:
            plant.trip("a", 50, stays=True)
        ended: list[tuple[float, Outcome]] = []

        async def act() -> None:
            more = {"value": 20, "unit": "Hz"} if verb is Verb.SET_SPEED else {}
            report = await operations.verb("a", verb, **more)  # type: ignore[arg-type]
            ended.append((plant.now_s, report.outcome))

        def many() -> list[asyncio.Task[object]]:
            return [asyncio.ensure_future(operations.read("c", Code(150))) for _ in range(250)]

        reads = many() if crowd == "before" else []
        acting = asyncio.create_task(act())
        await anyio.sleep(0.1 if crowd == "behind" else 0.0)
        reads += many() if crowd == "behind" else []
        await anyio.sleep(after_s)
        stopped_s = plant.now_s
        if by == "stop":
            stopping = asyncio.ensure_future(operations.stop(INHIBIT, "all"))
        else:
            stopping = asyncio.ensure_future(operations.write("a", Code(40), 0))  # type: ignore[arg-type]
        await acting
        await stopping
        assert ended[0][0] - stopped_s < 0.3
        if ended[0][0] >= stopped_s:
            assert ended[0][1] in (Outcome.SUPERSEDED, Outcome.DONE, Outcome.UNKNOWN)
        assert plant.line["a"].model.inhibited()
        left = plant.site.schedule.stats(plant.now_s).depth
        await asyncio.gather(*reads)
        assert left[Priority.INTERACTIVE] > 0, "the crowd waits still"

    with_plant(test, ROSTER)


def test_a_stop_ends_what_was_asked_for_before_it_and_had_to_wait_for_its_turn() -> None:
    """A crowd's requests are begun one at a time, a stop at once (`api.connection`)."""

    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        CAME_S.set(plant.now_s)
        await anyio.sleep(0.001)
        assert (await operations.stop(INHIBIT, "a")).outcome is Outcome.VERIFIED
        said = len(plant.end.sent)
        assert (await operations.write("a", Code(1), 0)).outcome is Outcome.SUPERSEDED
        group = await operations.write_group("two", Code(1920), 1)
        ended = {one.drive: one.outcome for one in group.members}
        assert ended["a"] is Outcome.SUPERSEDED
        assert ended["b"] is Outcome.DONE
        assert (await operations.verb("a", Verb.ENABLE)).outcome is Outcome.SUPERSEDED
        assert not [one for one in plant.end.sent[said:] if one.data[1:3] in (b"11", b"10")
                    and b"\x02" in one.data]  # fmt: skip
        CAME_S.set(plant.now_s)
        assert (await operations.write("a", Code(1920), 1)).outcome is Outcome.DONE

    with_plant(test, ROSTER)


async def enable_under_way(plant: Plant) -> asyncio.Task[VerbReport]:
    """Enable a drive that was inhibited; C0040 = 1 has just been sent to it."""
    await plant.site.operations.stop(INHIBIT, "a")
    enabling = asyncio.create_task(plant.site.operations.verb("a", Verb.ENABLE))
    await until(lambda: plant.is_asking(b"\x0411\x02401"))
    return enabling


@pytest.mark.parametrize("fails", ["silent", "nak", "expired"])
def test_an_enable_that_a_write_ended_which_did_not_stop_the_drive_is_taken_back(
    fails: str,
) -> None:
    """The enable ends when such a write comes; it may be refused, or never sent."""

    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        enabling = await enable_under_way(plant)
        expires_s = None
        if fails == "silent":
            plant.line.drive_faults[11] = Faults(lost=1.0)
        elif fails == "nak":
            await anyio.sleep(0.06)
            plant.line.drive_faults[11] = Faults(nak=1.0)
        else:
            expires_s = 0.0001
        report = await operations.write("a", Code(135), "H0008", expires_s=expires_s)
        assert not report.outcome.is_good
        plant.line.drive_faults[11] = Faults()
        enabled = await enabling
        assert enabled.outcome is Outcome.SUPERSEDED
        assert f"{NOT_DONE}; it was inhibited" in enabled.remedy
        assert plant.line["a"].model.inhibited()

    with_plant(test, ROSTER)


@pytest.mark.parametrize("is_heard", [True, False])
@pytest.mark.parametrize("verify", [None, False])
def test_so_is_one_whose_drive_is_not_known_to_have_heard_the_multicast_that_ended_it(
    *, verify: bool | None, is_heard: bool
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        enabling = await enable_under_way(plant)
        await anyio.sleep(0.06)
        assert not plant.line["a"].model.inhibited()
        said = len(plant.end.sent)
        writing = asyncio.create_task(operations.write_group("two", Code(40), 0, verify=verify))
        plant.line.drive_faults[11] = Faults(unheard=0.0 if is_heard else 1.0)
        await until(lambda: any(one.data[1:3] == b"10" for one in plant.end.sent[said:]))
        await anyio.sleep(0.007)
        plant.line.drive_faults[11] = Faults()
        report = await writing
        assert report.how == "multicast"
        enabled = await enabling
        assert enabled.outcome is Outcome.SUPERSEDED
        is_proven = report.members[0].outcome is Outcome.VERIFIED
        assert is_proven is (verify is None)
        assert (NOT_DONE in enabled.remedy) is not is_proven
        await anyio.sleep(1.0)
        assert plant.line["a"].model.inhibited()

    with_plant(test, SHARED)


@pytest.mark.parametrize("target", ["a", "two"])
def test_nor_is_it_forgotten_when_nobody_waits_for_that_write_any_more(target: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        enabling = await enable_under_way(plant)
        await anyio.sleep(0.06)
        plant.line.drive_faults[11] = Faults(nak=1.0, unheard=float(target == "two"))

        async def stop() -> None:
            if target == "a":
                await operations.write("a", Code(40), 0)
            else:
                await operations.write_group("two", Code(40), 0)

        writing = asyncio.create_task(stop())
        await anyio.sleep(0.005)
        assert not enabling.done()
        writing.cancel()
        await anyio.sleep(1.0)
        plant.line.drive_faults[11] = Faults()
        enabled = await enabling
        assert enabled.outcome is Outcome.SUPERSEDED
        assert f"{NOT_DONE}; it was inhibited" in enabled.remedy
        assert plant.line["a"].model.inhibited()

    with_plant(test, SHARED)


def test_one_that_was_ended_by_a_write_that_did_stop_the_drive_is_left_to_that() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        enabling = await enable_under_way(plant)
        report = await operations.write("a", Code(135), "H0008")
        assert report.outcome is Outcome.DONE
        enabled = await enabling
        assert (enabled.outcome, enabled.remedy) == (Outcome.SUPERSEDED, "")
        await anyio.sleep(2.0)
        assert not plant.line["a"].model.inhibited(), "it is held by the quick stop that was asked"

    with_plant(test, ROSTER)
