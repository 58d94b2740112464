"""One exchange after the other on an open port, without ever leaving the receive path.

Theory of operation. `start` says the first thing, and from then on every answer, deadline and pause
leads to the next telegram by itself, until the port is lost or the talk is to end. Whenever nothing
is under way `_go_on` asks, in this order: is the turnaround over, is the line silent again (only a
stop breaks that), what does the schedule want said; where nothing may or need be said yet it comes
back at the time when that changes, or when nudged.

Only after the next telegram is out the result of the one before is published, so that bookkeeping
runs while a drive thinks and costs the line nothing. While it thinks the next choice is made and
its telegram written out (`_look_ahead`); when a read's value has come that telegram goes out before
anything else is done about either (`_follow`). Whatever is out of the ordinary is concluded first.

* An exchange is fed by the receive path and watched by one timer. When that fires the port is
  looked at before anything is judged: the process may not have been run for a while, and an answer
  that lies in the kernel is in time. It is looked at, too, when a pause ended late, before the next
  telegram goes out: an old answer that came meanwhile could be taken for that telegram's.
* After an exchange without its answer the line is left alone until it has been silent for the time
  in which the old answer could still come (quarantine); what comes then is counted and thrown away,
  and the doubt about it lives on in `late_replies`. A stop breaks a quarantine: it begins with EOT,
  which silences a drive, and its acknowledgement is proven by reading back.

What must not live here: opening and losing ports (worker), who goes first (schedule), what a
result means (jobs), what is known about the drives (store).
Source of the timing rules: EDB2102EN 8.3.5.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Final

from ..drives import LineTiming
from ..errors import LineLostError
from ..protocol.exchange import Exchange, Result, ResultKind
from ..protocol.telegrams import NakAnswer, ValueAnswer
from ..schedule import Outcome, Priority, Request, Schedule
from ..schedule.request import CLIENT_GONE
from .bus_idle import BusIdleTimer
from .deferred_reports import DeferredReports
from .duplicates import Duplicates
from .idle_receive import IdleReceive
from .jobs import MulticastJob, ReadJob
from .late_replies import PendingLateReplies, UnansweredRead
from .observer import Observer
from .options import WorkerOptions
from .port import Port
from .port_connection import PortConnection
from .prepared_telegrams import PreparedTelegram, TelegramPreparer
from .stall import StallWatch
from .station import Job
from .stop_job import StopJob
from .telegram_log import TelegramLog
from .timers import Deadline, Lateness, WakeableTimer

__all__ = ["ExchangeLoop"]

logger = logging.getLogger(__name__)

LATE_S: Final = 0.002
"""A pause that ended so much too late may have let bytes come unseen, seconds."""

LONGEST_REST_S: Final = 1.0
"""Who has nothing to say looks round at least this often: that is its sign of life."""

PreparedStep = tuple[Request, Job, PreparedTelegram]
"""A request, what it knows of the protocol, and the telegram of its next step."""


def _loop_time() -> float:
    """Tell the time where `start` has not come yet: a port may give bytes while it is opened."""
    return asyncio.get_running_loop().time()


class ExchangeLoop:
    """Speaks and listens on the port of one line.

    Args:
        schedule: Says who speaks next.
        timing: Baud rate and latencies for time-outs.
        options: How the line is worked.
        connection: The port.
        line: The line's name, for logs.
        observer: Told what happens.
        lateness: Told how late it was woken.

    Attributes:
        observer: As given; tests put themselves in its place.
        exchanges: Exchanges so far.
        rests: How often there was nothing to say.
        duplicates: Answers that nobody asked for, and whom answers were asked of.
    """

    def __init__(
        self,
        schedule: Schedule,
        timing: LineTiming,
        options: WorkerOptions,
        connection: PortConnection,
        line: str,
        observer: Observer,
        lateness: Lateness,
    ) -> None:
        self.observer = observer
        self.exchanges = 0
        self.rests = 0
        self._schedule = schedule
        self._options = options
        self._connection = connection
        self._telegram_log = TelegramLog(line) if logger.isEnabledFor(logging.DEBUG) else None
        self.duplicates = Duplicates()
        self._late_replies = PendingLateReplies(
            options.late_answer_s if options.quarantine else 0.0
        )
        self._preparer = TelegramPreparer(timing, self._late_replies)
        self._exchange = Exchange(parity=True, echo=options.echo)
        self._deferred = DeferredReports()
        self._bus_idle = BusIdleTimer(options.turnaround_s)
        self._idle_receive = IdleReceive(
            schedule, self._bus_idle, self._late_replies, self.nudge, self.duplicates
        )
        self._stall = StallWatch(options.stall_s)
        self._under_way: PreparedStep | None = None
        self._ready: PreparedStep | None = None
        self._deadline = Deadline(self._on_deadline)
        self._pause = WakeableTimer(self._wake, lateness)
        self._ended: asyncio.Future[None] | None = None
        self._time: Callable[[], float] = _loop_time
        self._looked_s = 0.0  # when nothing lay in the port last
        self._ending = False
        self._nudged = False  # since the schedule was asked last

    # ---- what the worker calls ----------------------------------------------------------------

    def start(self, port: Port) -> asyncio.Future[None]:
        """Talk on a port that was opened just now.

        Returns:
            Done when the port is lost or the talk was to end; an error in it ends it as well.
        """
        loop = asyncio.get_running_loop()
        self._time = loop.time
        self._exchange = Exchange(parity=port.carries_parity, echo=self._options.echo)
        self._preparer.parity = port.carries_parity
        self._stall.opened()
        self._idle_receive.opened(loop.time(), parity=port.carries_parity)
        self._ended = ended = loop.create_future()
        self._wake()
        return ended

    def end(self) -> None:
        """End after the exchange under way, or when nudged."""
        self._ending = True

    def clear(self) -> None:
        """Call back no more: the port is gone."""
        self._pause.clear()
        self._deadline.clear()

    def nudge(self) -> None:
        """Look at the schedule again: something changed in it."""
        self._nudged = True
        self._pause.nudge()

    def stop_came(self) -> None:
        """A stop was submitted: have its telegram ready when the exchange under way ends."""
        if self._under_way is not None:
            self._hasten(*self._under_way)
            self._look_ahead(self._time())

    def _hasten(self, request: Request, job: Job, prepared: PreparedTelegram) -> None:
        """Wait for a slow drive's reading no longer than its manual says: a stop is there."""
        if prepared.documented_ask is not None and request.priority is not Priority.STOP:
            self._exchange.hasten(prepared.documented_ask)
            self._deadline.set(self._exchange.deadline_s())

    # ---- what the port calls --------------------------------------------------------------------

    def received(self, data: bytes) -> None:
        """Take bytes from the port."""
        now = self._time()
        if self._telegram_log is not None:
            (self._telegram_log.stray if self._under_way is None else self._telegram_log.heard)(
                data
            )
        if self._under_way is not None:
            result = self._exchange.feed(data, now, self._looked_s)
            if result is not None:
                self._end_exchange(result)
            elif self._exchange.disturbed:  # until there was a pause: look for that
                self._deadline.set(self._exchange.look_s())
            return
        late = self._idle_receive.stray(data, now, self._preparer.gap_s)
        self.observer.stray_bytes(data, late)

    def lost(self, exc: Exception | None) -> None:
        """Take note that the port is gone."""
        self._connection.note_loss(exc)
        if self._under_way is not None:
            self._end_exchange(self._exchange.lost(self._time()))
        elif self._pause.is_on:
            self._pause.clear()
            self._wake()

    # ---- between two exchanges ------------------------------------------------------------------

    def _wake(self) -> None:
        """Go on after a pause; an error ends the talk, not a callback."""
        try:
            if self._pause.late_s > LATE_S:
                self._stall.excuse(self._pause.late_s)
                self._look()
            self._go_on()
        except BaseException as exc:
            if not self._ends_by(exc):
                raise

    def _look(self) -> None:
        """Take what lies in the port: a process that was not run has not been given it yet."""
        if self._connection.port is not None and not self._connection.is_lost:
            self._connection.port.look()

    def _ends_by(self, exc: BaseException) -> bool:
        """End the talk by an error, whatever it is: it must not vanish in a callback."""
        if self._ended is None or self._ended.done():
            return False
        self._ended.set_exception(exc)
        return True

    def _go_on(self) -> None:
        """Say what comes next, or come back when it may be said."""
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
            if self._under_way is not None:
                return
        self._publish()
        if self._ended is not None and not self._ended.done():
            self._ended.set_result(None)

    def _turn_round(self, now: float) -> None:
        """Leave the drives their turnaround, whatever comes."""
        self._publish()
        if not self._is_ready(self._bus_idle.free_at_s) and self._bus_idle.is_over(now):
            self._look_ahead(now)
        self._pause.until(self._bus_idle.free_at_s, deaf=True)

    def _stay_quiet(self, now: float) -> bool:
        """Keep the quarantine, or listen for longer, unless a stop goes now; False: it is over."""
        stop_goes = self._schedule.stop_goes(now)
        look_at_s = self._idle_receive.quiet_until_s(now, stop_goes=stop_goes)
        if stop_goes or self._bus_idle.is_over(now):
            return False
        self._publish()
        self._pause.until(now if self._nudged else look_at_s)
        return True

    def _rest(self, now: float) -> None:
        """Nothing is due: wait, but not so long that an idle line looks like a stuck one."""
        self._publish()  # before whoever waited for the result looks for it in the books
        self.rests += 1
        wake_at_s = now if self._nudged else self._schedule.wake_at_s(now)
        latest_s = now + LONGEST_REST_S
        self._pause.until(latest_s if wake_at_s is None else min(wake_at_s, latest_s))

    # ---- an exchange begins ---------------------------------------------------------------------

    def _say(self, request: Request, now: float) -> None:
        """Begin the next step of a request as one exchange."""
        if request.is_unwanted:
            self._withdraw(request, now)
            return
        job: Job = request.work  # type: ignore[assignment]
        ready, self._ready = self._ready, None
        is_ready = ready is not None and ready[0] is request
        prepared = ready[2] if ready and is_ready else self._ask(request, job, now)
        if not isinstance(prepared, PreparedTelegram):
            self._postpone(request, prepared, now)
            return
        if request.cut_by_s:
            prepared = prepared.cut_by(request.cut_by_s)
        self._under_way = (request, job, prepared)
        self._begin(prepared, now, self._connection.say(prepared.ask.sent))

    def _ask(self, request: Request, job: Job, now: float) -> PreparedTelegram | float:
        """Put the next step of a request into a telegram; or the time before which it must not."""
        if type(job) is not StopJob:
            return self._preparer.ask(job, now, urgent=request.priority is Priority.STOP)
        if job.asks_for_word:
            self._publish()  # it takes the control word as the last exchange left it
        prepared = self._preparer.ask(job, now, urgent=True)
        if type(prepared) is float and job.cannot_read():
            prepared = self._preparer.ask(job, now, urgent=True)
        return prepared

    def _begin(self, prepared: PreparedTelegram, now: float, loss: LineLostError | None) -> None:
        """Begin the exchange of a telegram that was handed over, and use the time it takes."""
        self._looked_s = self._time()
        takes_nak = not self._late_replies.nak_may_come(now)
        self._exchange.begin(prepared.ask, now, self._looked_s, takes_nak=takes_nak)
        if loss is not None:
            self._connection.note_loss(loss)
            self._end_exchange(self._exchange.lost(now))
            return
        if self._telegram_log is not None and self._under_way is not None:
            self._telegram_log.sent(self._under_way[1], prepared.ask.sent)
        ask = prepared.ask
        if self._under_way is not None and ask.field:
            self.duplicates.asked(ask.field, self._under_way[1].station.name, now)
        self._deadline.set(self._looked_s + min(ask.late_s, ask.first_byte_s))
        self._publish()
        self._look_ahead(now)
        self.observer.thinking(prepared.thinking_s)

    def _look_ahead(self, now: float) -> None:
        """Choose the next request, and write out its telegram, while nothing can be sent."""
        self._ready = None
        if self._under_way is None:
            request = self._schedule.look_ahead(None, now, max(now, self._bus_idle.free_at_s))
        else:
            under_way, started_s = self._under_way[0], self._exchange.started_s
            expected_s = started_s + under_way.cost_s - self._options.turnaround_s
            request = self._schedule.look_ahead(under_way, started_s, expected_s)
        if request is None:
            return
        job: Job = request.work  # type: ignore[assignment]
        if (type(job) is StopJob and job.asks_for_word) or self._late_replies.any(now):
            return  # that depends on what the exchange under way brings
        prepared = self._preparer.ask(job, now, urgent=request.priority is Priority.STOP)
        if isinstance(prepared, PreparedTelegram):
            self._ready = (request, job, prepared)

    def _is_ready(self, at_s: float) -> bool:
        """Whether the telegram that was written out is the one to be said at that time."""
        return self._ready is not None and self._schedule.planned(at_s) is self._ready[0]

    def _withdraw(self, request: Request, now: float) -> None:
        """End a write that was chosen and not sent: no motor starts for a client that has left."""
        self._ready = None
        self._schedule.defer(request, now, now)
        self._schedule.withdraw(request, Outcome.REFUSED, CLIENT_GONE)

    def _postpone(self, request: Request, until_s: float, now: float) -> None:
        """Say it later: an old answer that could pass for its own may still come.

        A feed ends instead, as a vain attempt: it is not the request that must wait but the need,
        for which the schedule would at once find the same telegram again.
        """
        if request.priority is not Priority.WATCHDOG:
            self._schedule.defer(request, until_s, now)
            return
        self._schedule.finished(request, now, now, reached=False)
        request.end(Outcome.REFUSED, "an old answer that could pass for its own may still come")

    # ---- an exchange ends -----------------------------------------------------------------------

    def _on_deadline(self) -> None:
        saying = self._under_way
        if saying is None:
            return
        now, look_s = self._time(), self._exchange.look_s()
        if now >= look_s:
            self._look()
            if self._under_way is not saying:
                return  # its answer lay there
            self._looked_s = now
            result = self._exchange.expire(now)
            if result is not None:
                self._end_exchange(result)
                return
            look_s = self._exchange.look_s()
        self._deadline.set(look_s)

    def _end_exchange(self, result: Result) -> None:
        """Conclude the exchange under way and go on; an error ends the talk, not a callback."""
        done, self._under_way = self._under_way, None
        if done is None:
            return
        if self._telegram_log is not None:
            self._telegram_log.ended(done[1], result)
        try:
            if not self._follow(done, result):
                self._conclude(*done, result)
                self._go_on()
        except BaseException as exc:
            if not self._ends_by(exc):
                raise

    def _follow(self, done: PreparedStep, result: Result) -> bool:
        """Say what was made ready, and only then look at what the exchange before it brought.

        Only after a read that brought its value, for that changes nothing about what comes next.
        """
        ready = self._ready
        if ready is None or type(result.answer) is not ValueAnswer or type(done[1]) is not ReadJob:
            return False
        if ready[0].is_unwanted:
            return False
        now = self._time()
        if now < max(result.ended_s + self._options.turnaround_s, self._bus_idle.quiet_until_s):
            return False
        if self._ending or self._connection.is_lost or not self._is_ready(now):
            return False
        loss = self._connection.say(ready[2].ask.sent)
        self._ready = None
        if result.others:
            self._note_others(result)
        self.exchanges += 1
        self._bus_idle.exchange_ended(result.ended_s)
        self._heard()
        self._deferred.put_off(*done, result)
        self._schedule.follow(done[0], result.started_s, result.ended_s, now)
        self._under_way = ready
        self._begin(ready[2], now, loss)
        return True

    def _conclude(
        self, request: Request, job: Job, prepared: PreparedTelegram, result: Result
    ) -> None:
        """Tell schedule, doubts and job; the observer is told after the next telegram.

        A read that brought its value has nothing more to say: it is settled after that, too.
        """
        ended = result.ended_s
        answered = result.kind is ResultKind.ANSWERED
        self.exchanges += 1
        if result.others:
            self._note_others(result)
        if type(result.answer) is not ValueAnswer:
            self._ready = None  # a doubt, an echo, a lost line: look at it anew
        quarantined_s = self._after(request, job, prepared, result)
        self._schedule.finished(request, result.started_s, ended + quarantined_s, answered)
        if type(result.answer) is ValueAnswer and type(job) is ReadJob:
            self._deferred.put_off(request, job, prepared, result)
            return
        self._deferred.report(request, job, prepared, result, quarantined_s)
        if prepared.hold_s and result.kind is not ResultKind.LOST:
            # Its acknowledgement may have come though it was not understood, or not heard at all.
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
                behind, request.yields = job.goes_behind, job.only_proves
                if job.pause_s:  # others have it only when the silence is over
                    not_before_s += quarantined_s + job.pause_s
            self._schedule.again(request, ended, not_before_s, behind=behind)
        else:
            request.end(*verdict)

    def _note_others(self, result: Result) -> None:
        """Take note of whole answers to something else, unless one of them is missing."""
        for field in result.others:
            if self._late_replies.blocked_until_s(field, result.started_s) <= result.started_s:
                self.duplicates.came(field, result.ended_s)

    def _after(
        self, request: Request, job: Job, prepared: PreparedTelegram, result: Result
    ) -> float:
        """Set from when the line is free again; returns the quarantine in seconds."""
        ended = result.ended_s
        self._bus_idle.exchange_ended(ended)
        if result.kind is ResultKind.ANSWERED:
            self._heard()
            if type(result.answer) is NakAnswer:
                self._late_replies.refused(prepared.ask.field, ended)
            self._late_replies.answered(prepared.ask.field, ended)
            return 0.0
        if result.kind is ResultKind.SENT:
            return 0.0
        asked = UnansweredRead(
            job.station, job.step.code, result.started_s + prepared.ask.request_s
        )
        self._late_replies.add(prepared.ask.field, ended, asked)
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
