"""Bounds for many clients at once that never stand in the way of a stop.

Strategy: what waits for the line and what only looks at the store are counted apart, and each
kind is refused with a problem document beyond its limit: a thousand waiting writes make nobody
blind, and nothing makes a stop wait or fail. Connections are bounded by closing the one that has
been open longest without a request under way, so that clients which hold connections for nothing
cannot keep out the one that wants to stop a drive.

What must not live here: queues of the line (`schedule`), sockets (`server`).
"""

from __future__ import annotations

import asyncio
from typing import Any, Final, cast

from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from lecombus.api.problems import Problem

__all__ = ["CONNECTION_LIMIT", "REQUEST_LIMIT", "Connection", "Crowd"]

REQUEST_LIMIT: Final = 256
"""Requests of one kind under way: memory is bounded whatever clients do."""

CONNECTION_LIMIT: Final = 640
"""Connections kept: both kinds at their limits, some stops, and below 1024 open files."""

STOP_PATH: Final = "/v1/stop"


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
        if scope["type"] != "http" or scope["path"] == STOP_PATH:
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


class Connection(H11Protocol):
    """A connection that makes room by closing an idle one when there are too many."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take the connection; called by the loop."""
        self.made_at_s = asyncio.get_running_loop().time()
        super().connection_made(transport)
        if len(self.connections) > CONNECTION_LIMIT:
            others = cast("set[Connection]", self.connections)
            idle = [one for one in others if one is not self and one.is_idle]
            if idle:
                min(idle, key=lambda one: one.made_at_s).transport.close()

    @property
    def is_idle(self) -> bool:
        """Whether no request is under way."""
        cycle: Any = self.cycle
        return cycle is None or cycle.response_complete


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
