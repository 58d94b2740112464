"""What each exchange means: one event in plain words, given to all that follow the line.

The worker has one observer; this is it. It runs while the drive that was asked next
is already thinking. The order of the subscribers stands in one place, in `line_runtime`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from lecombus.drive_runtime import LineDrives
from lecombus.fieldbus.lecom.protocol.exchange import ResultKind
from lecombus.fieldbus.lecom.protocol.telegrams import (
    AckAnswer,
    NakAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from lecombus.fieldbus.reports import ExchangeReport
from lecombus.fieldbus.station import StepKind
from lecombus.line_events import ExchangeEvent, LineChange
from lecombus.metrics import Metrics
from lecombus.readings import NO_SUCH_CODE

__all__ = ["ExchangeRecorder", "ExchangeSubscriber", "LineSubscriber"]

ExchangeSubscriber = Callable[[ExchangeEvent], None]
"""Takes an exchange; it must return quickly and never raise."""
LineSubscriber = Callable[[LineChange], None]
"""Takes an opening or a loss of the port."""

_REFUSALS: Final[Mapping[type, str]] = {
    UnknownCodeAnswer: NO_SUCH_CODE,
    NakAnswer: "the drive refused the read (NAK)",
}

_OUTCOMES: Final[Mapping[ResultKind, str]] = {
    ResultKind.SENT: "sent",
    ResultKind.NO_REPLY: "no_reply",
    ResultKind.GARBLED: "garbled",
    ResultKind.ECHO: "echo",
    ResultKind.LOST: "line_lost",
}


class ExchangeRecorder:
    """Gives what happened on the line to its subscribers, in their order.

    Args:
        drives: The drives of the line.
        metrics: Counts bytes that belong to no exchange, and uses idle time to write its page.

    Attributes:
        disturbances: How often the line has carried something that was no answer.
        failures: How many exchanges have failed.
    """

    def __init__(self, drives: LineDrives, metrics: Metrics) -> None:
        self._drives = drives
        self._metrics = metrics
        self._on_exchange: tuple[ExchangeSubscriber, ...] = ()
        self._on_change: tuple[LineSubscriber, ...] = ()
        self.disturbances = 0
        self.failures = 0

    def subscribe(
        self, *, exchanges: tuple[ExchangeSubscriber, ...], changes: tuple[LineSubscriber, ...]
    ) -> None:
        """Set who gets exchanges and changes of the line, in this order."""
        self._on_exchange, self._on_change = exchanges, changes

    def exchange_ended(self, report: ExchangeReport) -> None:
        """Take one exchange."""
        if not report.result.clean:
            self.disturbances += 1
        if report.result.kind not in (ResultKind.ANSWERED, ResultKind.SENT):
            self.failures += 1
        event = self._event(report)
        if event is not None:
            for subscriber in self._on_exchange:
                subscriber(event)

    def line_changed(self, up: bool, reason: str) -> None:
        """The port was opened or lost."""
        change = LineChange(up, reason)
        for subscriber in self._on_change:
            subscriber(change)

    def thinking(self, for_s: float) -> None:
        """Use the time in which nothing can arrive for a page that was asked for."""
        self._metrics.window(for_s)

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        """Bytes came outside an exchange."""
        self.disturbances += 1
        self._metrics.counters.stray_bytes.inc(len(data))
        if late_answer:
            self._metrics.counters.late_answers.inc()

    def _event(self, report: ExchangeReport) -> ExchangeEvent | None:
        """Say what an exchange means; None: the roster has no such drive, or has no more."""
        if report.step.kind is StepKind.MULTICAST:
            return self._multicast(report)
        drive = self._drives.find(report.drive)
        if drive is None or drive.entry.address != report.address:
            return None  # it may have come back as another device
        result, step = report.result, report.step
        answer = result.answer
        kind = type(answer)
        is_write = step.kind is StepKind.WRITE and kind is not NakAnswer
        acknowledged = kind is AckAnswer and step.kind is StepKind.WRITE
        outcome, failure = "answered", None
        if kind is not ValueAnswer and not acknowledged:
            outcome = _failed(report)
            if step.kind is StepKind.READ:
                failure = _REFUSALS.get(kind, result.fault or "bad answer")
        return ExchangeEvent(
            report,
            (drive,),
            step.code,
            result.ended_s,
            outcome,
            read=answer.value if isinstance(answer, ValueAnswer) else None,
            read_s=result.ended_s - result.overdue_s,
            read_failure=failure,
            written=step.value if is_write else None,
            is_write=is_write,
            acknowledged=acknowledged,
            answered=answer is not None,
        )

    def _multicast(self, report: ExchangeReport) -> ExchangeEvent:
        """A multicast may have reached its members, however it ended."""
        result, step = report.result, report.step
        members = tuple(filter(None, map(self._drives.find, report.members)))
        outcome = "answered" if result.answer is not None else _OUTCOMES[result.kind]
        return ExchangeEvent(
            report, members, step.code, result.ended_s, outcome, written=step.value,
            is_write=True, to_all=result.kind is ResultKind.SENT,
        )  # fmt: skip


def _failed(report: ExchangeReport) -> str:
    """Name the end of an exchange that brought neither a value nor an acknowledgement."""
    answer = report.result.answer
    if answer is None:
        return _OUTCOMES[report.result.kind]
    refused = isinstance(answer, NakAnswer | UnknownCodeAnswer)
    return "refused" if refused else "unexpected"
