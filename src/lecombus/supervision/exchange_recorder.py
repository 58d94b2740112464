"""What each exchange means: one event in plain words, given to all that follow the line.

The worker has one observer; this is it. It runs while the drive that was asked next
is already thinking. `follow_line` sets who gets the events, in one order. Store and metrics know no
events, and a control word is one drive's; so what exchanges do to them stands here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from lecombus.drive_state.drive_runtime import LineDrives
from lecombus.drive_state.readings import NO_SUCH_CODE, DriveState, LineState
from lecombus.drive_state.store import Store
from lecombus.fieldbus.loop_interface import AnswerKind, ExchangeReport, ExchangeResult, ResultKind
from lecombus.fieldbus.requests import StepKind
from lecombus.line_events import ExchangeEvent, LineChange
from lecombus.metrics import Metrics
from lecombus.operations.facade import Operations
from lecombus.schedule import Priority
from lecombus.supervision.command_effects import CommandEffects
from lecombus.supervision.configurations import Configurations
from lecombus.supervision.fault_watch import FaultWatch
from lecombus.supervision.line_requests import RequestsToLine

__all__ = ["ExchangeRecorder", "ExchangeSubscriber", "LineSubscriber", "follow_line"]

ExchangeSubscriber = Callable[[ExchangeEvent], None]
"""Takes an exchange; it must return quickly and never raise."""
LineSubscriber = Callable[[LineChange], None]
"""Takes an opening or a loss of the port."""

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
        kind = None if answer is None else answer.kind
        is_write = step.kind is StepKind.WRITE and kind is not AnswerKind.REFUSED
        acknowledged = kind is AnswerKind.ACKNOWLEDGED and step.kind is StepKind.WRITE
        outcome, failure = "answered", None
        if kind is not AnswerKind.VALUE and not acknowledged:
            outcome = _failed(result)
            if step.kind is StepKind.READ:
                failure = _why_not_read(result)
        return ExchangeEvent(
            report,
            (drive,),
            step.code,
            result.ended_s,
            outcome,
            read=None if answer is None else answer.value,
            read_s=result.ended_s - result.older_by_s,
            read_failure=failure,
            written=step.value if is_write else None,
            is_write=is_write,
            acknowledged=acknowledged,
            answered=answer is not None,
            lapsed=answer is not None
            and drive.control_word.watchdog_may_have_acted(result.started_s),
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


def _failed(result: ExchangeResult) -> str:
    """Name the end of an exchange that brought neither a value nor an acknowledgement."""
    answer = result.answer
    if answer is None:
        return _OUTCOMES[result.kind]
    refused = answer.kind in (AnswerKind.REFUSED, AnswerKind.NO_SUCH_CODE)
    return "refused" if refused else "unexpected"


def _why_not_read(result: ExchangeResult) -> str:
    answer = result.answer
    if answer is None:
        return result.fault or "bad answer"
    if answer.kind is AnswerKind.NO_SUCH_CODE:
        return NO_SUCH_CODE
    return answer.text or result.fault or "bad answer"


class StoreRecord:
    """Writes values and the line's state into the store.

    Args:
        store: The store.
    """

    def __init__(self, store: Store) -> None:
        self._store = store

    def exchange_ended(self, event: ExchangeEvent) -> None:
        """Keep what was read, and what is not true any more because it was written."""
        store, code = self._store, event.code
        if event.lapsed:
            drive, began_s = event.drives[0], event.report.result.started_s
            store.watchdog_lapsed(drive.name, began_s, quick_stops=drive.watchdog_quick_stops)
        if event.is_write:
            for drive in event.drives:
                store.value_written(drive.name, code, event.ended_s)
        if event.read is not None:
            store.value_read(event.drives[0].name, code, event.read, event.read_s)
        elif event.read_failure is not None:
            store.value_failed(event.drives[0].name, code, event.read_failure)
        elif event.acknowledged and event.written is not None:
            store.write_taken(event.drives[0].name, code, event.written, event.ended_s)

    def line_changed(self, change: LineChange) -> None:
        """Keep how the line is doing."""
        if change.is_open:
            self._store.line_state(LineState.OPEN, change.reason)
            return
        # Which line it is need not be said to the line's own store.
        reason = change.reason
        text = reason.partition(": ")[2] if reason.startswith("line ") else reason
        self._store.line_state(LineState.LOST, text)


def record_control_words(event: ExchangeEvent) -> None:
    """Keep what an exchange shows of the control words of its drives."""
    began_s = event.report.result.started_s
    if event.written is not None:
        for drive in event.drives:
            word = drive.control_word
            if event.to_all:
                word.written_to_all(event.code, event.written)
            else:
                word.written(event.code, event.written, heard=event.acknowledged, at_s=began_s)
    if event.read is not None:
        event.drives[0].control_word.seen(
            event.code, event.read, began_s, may_be_anothers=event.report.may_be_anothers
        )
    if event.answered and event.drives:
        event.drives[0].control_word.heard(began_s)


class MetricsRecord:
    """Counts exchanges.

    Args:
        metrics: The metrics.
    """

    def __init__(self, metrics: Metrics) -> None:
        self._counters = metrics.counters
        self._window = metrics.rolling_window

    def exchange_ended(self, event: ExchangeEvent) -> None:
        """Count an exchange."""
        report, result = event.report, event.report.result
        if event.read is not None:
            self._window.value(report.drive, event.code, event.ended_s)
        took_s = result.ended_s - result.started_s
        busy_s = took_s + report.quarantined_s
        # A repetition and a stop of a silent drive wait otherwise than their class.
        is_promised = report.attempt == 1
        if report.priority is Priority.STOP and report.step.kind is not StepKind.MULTICAST:
            is_promised &= all(one.health.state is not DriveState.OFFLINE for one in event.drives)
        self._counters.exchange(
            report.drive,
            report.step.kind,
            event.outcome,
            took_s=took_s,
            busy_s=busy_s,
            priority=report.priority,
            waited_s=report.waited_s,
        )
        self._window.exchange(
            report.priority,
            busy_s,
            max(report.waited_s, 0.0) if is_promised else None,
            result.ended_s,
            good=result.kind is ResultKind.ANSWERED or result.kind is ResultKind.SENT,
        )
        if result.late:
            self._counters.late_answers.inc(result.late)

    def line_changed(self, change: LineChange) -> None:
        """Count an opening of the port."""
        if change.is_open:
            self._counters.port_opened()


def follow_line(
    recorder: ExchangeRecorder,
    store: Store,
    metrics: Metrics,
    line: RequestsToLine,
    operations: Operations,
    clock: Callable[[], float],
    wall: Callable[[], float],
) -> None:
    """Set who follows the events of a line, in this order and no other.

    First what was read and written is kept, so that all who follow find it. Health comes behind
    those that read values: what a drive said is known before it is judged by having said it.
    The counts come last, because a stop of a drive that is offline by now counts otherwise.
    """
    values, counts, health = StoreRecord(store), MetricsRecord(metrics), line.health
    recorder.subscribe(
        exchanges=(
            values.exchange_ended,
            record_control_words,
            FaultWatch(store, line, wall).exchange_ended,
            CommandEffects(store, line, clock).exchange_ended,
            Configurations(line).exchange_ended,
            operations.identities.exchange_ended,
            operations.context.wear.exchange_ended,
            health.exchange_ended,
            counts.exchange_ended,
        ),
        changes=(values.line_changed, health.line_changed, counts.line_changed),
    )
