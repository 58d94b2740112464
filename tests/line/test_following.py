"""From an answer's last byte to the next telegram: what goes first, and what must not."""

from __future__ import annotations

import anyio
import pytest

from lecombus.drives import StopAction
from lecombus.errors import LineLostError
from lecombus.fieldbus.loop_interface import ExchangeReport
from lecombus.line.worker import WorkerOptions
from lecombus.parameters import Code
from lecombus.schedule import Cyclic, Outcome, Priority
from support.lecom_loop import lecom_loop
from support.site_host import Ended, Recorder, Rig, reader, stop, until, with_rig

AT_ONCE = WorkerOptions(turnaround_s=0.0, echo=False)
WORD = Code(135)


class Watching(Recorder):
    """Notes how many telegrams had gone out when each exchange was told of."""

    def __init__(self, rig: Rig) -> None:
        super().__init__()
        self.rig = rig
        self.sent_by_then: list[int] = []

    def exchange_ended(self, report: ExchangeReport) -> None:
        super().exchange_ended(report)
        self.sent_by_then.append(len(self.rig.sent))


def watched(rig: Rig) -> Watching:
    seen = rig.worker.exchange_loop.observer = Watching(rig)
    return seen


@pytest.mark.parametrize("priority", [Priority.INTERACTIVE, Priority.BACKGROUND])
def test_the_next_telegram_is_out_before_anybody_is_told_of_the_answer(priority: Priority) -> None:
    async def test(rig: Rig) -> None:
        seen = watched(rig)
        reads = [rig.read("ab"[n % 2], 150, priority) for n in range(20)]
        await until(lambda: all(end.outcome for end in reads))
        assert seen.sent_by_then == [*range(2, 21), 20]
        assert [one.at_s for one in rig.sent[1:]] == [
            one.result.ended_s for one in seen.reports[:-1]
        ]
        assert {end.outcome for end in reads} == {Outcome.DONE}

    with_rig(test, options=AT_ONCE)


def test_cyclic_reads_follow_each_other_the_same_way() -> None:
    async def test(rig: Rig) -> None:
        seen = watched(rig)
        for name in "ab":
            make = reader(rig, name, 150, Priority.CYCLIC)
            rig.schedule.add_cyclic(Cyclic(name, 0.01, make), rig.now_s)
        rig.worker.nudge()
        await anyio.sleep(1.0)
        count = len(seen.reports)
        assert count > 30
        assert seen.sent_by_then == list(range(2, count + 2))
        assert [report.drive for report in seen.reports[:6]] == ["a", "b"] * 3

    with_rig(test, options=AT_ONCE)


def test_a_write_is_concluded_before_the_next_telegram_so_that_its_proof_can_go_first() -> None:
    async def test(rig: Rig) -> None:
        wrote = rig.write("a", 46, "20", verify=True)
        other = rig.read("b", 150)
        await until(lambda: wrote.outcome is not None and other.outcome is not None)
        assert wrote.outcome is Outcome.VERIFIED
        assert [one.data[1:3] for one in rig.sent] == [b"01", b"01", b"02"]

    with_rig(test, options=AT_ONCE)


def test_a_stop_goes_out_at_the_very_moment_at_which_the_answer_is_complete() -> None:
    async def test(rig: Rig) -> None:
        seen = watched(rig)
        for _ in range(5):
            rig.read("b", 150)
        await anyio.sleep(0.010)
        said = len(rig.sent)
        ended = stop(rig, "a")
        assert lecom_loop(rig.worker).ready is not None, "while the exchange lasts"
        await until(lambda: len(rig.sent) > said)
        assert rig.sent[said].data.startswith(b"\x0401\x02400\x03")
        assert rig.sent[said].at_s == rig.end.heard[-1].at_s
        assert seen.sent_by_then[-1] == said + 1, "the read was told of after the stop was out"
        await ended.done.wait()
        assert ended.outcome is Outcome.VERIFIED

    with_rig(test, options=AT_ONCE)


def test_a_quick_stop_waits_for_the_recorder_and_uses_the_word_the_answer_brought() -> None:
    async def test(rig: Rig) -> None:
        words: list[int] = []

        class Keeping(Recorder):
            def exchange_ended(self, report: ExchangeReport) -> None:
                value = getattr(report.result.answer, "value", None)
                if report.step.code == WORD and value is not None:
                    words.append(value.number)

        rig.worker.exchange_loop.observer = Keeping()
        rig.line["a"].model.control = 0x0204
        rig.read("a", 135)
        await anyio.sleep(0.010)
        ended = Ended()
        rig.worker.submit(
            rig.maker.stop(
                rig.stations["a"], StopAction.QUICK_STOP, settle=ended.settle, said=False,
                word=lambda: words[-1] if words else None,
            )
        )  # fmt: skip
        await ended.done.wait()
        assert ended.outcome is Outcome.VERIFIED
        assert b"\x02" in rig.sent[1].data, "the word was known: it was not read again"
        assert b"H020C" in rig.sent[1].data

    with_rig(test, options=AT_ONCE)


def test_a_line_lost_at_that_moment_loses_neither_the_answer_nor_the_next_request() -> None:
    async def test(rig: Rig) -> None:
        first, second = rig.read("a", 150), rig.read("b", 150)
        await until(lambda: len(rig.sent) == 1)
        port = rig.end.port
        assert port is not None
        assert lecom_loop(rig.worker).ready is not None

        def write(data: bytes) -> None:
            raise LineLostError("pulled")

        port.write = write  # type: ignore[method-assign]
        await until(lambda: first.outcome is not None and second.outcome is not None)
        assert first.outcome is Outcome.DONE
        assert second.outcome is Outcome.UNKNOWN
        assert rig.seen.kinds == ["answered", "line lost"]

    with_rig(test, options=AT_ONCE, retries=0)


def test_what_comes_in_while_an_answer_does_is_said_in_its_turn() -> None:
    async def test(rig: Rig) -> None:
        for _ in range(3):
            rig.read("b", 150, Priority.BACKGROUND)
        await anyio.sleep(0.010)
        rig.write("a", 46, "12")
        await until(lambda: len(rig.sent) == 2)
        assert rig.sent[1].data.startswith(b"\x0401\x02")

    with_rig(test, options=AT_ONCE)


def test_with_a_turnaround_the_telegram_made_ready_goes_out_exactly_after_it() -> None:
    async def test(rig: Rig) -> None:
        reads = [rig.read("ab"[n % 2], 150) for n in range(10)]
        await until(lambda: all(end.outcome for end in reads))
        ended = [report.result.ended_s for report in rig.seen.reports]
        pauses = [sent.at_s - at_s for sent, at_s in zip(rig.sent[1:], ended, strict=False)]
        assert pauses == pytest.approx([0.007] * 9, abs=1e-6)

    with_rig(test, options=WorkerOptions(turnaround_s=0.007))
