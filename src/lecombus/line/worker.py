"""The worker: it owns the port and runs one exchange at a time, for as long as the daemon lives.

Theory of operation. One task goes round: is the line free (turnaround, quarantine), what does the
schedule want said, say it, wait for the answer or its deadline, tell the schedule and the job,
and only after the next telegram is out publish the result, so that bookkeeping runs while a drive
thinks and costs the line nothing. While it thinks the next choice is made and its telegram written
out (`_rehearse`); when a read's value has come that telegram goes out before anything else is
done about either (`_follow`). Whatever is out of the ordinary is concluded first.

* An exchange is one future that the receive path completes and one timer; a stall of the whole
  machine past a deadline does not lose an answer that is already in the kernel, because bytes are
  looked at before timers.
* After an exchange without its answer the line is left alone until it has been silent for the
  time in which the old answer could still come (quarantine); what comes then is counted and
  thrown away, and the doubt about it lives on in `doubts`. Only a stop breaks a quarantine: it
  begins with EOT, which silences a drive, and its acknowledgement is proven by reading back.
* Cancelling a caller never reaches the wire: callers wait on futures, the worker runs in a shield
  and ends only between two exchanges.
* When the port is lost every waiting request is ended at once and nothing old is sent again.

What must not live here: who goes first (schedule), what a result means (jobs), what is known
about the drives (store). Source of the timing rules: EDB2102EN 8.3.5.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

import anyio

from ..drives import LineTiming
from ..errors import LineClosedError, LineLostError
from ..protocol.exchange import Exchange, Result, ResultKind
from ..protocol.telegrams import ValueAnswer
from ..schedule import Outcome, Priority, Request, Schedule
from .aftermath import Aftermath
from .connection import Connection
from .doubts import Asked, Doubts
from .jobs import MulticastJob, ReadJob
from .listening import Listening
from .observer import ExchangeReport, Observer
from .options import WorkerOptions
from .port import PortOpener, PortSettings
from .questions import Question, Questions
from .silence import Silence
from .stall import StallWatch
from .station import Job
from .stop_job import StopJob
from .waits import Deadline, Lateness, Nap

__all__ = ["ExchangeReport", "LineWorker", "Observer", "WorkerOptions"]

logger = logging.getLogger(__name__)

LONGEST_REST_S = 1.0
"""An idle worker looks round at least this often: that is its sign of life."""


class LineWorker:
    """Runs the exchanges of one line; create it, then keep `run` running in a task group.

    Args:
        settings: The port to open.
        opener: Opens it.
        schedule: Says who speaks next.
        timing: Baud rate and latencies for time-outs.
        options: How the line is worked.
        observer: Told what happens.
    """

    def __init__(
        self,
        settings: PortSettings,
        opener: PortOpener,
        schedule: Schedule,
        timing: LineTiming,
        options: WorkerOptions,
        observer: Observer,
    ) -> None:
        self.schedule = schedule
        self.options = options
        self.exchanges = 0
        self.rests = 0
        self._observer = observer
        self._name = settings.line
        self._talkative = logger.isEnabledFor(logging.DEBUG)
        self._doubts = Doubts(options.late_answer_s if options.quarantine else 0.0)
        self._questions = Questions(timing, self._doubts)
        self._connection = Connection(settings, opener, self)
        self._exchange = Exchange(parity=True, echo=options.echo)
        self._aftermath = Aftermath()
        self._under_way: tuple[Request, Job, Question] | None = None
        self._ready: tuple[Request, Job, Question] | None = None
        self._run: asyncio.Future[None] | None = None
        self._pause: asyncio.TimerHandle | None = None
        self._deadline = Deadline(self._on_deadline)
        self.lateness = Lateness()
        self._nap = Nap(self.lateness)
        self._silence = Silence(options.turnaround_s)
        self._listening = Listening(schedule, self._silence, self._doubts, self.nudge)
        self._stall = StallWatch(options.stall_s)
        self._closing = False

    # ---- what others call -------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        """Whether there is a port to speak on."""
        return self._connection.port is not None

    def describe_port(self) -> str:
        """Name the port for people."""
        return self._connection.describe()

    def submit(self, request: Request) -> None:
        """Take a request; its end comes through `request.settle`.

        Raises:
            LineClosedError: The worker is shutting down.
            LineLostError: There is no port now; nothing is kept for later.
            QueueFullError: Too many wait already.
        """
        if self._closing:
            raise LineClosedError("the line is being closed: no more requests are taken")
        if self._connection.port is None:
            raise LineLostError(f"{self._connection.why_not()}: nothing was sent")
        self.schedule.submit(request, asyncio.get_running_loop().time())
        if request.priority is Priority.STOP and self._under_way is not None:
            self._hasten(*self._under_way)
            self._rehearse()
        self.nudge()

    def nudge(self) -> None:
        """Look at the schedule again: something changed in it."""
        self._nap.nudge()

    def close(self) -> None:
        """End after the exchange under way."""
        self._closing = True
        self.nudge()

    async def run(self) -> None:
        """Work the line until `close` is called or the task is cancelled."""
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._close_when_cancelled)
            with anyio.CancelScope(shield=True):
                try:
                    await self._work()
                finally:
                    self._end_all()
            tasks.cancel_scope.cancel()

    # ---- what the port calls ----------------------------------------------------------------

    def received(self, data: bytes) -> None:
        """Take bytes from the port."""
        now = asyncio.get_running_loop().time()
        if self._talkative:
            logger.debug("line=%s event=received bytes=%s", self._name, data.hex(" "))
        if self._under_way is not None:
            result = self._exchange.feed(data, now)
            if result is not None:
                self._end_exchange(result)
            return
        late = self._listening.stray(data, now, self._questions.gap_s)
        self._observer.stray_bytes(data, late)

    def lost(self, exc: Exception | None) -> None:
        """Take note that the port is gone."""
        self._connection.note_loss(exc)
        if self._under_way is not None:
            self._end_exchange(self._exchange.lost(asyncio.get_running_loop().time()))
        elif self._pause is not None:
            self._pause.cancel()
            self._guarded(self._go_on)
        self.nudge()

    def _end_all(self) -> None:
        """Close the port and leave nobody waiting."""
        self._closing = True
        self._connection.drop()
        self._deadline.clear()
        self.schedule.fail_all(asyncio.get_running_loop().time(), "the line is being closed")

    # ---- the loop ---------------------------------------------------------------------------

    async def _close_when_cancelled(self) -> None:
        try:
            await anyio.sleep_forever()
        finally:
            self.close()

    async def _work(self) -> None:
        loop = asyncio.get_running_loop()
        while not self._closing:
            if await self._open():
                if not await self._serve():
                    return
                self._line_lost()
            self.rests += 1
            # Also after a loss: a port may open well and fail at once, again and again.
            await self._nap.until(loop.time() + self._connection.backoff_s())
            self.rests += 1

    async def _open(self) -> bool:
        """Try to open the port once."""
        loop = asyncio.get_running_loop()
        if not await self._connection.open():
            self._observer.line_changed(False, self._connection.why_not())
            return False
        port = self._connection.port
        assert port is not None
        self._exchange = Exchange(parity=port.carries_parity, echo=self.options.echo)
        self._questions.parity = port.carries_parity
        self._stall.opened()
        self._listening.opened(loop.time(), parity=port.carries_parity)
        self._observer.line_changed(True, port.describe())
        return True

    def _line_lost(self) -> None:
        reason = self._connection.why_not()
        self._connection.drop()
        self._observer.line_changed(False, reason)
        self.schedule.fail_all(asyncio.get_running_loop().time(), reason)

    async def _serve(self) -> bool:
        """Run exchanges until the port is lost (True) or the worker is closed (False)."""
        loop = asyncio.get_running_loop()
        while not self._closing and not self._connection.is_lost:
            now = loop.time()
            silence = self._silence
            silent = now < silence.free_at_s or now < silence.quiet_until_s or self._listening.is_on
            if silent and await self._stay_quiet(now):
                continue
            if self._say_next(now):
                await self._run_ends()
            else:
                self._publish()
                await self._rest(now)
        self._publish()
        return not self._closing

    async def _run_ends(self) -> None:
        """Wait while one exchange follows the other."""
        if self._under_way is None and self._pause is None:
            return
        self._run = asyncio.get_running_loop().create_future()
        try:
            await self._run
        finally:
            self._run = None

    async def _rest(self, now: float) -> None:
        """Nothing is due: sleep, but not so long that an idle line looks like a stuck one."""
        self.rests += 1
        wake_at = self.schedule.wake_at_s(now)
        latest = now + LONGEST_REST_S
        await self._nap.until(latest if wake_at is None else min(wake_at, latest))

    async def _stay_quiet(self, now: float) -> bool:
        """Keep the turnaround, and the quarantine unless a stop goes now; True: ask again."""
        self._publish()
        if now < self._silence.free_at_s:
            await self._nap.until(self._silence.free_at_s, deaf=True)
            return True
        stop_goes = self.schedule.stop_goes(now)
        look_at_s = self._listening.quiet_until_s(now, stop_goes=stop_goes)
        if stop_goes or self._silence.is_over(now):
            return False
        await self._nap.until(look_at_s)
        return True

    # ---- one exchange after the other, without leaving the receive path ---------------------

    def _say_next(self, now: float) -> bool:
        """Begin what the schedule wants said, if it wants anything; False: it does not."""
        request = self.schedule.next(now)
        if request is None:
            return False
        self._say(request, now)
        return True

    def _say(self, request: Request, now: float) -> None:
        """Begin the next step of a request as one exchange."""
        job: Job = request.work  # type: ignore[assignment]
        ready, self._ready = self._ready, None
        is_ready = ready is not None and ready[0] is request
        question = ready[2] if ready and is_ready else self._ask(request, job, now)
        if not isinstance(question, Question):
            self._postpone(request, question, now)
            return
        self._under_way = (request, job, question)
        self._begin(question, now, self._connection.say(question.ask.sent))

    def _ask(self, request: Request, job: Job, now: float) -> Question | float:
        """Put the next step of a request into a telegram; or the time before which it must not."""
        if type(job) is not StopJob:
            return self._questions.ask(job, now, urgent=request.priority is Priority.STOP)
        if job.asks_for_word:
            self._publish()  # it takes the control word as the last exchange left it
        question = self._questions.ask(job, now, urgent=True)
        if type(question) is float and job.cannot_read():
            question = self._questions.ask(job, now, urgent=True)
        return question

    def _rehearse(self) -> None:
        """Choose the next request, and write out its telegram, while nothing can be sent."""
        self._ready = None
        now = asyncio.get_running_loop().time()
        if self._under_way is None:
            request = self.schedule.rehearse(None, now, max(now, self._silence.free_at_s))
        else:
            under_way, started_s = self._under_way[0], self._exchange.started_s
            expected_s = started_s + under_way.cost_s - self.options.turnaround_s
            request = self.schedule.rehearse(under_way, started_s, expected_s)
        if request is None:
            return
        job: Job = request.work  # type: ignore[assignment]
        if (type(job) is StopJob and job.asks_for_word) or self._doubts.any(now):
            return  # that depends on what the exchange under way brings
        question = self._questions.ask(job, now, urgent=request.priority is Priority.STOP)
        if isinstance(question, Question):
            self._ready = (request, job, question)

    def _hasten(self, request: Request, job: Job, question: Question) -> None:
        """Wait for a slow drive's reading no longer than its manual says: a stop is there."""
        if question.in_haste is not None and request.priority is not Priority.STOP:
            self._exchange.hasten(question.in_haste)
            self._deadline.set(self._exchange.deadline_s())

    def _is_ready(self, at_s: float) -> bool:
        """Whether the telegram that was written out is the one to be said at that time."""
        return self._ready is not None and self.schedule.foreseen(at_s) is self._ready[0]

    def _follow(self, request: Request, job: Job, question: Question, result: Result) -> bool:
        """Say what was made ready, and only then look at what the exchange before it brought.

        Only after a read that brought its value, for that changes nothing about what comes next.
        """
        ready, now = self._ready, asyncio.get_running_loop().time()
        free_at_s = max(result.ended_s + self.options.turnaround_s, self._silence.quiet_until_s)
        if ready is None or now < free_at_s or self._closing or self._connection.is_lost:
            return False
        plain = type(result.answer) is ValueAnswer and type(job) is ReadJob
        if not plain or not self._is_ready(now):
            return False
        loss = self._connection.say(ready[2].ask.sent)
        self._ready = None
        self.exchanges += 1
        self._silence.exchange_ended(result.ended_s)
        self._heard()
        self._aftermath.put_off(request, job, question, result)
        self.schedule.follow(request, result.started_s, result.ended_s, now)
        self._under_way = ready
        self._begin(ready[2], now, loss)
        return True

    def _end_exchange(self, result: Result) -> None:
        """Conclude the exchange under way and go on; an error ends the worker, not a callback."""
        if self._under_way is None:
            return
        (request, job, question), self._under_way = self._under_way, None

        def conclude_and_go_on() -> None:
            if not self._follow(request, job, question, result):
                self._conclude(request, job, question, result)
                self._go_on()

        self._guarded(conclude_and_go_on)

    def _guarded(self, act: Callable[[], None]) -> None:
        try:
            act()
        except BaseException as exc:  # whatever it is, it must end the worker and not vanish
            if self._run is None or self._run.done():
                raise
            self._run.set_exception(exc)

    def _go_on(self) -> None:
        """Say the next thing at once where the line is free; else leave it to the worker's task."""
        loop = asyncio.get_running_loop()
        now = loop.time()
        if self._pause is not None:
            self.lateness.note(now - self._pause.when())
        self._pause = None
        if not self._closing and not self._connection.is_lost and self._silence.is_over(now):
            if now < self._silence.free_at_s:
                self._publish()
                if not self._is_ready(self._silence.free_at_s):
                    self._rehearse()
                self._pause = loop.call_at(self._silence.free_at_s, self._guarded, self._go_on)
                return
            self._say_next(now)
        if self._under_way is None:
            self._publish()  # before whoever waited for the result looks for it in the books
            if self._run is not None and not self._run.done():
                self._run.set_result(None)

    def _postpone(self, request: Request, until_s: float, now: float) -> None:
        """Say it later: an old answer that could pass for its own may still come.

        A feed ends instead, as a vain attempt: it is not the request that must wait but the need,
        for which the schedule would at once find the same telegram again.
        """
        if request.priority is not Priority.WATCHDOG:
            self.schedule.defer(request, until_s, now)
            return
        self.schedule.finished(request, now, now, reached=False)
        request.end(Outcome.REFUSED, "an old answer that could pass for its own may still come")

    def _begin(self, question: Question, now: float, loss: LineLostError | None) -> None:
        """Begin the exchange of a telegram that was handed over, and use the time it takes."""
        self._exchange.begin(question.ask, now)
        if loss is not None:
            self._connection.note_loss(loss)
            self._end_exchange(self._exchange.lost(now))
            return
        if self._talkative:
            logger.debug("line=%s event=sent bytes=%s", self._name, question.ask.sent.hex(" "))
        self._deadline.set(self._exchange.deadline_s())
        self._publish()
        self._rehearse()
        self._observer.thinking(question.thinking_s)

    def _on_deadline(self) -> None:
        if self._under_way is None:
            return
        result = self._exchange.expire(asyncio.get_running_loop().time())
        if result is None:
            self._deadline.set(self._exchange.deadline_s())
        else:
            self._end_exchange(result)

    def _conclude(self, request: Request, job: Job, question: Question, result: Result) -> None:
        """Tell schedule, doubts and job; the observer is told after the next telegram.

        A read that brought its value has nothing more to say: it is settled after that, too.
        """
        ended = result.ended_s
        answered = result.kind is ResultKind.ANSWERED
        self.exchanges += 1
        if type(result.answer) is not ValueAnswer:
            self._ready = None  # a doubt, an echo, a lost line: look at it anew
        quarantined_s = self._after(request, job, question, result)
        self.schedule.finished(request, result.started_s, ended + quarantined_s, answered)
        if type(result.answer) is ValueAnswer and type(job) is ReadJob:
            self._aftermath.put_off(request, job, question, result)
            return
        self._aftermath.report(request, job, question, result, quarantined_s)
        if question.hold_s and answered:
            self.schedule.hold(request.drive, ended + question.hold_s, ended)
        if type(job) is MulticastJob:
            for drive, hold_s in job.holds.items():
                self.schedule.hold(drive, ended + hold_s, ended)
        verdict = job.advance(result)
        if verdict is None:
            request.cut_outcome = job.cut_outcome
            behind, not_before_s = False, ended
            if type(job) is StopJob:
                behind = job.goes_behind
                if job.pause_s:  # others have it only when the silence is over
                    not_before_s += quarantined_s + job.pause_s
            self.schedule.again(request, ended, not_before_s, behind=behind)
        else:
            request.end(*verdict)

    def _after(self, request: Request, job: Job, question: Question, result: Result) -> float:
        """Set from when the line is free again; returns the quarantine in seconds."""
        ended = result.ended_s
        self._silence.exchange_ended(ended)
        if result.kind is ResultKind.ANSWERED:
            self._heard()
            self._doubts.answered(question.ask.field, ended)
            return 0.0
        if result.kind is ResultKind.SENT:
            return 0.0
        asked = Asked(job.station, job.step.code, result.started_s + question.ask.request_s)
        self._doubts.add(question.ask.field, ended, asked)
        silent_s = self._stall.failed(result)
        if silent_s is not None:
            self._connection.note_loss(
                LineLostError(f"no byte from any drive for {silent_s:.0f} s: the port is reopened")
            )
        if not self.options.quarantine or result.kind is ResultKind.LOST:
            return 0.0
        self._listening.missed(request, job, question, result)
        return question.quarantine_s

    def _heard(self) -> None:
        if self._stall.answered():
            self._connection.settled()

    def _publish(self) -> None:
        self._aftermath.publish(self._observer)
