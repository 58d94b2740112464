"""Bookkeeping of an exchange, postponed until the next telegram was sent.

Work between an answer and the next telegram costs time on the line. So a read that returned its
value is settled, and the observer is called, only after that telegram was sent. No client, stop or
audit runs in between: sending and `publish` are one step of the event loop.

At most one read is postponed, because only a read that returned its value cannot change what is
sent next. The observer is called in the order of the exchanges, each time after the request ended.
"""

from __future__ import annotations

from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.loop_interface import ExchangeReport, Observer, ResultKind
from lecombus.fieldbus.station import Job, StepKind
from lecombus.schedule import Request

from .prepared_telegrams import PreparedTelegram

__all__ = ["DeferredReports"]


class DeferredReports:
    """Keeps the reports of exchanges until they are published."""

    __slots__ = ("_unsettled", "reports")

    def __init__(self) -> None:
        self.reports: list[ExchangeReport] = []
        self._unsettled: tuple[Request, Job, PreparedTelegram, Result] | None = None

    def report(
        self,
        request: Request,
        job: Job,
        prepared: PreparedTelegram,
        result: Result,
        quarantined_s: float,
    ) -> None:
        """Keep the report of an exchange whose request is handled by the caller."""
        self._settle()
        self._keep(request, job, prepared, result, quarantined_s)

    def put_off(
        self, request: Request, job: Job, prepared: PreparedTelegram, result: Result
    ) -> None:
        """Keep a read that returned its value; `publish` settles it."""
        self._settle()
        self._unsettled = (request, job, prepared, result)

    def publish(self, observer: Observer) -> None:
        """Settle the postponed read and report each exchange to the observer."""
        self._settle()
        if not self.reports:
            return
        reports, self.reports = self.reports, []
        for report in reports:
            observer.exchange_ended(report)

    def _settle(self) -> None:
        if self._unsettled is None:
            return
        request, job, prepared, result = self._unsettled
        self._unsettled = None
        self._keep(request, job, prepared, result, 0.0)
        outcome = job.advance(result)
        assert outcome is not None, "a value ends a read"
        request.end(*outcome)

    def _keep(
        self,
        request: Request,
        job: Job,
        prepared: PreparedTelegram,
        result: Result,
        quarantined_s: float,
    ) -> None:
        station, step = job.station, job.step
        is_write = step.kind is StepKind.WRITE
        if result.thought_s is not None and result.clean:
            station.measured.note(
                step.code, prepared.documented_s, result.thought_s, result.ended_s, write=is_write
            )
        elif result.kind is ResultKind.NO_REPLY:
            station.measured.missed(step.code, result.ended_s, write=is_write)
        self.reports.append(
            ExchangeReport(
                request.drive,
                step,
                result,
                request.priority,
                result.started_s - request.submitted_at_s,
                quarantined_s,
                request.members,
                station.address,
                request.attempts,
            )
        )
