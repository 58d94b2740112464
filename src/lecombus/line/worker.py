"""The worker: it owns the port of one line for as long as the daemon lives.

Theory of operation. One task opens the port, runs the exchange loop of the protocol on it, and
opens it again, with backoff, whenever it was lost.

* Cancelling a caller never reaches the wire: callers wait on futures, the worker runs in a shield
  and ends only between two exchanges.
* When the port is lost every waiting request is ended immediately and nothing old is sent again.
"""

from __future__ import annotations

import asyncio

import anyio

from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.loop_interface import ExchangeLoop, ExchangeReport, Observer, WorkerOptions
from lecombus.fieldbus.port import PortOpener, PortSettings
from lecombus.fieldbus.protocols import Fieldbus

from ..errors import LineClosedError, LineLostError
from ..schedule import Priority, Request, Schedule
from .port_connection import PortConnection
from .timers import Lateness, WakeableSleep

__all__ = ["ExchangeReport", "LineWorker", "Observer", "WorkerOptions"]


class LineWorker:
    """Runs the exchanges of one line; create it, then keep `run` running in a task group.

    Args:
        fieldbus: The protocol.
        settings: The port to open.
        opener: Opens it.
        schedule: Gives the next request.
        timing: Baud rate and latencies for time-outs.
        options: Turnaround, echo, time-outs of the line.
        observer: Is called for each event on the line.

    Attributes:
        fieldbus: As given.
        exchange_loop: Sends telegrams and receives answers.
        lateness: How late the line was woken.
    """

    def __init__(
        self,
        fieldbus: Fieldbus,
        settings: PortSettings,
        opener: PortOpener,
        schedule: Schedule,
        timing: LineTiming,
        options: WorkerOptions,
        observer: Observer,
    ) -> None:
        self.fieldbus = fieldbus
        self.schedule = schedule
        self.lateness = Lateness()
        self._connection = PortConnection(settings, opener)
        self.exchange_loop: ExchangeLoop = fieldbus.exchange_loop(
            schedule, timing, options, self._connection, settings.line, observer, self.lateness
        )
        self._nap = WakeableSleep(self.lateness)
        self._retries = 0
        self._closing = False

    # ---- what others call -------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._connection.port is not None

    @property
    def exchanges(self) -> int:
        """Exchanges so far."""
        return self.exchange_loop.exchanges

    @property
    def rests(self) -> int:
        """How often it looked round with nothing to send, or without a port: its sign of life."""
        return self.exchange_loop.rests + self._retries

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
        if request.priority is Priority.STOP:
            self.exchange_loop.stop_came()
        self.exchange_loop.nudge()

    def nudge(self) -> None:
        """Look round: something changed in the schedule, or a lost port may be there again."""
        self.exchange_loop.nudge()
        self._nap.nudge()

    def close(self) -> None:
        """End after the exchange under way."""
        self._closing = True
        self.exchange_loop.end()
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

    # ---- the task ---------------------------------------------------------------------------

    async def _close_when_cancelled(self) -> None:
        try:
            await anyio.sleep_forever()
        finally:
            self.close()

    async def _work(self) -> None:
        loop = asyncio.get_running_loop()
        while not self._closing:
            if await self._connection.open(self.exchange_loop):
                if not await self._run_exchanges():
                    return
                self._line_lost()
            else:
                reason = self._connection.why_not()
                self.exchange_loop.observer.line_changed(False, reason)
                self.schedule.fail_all(loop.time(), reason)
            self._retries += 1
            # Also after a loss: a port may open well and fail at once, again and again.
            await self._nap.until(loop.time() + self._connection.backoff_s())
            self._retries += 1

    async def _run_exchanges(self) -> bool:
        """Run exchanges until the port is lost (True) or the worker is closed (False)."""
        port = self._connection.port
        assert port is not None
        self.exchange_loop.observer.line_changed(True, port.describe())
        await self.exchange_loop.start(port)
        return not self._closing

    def _line_lost(self) -> None:
        """End all that waits; a port that is opened again, for it was silent, keeps the stops."""
        reason = self._connection.why_not()
        self._connection.drop()
        self.exchange_loop.observer.line_changed(False, reason)
        self.schedule.fail_all(
            asyncio.get_running_loop().time(), reason, stops=not self._connection.is_reopened
        )

    def _end_all(self) -> None:
        """Close the port and end every waiting request."""
        self._closing = True
        self._connection.drop()
        self.exchange_loop.clear()
        self.schedule.fail_all(asyncio.get_running_loop().time(), "the line is being closed")
