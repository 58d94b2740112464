"""Answers that may still come: what is not said meanwhile, and what ends the doubt."""

from __future__ import annotations

import math

import anyio
import pytest

from lecombus.drives import family
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.exchanges.jobs import ReadJob
from lecombus.fieldbus.lecom.exchanges.late_answers import PendingLateAnswers
from lecombus.fieldbus.lecom.protocol.controls import bcc
from lecombus.fieldbus.lecom.request_maker import LecomRequestMaker
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.lecom.simulator.receiver import ReceivedRequest
from lecombus.fieldbus.requests import Station
from lecombus.line.worker import WorkerOptions
from lecombus.schedule import Outcome, Priority, WatchdogFeeding
from support.rosters import make_roster
from support.site_host import Plant, Rig, reader, stop, until, with_plant, with_rig

STOP_A = b"\x0401\x02400\x03"
"""C0040 = 0 to drive 1, without its block check."""

THREE = (("a", 1, "8200vector"), ("b", 2, "8200vector"), ("c", 3, "8200vector"))


def answer(field: bytes, value: bytes) -> bytes:
    body = field + value + b"\x03"
    return b"\x02" + body + bytes((bcc(body),))


def test_the_repetition_of_a_read_uses_the_other_addressing_form() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        await rig.read("a", 150).done.wait()
        assert [len(telegram.data) for telegram in rig.sent[:2]] == [6, 11]

    with_rig(test, retries=2)


def test_the_other_form_also_keeps_another_drive_s_read_apart() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        rig.read("a", 150)
        await rig.read("b", 150).done.wait()
        assert rig.sent[0].data == b"\x0401?0\x05"
        assert rig.sent[1].data == b"\x0402!009600\x05"

    with_rig(test, retries=0)


def test_no_write_goes_out_while_an_old_acknowledgement_may_come_but_reads_do() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        first = rig.write("a", 12, "7")
        await first.done.wait()
        given_up_s = rig.seen.reports[0].result.ended_s
        rig.line.drive_faults.clear()
        second = rig.write("b", 12, "8")
        read = rig.read("b", 50)
        await read.done.wait()
        assert read.outcome is Outcome.DONE
        assert not second.done.is_set(), "the read is not held up by the write"
        await second.done.wait()
        assert second.outcome is Outcome.DONE
        writes = [one for one in rig.sent if b"\x02" in one.data]
        assert [one.data[1:3] for one in writes] == [b"01", b"02"]
        assert writes[1].at_s >= given_up_s + 0.5

    with_rig(test, retries=0)


def test_a_stop_whose_acknowledgement_is_an_old_one_is_believed_only_when_read_back() -> None:
    async def test(rig: Rig) -> None:
        rig.line["a"].model.preset(40, "1")
        rig.line.drive_faults[2] = Faults(late=1.0, late_s=(0.2, 0.2))
        rig.write("b", 12, "7")
        await until(lambda: rig.worker.exchanges == 1)
        rig.line.drive_faults[1] = Faults(unheard=1.0)
        ended = stop(rig, "a")
        await ended.done.wait()
        assert ended.outcome is Outcome.UNKNOWN, "the drive heard nothing"

    with_rig(test, retries=1)


def test_an_acknowledgement_believed_by_a_stop_leaves_the_doubt_alive() -> None:
    """Its own acknowledgement may still come, and must not pass for the next write's."""

    async def test(rig: Rig) -> None:
        rig.line.drive_faults[2] = Faults(late=1.0, late_s=(0.45, 0.45))
        rig.write("b", 12, "7")
        await until(lambda: rig.worker.exchanges == 1)
        rig.line.drive_faults[1] = Faults(late=1.0, late_s=(0.4, 0.4))
        await anyio.sleep(0.35)
        ended = stop(rig, "a")
        await until(lambda: any(b"\x06" in one.data for one in rig.end.heard))
        believed_s = rig.now_s
        rig.line.drive_faults.clear()
        await ended.done.wait()
        third = rig.write("b", 12, "9")
        await third.done.wait()
        writes = [one for one in rig.sent if one.data.startswith(b"\x0402\x02")]
        assert writes[-1].at_s >= believed_s + 0.5

    with_rig(test, retries=0)


def test_a_late_answer_frees_its_code_for_everybody() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(late=1.0, late_s=(0.125, 0.125))
        await rig.read("a", 150).done.wait()
        await until(lambda: any(late for _, late in rig.seen.strays))
        said = len(rig.sent)
        await rig.read("b", 150).done.wait()
        assert rig.sent[said].data == b"\x0402?0\x05", "the preferred form is free again"

    with_rig(test, retries=0)


def test_a_feed_that_may_not_be_said_yet_does_not_stop_the_line() -> None:
    """All its telegrams may be in doubt at once; everything else must go on meanwhile."""

    async def test(rig: Rig) -> None:
        make = reader(rig, "a", 150, Priority.WATCHDOG)
        rig.line.drive_faults[1] = Faults(lost=1.0)
        rig.schedule.set_feeding("a", WatchdogFeeding(0.6, make), rig.now_s)
        for _ in range(3):
            await rig.read("a", 150).done.wait()
        ended = rig.read("b", 50)
        with anyio.fail_after(5.0):
            await ended.done.wait()
        assert ended.outcome is Outcome.DONE

    with_rig(test, retries=0, options=WorkerOptions(late_answer_s=5.0))


def test_an_answer_that_a_device_server_kept_while_it_was_away_is_not_the_next_drive_s() -> None:
    """It is delivered after the next connection, which may be long after `late_answer`."""

    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        asked = rig.read("a", 150)
        await anyio.sleep(0.005)
        rig.end.unplug()
        await asked.done.wait()
        await anyio.sleep(3.0)
        rig.end.replug()
        await until(lambda: rig.worker.is_open)
        rig.line.drive_faults[2] = Faults(lost=1.0)
        sent = len(rig.sent)
        other = rig.read("b", 150)
        await until(lambda: len(rig.sent) > sent)
        assert rig.sent[-1].data == b"\x0402!009600\x05", "not in the form of the lost answer"
        await anyio.sleep(0.02)
        rig.end.say(answer(b"?0", b"H1234"))
        await other.done.wait()
        assert other.outcome is Outcome.UNKNOWN, "what came was the first drive's"

    with_rig(test, retries=0)


def test_an_acknowledgement_kept_by_a_device_server_is_not_the_next_write_s() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        first = rig.write("a", 12, "7")
        await anyio.sleep(0.015)
        rig.end.unplug()
        await first.done.wait()
        await anyio.sleep(3.0)
        rig.end.replug()
        await until(lambda: rig.worker.is_open)
        opened_s = rig.seen.line[-1][0]
        rig.line.drive_faults[2] = Faults(unheard=1.0)
        second = rig.write("b", 12, "8")
        await anyio.sleep(0.08)
        rig.end.say(b"\x06")
        await second.done.wait()
        assert second.outcome is Outcome.UNKNOWN, "the drive heard nothing"
        writes = [one for one in rig.sent if one.data[:4] == b"\x0402\x02"]
        assert writes[0].at_s >= opened_s + 0.5

    with_rig(test, retries=0)


def test_what_could_no_longer_come_when_the_port_was_lost_holds_nothing_up_afterwards() -> None:
    late = PendingLateAnswers(0.5)
    late.add(b"?0", 10.0)
    late.port_lost(10.6)
    late.port_opened(10.7)
    assert late.blocked_until_s(b"?0", 10.7) <= 10.7
    assert not late.nak_may_come(10.7)
    late.add(b"?0", 11.0)
    late.port_lost(11.1)
    late.port_opened(15.0)
    assert late.blocked_until_s(b"?0", 15.4) == 15.5
    assert late.nak_may_come(15.4)
    assert late.sole(b"?0", 15.4) is None


def test_a_long_late_answer_and_absent_drives_leave_codes_to_feed_the_others_with() -> None:
    """Six lost answers, each of another drive, are all that C0150, C0068 and C0135 have."""
    drives = [(f"d{address}", address, "93xx") for address in (*range(1, 5), *range(11, 19))]
    roster = make_roster(
        drives, baud=9600, line="late_answer: 10s, adapter_latency: 16ms",
        watchdog="{time: 3s, action: inhibit, configure: yes}",
    )  # fmt: skip

    async def test(plant: Plant) -> None:
        for drive in plant.line.drives[4:]:
            drive.present = False
        await anyio.sleep(20.0)
        plant.line.advance(plant.now_s)
        assert [drive.watchdog_fired for drive in plant.line.drives[:4]] == [0, 0, 0, 0]

    with_plant(test, roster)


@pytest.mark.parametrize("name", ["820x", "821x", "8200vector", "93xx", "smvector"])
def test_what_feeds_a_drive_at_last_is_no_password_and_none_of_the_module_s_slow_codes(
    name: str,
) -> None:
    described = family(name)
    station = Station("a", 1, described, described.forms)
    maker = LecomRequestMaker(LineTiming(9600), 2, lambda priority, outcome: None)
    status = tuple(code for code, _ in described.status)
    job = maker.feed(station, status).work
    assert isinstance(job, ReadJob)
    assert job.instead[: len(status)] == status
    further = job.instead[len(status) :]
    assert len(further) == 16
    assert not {code.number for code in further} & {94, 1194}
    slowest_s = max(described.longest_answer_time_s(code, write=False) for code in status)
    assert all(described.longest_answer_time_s(code, write=False) <= slowest_s for code in further)


def test_behind_a_late_answer_the_turnaround_is_kept() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(late=1.0, late_s=(0.125, 0.125))
        rig.read("a", 150)
        await rig.read("b", 150).done.wait()
        late_s = rig.seen.reports[0].result.ended_s
        came_s = [one.at_s for one in rig.end.heard if one.at_s > late_s]
        first_b = next(one for one in rig.sent if one.data[:3] == b"\x0402")
        ended_s = max(at_s for at_s in came_s if at_s < first_b.at_s)
        assert first_b.at_s >= ended_s + 0.1 - 1e-9

    with_rig(test, retries=0, options=WorkerOptions(turnaround_s=0.1))


def test_what_an_adapter_held_from_before_the_daemon_s_start_is_dropped_for_as_long_as_it_may() -> (
    None
):
    """A daemon that was killed had asked; its successor's connection gets the answer."""
    roster = make_roster(
        [("a", 1, "8200vector")], line="adapter_latency: 100ms", drive="cyclic: []"
    )

    async def test(plant: Plant) -> None:
        plant.line.drives[0].present = False
        await anyio.sleep(0.1)
        plant.end.say(answer(b"?0", b"H1234"))
        await anyio.sleep(1.0)
        assert all(report.result.answer is None for report in plant.reports)

    with_plant(test, roster)


@pytest.mark.parametrize(
    ("baud", "tolerate", "late", "latency", "time_ms"),
    [(19200, 3, "500ms", "0ms", 528), (9600, 3, "1s", "0ms", 609), (9600, 1, "5s", "16ms", 419)],
)
def test_answers_that_are_lost_as_tolerated_leave_standard_addressing_codes_to_feed_with(
    baud: int, tolerate: int, late: str, latency: str, time_ms: int
) -> None:
    """The least watchdog times that `check` takes, and bursts of as many lost answers as it says.

    There is one form only: each lost answer holds back one of three status codes.
    """
    roster = make_roster(
        [("a", 1, "93xx"), ("b", 2, "93xx")], baud=baud, drive="addressing: standard",
        line=f"adapter_latency: {latency}, tolerate: {tolerate}, late_answer: {late}",
        watchdog=f"{{time: {time_ms}ms, action: inhibit, configure: yes}}",
    )  # fmt: skip

    async def test(plant: Plant) -> None:
        await plant.online()
        left, next_s = 0, plant.now_s + 1.0

        def heard(at_s: float, _request: ReceivedRequest) -> None:
            nonlocal left, next_s
            if at_s >= next_s:
                left, next_s = tolerate, math.inf
            plant.line.faults.lost = 1.0 if left else 0.0
            if left:
                left -= 1
                if not left:
                    next_s = at_s + time_ms / 1000 + 0.3

        fired = [drive.watchdog_fired for drive in plant.line.drives]
        plant.line.on_request = heard
        await anyio.sleep(30.0)
        plant.line.advance(plant.now_s)
        assert [drive.watchdog_fired for drive in plant.line.drives] == fired

    with_plant(test, roster)


@pytest.mark.parametrize("damage", [0, 1], ids=["whole", "damaged"])
def test_the_turnaround_is_kept_behind_a_damaged_late_answer_too(damage: int) -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        await rig.read("a", 150).done.wait()
        before = len(rig.sent)
        rig.read("b", 150)
        await anyio.sleep(0.09)
        late = answer(b"?0", b"H1234")
        rig.end.say(late[:-1] + bytes((late[-1] ^ damage,)))
        came_s = rig.now_s
        await until(lambda: len(rig.sent) > before)
        assert rig.sent[before].at_s >= came_s + 0.1 - 1e-9

    with_rig(test, retries=0, options=WorkerOptions(turnaround_s=0.1))


def test_what_was_listened_for_before_the_port_was_lost_is_not_measured_behind_it() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        for pause_s in (1.5, 1.5, 0.01):  # behind the third one it listens longer
            await rig.read("a", 150).done.wait()
            await anyio.sleep(pause_s)
        rig.end.unplug()
        await anyio.sleep(60.0)
        rig.line.drive_faults[1] = Faults()
        rig.end.replug()
        await until(lambda: rig.worker.is_open)
        await anyio.sleep(0.2)
        for _ in range(2):
            rig.end.say(answer(b"?0", b"H1234"))
        assert rig.stations["a"].measured.rows() == []

    with_rig(test, retries=0)
