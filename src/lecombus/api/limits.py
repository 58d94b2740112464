"""Limits: how long one request may be, how many may run, and how many connections there may be.

Strategy: the length of a request is checked before anything is decoded. The longest request that
lecombus understands has a body of some hundred bytes and ten headers; the limits are many times
that, and small enough that no request takes the event loop for longer than a millisecond or two.

Requests that wait for the line and those that only read the store are counted apart, and each kind
is refused with a problem document beyond its limit: a thousand waiting writes do not keep a reader
out, and nothing makes a stop wait or fail. Connections of both listeners are counted together
(`ConnectionPlaces`), because they share the process's open files. If there are too many, the one
is cut that has been open longest without a request under way; over TCP one without a valid token
before others, and one of the address that has most of them. One over TCP never takes the place of
one over the Unix socket, and one over the Unix socket always gets a place. Over TCP there are few
places besides, for each may hold an answer that its client does not take.
"""

from __future__ import annotations

import asyncio
import logging
import math
import resource
import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from starlette.types import ASGIApp, Receive, Scope, Send

from lecombus.api.answers import ProblemDocument

__all__ = [
    "ACCEPT_AT_ONCE",
    "BODY_LIMIT",
    "BODY_TOO_BIG",
    "CHUNKED_LIMIT",
    "CONNECTION_LIMIT",
    "EVENTS_PATH",
    "HEADERS_LIMIT",
    "HEAD_LIMIT",
    "HEAD_TOO_LONG",
    "LEASES_PATH",
    "NOT_HTTP",
    "PARAMETERS_LIMIT",
    "REQUEST_LIMIT",
    "STOP_PATH",
    "TARGET_BYTES",
    "TARGET_TOO_LONG",
    "TCP_LIMIT",
    "TCP_UNBEGUN_LIMIT",
    "TCP_WAITING_LIMIT",
    "TOKENS_TCP_LIMIT",
    "TOO_MANY_HEADERS",
    "TOO_MANY_PARAMETERS",
    "WRITERS_WAITING_LIMIT",
    "ConnectionPlaces",
    "PacedLineRequests",
    "PlacedConnection",
    "RequestLimiter",
    "SparseLog",
    "connection_limit",
    "is_paced",
    "is_stop",
    "is_stop_verb",
]

STOP_PATH: Final = "/v1/stop"
LEASES_PATH: Final = "/v1/leases"
EVENTS_PATH: Final = "/v1/events"
STOP_VERB_ENDS: Final = ("/verbs/inhibit", "/verbs/quick-stop")
STOP_ENDS: Final = (STOP_PATH, *STOP_VERB_ENDS)

PACED: Final = "lecombus.paced"
"""In the scope of a request that had to wait for its turn with the line."""

HEAD_LIMIT: Final = 16 * 1024
HEADERS_LIMIT: Final = 64
TARGET_BYTES: Final = 2048
PARAMETERS_LIMIT: Final = 16
BODY_LIMIT: Final = 8 * 1024
"""JSON of this length takes two milliseconds at the worst, its mistakes listed."""

CHUNKED_LIMIT: Final = 2 * BODY_LIMIT
"""Bytes of a body as sent, with what its chunks add and what follows the last one."""

NOT_HTTP: Final = ProblemDocument(
    "bad-http",
    "what came on this connection is not a request in HTTP/1.1",
    remedy="use an HTTP client; requests before it were carried out",
)
HEAD_TOO_LONG: Final = ProblemDocument(
    "head-too-big",
    f"the head of the request is longer than {HEAD_LIMIT} bytes",
    remedy="send fewer and shorter headers",
)
TOO_MANY_HEADERS: Final = ProblemDocument(
    "head-too-big",
    f"the request has more than {HEADERS_LIMIT} headers",
    remedy="send fewer headers: lecombus reads Host, Content-Length and Idempotency-Key",
)
TARGET_TOO_LONG: Final = ProblemDocument(
    "target-too-long",
    f"path and query of the request are longer than {TARGET_BYTES} bytes",
    remedy="give shorter names, and fewer query parameters",
)
TOO_MANY_PARAMETERS: Final = ProblemDocument(
    "too-many-parameters",
    f"the request has more than {PARAMETERS_LIMIT} query parameters",
    remedy="no path takes more than three; they stand in /openapi.json",
)
BODY_TOO_BIG: Final = ProblemDocument(
    "too-big",
    f"the body is longer than {BODY_LIMIT} bytes, or than {CHUNKED_LIMIT} with its chunks",
    remedy="a write is one value; send it alone",
    headers={"Connection": "close"},
)

REQUEST_LIMIT: Final = 256
"""Requests of one kind under way, so that memory is bounded."""

CONNECTION_LIMIT: Final = 640
"""Connections kept at most: both kinds of request at their limits, and some stops."""

TCP_LIMIT: Final = 16
"""Connections over TCP: a scraper, some dashboards, a browser. An answer has up to 500 kB."""

TCP_WAITING_LIMIT: Final = 4
"""Requests over TCP that wait for the line."""

TOKENS_TCP_LIMIT: Final = 64
"""Connections over TCP where tokens are needed."""

WRITERS_WAITING_LIMIT: Final = 16
"""Requests of tokens that write or control which wait for the line."""

TCP_GAP_S: Final = 0.5
"""From one such request to the next: reading on and on would leave the feeds the least margin that
the schedule allows."""

ACCEPT_AT_ONCE: Final = 16
"""Connections the Unix socket takes before the loop does anything else."""

TCP_UNBEGUN_LIMIT: Final = 32
"""Connections over TCP that were taken from the kernel and have not begun."""

KEPT_FILES: Final = 32 + 8 * ACCEPT_AT_ONCE + TCP_UNBEGUN_LIMIT
"""Open files left for the port, sockets and logs, and for connections of two listeners that were
taken but not counted yet, or cut but not closed yet: about four rounds of the loop."""

FEWEST_CONNECTIONS: Final = 8

LOG_GAP_S: Final = 1.0


def is_stop(path: str) -> bool:
    """Return whether a path is that of a stop, which no limit holds up."""
    return path.rstrip("/").endswith(STOP_ENDS)


def is_stop_verb(path: str) -> bool:
    """Return whether a path is that of a stop whose body is not read."""
    return path.rstrip("/").endswith(STOP_VERB_ENDS)


class RequestLimiter:
    """Lets so many requests of each kind through at a time, and every stop.

    Args:
        app: The application behind.
        limit: Requests that only look at the store.
        waiting_limit: Requests that wait for the line; None: as many.
    """

    def __init__(
        self, app: ASGIApp, limit: int = REQUEST_LIMIT, waiting_limit: int | None = None
    ) -> None:
        self._app = app
        self._limits = {True: limit if waiting_limit is None else waiting_limit, False: limit}
        self._inside = {True: 0, False: 0}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http" or is_stop(scope["path"]) or scope["path"] == EVENTS_PATH:
            await self._app(scope, receive, send)  # readers of events have a limit of their own
            return
        waits = needs_line(scope)
        if self._inside[waits] >= self._limits[waits]:
            await refusal(self._limits[waits], waits=waits).response()(scope, receive, send)
            return
        self._inside[waits] += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._inside[waits] -= 1


class PacedLineRequests:
    """Lets requests that need the line begin one by one, with a gap between them.

    Args:
        app: The application behind.
        gap_s: From the beginning of one to that of the next, seconds.
    """

    def __init__(self, app: ASGIApp, gap_s: float = TCP_GAP_S) -> None:
        self._app = app
        self._gap_s = gap_s
        self._next_s = -math.inf

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on when it is time for it."""
        if scope["type"] == "http" and needs_line(scope):
            now_s = asyncio.get_running_loop().time()
            begins_s = max(now_s, self._next_s)
            self._next_s = begins_s + self._gap_s
            if begins_s > now_s:
                await asyncio.sleep(begins_s - now_s)
            scope[PACED] = True
        await self._app(scope, receive, send)


class PlacedConnection(Protocol):
    """A connection as `ConnectionPlaces` sees it."""

    transport: asyncio.Transport
    is_local: bool
    is_known: bool

    @property
    def address(self) -> str:
        """The address of a TCP client."""

    @property
    def is_idle(self) -> bool:
        """Whether no request is under way that came whole."""

    @property
    def is_reading_events(self) -> bool:
        """Whether it only reads events, and may go on with that later."""


class ConnectionPlaces:
    """The connections of all listeners, the one open longest first.

    Args:
        limit: How many there may be.
        tcp_limit: How many of them over TCP.
    """

    def __init__(self, limit: int, tcp_limit: int = TCP_LIMIT) -> None:
        self._limit = limit
        self._tcp_limit = tcp_limit
        self._held: dict[PlacedConnection, None] = {}
        self._looking: dict[PlacedConnection, None] = {}  # those of them over TCP

    def take(self, new: PlacedConnection) -> None:
        """Count a connection, and cut one when there are too many, if need be itself."""
        self._held[new] = None
        if not new.is_local:
            self._looking[new] = None
        if len(self._held) > self._limit or len(self._looking) > self._tcp_limit:
            victim = self._victim(new)
            self.give_back(victim)  # before it has closed: it must not be chosen again
            victim.transport.abort()  # close() would wait for a client that does not read

    def give_back(self, lost: PlacedConnection) -> None:
        """Forget a connection that was closed."""
        self._held.pop(lost, None)
        self._looking.pop(lost, None)

    def _victim(self, new: PlacedConnection) -> PlacedConnection:
        looking = [one for one in self._looking if one is not new]
        others = [one for one in self._held if one is not new] if new.is_local else []
        ranks = [
            self._by_claim(one for one in looking if one.is_idle),
            (one for one in others if one.is_idle),
            (one for one in looking if new.is_local),
            (one for one in others if one.is_reading_events),
        ]
        return next((one for rank in ranks for one in rank), new)

    def _by_claim(self, idle: Iterable[PlacedConnection]) -> list[PlacedConnection]:
        """Order connections over TCP: without a token first, of the address with most first."""
        counts = Counter(one.address for one in self._looking)
        return sorted(idle, key=lambda one: (one.is_known, -counts[one.address]))


def connection_limit() -> int:
    """Return how many connections the process's open files leave room for."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files == resource.RLIM_INFINITY:
        return CONNECTION_LIMIT
    return min(CONNECTION_LIMIT, max(FEWEST_CONNECTIONS, files - KEPT_FILES))


class SparseLog:
    """Logs what clients can cause as often as they like: one event a second, with their count.

    Args:
        logger: Where to.
        event: The event's name.
        clock: A monotonic clock, seconds.
    """

    def __init__(
        self,
        logger: logging.Logger,
        event: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._logger = logger
        self._event = event
        self._clock = clock
        self._logged_at_s = -math.inf
        self._count = 0

    def log(self, **fields: str) -> None:
        """Log an event, or count it for the next one.

        Args:
            fields: What is said of it: no secrets, and nothing that a client chose freely.
        """
        self._count += 1
        now_s = self._clock()
        if now_s - self._logged_at_s >= LOG_GAP_S:
            text = " ".join(f"{key}={value}" for key, value in fields.items())
            self._logger.warning("event=%s %s count=%d", self._event, text, self._count)
            self._logged_at_s, self._count = now_s, 0


def is_paced(scope: Scope) -> bool:
    """Return whether a request had to wait for its turn with the line."""
    return PACED in scope


def needs_line(scope: Scope) -> bool:
    """Return whether a request may wait for the line."""
    if scope["path"].startswith(LEASES_PATH):
        return False  # a renewal waits for no write
    if scope["method"] not in ("GET", "HEAD") or "/line/addresses/" in scope["path"]:
        return True
    query = scope["query_string"]
    return b"fresh" in query or b"%" in query  # which may spell it


def refusal(limit: int, *, waits: bool) -> ProblemDocument:
    """Return the problem of a request beyond the limit."""
    doing = "wait for the line" if waits else "are being answered"
    return ProblemDocument(
        "queue-full",
        f"{limit} requests {doing} already; this one was not begun",
        remedy="ask again, less often; a stop is never refused for this reason",
    )
