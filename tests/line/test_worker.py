"""The worker on a simulated line: what goes out when, and how every request ends."""

from __future__ import annotations

import random
from collections.abc import Awaitable, Callable
from itertools import pairwise
from typing import Any

import anyio
import pytest

from lecombus.drives import StopAction
from lecombus.fieldbus.lecom.exchanges.telegram_log import TelegramLog
from lecombus.fieldbus.lecom.protocol.telegrams import ValueAnswer
from lecombus.fieldbus.lecom.simulator.faults import Faults, LateKind
from lecombus.fieldbus.requests import Station
from lecombus.line.worker import WorkerOptions
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority
from lecombus.schedule.request import Request
from support.site_host import Ended, Recorder, Rig, stop, until, with_rig
from support.virtual_loop import run

STOP_A = b"\x0401\x02400\x03"
"""C0040 = 0 to drive 1, without its block check."""

THREE = (("a", 1, "8200vector"), ("b", 2, "8200vector"), ("c", 3, "8200vector"))


def heard_before(rig: Rig, at_s: float) -> float:
    """When the last byte before a time came."""
    return max(one.at_s for one in rig.end.heard if one.at_s <= at_s)


# ---- when a telegram goes out ---------------------------------------------------------------


def test_the_turnaround_is_kept_between_an_answer_and_the_next_telegram_and_no_more() -> None:
    async def test(rig: Rig) -> None:
        ends = [rig.read("ab"[n % 2], 150) for n in range(40)]
        await until(lambda: all(end.outcome for end in ends))
        for telegram in rig.sent[1:]:
            pause_s = telegram.at_s - heard_before(rig, telegram.at_s)
            assert pause_s == pytest.approx(0.007, abs=1e-6)

    with_rig(test, options=WorkerOptions(turnaround_s=0.007))


def test_a_stop_goes_out_right_after_the_exchange_it_was_submitted_in() -> None:
    async def test(rig: Rig) -> None:
        for _ in range(50):
            rig.read("b", 150)
        await anyio.sleep(0.010)
        said = len(rig.sent)
        assert said > rig.worker.exchanges, "it must be submitted during an exchange"
        ended = stop(rig, "a")
        await until(lambda: len(rig.sent) > said)
        telegram = rig.sent[said]
        assert telegram.data.startswith(STOP_A)
        assert telegram.at_s - heard_before(rig, telegram.at_s) <= 0.002 + 1e-6
        await ended.done.wait()
        assert ended.outcome is Outcome.VERIFIED

    with_rig(test)


@pytest.mark.parametrize("turnaround_s", [0.0, 0.002])
@pytest.mark.parametrize("stops", [False, True])
def test_what_is_asked_for_when_a_read_settles_goes_out_on_an_idle_line(
    stops: bool, turnaround_s: float
) -> None:
    async def test(rig: Rig) -> None:
        settled: list[float] = []

        def settle(outcome: Outcome, reason: str) -> None:
            settled.append(rig.now_s)
            stop(rig, "b") if stops else rig.read("b", 150)

        station = rig.stations["a"]
        rig.worker.submit(rig.maker.read(station, Code(150), Priority.INTERACTIVE, settle=settle))
        await until(lambda: len(rig.sent) > 1)
        assert rig.sent[1].at_s - settled[0] <= turnaround_s

    with_rig(test, options=WorkerOptions(turnaround_s=turnaround_s))


def test_a_stop_breaks_the_silence_after_a_failed_exchange_and_nothing_else_does() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[2] = Faults(unheard=1.0)
        failed = rig.read("b", 150, Priority.INTERACTIVE)
        await until(lambda: rig.worker.exchanges == 1)
        given_up_s = rig.now_s
        other = rig.read("a", 50)
        await anyio.sleep(0.004)
        said = len(rig.sent)
        ended = stop(rig, "a")
        await until(lambda: len(rig.sent) > said)
        assert rig.sent[said].data.startswith(STOP_A)
        assert rig.sent[said].at_s - given_up_s < 0.020, "the silence would last 40 ms"
        for end in (failed, other, ended):
            await end.done.wait()

    with_rig(test, retries=0)


def test_between_two_sayings_to_a_silent_drive_others_are_spoken_to_in_turn() -> None:
    async def test(rig: Rig) -> None:
        rig.line.faults.absent = {2}
        ended = stop(rig, "b")
        while ended.outcome is None:
            read = rig.read("a", 50)
            await read.done.wait()
            assert read.outcome is Outcome.DONE
        said = [one.at_s for one in rig.sent if one.data.startswith(b"\x0402\x02400\x03")]
        assert 10 < len(said) < 40
        reads = [one.at_s for one in rig.sent if one.data.startswith(b"\x0401")]
        pauses = list(pairwise(said[1:]))
        assert all(any(a < at_s < b for at_s in reads) for a, b in pauses)

    with_rig(test, retries=0)


def test_without_a_stop_the_silence_is_kept_to_its_end() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[2] = Faults(unheard=1.0)
        rig.read("b", 150)
        other = rig.read("a", 50)
        await other.done.wait()
        failed, read = rig.seen.reports[0], rig.sent[1]
        assert read.at_s - failed.result.ended_s == pytest.approx(0.040, abs=1e-6)

    with_rig(test, retries=0)


def test_after_a_multicast_the_slowest_member_is_left_its_time() -> None:
    async def test(rig: Rig) -> None:
        group = Station("g", 10, rig.stations["fast"].family, rig.stations["fast"].forms)
        members = (rig.stations["fast"], rig.stations["slow"])
        ended = rig.submit(
            lambda settle: rig.maker.multicast(
                group, members, Code(46), Value.decimal(20), Priority.CONTROL, settle=settle
            )
        )
        rig.read("fast", 150)
        await until(lambda: len(rig.sent) == 2)
        assert ended.outcome is Outcome.DONE
        wire_s = len(rig.sent[0].data) * 10 / 19200
        slowest_s = rig.stations["slow"].family.longest_answer_time_s(Code(46), write=True)
        assert rig.sent[1].at_s - rig.sent[0].at_s >= wire_s + slowest_s
        assert rig.line["slow"].text(46) == "20"
        assert rig.line["fast"].text(46) == "20"

    with_rig(test, (("fast", 11, "8200vector"), ("slow", 12, "820x")))


def test_members_that_answer_in_shortened_time_are_left_alone_after_a_multicast() -> None:
    async def test(rig: Rig) -> None:
        held = [
            Station(s.name, s.address, s.family, s.forms, hold_s=0.230)
            for s in (rig.stations["a"], rig.stations["b"])
        ]
        group = Station("g", 10, held[0].family, held[0].forms)
        rig.submit(
            lambda settle: rig.maker.multicast(
                group, tuple(held), Code(46), Value.decimal(20), Priority.CONTROL, settle=settle
            )
        )
        rig.read("a", 150)
        await until(lambda: len(rig.sent) == 2)
        assert rig.sent[1].at_s - rig.sent[0].at_s >= 0.230

    with_rig(test, (("a", 11, "820x"), ("b", 12, "820x")))


@pytest.mark.parametrize("faults", ["", "lost=1", "noise=1", "half=1"])
def test_a_drive_is_left_alone_after_a_write_whatever_came_back(faults: str) -> None:
    """The drive has taken the write though nobody understood that it said so."""

    async def test(rig: Rig) -> None:
        plain = rig.stations["a"]
        rig.stations["a"] = Station("a", plain.address, plain.family, plain.forms, hold_s=0.230)
        rig.write("a", 46, "20")
        rig.read("a", 150)

        def to_it() -> list[float]:
            return [one.at_s for one in rig.sent if one.data[1:3] == b"11"]

        await until(lambda: len(to_it()) > 1)
        assert to_it()[1] - to_it()[0] >= 0.230

    with_rig(test, (("a", 11, "820x"),), faults=faults)


# ---- echo -----------------------------------------------------------------------------------


@pytest.mark.parametrize("echo", [None, True])
def test_an_echo_is_removed_found_out_or_said(echo: bool | None) -> None:
    async def test(rig: Rig) -> None:
        ends = [rig.read("a", 150), rig.write("a", 12, "7"), rig.read("b", 50)]
        await until(lambda: all(end.outcome for end in ends))
        assert {end.outcome for end in ends} == {Outcome.DONE}
        assert rig.seen.kinds[:2] == ["answered", "answered"]

    with_rig(test, faults="echo", options=WorkerOptions(echo=echo))


def test_an_echo_that_the_roster_denies_makes_every_answer_unusable_but_none_wrong() -> None:
    async def test(rig: Rig) -> None:
        ended = rig.read("a", 150)
        await ended.done.wait()
        assert ended.outcome in (Outcome.DONE, Outcome.UNKNOWN)
        for report in rig.seen.reports:
            assert report.result.kind.value in ("answered", "garbled")

    with_rig(test, faults="echo", options=WorkerOptions(echo=False))


def test_an_echo_the_roster_promises_and_that_does_not_come_is_a_fault_of_its_own() -> None:
    async def test(rig: Rig) -> None:
        ended = rig.read("a", 150)
        await ended.done.wait()
        assert ended.outcome is Outcome.UNKNOWN
        assert set(rig.seen.kinds) <= {"echo"}

    with_rig(test, options=WorkerOptions(echo=True), retries=0)


def test_a_damaged_echo_is_a_fault_of_its_own_and_the_read_is_repeated() -> None:
    async def test(rig: Rig) -> None:
        await rig.read("a", 150).done.wait()
        rig.line.faults.bad_echo = 1.0
        ended = rig.read("a", 50)
        await until(lambda: rig.worker.exchanges == 2)
        rig.line.faults.bad_echo = 0.0
        await ended.done.wait()
        assert ended.outcome is Outcome.DONE
        await anyio.sleep(1.1)
        assert rig.seen.kinds == ["answered", "echo", "answered"]

    with_rig(test, faults="echo")


@pytest.mark.parametrize("echoes_first", [True, False])
def test_whether_the_line_echoes_is_found_out_anew_after_every_reopening(
    echoes_first: bool,
) -> None:
    async def test(rig: Rig) -> None:
        rig.line.faults.echo = echoes_first
        first = rig.read("a", 150)
        await first.done.wait()
        rig.end.unplug()
        rig.end.replug()
        rig.line.faults.echo = not echoes_first
        await until(lambda: not rig.worker.is_open)
        await until(lambda: rig.worker.is_open)
        second = rig.read("a", 150)
        await second.done.wait()
        assert (first.outcome, second.outcome) == (Outcome.DONE, Outcome.DONE)

    with_rig(test, retries=0)


def test_a_line_that_echoes_only_from_some_time_on_is_found_out_without_a_reopening() -> None:
    """Another converter behind a device server, or a first telegram whose echo was lost."""

    async def test(rig: Rig) -> None:
        first = rig.read("a", 150)
        await first.done.wait()
        rig.line.faults.echo = True
        second = rig.read("a", 50)
        await second.done.wait()
        write = rig.write("b", 12, "7")
        await write.done.wait()
        outcomes = (first.outcome, second.outcome, write.outcome)
        assert outcomes == (Outcome.DONE, Outcome.DONE, Outcome.DONE)

    with_rig(test, retries=0)


def test_a_stray_eot_does_not_make_the_line_an_echoing_one() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        first = rig.read("a", 150)
        await anyio.sleep(0.004)
        rig.end.say(b"\x04")
        await first.done.wait()
        assert first.outcome is not Outcome.DONE
        rig.line.drive_faults.clear()
        second = rig.read("b", 50)
        await second.done.wait()
        assert second.outcome is Outcome.DONE

    with_rig(test, retries=0)


# ---- disturbance ----------------------------------------------------------------------------


def test_a_line_that_babbles_without_end_still_lets_every_request_end() -> None:
    async def test(rig: Rig) -> None:
        async def babble() -> None:
            while True:
                rig.end.say(b"U")
                await anyio.sleep(0.004)

        rig.tasks.start_soon(babble)
        await anyio.sleep(0.5)
        ended = rig.read("a", 150)
        with anyio.fail_after(20.0):
            await ended.done.wait()
        assert ended.outcome is Outcome.UNKNOWN

    with_rig(test)


@pytest.mark.parametrize("seed", range(6))
def test_every_request_ends_in_exactly_one_outcome_whatever_happens(seed: int) -> None:
    """`Ended` and `Request.end` both fail on a second end."""

    async def test(rig: Rig) -> None:
        chance = random.Random(seed)
        ends: list[Ended] = []
        rig.line.drive_faults[3] = Faults(unheard=1.0)
        for round_ in range(60):
            for _ in range(chance.randrange(6)):
                ends.append(ask_anything(rig, chance))
            if round_ % 20 == 19:
                rig.end.unplug()
                rig.end.replug()
                await until(lambda: not rig.worker.is_open)
                assert all(end.outcome for end in ends), "the loss ends all"
                await until(lambda: rig.worker.is_open)
            if chance.random() < 0.1:
                rig.schedule.park("c", rig.now_s, "c is offline")
            elif chance.random() < 0.2:
                rig.schedule.unpark("c", rig.now_s)
            await anyio.sleep(chance.uniform(0.0, 0.2))
        await until(lambda: all(end.outcome for end in ends), within_s=300.0)
        assert len({end.outcome for end in ends}) >= 4

    faults = "late=0.1:0.5s,noise=0.1,lost=0.1,half=0.05,bad_bcc=0.05,nak=0.1,request_noise=0.05"
    with_rig(test, THREE, faults=faults, seed=seed)


def ask_anything(rig: Rig, chance: random.Random) -> Ended:
    drive = chance.choice("abc")
    kind = chance.randrange(6)
    if kind == 0:
        return stop(rig, drive, chance.choice(list(StopAction)))
    if kind == 1:
        return rig.write(drive, 46, str(chance.randrange(50)), verify=chance.random() < 0.5)
    if kind == 2:
        return rig.write(drive, chance.choice((11, 12)), str(chance.randrange(8, 400)))
    if kind == 3:
        station = rig.stations[drive]

        def make(settle: Callable[[Outcome, str], None]) -> Request:
            return rig.maker.read(
                station, Code(61), Priority.BACKGROUND, settle=settle,
                expires_at_s=rig.now_s + chance.uniform(0.0, 0.5),
            )  # fmt: skip

        return rig.submit(make)
    return rig.read(drive, chance.choice((50, 52, 150, 9999)))


def test_an_observer_that_fails_ends_the_worker_loudly() -> None:
    class Broken(Recorder):
        def exchange_ended(self, report: object) -> None:
            raise RuntimeError("a mistake in the books")

    async def main() -> None:
        async with Rig() as rig:
            rig.worker.exchange_loop.observer = Broken()
            rig.read("a", 150)
            await anyio.sleep(5.0)

    with pytest.raises(ExceptionGroup) as caught:
        run(main())
    assert caught.group_contains(RuntimeError, match="books")


def test_the_stubborn_late_answer_of_one_drive_is_not_used_for_the_next() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(late=1.0, late_s=(0.1, 0.1), late_kind=LateKind.STUBBORN)
        rig.line["a"].model.readers[50] = lambda _: "11"
        rig.line["b"].model.readers[50] = lambda _: "22"
        rig.read("a", 50)
        await rig.read("b", 50).done.wait()
        await anyio.sleep(2.0)
        values = [r.result.answer for r in rig.seen.reports if r.drive == "b" and r.result.answer]
        assert [one.value.raw for one in values if isinstance(one, ValueAnswer)] == ["22"]
        assert len(values) == 1

    with_rig(test, retries=3)


def debug_lines(
    caplog: pytest.LogCaptureFixture, test: Callable[[Rig], Awaitable[None]], **options: Any
) -> list[str]:
    with caplog.at_level("DEBUG", logger="lecombus.line"):
        with_rig(test, **options)
    return [one.getMessage() for one in caplog.records if "event=telegram" in one.getMessage()]


def test_debug_logs_show_every_telegram_whole_and_decoded_one_a_line(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def test(rig: Rig) -> None:
        await rig.read("a", 150).done.wait()
        await rig.write("a", 46, 20).done.wait()

    said = debug_lines(caplog, test)
    assert said[0] == (
        "line=test drive=a event=telegram direction=sent kind=read code=C0150 "
        "bytes=84 30 b1 3f 30 05"
    )
    assert said[1].startswith(
        "line=test drive=a event=telegram direction=received kind=value code=C0150 ms="
    )
    assert " bytes=82 " in said[1], "STX with its parity bit, and all that follows"
    assert said[1].endswith(" value=H8678")
    assert " kind=write code=C0046 bytes=84 30 b1 82 " in said[2]
    assert said[2].endswith(" value=20")
    assert " kind=ack code=C0046 " in said[3]
    assert said[3].endswith(" bytes=06")
    assert len(said) == 4


def test_debug_logs_say_what_did_not_come_and_what_nobody_asked_for(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(late=1.0, late_s=(0.1, 0.1))
        await rig.read("a", 150).done.wait()
        await anyio.sleep(1.0)
        await rig.read("b", 150).done.wait()

    said = debug_lines(caplog, test, retries=0)
    assert [one for one in said if "kind=no-reply" in one and "bytes=none reason=no answer" in one]
    (unasked,) = [one for one in said if "kind=unasked" in one]
    assert "bytes=82 " in unasked, "a whole late answer in one line, however it came"
    assert said.index(unasked) < next(i for i, one in enumerate(said) if "drive=b" in one)


@pytest.mark.parametrize(("kind", "number"), [("smvector", 1194), ("generic", 94)])
@pytest.mark.parametrize("faults", ["", "echo"])
def test_debug_logs_hide_the_password_of_a_drive(
    caplog: pytest.LogCaptureFixture, kind: str, number: int, faults: str
) -> None:
    async def test(rig: Rig) -> None:
        rig.line["a"].model.preset(number, "1234")
        await rig.read("a", number).done.wait()
        await rig.write("a", number, 4711).done.wait()
        await rig.read("a", 150).done.wait()

    said = debug_lines(caplog, test, drives=[("a", 1, kind)], faults=faults)
    secret = [one for one in said if f"code=C{number:04d}" in one]
    read, value, write, *answers = secret
    assert "bytes=84 " in read, "a question holds no value"
    assert "bytes=***" in value
    assert write.endswith(" bytes=*** value=***")
    assert answers
    for password in (1234, 4711):
        assert not any(str(password) in one for one in said)
        digits = bytes(map(ord, str(password)))
        on_the_line = bytes(one | (one.bit_count() & 1) << 7 for one in digits).hex(" ")
        assert not any(on_the_line in one for one in said)
    assert any("code=C0150" in one and "***" not in one for one in said)


def test_debug_logs_hide_a_password_in_a_multicast_whatever_the_family(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def test(rig: Rig) -> None:
        drives = tuple(rig.stations.values())
        group = Station("all", 0, drives[0].family, drives[0].forms[:1])
        value = Value.parse("4711")

        async def send(number: int) -> None:
            def make(settle: Callable[[Outcome, str], None]) -> Request:
                return rig.maker.multicast(
                    group, drives, Code(number), value, Priority.INTERACTIVE, settle=settle
                )

            await rig.submit(make).done.wait()

        for number in (94, 1194, 46):
            await send(number)

    said = [one for one in debug_lines(caplog, test) if "kind=multicast" in one]
    assert ["value=4711" in one for one in said] == [False, False, True]
    assert [one.endswith("bytes=*** value=***") for one in said] == [True, True, False]


@pytest.mark.parametrize(
    ("text", "hidden"),
    [
        (b"\x02944711\x03q", True),
        (b"\x02!005E004711\x03x", True),
        (b"\x02934711\x03v", False),
        (b"944711", False),
    ],
)
def test_debug_logs_hide_a_password_that_comes_unasked(
    caplog: pytest.LogCaptureFixture, text: bytes, hidden: bool
) -> None:
    async def test(rig: Rig) -> None:
        rig.end.say(text)
        await rig.read("a", 150).done.wait()

    (unasked,) = [one for one in debug_lines(caplog, test) if "kind=unasked" in one]
    assert unasked.endswith("bytes=***") is hidden


def test_debug_logs_hide_a_late_answer_with_a_password(caplog: pytest.LogCaptureFixture) -> None:
    async def test(rig: Rig) -> None:
        rig.line["a"].model.preset(94, "4711")
        rig.line.drive_faults[1] = Faults(late=1.0, late_s=(2.0, 2.0))
        await rig.read("a", 94).done.wait()
        await anyio.sleep(4.0)
        await rig.read("b", 150).done.wait()

    drives = [("a", 1, "generic"), ("b", 2, "8200vector")]
    said = debug_lines(caplog, test, retries=0, drives=drives)
    (unasked,) = [one for one in said if "kind=unasked" in one]
    assert unasked.endswith(" bytes=***")


@pytest.mark.parametrize("level", ["DEBUG", "INFO"])
def test_without_debug_nothing_is_collected(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, level: str
) -> None:
    collected: list[bytes] = []
    monkeypatch.setattr(TelegramLog, "heard", lambda _, data: collected.append(data))

    async def test(rig: Rig) -> None:
        await rig.read("a", 150).done.wait()

    with caplog.at_level(level, logger="lecombus.line"):
        with_rig(test)
    assert bool(collected) is (level == "DEBUG")
