"""The HTTP application: all routes, stops first.

Strategy: Starlette finds the route. Answers are plain responses, so that no request holds the event
loop for long. A request that was begun on the line runs to its end also when its client goes away;
a write that was not sent by then is withdrawn. Of the routes themselves only `/metrics`,
`/healthz`, `/readyz` and `/openapi.json` stand here.
"""

from __future__ import annotations

import json
import time
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from lecombus.api.answers import JSON_TYPE, status_response
from lecombus.api.error_answers import ERROR_ANSWERS
from lecombus.api.event_readers import EventReaders
from lecombus.api.event_routes import EventRoutes
from lecombus.api.idempotency import Idempotency
from lecombus.api.journal_routes import JournalRoutes
from lecombus.api.lease_routes import LeaseRoutes
from lecombus.api.limits import is_stop
from lecombus.api.read_routes import ReadRoutes
from lecombus.api.refusals import Refusals
from lecombus.api.scopes import guarded
from lecombus.api.write_routes import StopRoutes, WriteRoutes
from lecombus.config import RosterChanges
from lecombus.drive_state.store import Store
from lecombus.journal.journal import Journal
from lecombus.journal.kept import KeyRow
from lecombus.metrics import OPENMETRICS_TYPE, TEXT_TYPE, Metrics, wants_openmetrics
from lecombus.operations.facade import Operations
from lecombus.parameters import Json

__all__ = ["Check", "create_app"]

Check = Callable[[], tuple[bool, str]]
"""Says whether something is so, and what is or is missing."""


def create_app(
    ops: Operations,
    store: Store,
    metrics: Metrics,
    *,
    plan_facts: Callable[[], dict[str, Json]],
    line_name: str,
    ready: Check,
    healthy: Check,
    reload: Callable[[], Awaitable[RosterChanges]],
    readers: EventReaders,
    port: str = "",
    baud: int = 9600,
    read_only: bool = False,
    journal: Journal | None = None,
    kept_keys: Sequence[KeyRow] = (),
    version: str = "",
    clock: Callable[[], float] = time.monotonic,
) -> Starlette:
    """Return the application of one line.

    Args:
        ops: What is done on the line.
        store: What is known.
        metrics: The metrics page.
        plan_facts: What a plan is made from, and what the last minutes showed.
        line_name: The line's name.
        ready: Whether the line is open and every drive was tried once.
        healthy: Whether the line task makes progress.
        reload: Reads the roster again and applies it.
        readers: Those who read events.
        port: The line's port, as the roster has it.
        baud: Its baud rate, bit/s.
        read_only: Whether all but reads and stops are refused.
        journal: The journal; None: there is none.
        kept_keys: What it keeps of requests of the run before.
        version: lecombus' version, for the OpenAPI document.
        clock: A monotonic clock for idempotency keys, seconds.
    """
    facts: dict[str, Json] = {"line": line_name, "port": port, "baud": baud}
    routes = [
        *StopRoutes(ops).routes(),
        *ReadRoutes(ops, store, facts, plan_facts, clock).routes(),
        *LeaseRoutes(ops).routes(),
        *WriteRoutes(
            ops, Idempotency(clock, journal, kept_keys), Refusals(clock, ops, journal), reload
        ).routes(),
        *JournalRoutes(journal, ops).routes(),
        *EventRoutes(readers, ops, store).routes(),
        *ServiceRoutes(metrics, ready, healthy, version or "0").routes(),
    ]
    app = Starlette(
        routes=guarded(routes, ops, read_only=read_only),
        middleware=[Middleware(with_plain_stop_paths)],
        exception_handlers=ERROR_ANSWERS,
    )
    app.router.redirect_slashes = False
    return app


def with_plain_stop_paths(app: ASGIApp) -> ASGIApp:
    """Remove extra slashes around the path of a stop; the router would not find it."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        path = scope["path"] if scope["type"] == "http" else ""
        if is_stop(path) and path != (plain := f"/{path.strip('/')}"):
            scope = {**scope, "path": plain}
        await app(scope, receive, send)

    return answer


class ServiceRoutes:
    """The routes for supervisors and programs: metrics, health, readiness, `/openapi.json`.

    Args:
        metrics: The metrics page.
        ready: Whether the line is open and every drive was tried once.
        healthy: Whether the line task makes progress.
        version: lecombus' version.
    """

    def __init__(self, metrics: Metrics, ready: Check, healthy: Check, version: str) -> None:
        self._metrics = metrics
        self._ready = ready
        self._healthy = healthy
        # Read before the line runs: it takes some milliseconds, in which no telegram is sent.
        self._openapi = openapi_text(version)

    def routes(self) -> list[Route]:
        """Return the routes."""
        return [
            Route("/metrics", self.page),
            Route("/healthz", self.healthz),
            Route("/readyz", self.readyz),
            Route("/openapi.json", self.openapi),
        ]

    async def page(self, request: Request) -> Response:
        """The metrics page, in the format that the scraper asks for."""
        openmetrics = wants_openmetrics(", ".join(request.headers.getlist("accept")))
        text = await self._metrics.fresh_page(openmetrics=openmetrics)
        return Response(text, media_type=OPENMETRICS_TYPE if openmetrics else TEXT_TYPE)

    async def healthz(self, request: Request) -> Response:
        """Whether the daemon works: 503 when the line task makes no progress."""
        return status_response("unhealthy", self._healthy())

    async def readyz(self, request: Request) -> Response:
        """Whether the line is open and every drive was tried once."""
        return status_response("not-ready", self._ready())

    async def openapi(self, request: Request) -> Response:
        """The description of this interface."""
        return Response(self._openapi, media_type=JSON_TYPE)


def openapi_text(version: str) -> bytes:
    """Return the OpenAPI document: the carried file (`make openapi`) with the version put in."""
    document = json.loads(Path(__file__).with_name("openapi.json").read_bytes())
    document["info"]["version"] = version
    return json.dumps(document).encode()
