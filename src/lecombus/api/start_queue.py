"""When the work of a request begins: one at a time, and over TCP in a share of the processor time.

The event loop runs all that is ready before it looks at its descriptors again. A hundred requests
that came together would thus be answered in one go: some thirty milliseconds in which no byte of a
drive is taken and no telegram sent. So one request begins in each turn of the loop (`StartQueue`).

TCP answers reads to any program on this machine. A flood of requests there must not take the time
in which the line is served. So all work for TCP clients begins here piece by piece, one client
after the other, and after a piece nothing begins until `1 / PART` times its processor time has
passed (`CpuShare`). The time is that of this thread: while the machine runs something else it does
not count. Steps of requests under way are measured as well (`TimedCoroutine`).

What must not live here: which requests do not wait (`connection`), what a piece is
(`tcp_connection`).
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Coroutine, Generator
from typing import Any, Final, Self

from starlette.types import ASGIApp, Receive, Scope, Send

__all__ = ["PART", "CpuShare", "StartQueue", "TimedApp", "TimedCoroutine"]

PART: Final = 0.2

LONGEST_REST_S: Final = 1.0
"""After the longest piece too, so that each client gets its turn."""


class StartQueue:
    """Begins one piece of work in each turn of the event loop, first come first served."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], None]] = deque()
        self._is_called = False

    def take(self, begin: Callable[[], None]) -> None:
        """Begin something now if nothing waits, else in its turn."""
        if self._is_called:
            self._waiting.append(begin)
            return
        self._call()
        begin()

    def _call(self) -> None:
        self._is_called = True
        asyncio.get_running_loop().call_soon(self._next)

    def _next(self) -> None:
        self._is_called = False
        if self._waiting:
            begin = self._waiting.popleft()
            self._call()
            begin()


class CpuShare:
    """Begins one piece after the other, and rests in between.

    Args:
        part: How much of the loop's time all pieces together may take, 0 to 1.
        clock: The processor time of this thread, seconds.
    """

    def __init__(self, part: float = PART, clock: Callable[[], float] = time.thread_time) -> None:
        self._part = part
        self._clock = clock
        self._waiting: dict[object, deque[Callable[[], None]]] = {}  # by client, the next one first
        self._free_at_s = 0.0  # by the loop's clock
        self._called: asyncio.Handle | None = None

    def take(self, client: object, begin: Callable[[], None]) -> None:
        """Begin something for a client in its turn, never before this returns."""
        self._waiting.setdefault(client, deque()).append(begin)
        if self._called is None:
            self._call()

    def forget(self, client: object) -> None:
        """Begin nothing more for a client that is gone: many of them would fill the memory."""
        self._waiting.pop(client, None)

    def spend(self, seconds: float) -> None:
        """Count processor time that was used."""
        now_s = asyncio.get_running_loop().time()
        free_at_s = max(self._free_at_s, now_s) + seconds / self._part
        self._free_at_s = min(free_at_s, now_s + LONGEST_REST_S)

    def _call(self) -> None:
        loop = asyncio.get_running_loop()
        if self._free_at_s > loop.time():
            self._called = loop.call_at(self._free_at_s, self._next)
        else:
            self._called = loop.call_soon(self._next)

    def _next(self) -> None:
        self._called = None
        if self._waiting and self._free_at_s <= asyncio.get_running_loop().time():
            began_s = self._clock()
            try:
                self._pop()()
            finally:
                self.spend(self._clock() - began_s)
        if self._waiting and self._called is None:
            self._call()

    def _pop(self) -> Callable[[], None]:
        """Take the next client's first piece; its other pieces wait behind the other clients."""
        client = next(iter(self._waiting))
        asked = self._waiting.pop(client)
        begin = asked.popleft()
        if asked:
            self._waiting[client] = asked
        return begin

    def timed(self, work: Coroutine[Any, Any, None]) -> TimedCoroutine:
        """Return a coroutine whose every step is counted."""
        return TimedCoroutine(work, self._clock, self.spend)


class TimedCoroutine(Generator[Any, Any, None]):
    """Awaits a coroutine and measures how much processor time each of its steps took.

    Args:
        work: The coroutine.
        clock: The processor time, seconds.
        spend: Gets the time of each step, seconds.
    """

    def __init__(
        self,
        work: Coroutine[Any, Any, None],
        clock: Callable[[], float],
        spend: Callable[[float], None],
    ) -> None:
        self._work = work
        self._clock = clock
        self._spend = spend

    def __await__(self) -> Self:
        """Return what the loop drives."""
        return self

    def send(self, value: Any) -> Any:
        """Take a step with the result that was waited for."""
        began_s = self._clock()
        try:
            return self._work.send(value)
        finally:
            self._spend(self._clock() - began_s)

    def throw(self, raised: Any, value: Any = None, traceback: Any = None) -> Any:
        """Take a step with an error, such as being cancelled."""
        began_s = self._clock()
        try:
            return self._work.throw(raised if value is None else value)
        finally:
            self._spend(self._clock() - began_s)

    def close(self) -> None:
        """End the coroutine."""
        self._work.close()


class TimedApp:
    """Counts the processor time of every step of an application.

    Args:
        app: The application behind.
        share: Where it is counted.
    """

    def __init__(self, app: ASGIApp, share: CpuShare) -> None:
        self._app = app
        self._share = share

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        answering = self._app(scope, receive, send)
        assert isinstance(answering, Coroutine), "an ASGI application is a coroutine function"
        await self._share.timed(answering)
