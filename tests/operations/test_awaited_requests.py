"""Waiting for the end of a request, and going away without waiting."""

from __future__ import annotations

import anyio
import pytest

from lecombus.drive_state.drive_runtime import LineDrives
from lecombus.errors import (
    ExchangeError,
    LineClosedError,
    NoReplyError,
    OperationError,
    QueueFullError,
)
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.operations.awaited_requests import Requests, never_sent
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority
from support.single_drives import drive_of
from support.site_host import Rig, stop, until, with_rig

STATUS = Code(150)


def requests_of(rig: Rig) -> Requests:
    drives = LineDrives()
    for station in rig.stations.values():
        drive = drive_of(station.name)
        drive.station = station
        drives.put(drive)
    return Requests(rig.worker, rig.maker, drives, lambda: rig.now_s)


def test_a_read_gives_its_value_and_a_write_its_outcome() -> None:
    async def test(rig: Rig) -> None:
        requests = requests_of(rig)
        one = requests.station("a")
        assert await requests.read(one, Code(46), Priority.INTERACTIVE) == Value.parse("0")
        ended = await requests.write(one, Code(46), Value.decimal(20), verify=True)
        assert ended == (Outcome.VERIFIED, "")

    with_rig(test)


@pytest.mark.parametrize("lost", [Faults(unheard=1.0), Faults(nak=1.0)], ids=["unheard", "nak"])
def test_a_write_to_the_end_that_a_stop_cut_off_is_made_behind_the_stop(lost: Faults) -> None:
    async def test(rig: Rig) -> None:
        requests = requests_of(rig)
        ended: list[tuple[Outcome, str]] = []

        async def write() -> None:
            one = requests.station("a")
            ended.append(
                await requests.write_to_the_end(one, Code(46), Value.decimal(20), verify=True)
            )

        async with anyio.create_task_group() as tasks:
            rig.line.drive_faults[1] = lost
            tasks.start_soon(write)
            await until(lambda: bool(rig.seen.kinds))
            assert (rig.line["a"].text(46), ended) == ("0", [])
            rig.line.drive_faults[1] = Faults()
            stopped = stop(rig, "a")
        assert stopped.outcome is Outcome.VERIFIED
        assert ended == [(Outcome.VERIFIED, "")]
        assert rig.line["a"].text(46) == "20"

    with_rig(test)


def test_an_unknown_drive_is_answered_with_those_there_are() -> None:
    async def test(rig: Rig) -> None:
        with pytest.raises(OperationError) as caught:
            requests_of(rig).station("x")
        assert caught.value.kind == "no-such-drive"
        assert "a, b" in caught.value.remedy

    with_rig(test)


def test_a_silent_drive_is_an_exchange_error_not_an_operation_s() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        requests = requests_of(rig)
        with pytest.raises(NoReplyError, match="attempt 3"):
            await requests.read(requests.station("a"), STATUS, Priority.INTERACTIVE)

    with_rig(test)


def test_a_read_begun_too_late_says_it_expired() -> None:
    async def test(rig: Rig) -> None:
        requests = requests_of(rig)
        for _ in range(30):
            rig.read("b", 150)
        with pytest.raises(OperationError) as caught:
            await requests.read(requests.station("a"), STATUS, Priority.BACKGROUND, timeout_s=0.05)
        assert caught.value.kind == "expired"

    with_rig(test)


def test_a_full_queue_and_a_closed_line_are_said_before_anything_waits() -> None:
    async def test(rig: Rig) -> None:
        requests = requests_of(rig)
        one = requests.station("a")
        for _ in range(2000):
            rig.read("b", 150)
        with pytest.raises(QueueFullError):
            await requests.read(one, STATUS, Priority.INTERACTIVE)
        rig.worker.close()
        with pytest.raises(LineClosedError):
            await requests.read(one, STATUS, Priority.STOP)

    with_rig(test)


@pytest.mark.parametrize("delay_s", [0.0005, 0.003, 0.012, 0.024])
@pytest.mark.parametrize("writing", [True, False])
def test_going_away_drops_the_result_and_never_a_telegram(delay_s: float, writing: bool) -> None:
    async def test(rig: Rig) -> None:
        requests = requests_of(rig)
        one = requests.station("a")
        with anyio.move_on_after(delay_s) as scope:
            if writing:
                await requests.write(one, Code(46), Value.decimal(20), verify=False)
            else:
                await requests.read(one, STATUS, Priority.INTERACTIVE)
        assert scope.cancelled_caught
        after = await requests.read(requests.station("b"), Code(46), Priority.INTERACTIVE)
        assert after == Value.parse("0")
        assert rig.line["a"].text(46) == ("20" if writing else "0")
        assert rig.line.aborted == rig.line.collisions == 0
        assert rig.seen.kinds[0] == "answered"

    with_rig(test)


def test_the_late_answer_of_a_read_whose_caller_went_away_is_not_misused() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(late=1.0, late_s=(0.3, 0.3))
        rig.line["a"].model.readers[50] = lambda _: "11"
        rig.line["b"].model.readers[50] = lambda _: "22"
        requests = requests_of(rig)
        with anyio.move_on_after(0.05):
            await requests.read(requests.station("a"), Code(50), Priority.INTERACTIVE)
        for _ in range(30):
            found = await requests.read(requests.station("b"), Code(50), Priority.INTERACTIVE)
            assert found == Value.parse("22")
        between = sum(late for _, late in rig.seen.strays)
        within = sum(report.result.late for report in rig.seen.reports)
        assert between + within == 1, "the late answer did come"

    with_rig(test, retries=0)


def test_a_feed_asks_for_the_cheapest_useful_code_once_and_takes_another_if_it_must() -> None:
    async def test(rig: Rig) -> None:
        made = requests_of(rig).feed_maker("a")()
        assert made.priority is Priority.WATCHDOG
        assert made.work.step.code == rig.stations["a"].family.feed_code  # type: ignore[attr-defined]
        assert made.work.retries == 0  # type: ignore[attr-defined]
        assert len(made.work.instead) > 1  # type: ignore[attr-defined]

    with_rig(test)


@pytest.mark.parametrize(
    ("outcome", "reason", "kind"),
    [
        (Outcome.EXPIRED, "it was too late to begin", "expired"),
        (Outcome.REFUSED, "a is offline: 4 exchanges failed", "offline"),
        (Outcome.REFUSED, "line t: unplugged", "line-lost"),
        (Outcome.REFUSED, "it may hold the line for 2 s", "does-not-fit"),
    ],
)
def test_why_nothing_was_sent_is_told_in_a_stable_word(
    outcome: Outcome, reason: str, kind: str
) -> None:
    async def test(rig: Rig) -> None:
        error = never_sent(outcome, reason, rig.stations["a"], STATUS)
        assert error.kind == kind
        assert reason in str(error)
        assert error.remedy
        assert not isinstance(error, ExchangeError)

    with_rig(test)
