"""Runs one exchange after the other on an open port, driven by callbacks of the receive path.

Theory of operation. `start` sends the first telegram. After that each answer, time-out and timer
starts the next telegram, until the port is lost or `end` was called. When no exchange is under way,
`_go_on` checks in this order: is the turnaround over; is the quarantine over (only a stop may break
it); which request does the schedule give. If nothing may or need be sent, a timer is set for the
time when that changes; `nudge` ends it early.

The result of an exchange is published only after the next telegram was sent (`DeferredReports`):
bookkeeping then runs while a drive prepares its answer, and costs no time on the line. In the same
time the next request is chosen and its telegram prepared (`_look_ahead`). After a read that
returned its value that telegram is sent first (`_follow`). After any other result, that result is
evaluated first.

* An exchange receives the bytes and has one timer. When the timer fires, the port is read before
  the exchange is judged: the process may have been suspended, and an answer that lies in the kernel
  is in time. The port is also read when a timer fired late, before the next telegram is sent: a
  late answer could otherwise pass for the answer to that telegram.
* After a missing answer nothing is sent for 30 ms and twice the adapter's latency (quarantine).
  Bytes in that time are counted and dropped. For `late_answer` after the time-out the answer may
  still come: `late_answers` holds back only what it could seem to answer. A stop breaks a
  quarantine: it begins with EOT, which silences a drive, and it is verified by reading back.

Source of the timing rules: EDB2102EN 8.3.5.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Final

from lecombus.errors import LineLostError
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.protocol.exchange import Exchange, Result
from lecombus.fieldbus.loop_interface import (
    ExchangeReport,
    LateWakes,
    Observer,
    OpenConnection,
    ResultKind,
    WorkerOptions,
)
from lecombus.fieldbus.port import Port
from lecombus.fieldbus.requests import Job, StepKind
from lecombus.line.port_connection import StallWatch
from lecombus.line.timers import Deadline, WakeableTimer
from lecombus.schedule import Outcome, Priority, Request, Schedule

from ..protocol.telegrams import NakAnswer, ValueAnswer
from .idle_receive import BusIdleTimer, IdleReceive
from .jobs import MulticastJob, ReadBackJob, ReadJob, WriteJob
from .late_answers import Duplicates, PendingLateAnswers, UnansweredRead
from .prepared_telegrams import PreparedTelegram, TelegramPreparer
from .stop_job import StopJob
from .telegram_log import TelegramLog

__all__ = ["DeferredReports", "LecomExchangeLoop"]


class DeferredReports:
    """Keeps the reports of exchanges until they are published, after the next telegram was sent.

    A read that returned its value is settled only then, too. No client, stop or audit runs in
    between: sending and `publish` are one step of the event loop. At most one read is postponed,
    because only a read that returned its value cannot change what is sent next. The observer is
    called in the order of the exchanges, each time after the request ended.
    """

    __slots__ = ("_unsettled", "reports")

    def __init__(self) -> None:
        self.reports: list[ExchangeReport] = []
        self._unsettled: tuple[Request, Job, PreparedTelegram, Result, bool] | None = None

    def report(
        self,
        request: Request,
        job: Job,
        prepared: PreparedTelegram,
        result: Result,
        quarantined_s: float,
        may_be_anothers: bool,
    ) -> None:
        """Keep the report of an exchange whose request is handled by the caller."""
        self._settle()
        self._keep(request, job, prepared, result, quarantined_s, may_be_anothers)

    def put_off(
        self,
        request: Request,
        job: Job,
        prepared: PreparedTelegram,
        result: Result,
        may_be_anothers: bool,
    ) -> None:
        """Keep a read that returned its value; `publish` settles it."""
        self._settle()
        self._unsettled = (request, job, prepared, result, may_be_anothers)

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
        request, job, prepared, result, may_be_anothers = self._unsettled
        self._unsettled = None
        self._keep(request, job, prepared, result, 0.0, may_be_anothers)
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
        may_be_anothers: bool,
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
                may_be_anothers,
            )
        )


# Not the name of this module: users search and filter their logs by it.
logger = logging.getLogger("lecombus.line.exchange_loop")

LATE_S: Final = 0.002
"""If a timer fires later than this, bytes may have arrived that were not read yet, seconds."""

LOOK_AGAIN_S: Final = 0.2
"""A reading that is kept apart from other drives' may be given up before its pause comes: that is
checked so often, seconds."""

LONGEST_REST_S: Final = 1.0
"""An idle line checks the schedule at least this often; the count of checks is its heartbeat."""

PreparedStep = tuple[Request, Job, PreparedTelegram]
"""A request, its job, and the telegram of its next step."""


def _loop_time() -> float:
    """Return the time before `start` was called: a port may deliver bytes while it is opened."""
    return asyncio.get_running_loop().time()


class LecomExchangeLoop:
    """Sends telegrams and receives answers on the port of one line.

    Args:
        schedule: Gives the next request.
        timing: Baud rate and latencies for time-outs.
        options: Turnaround, echo, time-outs of the line.
        connection: The port.
        line: The line's name, for logs.
        observer: Is called for each event on the line.
        lateness: Records how late timers fired.

    Attributes:
        observer: As given; tests replace it.
        exchanges: Exchanges so far. rests: How often nothing was due.
        duplicates: Answers without a request, and who was asked last for each answer.
        exchange: The exchange on the line, or the last one.
        under_way: What it is for, while it lasts. ready: What is prepared to follow it.
    """

    def __init__(
        self,
        schedule: Schedule,
        timing: LineTiming,
        options: WorkerOptions,
        connection: OpenConnection,
        line: str,
        observer: Observer,
        lateness: LateWakes,
    ) -> None:
        self.observer = observer
        self.exchanges = self.rests = 0
        self._schedule = schedule
        self._options = options
        self._connection = connection
        self._log = TelegramLog(line) if logger.isEnabledFor(logging.DEBUG) else None
        self.duplicates = Duplicates(timing.char_s)
        self.second_answers = self.duplicates.found
        late_s = options.late_answer_s if options.quarantine else 0.0
        self._latency_s = timing.adapter_latency_s
        self._late_answers = PendingLateAnswers(late_s)
        self._preparer = TelegramPreparer(timing, self._late_answers, self.duplicates)
        self.exchange = Exchange(parity=True, echo=options.echo)
        self._deferred = DeferredReports()
        self._bus_idle = BusIdleTimer(options.turnaround_s)
        self._idle_receive = IdleReceive(
            schedule, self._bus_idle, self._late_answers, self.nudge, self.duplicates
        )
        self._stall = StallWatch(options.stall_s)
        self.under_way: PreparedStep | None = None
        self.ready: PreparedStep | None = None
        self._deadline = Deadline(self._on_deadline)
        self._pause = WakeableTimer(self._wake, lateness)
        self._ended: asyncio.Future[None] | None = None
        self._time: Callable[[], float] = _loop_time
        self._looked_s = 0.0  # when nothing lay in the port last
        self._ending = False
        self._nudged = False  # since the schedule was asked last

    # ---- what the worker calls ----------------------------------------------------------------

    def start(self, port: Port) -> asyncio.Future[None]:
        """Start on a port that was just opened.

        Returns:
            Done when the port is lost or `end` was called; raises the error that ended it.
        """
        loop = asyncio.get_running_loop()
        self._time = loop.time
        self.exchange = Exchange(parity=port.carries_parity, echo=self._options.echo)
        self._preparer.opened(parity=port.carries_parity)
        self._stall.opened()
        self._late_answers.port_opened(loop.time())
        self.duplicates.opened(loop.time())
        self._idle_receive.opened(loop.time(), self._latency_s, parity=port.carries_parity)
        self._ended = ended = loop.create_future()
        self._wake()
        return ended

    def end(self) -> None:
        """End after the exchange under way; call `nudge` to end an idle line."""
        self._ending = True

    def clear(self) -> None:
        """Cancel all timers: the port is gone."""
        self._pause.clear()
        self._deadline.clear()

    def nudge(self) -> None:
        """Check the schedule again: something changed in it."""
        self._nudged = True
        self._pause.nudge()

    def stop_came(self) -> None:
        """A stop was submitted: prepare its telegram for the end of the exchange under way."""
        if self.under_way is not None:
            self._hasten(*self.under_way)
            self._look_ahead(self._time())

    def _hasten(self, request: Request, job: Job, prepared: PreparedTelegram) -> None:
        """Shorten the time-out of a slow drive's reading to its manual's: a stop is waiting."""
        if prepared.documented_ask is None or job.step.kind is not StepKind.READ:
            return
        if request.priority is not Priority.STOP:
            self.exchange.hasten(prepared.documented_ask)
            self._deadline.set(self.exchange.deadline_s())

    # ---- what the port calls --------------------------------------------------------------------

    def received(self, data: bytes) -> None:
        """Process bytes from the port."""
        now = self._time()
        if self._log is not None:
            (self._log.unsolicited if self.under_way is None else self._log.heard)(data)
        if self.under_way is not None:
            result = self.exchange.feed(data, now, self._looked_s)
            if result is not None:
                self._end_exchange(result)
            elif self.exchange.disturbed:  # it waits for a gap: check for that
                self._deadline.set(self.exchange.look_s())
            return
        late = self._idle_receive.unsolicited(data, now, self._preparer.gap_s)
        self.observer.stray_bytes(data, late)

    def lost(self, exc: Exception | None) -> None:
        """Handle the loss of the port."""
        self._connection.note_loss(exc)
        if self.under_way is not None:
            self._end_exchange(self.exchange.lost(self._time()))
        elif self._pause.is_on:
            self._pause.clear()
            self._wake()

    # ---- between two exchanges ------------------------------------------------------------------

    def _wake(self) -> None:
        """Continue after a timer; an error ends the loop instead of vanishing in a callback."""
        try:
            if self._pause.late_s > LATE_S:
                self._stall.excuse(self._pause.late_s)
                self._look()
            self._go_on()
        except BaseException as exc:  # of any kind: in a callback it would vanish
            if not self._ends_by(exc):
                raise

    def _look(self) -> None:
        """Read what the kernel holds: a suspended process has not received it yet."""
        if self._connection.port is not None and not self._connection.is_lost:
            self._connection.port.look()

    def _ends_by(self, exc: BaseException) -> bool:
        """End the loop by an error of any kind: it must not vanish in a callback."""
        if self._ended is None or self._ended.done():
            return False
        self._ended.set_exception(exc)
        return True

    def _go_on(self) -> None:
        """Send the next telegram, or set the timer for when it may be sent."""
        while not self._ending and not self._connection.is_lost:
            now, self._nudged = self._time(), False
            if now < self._bus_idle.free_at_s:
                self._turn_round(now)
                return
            silent = now < self._bus_idle.quiet_until_s or self._idle_receive.is_on
            if silent and self._stay_quiet(now):
                return
            request = self._schedule.next(now)
            if request is None:
                self._rest(now)
                return
            self._say(request, now)
            if self.under_way is not None:
                return
        self._late_answers.port_lost(self._time())
        self._publish()
        if self._ended is not None and not self._ended.done():
            self._ended.set_result(None)

    def _turn_round(self, now: float) -> None:
        """Wait for the end of the turnaround; nothing shortens it."""
        self._publish()
        if not self._is_ready(self._bus_idle.free_at_s) and self._bus_idle.is_over(now):
            self._look_ahead(now)
        self._pause.until(self._bus_idle.free_at_s, deaf=True)

    def _stay_quiet(self, now: float) -> bool:
        """Wait for the end of quarantine or extended listen; False: it is over, or a stop goes."""
        stop_goes = self._schedule.stop_goes(now)
        look_at_s = self._idle_receive.quiet_until_s(now, stop_goes=stop_goes)
        if stop_goes or self._bus_idle.is_over(now):
            return False
        self._publish()
        self._pause.until(now if self._nudged else look_at_s)
        return True

    def _rest(self, now: float) -> None:
        """Nothing is due: wait, but not so long that an idle line looks stuck."""
        self._publish()  # a caller woken by the result finds it in the store
        self.rests += 1
        wake_at_s = now if self._nudged else self._schedule.wake_at_s(now)
        latest_s = now + LONGEST_REST_S
        self._pause.until(latest_s if wake_at_s is None else min(wake_at_s, latest_s))

    # ---- an exchange begins ---------------------------------------------------------------------

    def _say(self, request: Request, now: float) -> None:
        """Start the exchange of the next step of a request."""
        job: Job = request.work  # type: ignore[assignment]
        if request.is_outdated is not None:
            self._publish()  # the last exchange may have shown it
        unwanted = why_unwanted(request, job)
        if unwanted:
            self._withdraw(request, now, unwanted)
            return
        ready, self.ready = self.ready, None
        is_ready = ready is not None and ready[0] is request
        prepared = ready[2] if ready and is_ready else self._ask(request, job, now)
        if not isinstance(prepared, PreparedTelegram):
            self._postpone(request, prepared, now)
            return
        if request.cut_by_s:
            prepared = prepared.cut_by(request.cut_by_s)
        self.under_way = (request, job, prepared)
        self._begin(prepared, now, self._connection.say(prepared.ask.sent))

    def _ask(self, request: Request, job: Job, now: float) -> PreparedTelegram | float:
        """Prepare the telegram of the next step, or return the time before which it must wait."""
        if type(job) is not StopJob:
            prepared = self._preparer.ask(job, now, urgent=request.priority is Priority.STOP)
            if type(prepared) is float and isinstance(job, ReadBackJob | WriteJob):
                if job.waits_apart(now, self._preparer.late_until_s(job, now)):
                    return min(prepared, now + LOOK_AGAIN_S)
                prepared = self._preparer.ask(job, now, urgent=False)
            return prepared
        if job.asks_for_word:
            self._publish()  # the job uses the control word as of the last exchange
        prepared = self._preparer.ask(job, now, urgent=True)
        if not isinstance(prepared, PreparedTelegram):
            late_until_s = self._preparer.late_until_s(job, now)
            others_late = prepared > now + self._preparer.apart_s
            pause_s = job.instead_of_reading_s(now, late_until_s, others_late=others_late)
            if pause_s:
                return now + pause_s
            if pause_s is not None:
                if job.asks_for_word:
                    self._publish()
                prepared = self._preparer.ask(job, now, urgent=True)
        return (
            prepared
            if isinstance(prepared, PreparedTelegram)
            else min(prepared, now + LOOK_AGAIN_S)
        )

    def _begin(self, prepared: PreparedTelegram, now: float, loss: LineLostError | None) -> None:
        """Start the exchange of a telegram that was sent; then publish and look ahead."""
        self._looked_s = self._time()
        takes_nak = not self._late_answers.nak_may_come(now)
        self.exchange.begin(prepared.ask, now, self._looked_s, takes_nak=takes_nak)
        if loss is not None:
            self._connection.note_loss(loss)
            self._end_exchange(self.exchange.lost(now))
            return
        if self._log is not None and self.under_way is not None:
            self._log.sent(self.under_way[1], prepared.ask.sent)
        ask = prepared.ask
        if self.under_way is not None and ask.field:
            self.duplicates.asked(ask.field, self.under_way[1].station.name, now)
        self._deadline.set(self._looked_s + min(ask.late_s, ask.first_byte_s))
        self._publish()
        self._look_ahead(now)
        self.observer.thinking(prepared.thinking_s)

    def _look_ahead(self, now: float) -> None:
        """Choose the next request and prepare its telegram while nothing can be sent."""
        self.ready = None
        if self.under_way is None:
            request = self._schedule.look_ahead(None, now, max(now, self._bus_idle.free_at_s))
        else:
            under_way, started_s = self.under_way[0], self.exchange.started_s
            expected_s = started_s + under_way.cost_s - self._options.turnaround_s
            request = self._schedule.look_ahead(under_way, started_s, expected_s)
        if request is None:
            return
        job: Job = request.work  # type: ignore[assignment]
        by_result = request.is_outdated is not None or (type(job) is StopJob and job.asks_for_word)
        if by_result or self._late_answers.any(now):
            return  # depends on the result of the exchange under way
        if self.duplicates.came_once and job.step.apart:
            return  # its time counts from the end of the exchange under way
        prepared = self._preparer.ask(job, now, urgent=request.priority is Priority.STOP)
        if isinstance(prepared, PreparedTelegram):
            self.ready = (request, job, prepared)

    def _is_ready(self, at_s: float) -> bool:
        """Whether the prepared telegram is still the one to send."""
        return self.ready is not None and self._schedule.planned(at_s) is self.ready[0]

    def _withdraw(self, request: Request, now: float, why: str) -> None:
        """End a write that was chosen and not sent: no motor starts for a client that has left."""
        self.ready = None
        outcome = Outcome.SUPERSEDED if why == request.overtaken else Outcome.REFUSED
        self._schedule.defer(request, now, now)
        self._schedule.withdraw(request, outcome, why)

    def _postpone(self, request: Request, until_s: float, now: float) -> None:
        """Send it later: a late answer that could pass for its own may still come.

        A feed is ended instead, as a failed attempt: the watchdog still needs one, so the schedule
        would choose the same telegram again immediately.
        """
        if request.priority is not Priority.WATCHDOG:
            self._schedule.defer(request, until_s, now)
            return
        self._schedule.finished(request, now, now, reached=False)
        request.end(Outcome.REFUSED, "an old answer that could pass for its own may still come")

    # ---- an exchange ends -----------------------------------------------------------------------

    def _on_deadline(self) -> None:
        under_way = self.under_way
        if under_way is None:
            return
        now, look_s = self._time(), self.exchange.look_s()
        if now >= look_s:
            self._look()
            if self.under_way is not under_way:
                return  # the answer was in the kernel
            self._looked_s = now
            result = self.exchange.expire(now)
            if result is not None:
                self._end_exchange(result)
                return
            look_s = self.exchange.look_s()
        self._deadline.set(look_s)

    def _end_exchange(self, result: Result) -> None:
        """Evaluate the exchange and continue; an error ends the loop, not the callback."""
        done, self.under_way = self.under_way, None
        if done is None:
            return
        if self.duplicates.came_once and done[2].ask.field:
            self.duplicates.ended(done[2].ask.field, result.ended_s)
        if self._log is not None:
            self._log.ended(done[1], result)
        try:
            if not self._follow(done, result):
                self._conclude(*done, result)
                self._go_on()
        except BaseException as exc:  # of any kind: in a callback it would vanish
            if not self._ends_by(exc):
                raise

    def _follow(self, done: PreparedStep, result: Result) -> bool:
        """Send the prepared telegram before the result of the last exchange is evaluated.

        Only after a read that returned its value: that cannot change what is sent next.
        """
        ready = self.ready
        if ready is None or type(result.answer) is not ValueAnswer or type(done[1]) is not ReadJob:
            return False
        if why_unwanted(ready[0], ready[1]):
            return False
        now = self._time()
        if now < max(result.ended_s + self._options.turnaround_s, self._bus_idle.quiet_until_s):
            return False
        if self._ending or self._connection.is_lost or not self._is_ready(now):
            return False
        loss = self._connection.say(ready[2].ask.sent)
        self.ready = None
        if result.others:
            self._note_others(result)
        self.exchanges += 1
        self._bus_idle.exchange_ended(result.ended_s)
        self._heard()
        anothers = self.duplicates.came_once and self._may_be_anothers(done, result)
        self._deferred.put_off(*done, result, anothers)
        self._schedule.follow(done[0], result.started_s, result.ended_s, now)
        self.under_way = ready
        self._begin(ready[2], now, loss)
        return True

    def _conclude(
        self, request: Request, job: Job, prepared: PreparedTelegram, result: Result
    ) -> None:
        """Update schedule, late answers and job; report, and settle a read, after the next send."""
        ended = result.ended_s
        answered = result.kind is ResultKind.ANSWERED
        self.exchanges += 1
        if result.others:
            self._note_others(result)
        if type(result.answer) is not ValueAnswer:
            self.ready = None  # the result may change what is sent next: choose again
        quarantined_s = self._after(request, job, prepared, result)
        self._schedule.finished(request, result.started_s, ended + quarantined_s, answered)
        done = (request, job, prepared)
        anothers = self.duplicates.came_once and self._may_be_anothers(done, result)
        if type(result.answer) is ValueAnswer and type(job) is ReadJob:
            self._deferred.put_off(request, job, prepared, result, anothers)
            return
        self._deferred.report(request, job, prepared, result, quarantined_s, anothers)
        if prepared.hold_s and result.kind is not ResultKind.LOST:
            # The drive may have taken the write although its answer was damaged or missing.
            taken_s = ended if answered else min(ended, result.started_s + prepared.ask.late_s)
            self._schedule.hold(request.drive, taken_s + prepared.hold_s, ended)
        if type(job) is MulticastJob:
            for drive, hold_s in job.holds.items():
                self._schedule.hold(drive, ended + hold_s, ended)
        verdict = job.advance(result)
        if verdict is None:
            request.cut_outcome = job.cut_outcome
            behind, not_before_s = False, ended
            if type(job) is StopJob:
                behind, request.yields = job.goes_behind, job.yields
                request.worst_s = job.longest_s(request.worst_s)
                if job.pause_s:  # others may use the line only after the quarantine
                    not_before_s += quarantined_s + job.pause_s
            self._schedule.again(request, ended, not_before_s, behind=behind)
        else:
            request.end(*verdict)

    def _note_others(self, result: Result) -> None:
        """Record complete answers to other requests, unless such an answer is still missing."""
        for field in result.others:
            if self._late_answers.blocked_until_s(field, result.started_s) <= result.started_s:
                self.duplicates.came(field, result.ended_s)

    def _may_be_anothers(self, done: PreparedStep, result: Result) -> bool:
        """Whether a value may be another drive's; asked before the next telegram is sent."""
        if type(result.answer) is not ValueAnswer:
            return False
        field, name = done[2].ask.field, done[1].station.name
        return self.duplicates.may_be_anothers(field, name, result.started_s)

    def _after(
        self, request: Request, job: Job, prepared: PreparedTelegram, result: Result
    ) -> float:
        """Set when the line is free again; return the quarantine in seconds."""
        ended = result.ended_s
        self._bus_idle.exchange_ended(ended)
        if result.kind is ResultKind.ANSWERED:
            self._heard()
            if type(result.answer) is NakAnswer:
                self._late_answers.refused(prepared.ask.field, ended)
            self._late_answers.answered(prepared.ask.field, ended)
            return 0.0
        if result.kind is ResultKind.SENT:
            return 0.0
        sent_s = result.started_s + prepared.ask.request_s
        asked = UnansweredRead(job.station, job.step.code, sent_s)
        self._late_answers.add(prepared.ask.field, ended, asked)
        self.duplicates.unanswered(prepared.ask.field, job.station.name, ended)
        silent_s = self._stall.failed(result)
        if silent_s is not None:
            self._connection.reopen(
                f"no byte from any drive for {silent_s:.0f} s: the port is reopened"
            )
        if not self._options.quarantine or result.kind is ResultKind.LOST:
            return 0.0
        self._idle_receive.missed(request, job, prepared, result)
        return prepared.quarantine_s

    def _heard(self) -> None:
        if self._stall.answered():
            self._connection.settled()

    def _publish(self) -> None:
        self._deferred.publish(self.observer)


def why_unwanted(request: Request, job: Job) -> str:
    """Say why the next telegram of a request may not be sent any more; empty: it may.

    The step is looked at only where that depends on it: that of a stop is made at the first look,
    and must not be made before the last exchange is published (`_ask`).
    """
    depends = request.lease_ended is not None or bool(request.overtaken)
    writes = depends and job.step.kind is not StepKind.READ
    return request.why_unwanted(writes=writes)
