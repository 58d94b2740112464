"""Losing the port and coming back: every request ends, nothing old is said again."""

from __future__ import annotations

import asyncio

import anyio
import pytest

from lecombus.errors import LineClosedError, LineLostError
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.port import Port, PortSettings, Receiver
from lecombus.line.worker import WorkerOptions
from lecombus.schedule import Cyclic, Outcome, Priority, WatchdogFeeding
from support.site_host import Rig, reader, stop, until, with_rig

STOP_A = b"\x0401\x02400\x03"
"""C0040 = 0 to drive 1, without its block check."""

THREE = (("a", 1, "8200vector"), ("b", 2, "8200vector"), ("c", 3, "8200vector"))


def test_losing_the_line_ends_every_waiting_request_at_once_and_replays_nothing() -> None:
    async def test(rig: Rig) -> None:
        make = reader(rig, "c", 61, Priority.CYCLIC)
        rig.schedule.add_cyclic(Cyclic("c", 1.0, make), rig.now_s)
        feed = reader(rig, "b", 52, Priority.WATCHDOG)
        rig.schedule.set_feeding("b", WatchdogFeeding(2.0, feed), rig.now_s)
        ends = [rig.read("a", 150) for _ in range(5)]
        ends += [rig.write("a", 12, str(n)) for n in range(1, 5)]
        ends += [stop(rig, "a"), stop(rig, "b")]
        await anyio.sleep(0.005)
        rig.end.unplug()
        lost_s = rig.now_s
        await anyio.lowlevel.checkpoint()
        await anyio.sleep(0.001)
        assert all(end.outcome is not None for end in ends), "none may hang"
        # The stop of a has ended the writes that waited for it.
        outcomes = {Outcome.UNKNOWN, Outcome.REFUSED, Outcome.SUPERSEDED}
        assert {end.outcome for end in ends} == outcomes
        assert all("unplugged" in end.reason for end in ends if end.outcome is Outcome.REFUSED)
        with pytest.raises(LineLostError, match="nothing was sent"):
            rig.read("a", 150)
        rig.end.replug()
        said = len(rig.sent)
        await anyio.sleep(10.0)
        assert rig.now_s > lost_s
        fields = {one.data[1:3] + one.data[3:5] for one in rig.sent[said:]}
        assert fields == {b"0361", b"0252"}, "only cyclic reads and feeding go on"

    with_rig(test, THREE)


def test_bytes_that_come_while_the_port_is_opened_are_strays() -> None:
    async def open_noisily(settings: PortSettings, receiver: Receiver) -> Port:
        receiver.received(b"\x81\x82")
        return await rigs[0].end.open(settings, receiver)

    async def test(rig: Rig) -> None:
        rigs.append(rig)
        await until(lambda: rig.worker.is_open)
        assert rig.seen.strays == [(b"\x81\x82", False)]
        read = rig.read("a", 150)
        await read.done.wait()
        assert read.outcome is Outcome.DONE

    rigs: list[Rig] = []
    with_rig(test, opener=open_noisily)


def test_a_write_cut_off_before_its_proof_is_not_called_unsent() -> None:
    async def test(rig: Rig) -> None:
        ended = rig.write("a", 11, "60", verify=True)
        await until(lambda: rig.line["a"].text(11) == "60")
        await until(lambda: rig.worker.exchanges == 1)
        assert len(rig.sent) == 1, "the acknowledgement is here, the proof has not been asked for"
        rig.end.unplug()
        await ended.done.wait()
        assert ended.outcome is Outcome.UNKNOWN, ended.reason
        assert ended.reason.endswith("; it was sent before, and not proven")

    with_rig(test, options=WorkerOptions(turnaround_s=0.05))


def test_an_unanswered_write_cut_off_before_its_proof_is_unknown() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(lost=1.0)
        ended = rig.write("a", 11, "60")
        await until(lambda: rig.worker.exchanges == 1)
        rig.end.unplug()
        await ended.done.wait()
        assert ended.outcome is Outcome.UNKNOWN
        assert "not sent" not in ended.reason

    with_rig(test)


def test_a_stop_that_was_said_and_is_cut_off_by_the_loss_is_unknown() -> None:
    async def test(rig: Rig) -> None:
        ended = stop(rig, "a")
        await until(lambda: rig.worker.exchanges == 1)
        rig.end.unplug()
        await ended.done.wait()
        assert ended.outcome is Outcome.UNKNOWN

    with_rig(test, options=WorkerOptions(turnaround_s=0.05))


def test_reopening_is_tried_from_a_tenth_of_a_second_up_to_every_five() -> None:
    async def test(rig: Rig) -> None:
        rig.end.unplug()
        lost_s = rig.now_s
        await anyio.sleep(40.0)
        tries = [at_s for at_s in rig.end.tries if at_s > lost_s - 1e-9]
        pauses = [b - a for a, b in zip([lost_s, *tries], tries, strict=False)]
        assert pauses[0] == pytest.approx(0.1)
        assert pauses[1:7] == pytest.approx([0.2, 0.4, 0.8, 1.6, 3.2, 5.0])
        assert pauses[7:] == pytest.approx([5.0] * len(pauses[7:]))
        rig.end.replug()
        await until(lambda: rig.worker.is_open, within_s=5.1)
        await rig.read("a", 150).done.wait()
        rig.end.unplug()
        rig.end.replug()
        again_s = rig.now_s
        await until(lambda: rig.worker.is_open and rig.end.tries[-1] > again_s)
        assert rig.end.tries[-1] - again_s == pytest.approx(0.1, abs=0.01)

    with_rig(test)


def test_a_port_that_opens_and_is_lost_at_once_is_not_opened_without_a_pause() -> None:
    tries: list[float] = []

    class Dying:
        carries_parity = True

        def write(self, data: bytes) -> None:
            raise LineLostError("gone")

        def discard_input(self) -> None: ...

        def look(self) -> None: ...

        def abort(self) -> None: ...

        def describe(self) -> str:
            return "dying"

    async def open_dying(settings: PortSettings, receiver: Receiver) -> Dying:
        tries.append(anyio.current_time())
        asyncio.get_running_loop().call_later(0.001, receiver.lost, LineLostError("gone"))
        return Dying()

    async def test(rig: Rig) -> None:
        await anyio.sleep(20.0)
        assert 5 <= len(tries) <= 12, "backoff from 0.1 s to 5 s"

    with_rig(test, opener=open_dying)


def test_an_adapter_that_stalls_silently_is_reopened() -> None:
    async def test(rig: Rig) -> None:
        await rig.read("a", 150).done.wait()
        rig.line.faults.unplugged = True
        make = reader(rig, "a", 150, Priority.CYCLIC)
        rig.schedule.add_cyclic(Cyclic("a", 0.5, make), rig.now_s)
        silent_s = rig.now_s
        await until(lambda: rig.end.memory.opened == 2)
        assert 3.0 <= rig.now_s - silent_s < 4.5
        assert "no byte from any drive" in rig.seen.line[-2][2]
        rig.line.faults.unplugged = False
        said = rig.worker.exchanges
        await until(lambda: rig.worker.exchanges > said + 3)
        assert rig.seen.kinds[-1] == "answered"
        assert rig.end.memory.opened == 2

    with_rig(test, options=WorkerOptions(stall_s=3.0))


def test_a_stop_outlasts_the_reopening_of_a_silent_port() -> None:
    async def test(rig: Rig) -> None:
        await rig.read("a", 150).done.wait()
        rig.line.faults.unplugged = True
        make = reader(rig, "b", 150, Priority.CYCLIC)
        rig.schedule.add_cyclic(Cyclic("b", 0.5, make), rig.now_s)
        await anyio.sleep(2.5)
        ended, waiting = stop(rig, "a"), rig.read("c", 150)
        await until(lambda: rig.end.memory.opened == 2)
        rig.line.faults.unplugged = False
        await ended.done.wait()
        assert ended.outcome is Outcome.VERIFIED
        assert waiting.outcome is Outcome.REFUSED, "all else ends"

    with_rig(test, THREE, options=WorkerOptions(stall_s=3.0))


def test_it_ends_where_the_port_cannot_be_opened_again() -> None:
    async def test(rig: Rig) -> None:
        await rig.read("a", 150).done.wait()
        rig.line.faults.unplugged = True
        make = reader(rig, "b", 150, Priority.CYCLIC)
        rig.schedule.add_cyclic(Cyclic("b", 0.5, make), rig.now_s)
        await anyio.sleep(2.5)
        ended = stop(rig, "a")
        await until(lambda: not rig.worker.is_open)
        assert not ended.done.is_set()
        rig.end.unplug()
        await ended.done.wait()
        assert ended.outcome is Outcome.UNKNOWN, "it was sent"
        assert "unplugged" in ended.reason

    with_rig(test, THREE, options=WorkerOptions(stall_s=3.0))


def test_one_failure_after_a_long_idle_time_is_no_stall() -> None:
    async def test(rig: Rig) -> None:
        await rig.read("a", 150).done.wait()
        await anyio.sleep(60.0)
        rig.line.drive_faults[2] = Faults(unheard=1.0)
        lost = rig.read("b", 150)
        good = rig.read("a", 50)
        await lost.done.wait()
        await good.done.wait()
        assert good.outcome is Outcome.DONE
        assert rig.end.memory.opened == 1

    with_rig(test, retries=0, options=WorkerOptions(stall_s=3.0))


def test_closing_ends_what_waits_and_takes_nothing_more() -> None:
    async def test(rig: Rig) -> None:
        ends = [rig.read("a", 150) for _ in range(5)]
        await anyio.sleep(0.005)
        rig.worker.close()
        with pytest.raises(LineClosedError):
            rig.read("a", 150)
        await anyio.sleep(1.0)
        assert ends[0].outcome is Outcome.DONE, "the telegram under way is completed"
        assert {end.outcome for end in ends[1:]} == {Outcome.REFUSED}
        assert "closed" in ends[1].reason
        assert len(rig.sent) == 1

    with_rig(test)


def test_cancelling_the_worker_lets_the_telegram_under_way_end() -> None:
    async def test(rig: Rig) -> None:
        ended = rig.read("a", 150)
        await anyio.sleep(0.005)
        rig.tasks.cancel_scope.cancel()
        with anyio.CancelScope(shield=True):
            await ended.done.wait()
        assert ended.outcome is Outcome.DONE

    with_rig(test)


def test_one_loss_is_logged_once_and_a_later_reason_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    reasons = ["no such file", "no such file", "permission denied", "permission denied"]

    async def open_later(settings: PortSettings, receiver: Receiver) -> Port:
        if opened and reasons:
            raise LineLostError(reasons.pop(0))
        opened.append(receiver)
        return await rigs[0].end.open(settings, receiver)

    async def test(rig: Rig) -> None:
        rigs.append(rig)
        await until(lambda: rig.worker.is_open)
        rig.end.unplug()
        rig.end.replug()
        await until(lambda: len(opened) == 2 and rig.worker.is_open, within_s=60.0)
        lost = [one for one in caplog.messages if "event=port-lost" in one]
        assert [one.partition("reason=")[2] for one in lost] == [
            "the simulated line was unplugged", "permission denied",
        ]  # fmt: skip

    opened: list[Receiver] = []
    rigs: list[Rig] = []
    with_rig(test, opener=open_later)
