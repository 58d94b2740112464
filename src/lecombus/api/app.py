"""The HTTP application: put together from the modules that add its paths.

Strategy: FastAPI routes requests and describes them (`openapi`); answers are plain responses
written straight from the store, so that no request holds up the loop for long. Whatever fails
becomes a problem document in one place (`mistakes`). A client that goes away cuts nothing: its
request runs to its end. Here stand only the paths for supervisors.

What must not live here: sockets (`server`), checks of bodies (`bodies`), any other path.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.addresses import add_addresses
from lecombus.api.answers import described, status_response
from lecombus.api.custody import add_custody
from lecombus.api.description import add_description_of_drives
from lecombus.api.diagnosis import add_diagnosis
from lecombus.api.documents import StatusDocument
from lecombus.api.idempotency import Idempotency
from lecombus.api.known import add_drive_list, add_known, add_reads
from lecombus.api.mistakes import answer_errors_with_problems
from lecombus.api.openapi import add_description
from lecombus.api.planned import add_plan
from lecombus.api.seam import CustodyPort, OperationsPort
from lecombus.api.stopping import add_stop
from lecombus.api.stops import PlainStops
from lecombus.api.verbs import add_verbs
from lecombus.api.writing import add_group_writes, add_writes
from lecombus.metrics import OPENMETRICS_TYPE, TEXT_TYPE, Metrics, wants_openmetrics
from lecombus.readings import Json
from lecombus.store import Store

__all__ = ["Check", "create_app"]

Check = Callable[[], tuple[bool, str]]
"""Says whether something is so, and what is or is missing."""


def create_app(
    ops: OperationsPort,
    store: Store,
    metrics: Metrics,
    *,
    custody: CustodyPort,
    plan_facts: Callable[[], dict[str, Json]],
    line_name: str,
    ready: Check,
    healthy: Check,
    port: str = "",
    baud: int = 9600,
    version: str = "",
    clock: Callable[[], float] = time.monotonic,
) -> FastAPI:
    """Return the application of one line.

    Args:
        ops: What is done on the line.
        store: What is known.
        metrics: The metrics page.
        custody: What looking after drives takes besides reading and writing.
        plan_facts: What a plan is made from, and what the last minutes showed.
        line_name: The line's name.
        ready: Whether the line is open and every drive was tried once.
        healthy: Whether the line task makes progress.
        port: The line's port, as the roster has it.
        baud: Its baud rate, bit/s.
        version: lecombus' version, for the OpenAPI document.
        clock: A monotonic clock for idempotency keys, seconds.
    """
    app = FastAPI(
        title="lecombus",
        version=version or "0",
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    answer_errors_with_problems(app)
    add_known(app, store, {"line": line_name, "port": port, "baud": baud}, ops)
    add_drive_list(app, store, clock)
    keys = Idempotency(clock)
    add_description_of_drives(app, store)
    add_reads(app, ops, store)
    add_addresses(app, ops)
    add_writes(app, ops, keys)
    add_group_writes(app, ops, keys)
    add_stop(app, ops)
    add_verbs(app, ops, keys)
    add_custody(app, custody, keys)
    add_diagnosis(app, ops)
    add_plan(app, plan_facts)
    add_service(app, metrics, ready, healthy)
    add_description(app)
    app.add_middleware(PlainStops, ops=ops)
    return app


def add_service(app: FastAPI, metrics: Metrics, ready: Check, healthy: Check) -> None:
    """Add what supervisors ask: metrics, health, readiness."""

    # Whoever only looks whether they are there, as some supervisors do, is spared the body.
    @app.head("/metrics", include_in_schema=False)
    @app.get("/metrics", include_in_schema=False)
    async def page(request: Request) -> Response:
        """The metrics page, in the format the scraper likes."""
        openmetrics = wants_openmetrics(request.headers.get("accept", ""))
        text = await metrics.fresh_page(openmetrics=openmetrics)
        return Response(text, media_type=OPENMETRICS_TYPE if openmetrics else TEXT_TYPE)

    @app.head("/healthz", include_in_schema=False)
    @app.get("/healthz", **described(StatusDocument, 503))
    async def healthz() -> Response:
        """Whether the daemon works: 503 when the line task makes no progress."""
        return status_response("unhealthy", healthy())

    @app.head("/readyz", include_in_schema=False)
    @app.get("/readyz", **described(StatusDocument, 503))
    async def readyz() -> Response:
        """Whether the line is open and every drive was tried once."""
        return status_response("not-ready", ready())
