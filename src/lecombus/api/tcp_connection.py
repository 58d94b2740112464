"""A connection over TCP, which any program on this machine may open, with tokens and TLS others.

It differs from one over the Unix socket in five things:

* it is served in a share of the loop's time (`CpuShare`): slices and requests are begun there,
  and nothing is read while a slice waits to be parsed;
* it reads through one small buffer for all: otherwise each read would be given a quarter of a
  megabyte, and many of them took 100 MB;
* few requests may be pending, and there are few places (`limits`);
* a client that keeps the daemon waiting is cut: one that does not complete a request, or does not
  take its answer, for `PATIENCE_S`;
* it is closed in two steps (`LingeringTransport`), so that a client that still sends reads why.

Any program on this machine may ask over TCP, with tokens and TLS other machines too. A flood of
requests there must not take the time in which the line is served. So all work for TCP clients
begins piece by piece, one client after the other, and after a piece nothing begins until `1 / PART`
times its processor time has passed. The time is that of this thread: while the machine runs
something else it does not count. Steps of requests under way are measured as well
(`TimedCoroutine`).
"""

from __future__ import annotations

import asyncio
import contextlib
import select
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Coroutine, Generator, Iterator
from contextvars import copy_context
from functools import partial, wraps
from typing import Any, Final, Self, TypeVar, cast

from starlette.types import ASGIApp, Receive, Scope, Send

from lecombus.api.connection import HttpConnection, is_closed
from lecombus.api.limits import is_stop
from lecombus.operations.actions import ACTOR, Actor
from lecombus.operations.awaited_requests import CAME_S, IS_GONE
from lecombus.tokens import grants
from lecombus.tokens.token_file import TokenEntry

__all__ = [
    "PART",
    "PATIENCE_S",
    "TCP_PENDING_LIMIT",
    "CpuShare",
    "LingeringTransport",
    "TcpConnection",
    "TimedCoroutine",
    "fairest",
    "timed",
]

PART: Final = 0.2

LONGEST_REST_S: Final = 1.0
"""After the longest piece too, so that each client gets its turn."""

TCP_PENDING_LIMIT: Final = 2

READ_BYTES: Final = 16 * 1024

PATIENCE_S: Final = 10.0
"""How long a client may keep the daemon waiting; it is cut after once to twice that."""

LINGER_S: Final = 1.0
"""How long a client that was answered for the last time may go on sending; the time begins when the
kernel has taken the answer, for which a slow client may take `PATIENCE_S`."""

DROPPED_LIMIT: Final = 64 * 1024
"""Bytes that it may send in that time."""

Method = TypeVar("Method", bound=Callable[..., Any])


def counted(method: Method) -> Method:
    """Count the processor time of what the loop calls of a connection in the share of TCP."""

    @wraps(method)
    def count(self: TcpConnection, *given: Any) -> Any:
        with self.share.counting():
            return method(self, *given)

    return cast(Method, count)


def without_token(scope: Scope) -> None:
    """No request has one."""


class LingeringTransport(asyncio.Transport):
    """A transport that is closed in two steps: first it says that it will send no more.

    Closing a socket with bytes unread makes the kernel reset the connection, and the client may
    lose an answer that it has not read yet.

    Args:
        inner: The loop's transport.
    """

    def __init__(self, inner: asyncio.Transport) -> None:
        super().__init__()
        self._inner = inner
        self._end: asyncio.TimerHandle | None = None
        self._is_read = False

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """Return what the loop's transport knows."""
        return self._inner.get_extra_info(name, default)

    def is_closing(self) -> bool:
        """Whether it was closed, or is lingering."""
        return self._end is not None or self._inner.is_closing()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send bytes, unless it was closed."""
        if self._end is None:
            self._inner.write(data)

    def get_write_buffer_size(self) -> int:
        """Return how many bytes the kernel did not take yet."""
        return self._inner.get_write_buffer_size()

    def pause_reading(self) -> None:
        """Read no more."""
        self._inner.pause_reading()

    def resume_reading(self) -> None:
        """Read on."""
        self._inner.resume_reading()

    def close(self) -> None:
        """Send what is left, say that it was the last, and close soon after."""
        if self._is_read or self.is_closing():
            self._inner.close()
            return
        self._linger(PATIENCE_S - LINGER_S)
        self._inner.resume_reading()
        with contextlib.suppress(OSError):  # it was reset, which the loop will find out
            self._inner.write_eof()

    def _linger(self, for_s: float) -> None:
        """Look again in a while; close where all was sent by now, or after so many seconds."""
        is_last = for_s <= 0.0 or not self._inner.get_write_buffer_size()
        then = self._inner.abort if is_last else partial(self._linger, for_s - LINGER_S)
        self._end = asyncio.get_running_loop().call_later(LINGER_S, then)

    def abort(self) -> None:
        """Close without sending what is left."""
        self._inner.abort()

    def read_all(self) -> None:
        """The client sends no more: there is nothing to linger for."""
        self._is_read = True

    def ended(self) -> None:
        """The loop's transport is closed."""
        if self._end is not None:
            self._end.cancel()


class TcpConnection(HttpConnection, asyncio.BufferedProtocol):
    """A connection over TCP."""

    share: CpuShare
    buffer = memoryview(bytearray(READ_BYTES))
    """What the loop reads into; all of it is taken out after each read."""
    transport: LingeringTransport
    is_local = False
    token_of: Callable[[Scope], TokenEntry | None] = staticmethod(without_token)
    """Gives the valid token of a request."""
    pending_limit = TCP_PENDING_LIMIT

    @counted
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take the connection; called by the loop."""
        self._dropped = 0
        self._progress = self._progress_seen = 0
        self._arrived_s: float | None = None  # when a request began to come that waits for no other
        super().connection_made(self._lingering(transport))
        self._looking = self.loop.call_later(PATIENCE_S, self._look)

    def _lingering(self, transport: asyncio.Transport) -> LingeringTransport:
        """Return the transport that is closed in two steps."""
        return LingeringTransport(transport)

    def _client(self) -> Actor:
        """Return the client."""
        return Actor("tcp", client="" if self.client is None else ":".join(map(str, self.client)))

    @counted
    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back; called by the loop."""
        self.share.forget(self)
        self._looking.cancel()
        self.transport.ended()
        super().connection_lost(exc)

    def get_buffer(self, sizehint: int) -> memoryview:
        """Return where bytes are read to; called by the loop."""
        return self.buffer

    @counted
    def buffer_updated(self, nbytes: int) -> None:
        """Take the bytes that were read; called by the loop."""
        self.data_received(bytes(self.buffer[:nbytes]))

    def data_received(self, data: bytes) -> None:
        """Keep bytes until their turn; called by the loop."""
        if self.transport.is_closing():
            self._dropped += len(data)
            if self._dropped > DROPPED_LIMIT:
                self.transport.abort()
            return
        self._unset_keepalive_if_required()
        if self._end is None:
            if not self._unread and self._is_answered:
                self._arrived_s = asyncio.get_running_loop().time()
            self._unread += data
            self.flow.is_held = True
            self.flow.pause_reading()
            if self._room > 0:
                self._parse_later()

    def eof_received(self) -> bool:  # type: ignore[override]
        """The client sends no more; called by the loop."""
        self.transport.read_all()
        return not self.transport.is_closing() and super().eof_received()

    def on_message_complete(self) -> None:
        """A request came whole."""
        self._progress += 1
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Go on with the next request, or end; called when an answer was handed over."""
        self._progress += 1
        super().on_response_complete()

    def _queue(self, begin: Callable[[], None]) -> None:
        self.share.take(self, begin)

    def _start_asgi_task(self, cycle: Any, app: Any) -> None:
        self._begin(cycle)
        # Its turn may come a second later: a stop in between ends it. One that was sent behind
        # another comes when that is answered, which may have been a stop.
        came_s = asyncio.get_running_loop().time() if self._arrived_s is None else self._arrived_s
        self._arrived_s = None
        is_gone = partial(is_closed, self.transport.get_extra_info("socket"), select.POLLRDHUP)

        def start() -> None:
            if not self.transport.is_closing():
                context = copy_context()
                context.run(ACTOR.set, self._actor)
                context.run(CAME_S.set, came_s)
                context.run(IS_GONE.set, is_gone)
                context.run(super(HttpConnection, self)._start_asgi_task, cycle, app)

        token = self.token_of(cycle.scope)
        self.is_known = self.is_known or token is not None
        may_stop = token is not None and grants.Scope.CONTROL in token.grant.scopes
        if may_stop and is_stop(cycle.scope["path"]):
            start()  # it waits for no other request
        else:
            self.share.take(self, start)

    def shutdown(self) -> None:
        """End after the requests under way; called by the server."""
        super().shutdown()
        if self._is_answered:
            self.transport.abort()

    def _look(self) -> None:
        """Cut the client if it kept us waiting since the last look."""
        if self._waits_for_client and self._progress == self._progress_seen:
            self.transport.abort()
            return
        self._progress_seen = self._progress
        self._looking = self.loop.call_later(PATIENCE_S, self._look)

    @property
    def _waits_for_client(self) -> bool:
        """Whether the client is to send the rest of a request, or to take an answer."""
        if self.flow.write_paused:
            return True
        if self._is_queued:
            return False
        running = self._running
        if running is None or not self._is_answered:
            return running is None or running.more_body
        return self._is_begun


def first(waiting: Collection[Any]) -> object:
    """Return the client that waits longest."""
    return next(iter(waiting))


def fairest(waiting: Collection[Any]) -> object:
    """Return a client with a valid token before others, then one of the address with fewest."""
    counts = Counter(one.address for one in waiting)
    chosen: object = min(waiting, key=lambda one: (not one.is_known, counts[one.address]))
    return chosen


class CpuShare:
    """Begins one piece after the other, and rests in between.

    Taking a new connection is a piece too. While clients wait, it has every second turn: neither
    can a flood of connections keep clients waiting, nor clients a new connection.

    Args:
        part: How much of the loop's time all pieces together may take, 0 to 1.
        clock: The processor time of this thread, seconds.
        choose: Says which of the waiting clients is next; by default the one that waits longest.
    """

    def __init__(
        self,
        part: float = PART,
        clock: Callable[[], float] = time.thread_time,
        choose: Callable[[Collection[Any]], object] = first,
    ) -> None:
        self._part = part
        self._clock = clock
        self._choose = choose
        self._waiting: dict[object, deque[Callable[[], None]]] = {}  # by client, the next one first
        self._opening: Callable[[], None] | None = None  # takes the next connection
        self._has_opened = False  # the last turn was that of a new connection
        self._free_at_s = 0.0  # by the loop's clock
        self._called: asyncio.Handle | None = None

    def take(self, client: object, begin: Callable[[], None]) -> None:
        """Begin something for a client in its turn, never before this returns."""
        self._waiting.setdefault(client, deque()).append(begin)
        if self._called is None:
            self._call()

    def open(self, take: Callable[[], None]) -> None:
        """Take a new connection in its turn, never before this returns.

        Args:
            take: Takes it. There is one at a time.
        """
        self._opening = take
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

    @contextlib.contextmanager
    def counting(self) -> Iterator[None]:
        """Count the processor time of what is done inside."""
        began_s = self._clock()
        try:
            yield
        finally:
            self.spend(self._clock() - began_s)

    def _call(self) -> None:
        loop = asyncio.get_running_loop()
        if self._free_at_s > loop.time():
            self._called = loop.call_at(self._free_at_s, self._next)
        else:
            self._called = loop.call_soon(self._next)

    def _next(self) -> None:
        self._called = None
        if self._is_wanted and self._free_at_s <= asyncio.get_running_loop().time():
            with self.counting():
                self._pop()()
        if self._is_wanted and self._called is None:
            self._call()

    @property
    def _is_wanted(self) -> bool:
        return bool(self._waiting) or self._opening is not None

    def _pop(self) -> Callable[[], None]:
        """Take the next client's first piece; its other pieces wait behind the other clients."""
        opening = self._opening
        self._has_opened = opening is not None and not (self._waiting and self._has_opened)
        if opening is not None and self._has_opened:
            self._opening = None
            return opening
        client = self._choose(self._waiting.keys())
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


def timed(app: ASGIApp, share: CpuShare) -> ASGIApp:
    """Count the processor time of every step of an application."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        answering = app(scope, receive, send)
        assert isinstance(answering, Coroutine), "an ASGI application is a coroutine function"
        await share.timed(answering)

    return answer
