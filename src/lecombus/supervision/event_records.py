"""What exchanges do to the store, to the control words and to the metrics.

Store and metrics know no events, and a control word is one drive's; so their part stands here.
"""

from __future__ import annotations

from lecombus.fieldbus.lecom.protocol.exchange import ResultKind
from lecombus.fieldbus.station import StepKind
from lecombus.line_events import ExchangeEvent, LineChange
from lecombus.metrics import Metrics
from lecombus.readings import DriveState, LineState
from lecombus.schedule import Priority
from lecombus.store import Store

__all__ = ["MetricsRecord", "StoreRecord", "record_control_words"]


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
        if event.is_write:
            for drive in event.drives:
                store.value_written(drive.name, code, event.ended_s)
        if event.read is not None:
            store.value_read(event.drives[0].name, code, event.read, event.read_s)
        elif event.read_failure is not None:
            store.value_failed(event.drives[0].name, code, event.read_failure)
        elif event.acknowledged and event.written is not None:
            store.setpoint_taken(event.drives[0].name, code, event.written, event.ended_s)

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
    if event.written is not None:
        for drive in event.drives:
            if event.to_all:
                drive.control_word.written_to_all(event.code, event.written)
            else:
                drive.control_word.written(event.code, event.written, heard=event.acknowledged)
    if event.read is not None:
        event.drives[0].control_word.seen(event.code, event.read)
    if event.answered and event.drives:
        event.drives[0].control_word.heard(event.ended_s)


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
