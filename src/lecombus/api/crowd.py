"""Bounds for many clients at once that never stand in the way of a stop.

Strategy: what waits for the line and what only looks at the store are counted apart, and each
kind is refused with a problem document beyond its limit: a thousand waiting writes make nobody
blind, and nothing makes a stop wait or fail. Connections of both listeners are counted together
(`Places`), because they share the process's open files. Too many are met by cutting the one that
has been open longest without a request under way; one over TCP, which can only look, never takes
the place of one over the Unix socket, and one over the Unix socket always gets a place. Over TCP
there are few places besides, for each may hold an answer that nobody takes.

What must not live here: queues of the line (`schedule`), sockets (`server`).
"""

from __future__ import annotations

import asyncio
import math
import resource
from typing import Final, Protocol

from starlette.types import ASGIApp, Receive, Scope, Send

from lecombus.api.problems import Problem
from lecombus.api.stops import is_stop

__all__ = [
    "ACCEPT_AT_ONCE",
    "CONNECTION_LIMIT",
    "REQUEST_LIMIT",
    "TCP_LIMIT",
    "TCP_WAITING_LIMIT",
    "Crowd",
    "Paced",
    "Placed",
    "Places",
    "connection_limit",
]

REQUEST_LIMIT: Final = 256
"""Requests of one kind under way: memory is bounded whatever clients do."""

CONNECTION_LIMIT: Final = 640
"""Connections kept at most: both kinds of request at their limits, and some stops."""

TCP_LIMIT: Final = 16
"""Connections over TCP: a scraper, some dashboards, a browser. An answer may be half a megabyte."""

TCP_WAITING_LIMIT: Final = 4
"""Requests over TCP that wait for the line."""

TCP_GAP_S: Final = 0.5
"""From one such request to the next: reading on and on would leave the feeds the least margin that
the schedule allows."""

ACCEPT_AT_ONCE: Final = 16
"""Connections the Unix socket takes before the loop does anything else; TCP takes one."""

KEPT_FILES: Final = 32 + 8 * ACCEPT_AT_ONCE
"""Open files left for the port, sockets and logs, and for connections of two listeners that were
taken but not counted yet, or cut but not closed yet: about four rounds of the loop."""

FEWEST_CONNECTIONS: Final = 8


class Crowd:
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
        if scope["type"] != "http" or is_stop(scope["path"]):
            await self._app(scope, receive, send)
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


class Paced:
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
        await self._app(scope, receive, send)


class Placed(Protocol):
    """What is counted: a connection as `Places` sees it."""

    transport: asyncio.Transport
    may_write: bool

    @property
    def is_idle(self) -> bool:
        """Whether no request is under way that came whole."""


class Places:
    """The connections of all listeners, the one open longest first.

    Args:
        limit: How many there may be.
        tcp_limit: How many of them over TCP.
    """

    def __init__(self, limit: int, tcp_limit: int = TCP_LIMIT) -> None:
        self._limit = limit
        self._tcp_limit = tcp_limit
        self._held: dict[Placed, None] = {}
        self._looking: dict[Placed, None] = {}  # those of them over TCP

    def take(self, new: Placed) -> None:
        """Count a connection, and cut one when there are too many, if need be itself."""
        self._held[new] = None
        if not new.may_write:
            self._looking[new] = None
        if len(self._held) > self._limit or len(self._looking) > self._tcp_limit:
            victim = self._victim(new)
            self.give_back(victim)  # at once: it must not be chosen again while it closes
            victim.transport.abort()  # close() would wait for a client that does not read

    def give_back(self, lost: Placed) -> None:
        """Forget a connection that was closed."""
        self._held.pop(lost, None)
        self._looking.pop(lost, None)

    def _victim(self, new: Placed) -> Placed:
        looking = [one for one in self._looking if one is not new]
        others = [one for one in self._held if one is not new] if new.may_write else []
        ranks = [
            (one for one in looking if one.is_idle),
            (one for one in others if one.is_idle),
            (one for one in looking if new.may_write),
        ]
        return next((one for rank in ranks for one in rank), new)


def connection_limit() -> int:
    """Return how many connections the process's open files leave room for."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files == resource.RLIM_INFINITY:
        return CONNECTION_LIMIT
    return min(CONNECTION_LIMIT, max(FEWEST_CONNECTIONS, files - KEPT_FILES))


def needs_line(scope: Scope) -> bool:
    """Tell whether a request may wait for the line."""
    if scope["method"] not in ("GET", "HEAD"):
        return True
    query = scope["query_string"]
    return b"fresh" in query or b"%" in query  # which may spell it


def refusal(limit: int, *, waits: bool) -> Problem:
    """Return what a request beyond the limit is told."""
    doing = "wait for the line" if waits else "are being answered"
    return Problem(
        "queue-full",
        f"{limit} requests {doing} already; this one was not begun",
        remedy="ask again, less often; a stop is never refused for this reason",
    )
