"""The HTTP application: all routes, stops first, and what an error becomes.

Strategy: Starlette finds the route. Answers are plain responses, so that no request holds the event
loop for long. Every error becomes a problem document here. A request that was
begun on the line runs to its end also when its client goes away; a write that was not sent by then
is withdrawn. Of the routes themselves only `/metrics`, `/healthz`,
`/readyz` and `/openapi.json` stand here.

What must not live here: sockets (`server`), checks of requests (`request_checks`).
"""

from __future__ import annotations

import json
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Match, Route
from starlette.types import ASGIApp, Receive, Scope, Send

from lecombus.api.answers import JSON_TYPE, ProblemDocument, problem_of, status_response
from lecombus.api.decimal_json import short
from lecombus.api.event_readers import EventReaders
from lecombus.api.event_routes import EventRoutes
from lecombus.api.idempotency import Idempotency
from lecombus.api.journal_routes import JournalRoutes
from lecombus.api.lease_routes import LeaseRoutes
from lecombus.api.limits import is_stop
from lecombus.api.read_routes import ReadRoutes
from lecombus.api.scopes import guarded
from lecombus.api.write_routes import StopRoutes, WriteRoutes
from lecombus.config import RosterChanges
from lecombus.drive_state.store import Store
from lecombus.errors import LecombusError
from lecombus.journal.journal import Journal
from lecombus.journal.kept import KeyRow
from lecombus.metrics import OPENMETRICS_TYPE, TEXT_TYPE, Metrics, wants_openmetrics
from lecombus.operations.facade import Operations
from lecombus.parameters import Json
from lecombus.schedule import Outcome

__all__ = ["Check", "create_app"]

WRONG_REQUESTS: Final = frozenset((400, 401, 404, 405, 413, 414, 421, 422, 431))
"""Statuses of a request that is none: what it asks for cannot be written at all."""

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
        *WriteRoutes(ops, Idempotency(clock, journal, kept_keys), reload).routes(),
        *JournalRoutes(journal, ops).routes(),
        *EventRoutes(readers, ops, store).routes(),
        *ServiceRoutes(metrics, ready, healthy, version or "0").routes(),
    ]
    app = Starlette(
        routes=guarded(routes, ops, read_only=read_only),
        middleware=[Middleware(with_plain_stop_paths)],
        exception_handlers={
            LecombusError: known_error,
            HTTPException: not_routed,
            Exception: unexpected_error,
        },
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


async def known_error(request: Request, exc: Exception) -> Response:
    """Answer with the problem of an error that lecombus raises on purpose."""
    assert isinstance(exc, LecombusError)
    place = request.path_params
    code = "/".join(place[part] for part in ("code", "subcode") if place.get(part))
    problem = problem_of(exc, drive=short(place.get("drive", "")), code=short(code))
    if is_write(request) and problem.status not in WRONG_REQUESTS and not problem.outcome:
        more = {**problem.more, "sent": False}
        problem = replace(problem, outcome=Outcome.REFUSED.value, more=more)
    detail = problem.detail
    for sent in place.values():  # messages quote what was asked for, however long it is
        detail = detail.replace(str(sent), short(str(sent)))
    return replace(problem, detail=detail).shortened().response()


def is_write(request: Request) -> bool:
    """Whether a request asks for what ends in an outcome: a write, a verb, another address."""
    place, method = request.path_params, request.method
    writes = method == "PUT" and "code" in place
    return writes or (
        method == "POST" and ("verb" in place or request.url.path.endswith("/address"))
    )


async def not_routed(request: Request, exc: Exception) -> Response:
    """Answer a request for a path or with a method that does not exist."""
    assert isinstance(exc, HTTPException)
    path = short(request.url.path)
    if exc.status_code == 405:
        allowed = ", ".join(allowed_methods(request))
        method = "GET" if request.method == "HEAD" else request.method  # the answers are the same
        return ProblemDocument(
            "wrong-method",
            f"{short(method)} is not possible on {path}",
            remedy=f"{allowed} {'are' if ', ' in allowed else 'is'} possible there",
            headers={"Allow": allowed},
        ).response()
    return ProblemDocument(
        "no-such-path", f"there is nothing at {path}", remedy="paths stand in /openapi.json"
    ).response()


async def unexpected_error(request: Request, exc: Exception) -> Response:
    """Answer an error that is a mistake in lecombus; it is raised again for the log."""
    return ProblemDocument(
        "internal",
        f"{type(exc).__name__} while answering {short(request.url.path)}",
        outcome=Outcome.UNKNOWN.value if is_write(request) else "",
        remedy="this is a mistake in lecombus: please report it with the daemon's log",
    ).response()


def allowed_methods(request: Request) -> list[str]:
    """Return the methods that the path of a request has."""
    found: set[str] = set()
    for route in request.app.routes:
        if isinstance(route, Route) and route.matches(request.scope)[0] is not Match.NONE:
            found |= route.methods or set()
    return sorted(found)
