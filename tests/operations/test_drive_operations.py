"""What users may ask of one drive, and how it is told what came of it."""

from __future__ import annotations

import asyncio
import functools
from decimal import Decimal

import anyio
import anyio.lowlevel
import pytest

from lecombus.drive_state.readings import LineState, Quality
from lecombus.drives import StopAction, Verb
from lecombus.errors import (
    CutReplyError,
    ExchangeError,
    LineClosedError,
    LineLostError,
    NoReplyError,
    OperationError,
    QueueFullError,
    UnknownCodeError,
)
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.operations.operation_reports import WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome, Priority
from support.golden import Golden
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

AB = [("a", 11, "8200vector"), ("b", 12, "8200vector")]
STATUS, SETPOINT, ENABLE, PLAIN = Code(150), Code(46), Code(40), Code(11)
MODULE = Code(1920)  # not stored: written without being read first
WRITABLE = "cyclic: [], writable: [C0011, C0012, C0040, C0043, C0046, C0135, C1920]"
ROSTER = roster_text(AB, drive=WRITABLE)


async def write(plant: Plant, code: Code, value: int | str, **more: object) -> WriteReport:
    return await plant.site.operations.write("a", code, value, **more)  # type: ignore[arg-type]


def test_a_read_gives_the_value_with_its_name_and_age() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        reading = await plant.site.operations.read("a", SETPOINT)
        assert (reading.name, reading.unit, reading.quality) == (
            "frequency setpoint", "Hz", Quality.GOOD,
        )  # fmt: skip
        assert reading.age_s == 0.0

    with_plant(test, ROSTER)


def test_any_code_may_be_read_and_an_unknown_one_says_so() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert (await plant.site.operations.read("a", Code(99))).value is not None
        with pytest.raises(UnknownCodeError, match="C4711"):
            await plant.site.operations.read("a", Code(4711))

    with_plant(test, ROSTER)


def test_digits_for_a_word_are_refused_with_both_readings_and_nothing_is_sent() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        for action in (StopAction.QUICK_STOP, StopAction.INHIBIT):
            assert (await plant.site.operations.stop(action, "a")).outcome is Outcome.VERIFIED
        said = len(plant.end.sent)
        for text in ("0208", "208", "8", "-5"):
            with pytest.raises(OperationError) as refused:
                await write(plant, Code(135), text)
            assert refused.value.kind == "bad-value"
        with pytest.raises(OperationError, match=r"H0208 \(520\) or decimal 208 \(H00D0\)"):
            await write(plant, Code(135), "0208")
        assert len(plant.end.sent) == said
        for right in ("0x0208", "h0208", 520):
            assert (await write(plant, Code(135), right)).outcome is Outcome.DONE
            assert plant.line["a"].log[-1].text == "H0208"

    with_plant(test, ROSTER)


def test_an_undescribed_code_that_reads_as_a_word_takes_no_digits() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        device = plant.line["g"]
        write_g = functools.partial(plant.site.operations.write, "g", Code(30))
        with pytest.raises(OperationError, match=r"H0208\) or decimal 208"):
            await write_g("0208")
        assert (await write_g("208")).outcome is Outcome.DONE
        device.model.readers[30] = lambda _: "H0000"
        await plant.site.operations.read("g", Code(30))
        with pytest.raises(OperationError, match=r"H0208 \(520\) or decimal 208 \(H00D0\)"):
            await write_g("208")
        await write_g(520)
        assert [one.text for one in device.log if one.kind == "write"] == ["208", "H0208"]

    with_plant(test, roster_text([("g", 22, "generic")], drive="writable: [C0030]"))


def test_a_drive_that_does_not_answer_is_named_in_the_error() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.drive_faults[11] = Faults(lost=1.0)
        with pytest.raises(NoReplyError, match=r"a \(address 11\), C0150"):
            await plant.site.operations.read("a", STATUS)

    with_plant(test, ROSTER)


@pytest.mark.parametrize(
    ("code", "value", "kind"),
    [
        (Code(1), 1, "not-writable"),
        (SETPOINT, "twenty", "bad-value"),
        (SETPOINT, "0.00001", "bad-value"),
        (Code(135), "Sabc", "bad-value"),
    ],
)
def test_a_write_that_may_not_be_made_is_refused_before_anything_is_sent(
    code: Code, value: str, kind: str
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        said = len(plant.sent_to(11))
        with pytest.raises(OperationError) as caught:
            await write(plant, code, value)
        assert caught.value.kind == kind
        assert caught.value.remedy
        assert not [one for one in plant.sent_to(11)[said:] if b"\x02" in one.data]

    with_plant(test, ROSTER)


def test_of_a_code_that_nobody_can_write_no_roster_is_said_to_help() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        with pytest.raises(OperationError) as caught:
            await write(plant, STATUS, "1")
        assert str(caught.value).startswith("C0150 of a is read only: controller status word")
        assert caught.value.kind == "not-writable"
        assert "writable" not in caught.value.remedy

    with_plant(test, ROSTER)


@pytest.mark.parametrize(
    "writable",
    ["", ", writable: [C0046]", ", writable: [C0046], also_writable: [C0012]", ", writable: []"],
)
def test_a_refusal_says_what_may_be_written(writable: str, golden: Golden) -> None:
    async def test(plant: Plant) -> None:
        with pytest.raises(OperationError) as caught:
            await write(plant, Code(1), 1)
        golden(caught.value.remedy)

    with_plant(test, roster_text(AB, drive=f"cyclic: []{writable}"))


@pytest.mark.parametrize(
    ("kind", "code", "named"), [("8200vector", 1922, "C1922"), ("smvector", 1426, "P426")]
)
def test_what_the_roster_sets_of_a_watchdog_is_written_by_no_client(
    kind: str, code: int, named: str
) -> None:
    """A watchdog that a client switches off would stop nobody until it is read again."""

    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        with pytest.raises(OperationError) as caught:
            await operations.write("a", Code(code), 0)
        assert caught.value.kind == "not-writable"
        assert str(caught.value).startswith(f"{named} of a is set by lecombus")
        assert "change `watchdog` of this drive in the roster" in caught.value.remedy
        with pytest.raises(OperationError) as caught:
            await operations.write_group("all", Code(code), 0)
        assert caught.value.kind == "not-writable"

    async def compared_only(plant: Plant) -> None:
        await plant.online()
        assert (await plant.site.operations.write("a", Code(code), 0)).outcome is Outcome.DONE

    watchdog = "{time: 2s, action: quick-stop, configure: %s}"
    for configure, run in (("true", test), ("false", compared_only)):
        drive = f"also_writable: [C{code}]"
        with_plant(run, roster_text([("a", 11, kind)], drive=drive, watchdog=watchdog % configure))


def test_what_is_also_writable_takes_nothing_away() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert (await write(plant, Code(12), 7)).outcome is Outcome.DONE
        speed = {"value": Decimal(20), "unit": "Hz"}
        for verb, keys in ((Verb.ENABLE, {}), (Verb.SET_SPEED, speed)):
            report = await plant.site.operations.verb("a", verb, **keys)  # type: ignore[arg-type]
            assert report.outcome in (Outcome.DONE, Outcome.VERIFIED)

    with_plant(test, roster_text(AB, drive="cyclic: [], also_writable: [C0012]"))


def test_a_drive_is_not_written_to_before_it_is_audited_nor_while_it_is_offline() -> None:
    async def test(plant: Plant) -> None:
        with pytest.raises(LineLostError, match="not been opened yet: nothing was sent"):
            await write(plant, SETPOINT, 20)
        await until(lambda: plant.site.worker.is_open)
        with pytest.raises(OperationError) as caught:
            await write(plant, SETPOINT, 20)
        assert caught.value.kind == "starting"
        await plant.online()
        plant.line.faults.absent = {11}
        for _ in range(2):
            with pytest.raises((ExchangeError, OperationError)):
                await plant.site.operations.read("a", STATUS)
        with pytest.raises(OperationError) as caught:
            await write(plant, SETPOINT, 20)
        assert caught.value.kind == "offline"
        with pytest.raises(OperationError) as caught:
            await plant.site.operations.read("a", STATUS)
        assert caught.value.kind == "offline"

    with_plant(test, ROSTER)


@pytest.mark.parametrize(
    ("code", "value", "verify", "faults", "outcome", "kind"),
    [
        (SETPOINT, 20, False, Faults(), Outcome.DONE, ""),
        (SETPOINT, 20, True, Faults(), Outcome.VERIFIED, ""),
        (SETPOINT, 9999, False, Faults(), Outcome.REFUSED, "nak"),
        (SETPOINT, 20, False, Faults(lost=1.0), Outcome.UNKNOWN, "no-answer"),
        (Code(43), 0, False, Faults(lost=1.0), Outcome.UNKNOWN, "no-answer"),
    ],
)
def test_how_a_write_is_told(
    code: Code, value: int, verify: bool, faults: Faults, outcome: Outcome, kind: str
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line.drive_faults[11] = faults
        report = await write(plant, code, value, verify=verify)
        assert (report.outcome, report.kind) == (outcome, kind)
        assert bool(report.remedy) == bool(kind)

    # Whether the manual allows a value is not asked here: the drive shall refuse it itself.
    with_plant(test, ROSTER.replace(", cyclic: []", ", unchecked: [C0046], cyclic: []"))


REFUSED = [
    ("821x", 46, "480.1", "frequency setpoint is 0 to 480 Hz"),
    ("821x", 46, "-1", "frequency setpoint is 0 to 480 Hz"),
    ("821x", 141, "100.01", "is -100 to 100 %"),
    ("821x", 1922, "3", r"monitoring action is 0 \(not active\), 1 \(controller inhibit\), 2 \("),
    ("821x", 1922, "0.5", "monitoring action is 0 "),
    ("821x", 1923, "60.5", "monitoring time is 50 to 65535 ms in steps of 1"),
    ("821x", 2001, "4", "operating mode is 0 "),
    ("8200vector", 1923, "49", "monitoring time is 50 to 65535 ms"),
]


@pytest.mark.parametrize(("kind", "code", "value", "message"), REFUSED)
def test_a_value_that_the_manual_does_not_allow_is_refused_before_anything_is_sent(
    kind: str, code: int, value: str, message: str
) -> None:
    drives = [("a", 11, kind)]
    more = f"cyclic: [], writable: [{code}]"

    async def test(plant: Plant) -> None:
        await plant.online()
        since_s = plant.now_s
        with pytest.raises(OperationError, match=message) as refused:
            await plant.site.operations.write("a", Code(code), value)
        assert (refused.value.kind, refused.value.code) == ("bad-value", str(Code(code)))
        assert f"list {Code(code)} under `unchecked`" in refused.value.remedy
        await anyio.sleep(0.5)
        assert not any(b"\x02" in one.data for one in plant.sent_to(11, since_s))

    with_plant(test, roster_text(drives, drive=more))


def test_a_value_at_the_ends_of_the_range_is_written_and_an_undescribed_code_takes_any() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        for code, value in ((46, "480"), (46, "0"), (46, "35.37"), (2011, "60.5"), (14, "4")):
            report = await plant.site.operations.write("a", Code(code), value)
            assert report.outcome is Outcome.DONE, code

    writable = "cyclic: [], writable: [C0046, C2011, C0014]"
    with_plant(test, roster_text([("a", 11, "821x")], drive=writable))


def test_another_parameter_set_is_written_only_when_it_is_named() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        with pytest.raises(OperationError) as refused:
            await plant.site.operations.write("a", Code(2011), 60)
        assert refused.value.kind == "not-writable"

    with_plant(test, roster_text([("a", 11, "821x")], drive="writable: [C0011]"))


def test_a_group_write_that_one_member_cannot_take_goes_to_none() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        since_s = plant.now_s
        with pytest.raises(OperationError, match="C0046 of b cannot take 500"):
            await plant.site.operations.write_group("both", SETPOINT, 500)
        await anyio.sleep(0.5)
        for address in (10, 11, 12):
            assert not any(b"\x02" in one.data for one in plant.sent_to(address, since_s))

    groups = "groups:\n  both: {members: [a, b]}\n"
    roster = roster_text(AB, drive=WRITABLE, sections=groups)
    with_plant(test, roster.replace(", cyclic: []", ", unchecked: [C0046], cyclic: []", 1))


def test_a_write_the_drive_acknowledges_and_ignores_is_told_as_without_effect() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line["a"].model.readers[46] = lambda _: "5"
        report = await write(plant, SETPOINT, 20, verify=True)
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "not-in-effect")
        assert report.reading is not None
        assert report.reading.value is not None
        assert report.reading.value.number == Decimal(5)

    with_plant(test, ROSTER)


def test_the_latest_setpoint_wins() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        tasks = [asyncio.create_task(write(plant, SETPOINT, value)) for value in (10, 20, 30, 40)]
        reports = await asyncio.gather(*tasks)
        assert [report.outcome for report in reports[:3]].count(Outcome.SUPERSEDED) >= 2
        assert reports[1].kind == "superseded"
        assert reports[3].outcome is Outcome.DONE
        assert plant.line["a"].text(46) == "40"
        log = [e.text for e in plant.line["a"].log if e.kind == "write" and e.code == 46]
        assert log[-1] == "40"
        assert len(log) <= 2

    with_plant(test, ROSTER)


def test_every_switching_write_counts_none_is_superseded_by_a_later_one() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        tasks = [asyncio.create_task(write(plant, ENABLE, value)) for value in (1, 0, 1)]
        reports = await asyncio.gather(*tasks)
        assert {report.outcome for report in reports} == {Outcome.DONE}

    with_plant(test, ROSTER)


def test_a_stop_ends_the_writes_that_wait() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        asked = (write(plant, PLAIN, 60), write(plant, SETPOINT, 20), write(plant, ENABLE, 1))
        tasks = [asyncio.create_task(one) for one in asked]
        await anyio.sleep(0.0)
        stop = await plant.site.operations.stop(StopAction.INHIBIT, "a")
        plain, setpoint, enable = await asyncio.gather(*tasks)
        assert stop.outcome is Outcome.VERIFIED
        assert {plain.outcome, setpoint.outcome, enable.outcome} == {Outcome.SUPERSEDED}
        assert plant.line["a"].text(40) == "0", "nothing may enable it after the stop"

    with_plant(test, ROSTER)


def test_a_write_that_is_too_late_is_never_sent() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        others = [asyncio.create_task(plant.site.operations.read("b", STATUS)) for _ in range(20)]
        await anyio.sleep(0.001)
        report = await write(plant, PLAIN, 60, expires_s=0.05)
        assert (report.outcome, report.kind) == (Outcome.EXPIRED, "expired")
        await asyncio.gather(*others)
        assert plant.line["a"].text(11) != "60"

    with_plant(test, ROSTER)


def test_a_full_queue_is_said_at_once_and_nothing_is_sent() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        fill(plant, leave=0)
        with pytest.raises(QueueFullError):
            await write(plant, PLAIN, 60)
        assert plant.line["a"].text(11) != "60"

    with_plant(test, ROSTER)


def fill(plant: Plant, *, leave: int) -> None:
    """Fill the interactive queue up to a few places."""
    requests = plant.site.requests
    station = requests.station("b")
    for _ in range(2000 - leave):
        requests.worker.submit(requests.maker.read(station, STATUS, Priority.INTERACTIVE))


def test_without_a_line_nothing_is_kept_for_later() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.end.unplug()
        await until(lambda: not plant.site.worker.is_open)
        line = plant.site.store.line()
        assert (line.state, line.reason) == (LineState.LOST, "the simulated line was unplugged")
        drive = plant.site.store.drive("a")
        assert drive.reason == "line lost: the simulated line was unplugged"
        for asked in (
            write(plant, SETPOINT, 20),
            plant.site.operations.stop(StopAction.INHIBIT, "a"),
            plant.site.operations.read("a", STATUS),
        ):
            with pytest.raises(LineLostError):
                await asked

    with_plant(test, ROSTER)


def test_what_the_loss_of_the_line_cuts_off_is_not_put_down_to_the_drive() -> None:
    async def cut(plant: Plant) -> None:
        sent = len(plant.end.sent)
        await until(lambda: len(plant.end.sent) > sent)
        plant.end.unplug()

    async def test(plant: Plant) -> None:
        await plant.online()
        reading = asyncio.create_task(plant.site.operations.read("a", STATUS))
        await cut(plant)
        with pytest.raises(CutReplyError, match="the line was lost during the exchange"):
            await reading
        plant.end.replug()
        await plant.online()
        writing = asyncio.create_task(write(plant, SETPOINT, 20))
        await cut(plant)
        report = await writing
        assert (report.outcome, report.kind) == (Outcome.UNKNOWN, "line-lost")
        assert "read the code then to see what it holds" in report.remedy

    with_plant(test, ROSTER)


def test_what_the_loss_of_the_line_ends_is_told_as_that() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        reads = [asyncio.create_task(plant.site.operations.read("b", STATUS)) for _ in range(5)]
        stopping = asyncio.create_task(plant.site.operations.stop(StopAction.INHIBIT, "all"))
        await anyio.lowlevel.checkpoint()
        writing = asyncio.create_task(write(plant, MODULE, 1))
        await anyio.sleep(0.005)
        plant.end.unplug()
        ends = await asyncio.gather(*reads, return_exceptions=True)
        kinds = [getattr(end, "kind", None) or type(end).__name__ for end in ends]
        assert set(kinds) <= {"line-lost", "LineLostError", "CutReplyError"}, kinds
        report = await writing
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "line-lost")
        stop = await stopping
        assert {member.kind for member in stop.members} == {"line-lost"}

    with_plant(test, ROSTER)


def test_cancelling_a_caller_neither_cuts_a_telegram_nor_confuses_the_next() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line["a"].model.readers[50] = lambda _: "11"
        plant.line["b"].model.readers[50] = lambda _: "22"
        for delay_s in (0.001, 0.004, 0.010, 0.025, 0.030):
            said = len(plant.end.sent)
            with anyio.move_on_after(delay_s):
                await plant.site.operations.read("a", Code(50))
            reading = await plant.site.operations.read("b", Code(50))
            assert reading.value is not None
            assert reading.value.raw == "22"
            telegrams = plant.end.sent[said:]
            assert all(one.data.endswith(b"\x05") for one in telegrams)
            results = [report.result.kind.value for report in plant.reports[-2:]]
            assert results == ["answered", "answered"]

    with_plant(test, ROSTER)


def test_nothing_more_is_written_once_the_daemon_is_ending_but_stops_are_said() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.site.operations.close()
        with pytest.raises(LineClosedError, match="being ended"):
            await plant.site.operations.write("a", Code(46), 20)
        report = await plant.site.operations.stop(StopAction.INHIBIT, "a")
        assert report.outcome is Outcome.VERIFIED

    with_plant(test, roster_text([("a", 11, "8200vector")]))
