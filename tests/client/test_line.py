"""What a program sees of a line: readings, outcomes, errors; against the real HTTP application."""

from __future__ import annotations

from datetime import datetime
from decimal import Decimal
from typing import Any

import pytest

from lecombus.client import (
    ClientError,
    DriveStatus,
    GroupResult,
    Line,
    NotDoneError,
    Outcome,
    ProblemError,
    Quality,
    Reading,
    WriteResult,
)
from lecombus.client.requests import code_text, exact
from lecombus.drives import StopAction, Verb
from lecombus.errors import LecombusError, NoReplyError, OperationError, QueueFullError
from lecombus.operations.operation_reports import WriteReport
from lecombus.parameters import Code
from lecombus.schedule.request import Outcome as Ended
from support import api_line

pytestmark = pytest.mark.anyio


async def test_a_stored_value_and_a_fresh_one_carry_their_age(
    line: Line, fake: api_line.Line
) -> None:
    feeder = line.drive("feeder")
    stored = await feeder.value("C0046")
    assert (stored.value, stored.raw, stored.unit) == (Decimal("35.40"), "35.40", "Hz")
    assert (stored.code, stored.subcode, stored.quality) == ("C0046", 0, Quality.GOOD)
    assert isinstance(stored.time, datetime)
    assert stored.age_s is not None
    assert fake.ops.asked == []
    fresh = await feeder.read(46)
    assert (fresh.number, fake.ops.asked) == (Decimal("50.10"), [("read", "feeder", Code(46))])
    assert (await feeder.read("c0039/1")).subcode == 1


async def test_a_number_is_never_taken_from_an_old_or_missing_value(line: Line) -> None:
    reading = await line.drive("belt").value("C0046")
    assert (reading.value, reading.time, reading.quality) == (None, None, Quality.BAD)
    with pytest.raises(ClientError, match="belt C0046 is bad"):
        _ = reading.number
    old = Reading.of({"value": Decimal(5), "quality": "stale", "reason": "not read in time"})
    with pytest.raises(ClientError, match="stale: not read in time"):
        _ = old.number
    assert Reading.of({"value": 5, "quality": "fresher"}).quality is Quality.BAD
    with pytest.raises(ClientError, match="is not a number but `abc`"):
        _ = Reading.of({"value": "abc", "quality": "good"}).number


async def test_what_a_drive_did_before_it_fell_silent_is_not_what_it_does() -> None:
    motion = {"doing": "stopped", "stale": False}
    assert DriveStatus.of({"drive": "feeder", "motion": motion}).doing == "stopped"
    old = DriveStatus.of({"drive": "feeder", "motion": {**motion, "stale": True}})
    assert old.doing == "unknown"
    assert old.document["motion"]["doing"] == "stopped"


async def test_drives_groups_line_and_why(line: Line) -> None:
    status = await line.status()
    assert (status.name, status.state, status.drives) == ("hall-3", "open", {"online": 2})
    feeder, belt = await line.drives()
    assert (feeder.name, feeder.address, feeder.family) == ("feeder", 11, "8200vector")
    assert (feeder.state, feeder.states, feeder.fault) == ("online", None, None)
    assert feeder.doing == "unknown"
    assert [one.code for one in feeder.values] == ["C0046"]
    assert (await line.drive("belt").status()).document["drive"] == belt.name == "belt"
    conveyors, everyone = await line.groups()
    assert (conveyors.name, conveyors.members) == ("conveyors", ("feeder", "belt"))
    assert (everyone.stops, everyone.writes) == ("multicast", "one-by-one")
    why = await line.drive("feeder").why(fresh=False, language="de")
    assert why.answer == "der Regler ist gesperrt"
    assert [(one.name, one.weight) for one in why.findings] == [("inhibited", "reason")]
    assert why.document["history"][0]["number"] == 50


@pytest.mark.usefixtures("standing_clock")
@pytest.mark.parametrize("outcome", list(Ended))
async def test_every_outcome_arrives_as_itself(
    line: Line, fake: api_line.Line, outcome: Ended
) -> None:
    fake.ops.report = lambda drive, code: WriteReport(
        drive, code, outcome, "because", "the cause", "" if outcome.is_good else "nak", "the remedy"
    )
    feeder = line.drive("feeder")
    written = await feeder.write("C0046", 35.4, verify=True, expires_s=2)
    assert fake.ops.asked == [("write", "feeder", Code(46), Decimal("35.4"), 2.0, True)]
    assert written.outcome == Outcome(outcome.value)
    assert (written.drive, written.code, written.subcode) == ("feeder", "C0046", 0)
    assert (written.reason, written.cause, written.remedy) == (
        "because", "the cause", "the remedy",
    )  # fmt: skip
    assert written.is_good is outcome.is_good
    verb = await feeder.enable()
    assert (verb.outcome, verb.verb, verb.states) == (outcome.value, "enable", ("enabled",))
    group = await line.group("conveyors").write("C0046", 1)
    assert [one.outcome for one in group.members] == [outcome.value] * 2
    assert (group.outcome.is_good, group.how) == (outcome.is_good, "one-by-one")
    stop = await line.stop("conveyors", "inhibit")
    assert [(one.drive, one.outcome) for one in stop.members] == [
        ("feeder", outcome.value), ("belt", outcome.value),
    ]  # fmt: skip
    for result in (written, verb, group, stop):
        if outcome.is_good:
            result.check()
        else:
            with pytest.raises(NotDoneError, match=f"{outcome}, .*the cause; the remedy"):
                result.check()


async def test_verbs_and_stops_ask_for_what_they_are_called(
    line: Line, fake: api_line.Line
) -> None:
    feeder = line.drive("feeder")
    await feeder.set_speed(Decimal("70"), "%", verify=True, expires_s=0.5)
    await feeder.reset_fault(expires_s=1)
    await feeder.quick_stop()
    await feeder.inhibit()
    await line.group("conveyors").stop()
    assert [what[1:4] for what in fake.ops.asked[:4]] == [
        ("feeder", Verb.SET_SPEED, Decimal(70)),
        ("feeder", Verb.RESET_FAULT, None),
        ("feeder", Verb.QUICK_STOP, None),
        ("feeder", Verb.INHIBIT, None),
    ]
    assert fake.ops.asked[4] == ("stop", StopAction.QUICK_STOP, "conveyors")


@pytest.mark.parametrize(
    ("error", "outcome", "kind"),
    [
        (OperationError("not writable", kind="not-writable"), "refused", "not-writable"),
        (OperationError("a fault", kind="fault-active"), "refused", "fault-active"),
        (OperationError("too soon", kind="too-many-writes"), "refused", "too-many-writes"),
        (OperationError("left", kind="client-gone"), "refused", "client-gone"),
        (QueueFullError(priority="control", depth=9, limit=9), "refused", "queue-full"),
        (NoReplyError("silence"), "refused", "no-answer"),
        (RuntimeError("a mistake"), "unknown", "internal"),
    ],
)
async def test_a_refusal_is_an_answer_with_an_outcome(
    line: Line, fake: api_line.Line, error: LecombusError, outcome: str, kind: str
) -> None:
    fake.ops.error = error
    feeder = line.drive("feeder")
    results = (
        await feeder.write("C0046", 1), await feeder.enable(),
        await line.group("conveyors").write("C0046", 1),
    )  # fmt: skip
    for result in results:
        assert (result.outcome, result.kind, result.answer is None) == (outcome, kind, False)
    assert isinstance(results[0], WriteResult)
    assert (results[0].drive, results[0].code) == ("feeder", "C0046")
    assert isinstance(results[2], GroupResult)
    assert results[2].target == "conveyors"


@pytest.mark.parametrize("kind", ["no-such-drive", "no-such-code", "bad-value", "bad-request"])
async def test_a_wrong_request_is_an_error(line: Line, fake: api_line.Line, kind: str) -> None:
    fake.ops.error = OperationError("wrong", kind=kind, drive="feeder", remedy="mend it")
    with pytest.raises(ProblemError, match="wrong; mend it") as caught:
        await line.drive("feeder").write("C0046", 1)
    assert (caught.value.kind, caught.value.drive) == (kind, "feeder")


async def test_a_read_without_a_value_is_an_error(line: Line, fake: api_line.Line) -> None:
    fake.ops.error = NoReplyError("feeder does not answer")
    with pytest.raises(ProblemError, match="feeder does not answer") as caught:
        await line.drive("feeder").read("C0050")
    assert (caught.value.kind, caught.value.status) == ("no-answer", 504)


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "x" * 65])
def test_a_name_that_would_mean_another_path_is_refused(name: str) -> None:
    line = Line(None)  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match="there is no drive"):
        line.drive(name)
    with pytest.raises(ProblemError, match="there is no group"):
        line.group(name)


@pytest.mark.parametrize("code", ["C0046/../x", "0x2E", "C 46", "", "C0039/", "Ä46", "-1"])
def test_what_is_no_code_is_refused(code: str) -> None:
    with pytest.raises(ValueError, match="is not a code"):
        code_text(code)


@pytest.mark.parametrize("value", [
    float("nan"), float("inf"), Decimal("sNaN"), True, None, "", [1], {}, b"1",
])  # fmt: skip
def test_what_is_no_value_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match="is not a value"):
        exact(value)


@pytest.mark.parametrize(
    ("value", "sent"),
    [
        (35.4, Decimal("35.4")),
        (0.1, Decimal("0.1")),
        (8, 8),
        ("H0008", "H0008"),
        (-5.0, Decimal("-5.0")),
    ],
)
def test_a_float_is_sent_as_it_is_written(value: float, sent: object) -> None:
    assert exact(value) == sent


@pytest.mark.parametrize("time_s", [0, -1, 3601, float("nan"), float("inf")])
async def test_a_lease_time_out_of_range_is_refused(line: Line, time_s: float) -> None:
    with pytest.raises(ValueError, match=r"time_s is .*, 0\.001 to 3600 is possible"):
        async with line.lease("winder", ["feeder"], time_s):
            raise AssertionError


@pytest.mark.parametrize("expires_s", [0, -1, 3601, float("nan")])
async def test_a_duration_out_of_range_is_refused(line: Line, expires_s: float) -> None:
    with pytest.raises(ValueError, match="expires_s is"):
        await line.drive("feeder").enable(expires_s=expires_s)
