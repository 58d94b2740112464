"""One event of each exchange, given to all that follow the line, in their order."""

from __future__ import annotations

import pytest

from lecombus.drive_state.drive_runtime import LineDrives
from lecombus.drive_state.store import Store
from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.lecom.protocol.telegrams import (
    AckAnswer,
    Answer,
    NakAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.fieldbus.requests import JobStep, StepKind
from lecombus.line_events import ExchangeEvent, LineChange
from lecombus.metrics import Metrics
from lecombus.parameters import Code, Value
from lecombus.schedule import Priority
from lecombus.supervision.exchange_recorder import ExchangeRecorder
from support.single_drives import drive_of

CODE, VALUE = Code(46), Value.decimal(20)
READ, WRITE = JobStep(StepKind.READ, CODE), JobStep(StepKind.WRITE, CODE, VALUE)
ALL = JobStep(StepKind.MULTICAST, CODE, VALUE)


class Following:
    """A recorder of two drives at address 1, with two subscribers."""

    def __init__(self) -> None:
        self.drives = LineDrives()
        for name in "ab":
            self.drives.put(drive_of(name))
        store = Store(lambda: 0.0, lambda: 0.0)
        metrics = Metrics("t", store, version="0", clock=lambda: 0.0)
        self.recorder = ExchangeRecorder(self.drives, metrics)
        self.events: list[ExchangeEvent] = []
        self.order: list[str] = []
        self.recorder.subscribe(exchanges=(self._first, self._second), changes=(self._change,))

    def _first(self, event: ExchangeEvent) -> None:
        self.order.append("first")
        self.events.append(event)

    def _second(self, event: ExchangeEvent) -> None:
        self.order.append("second")

    def _change(self, change: LineChange) -> None:
        self.order.append(f"{change.is_open} {change.reason}")

    def ended(
        self,
        step: JobStep,
        kind: ResultKind = ResultKind.ANSWERED,
        answer: Answer | None = None,
        *,
        drive: str = "a",
        address: int = 1,
        members: tuple[str, ...] = (),
    ) -> ExchangeEvent | None:
        result = Result(kind, 2.0, 3.0, answer, "no answer in time", older_by_s=0.25)
        before = len(self.events)
        self.recorder.exchange_ended(
            ExchangeReport(drive, step, result, Priority.CYCLIC, 0.0, 0.0, members, address)
        )
        return self.events[-1] if len(self.events) > before else None


def test_subscribers_are_called_in_their_order() -> None:
    following = Following()
    following.ended(READ, answer=ValueAnswer(b"0046", VALUE))
    following.recorder.line_changed(False, "line t: gone")
    assert following.order == ["first", "second", "False line t: gone"]


@pytest.mark.parametrize(
    ("step", "kind", "answer", "outcome", "says"),
    [
        (READ, ResultKind.ANSWERED, ValueAnswer(b"0046", VALUE), "answered", "read answered"),
        (READ, ResultKind.ANSWERED, NakAnswer(), "refused", "failed answered"),
        (READ, ResultKind.ANSWERED, UnknownCodeAnswer(b"0046"), "refused", "failed answered"),
        (READ, ResultKind.NO_REPLY, None, "no_reply", "failed"),
        (WRITE, ResultKind.ANSWERED, AckAnswer(), "answered", "written acknowledged answered"),
        (WRITE, ResultKind.ANSWERED, NakAnswer(), "refused", "answered"),
        (WRITE, ResultKind.GARBLED, None, "garbled", "written"),
        (WRITE, ResultKind.LOST, None, "line_lost", "written"),
    ],
)
def test_what_an_exchange_with_one_drive_means(
    step: JobStep, kind: ResultKind, answer: Answer | None, outcome: str, says: str
) -> None:
    event = Following().ended(step, kind, answer)
    assert event is not None
    assert (event.outcome, [drive.name for drive in event.drives]) == (outcome, ["a"])
    said = {
        "read": event.read is not None,
        "failed": event.read_failure is not None,
        "written": event.written is not None and event.is_write,
        "acknowledged": event.acknowledged,
        "answered": event.answered,
    }
    assert " ".join(key for key, holds in said.items() if holds) == says
    assert (event.ended_s, event.read_s) == (3.0, 2.75)


@pytest.mark.parametrize(
    ("kind", "outcome", "to_all"),
    [(ResultKind.SENT, "sent", True), (ResultKind.ECHO, "echo", False)],
)
def test_a_multicast_may_have_reached_its_members_that_are_still_there(
    kind: ResultKind, outcome: str, to_all: bool
) -> None:
    event = Following().ended(ALL, kind, drive="all", address=0, members=("a", "b", "gone"))
    assert event is not None
    assert [drive.name for drive in event.drives] == ["a", "b"]
    assert (event.outcome, event.to_all, event.written) == (outcome, to_all, VALUE)


@pytest.mark.parametrize(("drive", "address"), [("gone", 1), ("a", 2)])
def test_an_exchange_with_no_drive_of_the_roster_is_no_event_but_may_disturb(
    drive: str, address: int
) -> None:
    following = Following()
    assert following.ended(READ, ResultKind.GARBLED, drive=drive, address=address) is None
    assert following.recorder.failures == 1


def test_a_drive_that_left_keeps_what_lasts_for_its_name() -> None:
    following = Following()
    drive = following.drives.get("a")
    following.drives.lasting("a").stops += 1
    following.drives.take_out(drive)
    assert following.drives.find("a") is None
    assert following.drives.lasting("a").stops == 1
