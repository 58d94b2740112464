"""One HTTP connection, as robust as uvicorn's needs to be here.

Strategy: uvicorn's httptools connection with what it leaves open closed (httptools is measurably
faster than h11 and gives a whole request in one call, see ADR 10):

* a request's head ends at `HEAD_LIMIT`, with 431;
* at most `PENDING_LIMIT` requests of one connection are pending. What came beyond is kept unread,
  and nothing more is read, until there is room; nothing of it is lost;
* what came whole is answered, whatever follows it: rubbish (then `bad-http`, as a problem document,
  and the end), the end of what the client sends, or an offer to speak another protocol, which is
  ignored (after a CONNECT the connection ends);
* the host of an absolute request target counts instead of the `Host` header (RFC 9112, 3.2.2).

Bytes are given to the parser in pieces so small that the requests in them cannot exceed the limit.

What must not live here: who may come in (`doors`), how many (`crowd`), in whose turn (`turns`).
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from typing import Any, Final

import httptools
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from lecombus.api.crowd import Places, connection_limit
from lecombus.api.problems import Problem
from lecombus.api.stops import is_stop
from lecombus.api.turns import Turns

__all__ = ["HEAD_LIMIT", "PENDING_LIMIT", "Connection", "connections"]

HEAD_LIMIT: Final = 64 * 1024
PENDING_LIMIT: Final = 16

SHORTEST_REQUEST: Final = 16
"""Bytes of `GET / HTTP/1.1` and two line feeds: a piece has room for no more requests than that."""

NOT_HTTP: Final = Problem(
    "bad-http",
    "what came on this connection is not a request in HTTP/1.1",
    remedy="use an HTTP client; requests before it were carried out",
)
TOO_LONG: Final = Problem(
    "head-too-big",
    f"the head of the request is longer than {HEAD_LIMIT} bytes",
    remedy="send a shorter path and fewer headers",
)


OFFERS: Final = frozenset((b"upgrade", b"http2-settings", b"connection"))
"""Headers that make up an offer to speak another protocol; `Connection: close` is kept."""


class PatientFlow(FlowControl):
    """Flow control that goes on reading only when nothing is kept unread."""

    is_held = False

    def resume_reading(self) -> None:
        """Read on, unless bytes are kept."""
        if not self.is_held:
            super().resume_reading()


class Connection(HttpToolsProtocol):
    """A connection that holds one of a bounded number of places; see `connections`."""

    places: Places
    turns: Turns
    flow: PatientFlow

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take the connection; called by the loop."""
        super().connection_made(transport)
        self.flow = PatientFlow(transport)
        self._unread = bytearray()
        self._barren = 0  # bytes parsed since something came of them
        self._is_in_body = False
        self._is_offer = False  # the head just read offers to speak another protocol
        self._end: Problem | None = None  # nothing is parsed any more; said after the last answer
        self._is_half_closed = False
        self._running: Any = None  # the request that is being answered
        made_by = transport.get_extra_info("socket")
        self.may_write = made_by is not None and made_by.family == socket.AF_UNIX
        self.places.take(self)

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

    @property
    def is_idle(self) -> bool:
        """Whether no request is under way that came whole."""
        running = self._running
        return not self.pipeline and (running is None or self._is_answered or running.more_body)

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
            self._parse()

    def eof_received(self) -> bool:  # type: ignore[override]
        """The client sends no more; it may still wait for answers to what came whole."""
        self._is_half_closed = True
        if not self._unread:
            self._drop_unfinished()
        return not self._is_answered

    def _parse(self) -> None:
        """Give the parser what there is room for, and keep the rest."""
        while self._unread and self._end is None and not self.transport.is_closing():
            room = PENDING_LIMIT - self._pending
            if room <= 0:
                break
            piece = bytes(self._unread[: room * SHORTEST_REQUEST])
            del self._unread[: len(piece)]
            self._feed(piece)
        was_held, self.flow.is_held = self.flow.is_held, bool(self._unread)
        if self.flow.is_held:
            self.flow.pause_reading()
            return
        if was_held and not self.pipeline:
            self.flow.resume_reading()
        if self._is_half_closed:
            self._drop_unfinished()

    def _feed(self, piece: bytes) -> None:
        self._barren += len(piece)
        try:
            self.parser.feed_data(piece)
        except httptools.HttpParserUpgrade as offer:
            if self._is_offer:
                self._unread[:0] = self._without_offer() + piece[offer.args[0] :]
            else:
                self._end_after_connect()
        except httptools.HttpParserError:
            self._give_up(NOT_HTTP)
        if self._barren > HEAD_LIMIT:
            self._give_up(TOO_LONG)

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
        self._barren = 0
        return b"\r\n".join([*lines, b"", b""])

    @property
    def _pending(self) -> int:
        """How many requests wait for their answers."""
        is_running = self._running is not None and not self._running.response_complete
        return len(self.pipeline) + is_running

    # ---- what the parser calls --------------------------------------------------------------

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header; those behind a body in chunks are dropped."""
        if not self._is_in_body:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Take the head of a request."""
        self._is_offer = self.parser.should_upgrade() and self.parser.get_method() != b"CONNECT"
        if self._is_offer:
            return
        self._barren = 0
        self._is_in_body = True
        host = httptools.parse_url(self.url).host
        if host is not None:
            self.headers[:] = [one for one in self.headers if one[0] != b"host"]
            self.headers.append((b"host", b"[%b]" % host if b":" in host else host))
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Take a part of a body."""
        self._barren = 0
        super().on_body(body)

    def on_message_complete(self) -> None:
        """A request came whole."""
        if self._is_offer:
            return
        self._barren = 0
        self._is_in_body = False
        super().on_message_complete()

    # ---- turns and ends ---------------------------------------------------------------------

    def _start_asgi_task(self, cycle: Any, app: Any) -> None:
        """Have a request answered in its turn; a stop at once."""
        self._running = cycle

        def start() -> None:
            super(Connection, self)._start_asgi_task(cycle, app)

        if is_stop(cycle.scope["path"]):
            start()
        else:
            self.turns.take(start)

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

    def _give_up(self, why: Problem) -> None:
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

    def _say_end(self, problem: Problem) -> None:
        """Write a problem document without the application, and close."""
        answer = problem.response()
        lines = [b"%b: %b\r\n" % header for header in answer.raw_headers]
        head = b"".join([STATUS_LINE[answer.status_code], *lines, b"connection: close\r\n\r\n"])
        self.transport.write(head + bytes(answer.body))
        self.transport.close()


def connections() -> type[Connection]:
    """Return the class of connections that share the places and turns of one server."""

    class Placed(Connection):
        places = Places(connection_limit())
        turns = Turns()

    return Placed
