"""Bounds for many clients at once that never stand in the way of a stop.

Strategy: what waits for the line and what only looks at the store are counted apart, and each
kind is refused with a problem document beyond its limit: a thousand waiting writes make nobody
blind, and nothing makes a stop wait or fail. Connections of both listeners are counted together
(`Places`), because they share the process's open files. Too many are met by cutting the one that
has been open longest without a request under way; one over TCP, which can only look, never takes
the place of one over the Unix socket, and one over the Unix socket always gets a place.

What must not live here: queues of the line (`schedule`), sockets (`server`).
"""

from __future__ import annotations

import asyncio
import resource
from typing import Final, Protocol

from starlette.types import ASGIApp, Receive, Scope, Send

from lecombus.api.problems import Problem
from lecombus.api.stops import is_stop

__all__ = [
    "ACCEPT_AT_ONCE",
    "CONNECTION_LIMIT",
    "REQUEST_LIMIT",
    "Crowd",
    "Placed",
    "Places",
    "connection_limit",
]

REQUEST_LIMIT: Final = 256
"""Requests of one kind under way: memory is bounded whatever clients do."""

CONNECTION_LIMIT: Final = 640
"""Connections kept at most: both kinds of request at their limits, and some stops."""

ACCEPT_AT_ONCE: Final = 16
"""Connections a listener takes before the loop does anything else."""

KEPT_FILES: Final = 32 + 8 * ACCEPT_AT_ONCE
"""Open files left for the port, sockets and logs, and for connections of two listeners that were
taken but not counted yet, or cut but not closed yet: about four rounds of the loop."""

FEWEST_CONNECTIONS: Final = 8


class Crowd:
    """Lets so many requests of each kind through at a time, and every stop.

    Args:
        app: The application behind.
        limit: Requests of one kind.
    """

    def __init__(self, app: ASGIApp, limit: int = REQUEST_LIMIT) -> None:
        self._app = app
        self._limit = limit
        self._inside = {True: 0, False: 0}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http" or is_stop(scope["path"]):
            await self._app(scope, receive, send)
            return
        waits = needs_line(scope)
        if self._inside[waits] >= self._limit:
            await refusal(self._limit, waits=waits).response()(scope, receive, send)
            return
        self._inside[waits] += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._inside[waits] -= 1


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
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._held: dict[Placed, None] = {}

    def take(self, new: Placed) -> None:
        """Count a connection, and cut one when there are too many, if need be itself."""
        self._held[new] = None
        if len(self._held) > self._limit:
            victim = self._victim(new)
            del self._held[victim]  # at once: it must not be chosen again while it closes
            victim.transport.abort()  # close() would wait for a client that does not read

    def give_back(self, lost: Placed) -> None:
        """Forget a connection that was closed."""
        self._held.pop(lost, None)

    def _victim(self, new: Placed) -> Placed:
        others = [one for one in self._held if one is not new]
        looking = [one for one in others if not one.may_write]
        ranks = [
            (one for one in looking if one.is_idle),
            (one for one in others if one.is_idle and new.may_write),
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
    return scope["method"] not in ("GET", "HEAD") or b"fresh=" in scope["query_string"]


def refusal(limit: int, *, waits: bool) -> Problem:
    """Return what a request beyond the limit is told."""
    doing = "wait for the line" if waits else "are being answered"
    return Problem(
        "queue-full",
        f"{limit} requests {doing} already; this one was not begun",
        remedy="ask again, less often; a stop is never refused for this reason",
    )
