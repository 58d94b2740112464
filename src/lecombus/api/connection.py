"""One HTTP connection: uvicorn's httptools connection with limits and orderly ends.

Strategy: httptools is measurably faster than h11 and gives a whole request in one call (ADR 10).
uvicorn's connection is extended where it sets no limit or does not answer. That takes private names
of uvicorn, so its version is bound and `tests/api/test_uvicorn.py` checks each name:

* a request ends at its limits (`limits`), before anything of it is decoded;
* in one turn of the loop `SLICE` bytes of a connection are parsed; what is beyond is kept unread,
  nothing more is read, and it goes on in its turn;
* at most `pending_limit` requests of one connection are pending. What came beyond is kept unread
  in the same way until there is room; nothing of it is lost;
* what came whole is answered, also before rubbish (then `bad-http`, as a problem document,
  and the end), the end of what the client sends, or an offer to speak another protocol, which is
  ignored (after a CONNECT the connection ends);
* a request in another version than HTTP/1.0 or 1.1 is none: HTTP/0.9 has no headers, and an answer
  to it no status;
* the host of an absolute request target counts instead of the `Host` header (RFC 9112, 3.2.2).

Bytes are given to the parser in pieces so small that the requests in them cannot exceed the limit.

The event loop runs all that is ready before it looks at its descriptors again. A hundred requests
that came together would thus be answered in one go: some thirty milliseconds in which no byte of a
drive is taken and no telegram sent. So one request begins in each turn of the loop (`StartQueue`);
a stop does not wait.
"""

from __future__ import annotations

import asyncio
import contextlib
import select
import socket
import struct
from collections import deque
from collections.abc import Callable
from contextvars import copy_context
from functools import partial
from typing import Any, Final, NoReturn

import httptools
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from lecombus.api.answers import ProblemDocument, date_header
from lecombus.api.event_readers import OUTLET, Outlet
from lecombus.api.limits import (
    BODY_LIMIT,
    BODY_TOO_BIG,
    CHUNKED_LIMIT,
    EVENTS_PATH,
    HEAD_LIMIT,
    HEAD_TOO_LONG,
    HEADERS_LIMIT,
    LEASES_PATH,
    NOT_HTTP,
    PARAMETERS_LIMIT,
    TARGET_BYTES,
    TARGET_TOO_LONG,
    TOO_MANY_HEADERS,
    TOO_MANY_PARAMETERS,
    ConnectionPlaces,
    is_stop,
    is_stop_verb,
)
from lecombus.operations.actions import ACTOR, Actor
from lecombus.operations.awaited_requests import CAME_S, IS_GONE
from lecombus.tokens.grants import EVERYTHING

__all__ = ["PENDING_LIMIT", "SLICE", "HttpConnection", "StartQueue"]

PENDING_LIMIT: Final = 16

SLICE: Final = 2048
"""Bytes of a connection that are parsed in one turn: some tenths of a millisecond at the most."""

CREDENTIALS: Final = struct.Struct("3i")
"""Process, user and group at the other end of a Unix socket (unix(7), SO_PEERCRED)."""

SHORTEST_REQUEST: Final = 16
"""Bytes of `GET / HTTP/1.1` and two line feeds: a piece has room for no more requests than that."""

VERSIONS: Final = ("1.0", "1.1")

OFFERS: Final = frozenset((b"upgrade", b"http2-settings", b"connection"))
"""Headers that make up an offer to speak another protocol; `Connection: close` is kept."""


class StartQueue:
    """Begins one piece of work in each turn of the event loop, first come first served."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], None]] = deque()
        self._is_called = False

    def take(self, begin: Callable[[], None], *, first: bool = False) -> None:
        """Begin something now if nothing waits, else in its turn, or before all that wait."""
        if self._is_called:
            if first:
                self._waiting.appendleft(begin)
            else:
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


class BeyondBoundsError(Exception):
    """Ends the parsing of a request that is beyond its bounds."""


class PatientFlow(FlowControl):
    """Flow control that goes on reading only when nothing is kept unread."""

    is_held = False

    def resume_reading(self) -> None:
        """Read on, unless bytes are kept."""
        if not self.is_held:
            super().resume_reading()


class HttpConnection(HttpToolsProtocol):
    """A connection over the Unix socket, which holds one of a bounded number of places."""

    places: ConnectionPlaces
    starts: StartQueue
    flow: PatientFlow
    is_local = True
    is_known = False
    """Whether a request on it carried a valid token."""
    pending_limit = PENDING_LIMIT

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take the connection; called by the loop."""
        super().connection_made(transport)
        self._actor = self._client()
        self.flow = PatientFlow(transport)
        self._unread = bytearray()
        self._size = 0  # bytes of the head, or of the body, that is being parsed
        self._is_begun = False  # a request has begun and did not come whole yet
        self._is_in_body = False
        self._is_queued = False  # the next slice waits for its turn
        self._refusal: ProblemDocument | None = None  # why the parser was ended
        self._is_offer = False  # the head just read offers to speak another protocol
        self._end: ProblemDocument | None = None  # if set: parse no more, send it after all answers
        self._is_half_closed = False
        self._running: Any = None  # the request that is being answered
        self._outlet: Outlet | None = None  # of a request for events
        self.places.take(self)

    def _client(self) -> Actor:
        """Return the client as the kernel knows it, not as it describes itself."""
        peer = self.transport.get_extra_info("socket")
        try:
            said = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
        except OSError:  # the client is gone already
            return Actor("socket", grant=EVERYTHING)
        pid, uid, _ = CREDENTIALS.unpack(said)
        return Actor("socket", uid, pid, grant=EVERYTHING)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back; called by the loop."""
        self.places.give_back(self)
        self._unset_keepalive_if_required()  # uvicorn leaves it when the connection was reset
        self._unread.clear()
        self.pipeline.clear()
        if self._running is not None and not self._running.response_complete:
            self._running.disconnected = True
            self._running.message_event.set()
        super().connection_lost(exc)
        self._outlet = None
        self.cycle = self._running = None  # type: ignore[assignment]  # each refers to the other

    @property
    def address(self) -> str:
        """The address of a TCP client."""
        return "" if self.client is None else self.client[0]

    @property
    def is_idle(self) -> bool:
        """Whether no request is under way that came whole."""
        running = self._running
        return not self.pipeline and (running is None or self._is_answered or running.more_body)

    @property
    def is_reading_events(self) -> bool:
        """Whether it only reads events, and may go on with that later."""
        return self._outlet is not None and not self.pipeline and not self._is_answered

    @property
    def _is_answered(self) -> bool:
        """Whether every request that began has its answer."""
        return not self.pipeline and (self._running is None or self._running.response_complete)

    # ---- what comes in ----------------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        """Take bytes; called by the loop."""
        self._unset_keepalive_if_required()
        if self._end is None:
            self._unread += data
            if not self._is_queued:
                self._parse()

    def eof_received(self) -> bool:  # type: ignore[override]
        """The client sends no more; it may still wait for answers to what came whole."""
        self._is_half_closed = True
        if self._outlet is not None:
            self._outlet.is_half_closed = True
        if not self._unread:
            self._drop_unfinished()
        return bool(self._unread) or not self._is_answered

    def _parse(self) -> None:
        """Give the parser a slice of what there is room for, and keep the rest."""
        left = SLICE
        while left > 0 and self._unread and (room := self._room) > 0:
            piece = bytes(self._unread[: min(left, room * SHORTEST_REQUEST)])
            del self._unread[: len(piece)]
            left -= len(piece)
            self._feed(piece)
        was_held, self.flow.is_held = self.flow.is_held, bool(self._unread)
        if self.flow.is_held:
            self.flow.pause_reading()
            if self._room > 0:
                self._parse_later()
            return
        if was_held and not self.pipeline:
            self.flow.resume_reading()
        if self._is_half_closed:
            self._drop_unfinished()

    @property
    def _room(self) -> int:
        """How many more requests may be parsed now."""
        if self._end is not None or self.transport.is_closing():
            return 0
        return self.pending_limit - self._pending

    def _parse_later(self) -> None:
        """Parse the next slice in its turn."""
        if not self._is_queued:
            self._is_queued = True
            self._queue(self._parse_in_turn)

    def _parse_in_turn(self) -> None:
        self._is_queued = False
        if self.transport.is_closing():
            return
        self._parse()
        self._end_if_answered()

    def _queue(self, begin: Callable[[], None]) -> None:
        """Do something in its turn."""
        self.starts.take(begin)

    def _feed(self, piece: bytes) -> None:
        self._size += len(piece)
        try:
            self.parser.feed_data(piece)
        except httptools.HttpParserUpgrade as offer:
            if self._is_offer:
                self._unread[:0] = self._without_offer() + piece[offer.args[0] :]
            else:
                self._end_after_connect()
        except httptools.HttpParserError:
            self._give_up(self._refusal or NOT_HTTP)
        if self._is_in_body and self._size > CHUNKED_LIMIT:
            self._end_body()
        elif not self._is_in_body and self._size > HEAD_LIMIT:
            self._give_up(HEAD_TOO_LONG)

    def _end_body(self) -> None:
        """Read no more of a body without end: it was answered already, or it is refused."""
        cycle: Any = self.cycle
        if cycle.response_complete:
            self.transport.close()
        elif is_stop_verb(cycle.scope["path"]) and self.is_local:
            cycle.keep_alive = False
            self._unread.clear()
            self.flow.is_held = True
            self.flow.pause_reading()
        else:
            self._give_up(BODY_TOO_BIG)

    def _end_after_connect(self) -> None:
        """Answer a CONNECT like any other request, and end: what follows would be a tunnel."""
        self.cycle.keep_alive = False
        self._give_up(NOT_HTTP)

    def _without_offer(self) -> bytes:
        """Begin again with the same head, but for the offer to speak another protocol.

        The parser takes what follows such a head for that protocol, also a body.
        """
        parser, self.parser = self.parser, httptools.HttpRequestParser(self)
        with contextlib.suppress(AttributeError):  # as uvicorn does
            self.parser.set_dangerous_leniencies(lenient_data_after_close=True)
        version = parser.get_http_version().encode()
        lines = [b"%b %b HTTP/%b" % (parser.get_method(), self.url, version)]
        lines += [b"%b: %b" % header for header in self.headers if header[0] not in OFFERS]
        if not parser.should_keep_alive():
            lines.append(b"connection: close")
        self._is_offer = False
        self._size = 0
        return b"\r\n".join([*lines, b"", b""])

    @property
    def _pending(self) -> int:
        """How many requests wait for their answers."""
        is_running = self._running is not None and not self._running.response_complete
        return len(self.pipeline) + is_running

    # ---- what the parser calls --------------------------------------------------------------

    def on_message_begin(self) -> None:
        """A request begins."""
        self._is_begun = True
        super().on_message_begin()

    def on_url(self, url: bytes) -> None:
        """Take a part of the request's target."""
        if len(self.url) + len(url) > TARGET_BYTES:
            self._refuse(TARGET_TOO_LONG)
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header; those behind a body in chunks are dropped."""
        if self._is_in_body:
            return
        if len(self.headers) >= HEADERS_LIMIT:
            self._refuse(TOO_MANY_HEADERS)
        super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Take the head of a request."""
        if self.parser.get_http_version() not in VERSIONS:
            self._refuse(NOT_HTTP)
        self._is_offer = self.parser.should_upgrade() and self.parser.get_method() != b"CONNECT"
        if self._is_offer:
            return
        self._size = 0
        target = httptools.parse_url(self.url)
        if not (self.is_local and is_stop((target.path or b"").decode("latin-1"))):
            self._check_bounds(target.query or b"")
        self._is_in_body = True
        if target.host is not None:
            host = b"[%b]" % target.host if b":" in target.host else target.host
            self.headers[:] = [one for one in self.headers if one[0] != b"host"]
            self.headers.append((b"host", host))
        super().on_headers_complete()

    def _check_bounds(self, query: bytes) -> None:
        """Refuse what is too much before it is decoded; the application checks a stop."""
        if query.count(b"&") >= PARAMETERS_LIMIT:
            self._refuse(TOO_MANY_PARAMETERS)
        for name, value in self.headers:
            if name == b"content-length" and int(value) > BODY_LIMIT:
                self._refuse(BODY_TOO_BIG)

    def _refuse(self, why: ProblemDocument) -> NoReturn:
        """End the parser in the middle of a request; called while it parses."""
        self._refusal = why
        raise BeyondBoundsError(why.kind)

    def on_message_complete(self) -> None:
        """A request came whole."""
        if self._is_offer:
            return
        self._size = 0
        self._is_begun = self._is_in_body = False
        super().on_message_complete()

    # ---- turns and ends ---------------------------------------------------------------------

    def _start_asgi_task(self, cycle: Any, app: Any) -> None:
        """Answer a request in its turn; a stop without waiting."""
        self._begin(cycle)
        came_s = asyncio.get_running_loop().time()
        is_gone = partial(is_closed, self.transport.get_extra_info("socket"))

        def start() -> None:
            if self._actor.pid and cycle.scope["method"] not in ("GET", "HEAD") and not stops:
                self._actor.find_process()  # it may be gone afterwards; a stop does not wait for it
            context = copy_context()  # the task that answers has it: the log of a write names who
            context.run(ACTOR.set, self._actor)
            context.run(CAME_S.set, came_s)
            context.run(IS_GONE.set, is_gone)
            context.run(super(HttpConnection, self)._start_asgi_task, cycle, app)

        stops = is_stop(cycle.scope["path"])
        if stops:
            start()
        else:
            # A renewal waits for no crowd of other requests.
            self.starts.take(start, first=cycle.scope["path"].startswith(LEASES_PATH))

    def _begin(self, cycle: Any) -> None:
        """Take the request that is answered next; one for events gets the transport itself."""
        self._running = cycle
        self._outlet = None
        if cycle.scope["path"] == EVENTS_PATH:
            self._outlet = cycle.scope[OUTLET] = Outlet(self.transport)

    def shutdown(self) -> None:
        """End after the requests under way; called by the server."""
        if self._is_answered:
            self.transport.close()
        else:
            last = self.pipeline[0][0] if self.pipeline else self._running
            last.keep_alive = False

    def on_response_complete(self) -> None:
        """Go on with the next request, or end; called when an answer was handed over."""
        super().on_response_complete()
        if self.transport.is_closing():
            return
        if self._unread:
            self._unset_keepalive_if_required()
            self._parse()
        self._end_if_answered()

    def _give_up(self, why: ProblemDocument) -> None:
        """Parse no more; what came whole is answered first."""
        if self._end is None:
            self._end = why
            self._unread.clear()
            self._drop_unfinished()
            self._end_if_answered()

    def _drop_unfinished(self) -> None:
        """Forget a request whose body will never come whole."""
        cycle: Any = self.cycle
        if cycle is None or not cycle.more_body or cycle.response_complete:
            return
        cycle.disconnected = True
        cycle.message_event.set()
        if self.pipeline and self.pipeline[0][0] is cycle:
            self.pipeline.popleft()
        cycle.response_complete = True

    def _end_if_answered(self) -> None:
        if not self._is_answered or self.transport.is_closing():
            return
        if self._end is not None:
            self._say_end(self._end)
        elif self._is_half_closed and not self._unread:
            self.transport.close()

    def _say_end(self, problem: ProblemDocument) -> None:
        """Write a problem document without the application, and close."""
        answer = problem.response()
        headers = [one for one in answer.raw_headers if one[0] != b"connection"]
        headers.append(date_header())
        lines = [b"%b: %b\r\n" % header for header in headers]
        head = b"".join([STATUS_LINE[answer.status_code], *lines, b"connection: close\r\n\r\n"])
        self.transport.write(head + bytes(answer.body))
        self.transport.close()


def is_closed(peer: Any, more: int = 0) -> bool:
    """Whether the client has closed its socket; one that only sends no more has not.

    The kernel is asked, because a request and the end of its client come in one turn of the loop
    where the process did not run in between, and because nothing more is read of a client that
    sent much. The connection itself is not held: a context keeps what was set in it for long.

    Args:
        peer: The socket.
        more: Further events of poll(2) that mean it. TCP does not say whether a client that sends
            no more still listens, so over TCP the end of what it sends counts (POLLRDHUP).
    """
    poll = select.poll()
    try:
        poll.register(peer, more)
    except (OSError, ValueError):  # closed on this side
        return True
    return bool(poll.poll(0))
