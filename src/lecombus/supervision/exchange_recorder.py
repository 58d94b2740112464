"""Keeping the books of a line: what each exchange means for store, meters, health and words.

The worker tells one observer what happened; this is it. It runs while the next drive is already
thinking, and is the only place that knows everyone who wants to be told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from lecombus.line.observer import ExchangeReport
from lecombus.line.station import StepKind
from lecombus.metrics import Metrics
from lecombus.operations.control_words import ControlWords
from lecombus.operations.identities import Identities
from lecombus.operations.wear import Wear
from lecombus.protocol.exchange import ResultKind
from lecombus.protocol.telegrams import AckAnswer, NakAnswer, UnknownCodeAnswer, ValueAnswer
from lecombus.readings import NO_SUCH_CODE, DriveState, LineState
from lecombus.schedule import Priority
from lecombus.store import Store
from lecombus.supervision.command_effects import CommandEffects
from lecombus.supervision.configurations import Configurations
from lecombus.supervision.fault_watch import FaultWatch
from lecombus.supervision.health import Health

__all__ = ["ExchangeRecorder"]

_REFUSALS: Mapping[type, str] = {
    UnknownCodeAnswer: NO_SUCH_CODE,
    NakAnswer: "the drive refused the question (NAK)",
}

_OUTCOMES: Mapping[ResultKind, str] = {
    ResultKind.SENT: "sent",
    ResultKind.NO_REPLY: "no_reply",
    ResultKind.GARBLED: "garbled",
    ResultKind.ECHO: "echo",
    ResultKind.LOST: "line_lost",
}


class ExchangeRecorder:
    """Tells store, meters, health and control words what happened on the line.

    Args:
        store: Values and states.
        metrics: Counters.
        health: Judges the drives.
        words: Control words.
        faults: Watches for faults.
        effects: Has status words read after a command.
        configurations: Follows the signal configurations.
        identities: Knows what the drives said of themselves.
        wear: Counts what may have worn a drive's memory.
        is_drive: Whether a name is a drive of the roster and has this address (None: any): it
            may have left the roster meanwhile, or come back as another device.
    """

    def __init__(
        self,
        store: Store,
        metrics: Metrics,
        health: Health,
        words: ControlWords,
        faults: FaultWatch,
        effects: CommandEffects,
        configurations: Configurations,
        identities: Identities,
        wear: Wear,
        is_drive: Callable[[str, int | None], bool],
    ) -> None:
        self._store = store
        self._metrics = metrics
        self._health = health
        self._words = words
        self._wear = wear
        self._is_drive = is_drive
        self._faults = faults
        self._effects = effects
        self.disturbances = 0
        self.failures = 0
        self._configurations = configurations
        self._identities = identities

    def exchange_ended(self, report: ExchangeReport) -> None:
        """Book one exchange."""
        if not report.result.clean:
            self.disturbances += 1
        if report.result.kind is not ResultKind.ANSWERED:
            self.failures += report.result.kind is not ResultKind.SENT
        result = report.result
        answer = result.answer
        kind = report.step.kind
        outcome = "answered" if answer is not None else _OUTCOMES[result.kind]
        if kind is StepKind.MULTICAST:
            self._book_multicast(report)
        elif self._is_drive(report.drive, report.address):
            if kind is StepKind.WRITE and type(answer) is not NakAnswer:
                self._store.value_written(report.drive, report.step.code, result.ended_s)
                if report.step.value is not None:
                    self._words.written(
                        report.drive, report.step.code, report.step.value,
                        heard=type(answer) is AckAnswer,
                    )  # fmt: skip
                self._effects.written(report.drive, report.step.code)
                self._configurations.written(report.drive, report.step.code)
                self._wear.written(report.drive, report.step.code)
            if type(answer) is ValueAnswer:
                code = report.step.code
                as_of_s = result.ended_s - result.overdue_s
                self._store.value_read(report.drive, code, answer.value, as_of_s)
                self._metrics.minutes.value(report.drive, code, result.ended_s)
                self._words.seen(report.drive, code, answer.value)
                self._faults.seen(report.drive, code, answer.value)
                self._effects.seen(report.drive, code, answer.value)
                self._configurations.seen(report.drive, code, answer.value)
                self._identities.seen(report.drive, code, answer.value)
            elif not (type(answer) is AckAnswer and kind is StepKind.WRITE):
                outcome = self._book_failure(report, outcome)
            elif report.step.value is not None:
                self._store.setpoint_taken(
                    report.drive, report.step.code, report.step.value, result.ended_s
                )
            if answer is not None:
                self._words.heard(report.drive, result.ended_s)
            self._health.exchange_ended(report.drive, result.kind, result.fault)
        else:
            return
        self._count(report, outcome)

    def forget(self, drive: str) -> None:
        """The drive has left the roster; what comes back by its name may be another device."""
        self._faults.forget(drive)
        self._effects.forget(drive)
        self._configurations.forget(drive)

    def _book_multicast(self, report: ExchangeReport) -> None:
        code, value = report.step.code, report.step.value
        for member in report.members:
            if self._is_drive(member, None):
                self._store.value_written(member, code, report.result.ended_s)
                self._effects.written(member, code)
                self._configurations.written(member, code)
                self._wear.written(member, code)
            if value is not None and report.result.kind is ResultKind.SENT:
                self._words.said_to_all(member, code, value)
            elif value is not None:
                self._words.written(member, code, value, heard=False)

    def _book_failure(self, report: ExchangeReport, outcome: str) -> str:
        """A read that brought nothing leaves the value bad; a refused write leaves it as it is."""
        result = report.result
        refused = type(result.answer) is NakAnswer or type(result.answer) is UnknownCodeAnswer
        if report.step.kind is StepKind.READ:
            reason = _REFUSALS.get(type(result.answer), result.fault or "bad answer")
            self._store.value_failed(report.drive, report.step.code, reason)
        return "refused" if refused else "unexpected" if outcome == "answered" else outcome

    def _count(self, report: ExchangeReport, outcome: str) -> None:
        result = report.result
        took_s = result.ended_s - result.started_s
        meters = self._metrics.meters
        meters.exchange(
            report.drive,
            report.step.kind,
            outcome,
            took_s=took_s,
            busy_s=took_s + report.quarantined_s,
            priority=report.priority,
            waited_s=report.waited_s,
        )
        first_wait_s = max(report.waited_s, 0.0) if report.attempt == 1 else None
        if report.priority is Priority.STOP and self._is_away(report):
            first_wait_s = None  # it is promised another wait than its class
        self._metrics.minutes.exchange(
            report.priority,
            took_s + report.quarantined_s,
            first_wait_s,
            result.ended_s,
            good=result.kind is ResultKind.ANSWERED or result.kind is ResultKind.SENT,
        )
        if result.late:
            meters.late_answers.inc(result.late)

    def _is_away(self, report: ExchangeReport) -> bool:
        if not self._is_drive(report.drive, None):
            return False
        return self._health.state(report.drive) is DriveState.OFFLINE

    def line_changed(self, up: bool, reason: str) -> None:
        """The port was opened or lost."""
        if up:
            self._metrics.meters.port_opened()
            self._store.line_state(LineState.OPEN, reason)
            self._health.line_opened()
        else:
            # The store's line needs no telling which line it is.
            told = reason.partition(": ")[2] if reason.startswith("line ") else reason
            self._store.line_state(LineState.LOST, told)

    def thinking(self, for_s: float) -> None:
        """Use the time in which nothing can arrive for a page that was asked for."""
        self._metrics.window(for_s)

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        """Bytes came that nobody asked for."""
        self.disturbances += 1
        self._metrics.meters.stray_bytes.inc(len(data))
        if late_answer:
            self._metrics.meters.late_answers.inc()
