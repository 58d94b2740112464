"""The HTTP application: which path does what, and what every answer is written from.

Strategy: FastAPI routes requests and describes them (`/openapi.json`, made once at the start);
answers are plain responses written straight from the store, and lists give others their turn
between drives, so that no request holds up the loop for long. Whatever fails becomes a problem
document in one place. A client that goes away cuts nothing: its request runs to its end.

What must not live here: sockets (`server`), checks of bodies (`bodies`), what a write means.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import replace
from typing import Annotated, Final

import anyio.lowlevel
from fastapi import FastAPI, Query
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Match, Route

from lecombus.api.addresses import add_addresses
from lecombus.api.answers import (
    JSON_TYPE,
    REFUSALS,
    Key,
    code_of,
    content_of,
    described,
    group_json,
    group_response,
    json_response,
    report_json,
    status_response,
    text_response,
)
from lecombus.api.bodies import (
    RIGHT,
    DriveWriteBody,
    Urgency,
    WriteBody,
    check_query,
    read_body,
)
from lecombus.api.custody import add_custody
from lecombus.api.description import add_description_of_drives
from lecombus.api.diagnosis import add_diagnosis
from lecombus.api.documents import (
    DriveDocument,
    DrivesDocument,
    GroupOutcomeDocument,
    GroupsDocument,
    LineDocument,
    OutcomeDocument,
    ProblemDocument,
    ReadingDocument,
    RestoreDocument,
    StatusDocument,
)
from lecombus.api.exact import encode, short
from lecombus.api.idempotency import Idempotency
from lecombus.api.pages import KeptPage
from lecombus.api.planned import add_plan
from lecombus.api.problems import Problem, problem_of, report_problem
from lecombus.api.seam import CustodyPort, OperationsPort
from lecombus.api.stopping import add_stop
from lecombus.api.stops import PlainStops
from lecombus.api.verbs import add_verbs
from lecombus.errors import LecombusError
from lecombus.metrics import OPENMETRICS_TYPE, TEXT_TYPE, Metrics, wants_openmetrics
from lecombus.readings import DriveInfo, Json
from lecombus.store import Store

__all__ = ["Check", "create_app"]

Check = Callable[[], tuple[bool, str]]
"""Says whether something is so, and what is or is missing."""

VALUES_AT_ONCE: Final = 16
"""Values written before others get their turn: about a tenth of a millisecond."""


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


def add_known(
    app: FastAPI,
    store: Store,
    facts: Mapping[str, Json],
    ops: OperationsPort,
) -> None:
    """Add what is known now: line, drives, drive, groups."""

    @app.get("/v1/line", **described(LineDocument, 422))
    async def line(request: Request) -> Response:
        """The line: its state, and how many drives are in which state."""
        check_query(request)
        states = Counter(info.state.value for info in store.drives())
        return json_response({**facts, **store.line().as_json(), "drives": {**states}})

    @app.get("/v1/drives/{drive}", **described(DriveDocument, 404, 422))
    async def one_drive(request: Request, drive: str) -> Response:
        """One drive with its state and every value known, with age and quality."""
        check_query(request)
        return text_response(await drive_text(store, store.drive(drive)))

    @app.get("/v1/drives/{drive}/restore", **described(RestoreDocument, 404, 422))
    async def restore(request: Request, drive: str) -> Response:
        """Whether a backup may be restored into a drive, and what it leaves alone there."""
        check_query(request)
        return json_response(ops.restore_rights(drive).as_json())

    @app.get("/v1/groups", **described(GroupsDocument, 422))
    async def groups(request: Request) -> Response:
        """Every group, its members and whether it is spoken to by multicast."""
        check_query(request)
        return json_response({"groups": [group_json(one) for one in ops.groups()]})


def add_drive_list(app: FastAPI, store: Store, clock: Callable[[], float]) -> None:
    """Add the list of all drives, which is written once for all who ask at the same time."""

    async def every_drive() -> bytes:
        texts = [await drive_text(store, info) for info in store.drives()]
        return ('{"drives": [' + ", ".join(texts) + "]}").encode()

    page = KeptPage(every_drive, lambda: store.changes, clock)

    @app.get("/v1/drives", **described(DrivesDocument, 422))
    async def drives(request: Request) -> Response:
        """Every drive with its state and every value known, with age and quality.

        Values and ages may be 0.1 s behind; states, failures and writes never are.
        """
        check_query(request)
        return text_response(await page.get())


def add_reads(app: FastAPI, ops: OperationsPort, store: Store) -> None:
    """Add the reads of codes."""
    told = described(ReadingDocument, 404, 409, 422, 502, 503, 504)

    @app.get("/v1/drives/{drive}/codes/{code}", **told)
    @app.get("/v1/drives/{drive}/codes/{code}/{subcode}", **told)
    async def read_code(
        request: Request,
        drive: str,
        code: str,
        subcode: str = "",
        fresh: Annotated[bool, Query(description="Read it now")] = False,
        priority: Annotated[Urgency, Query(description=RIGHT["priority"])] = Urgency.INTERACTIVE,
    ) -> Response:
        """A value from the store, or read now."""
        check_query(request, ("fresh", "priority"))
        wanted = code_of(code, subcode)
        if fresh:
            read = await ops.read(
                drive, wanted, priority=priority.priority, timeout_s=priority.timeout_s
            )
            return json_response(read.as_json())
        reading = store.reading(drive, wanted) or store.unread(drive, wanted)
        return json_response(reading.as_json())


def add_writes(app: FastAPI, ops: OperationsPort, keys: Idempotency) -> None:
    """Add the writes of codes."""
    told = described(OutcomeDocument, *REFUSALS, body=DriveWriteBody)

    @app.put("/v1/drives/{drive}/codes/{code}", **told)
    @app.put("/v1/drives/{drive}/codes/{code}/{subcode}", **told)
    async def write_code(
        request: Request, drive: str, code: str, subcode: str = "", key: Key = None
    ) -> Response:
        """A write; answers when its outcome is known."""
        check_query(request)
        wanted = code_of(code, subcode)
        body, raw = await read_body(request, DriveWriteBody)

        async def act() -> Response:
            report = await ops.write(
                drive,
                wanted,
                body.value,
                expires_s=body.expires_s,
                verify=bool(body.verify),
                urgency=None if body.priority is None else body.priority.priority,
                restoring=bool(body.restore),
            )
            problem = report_problem(report)
            return problem.response() if problem else json_response(report_json(report))

        return await keys.run(key, content_of(request, raw), act)


def add_group_writes(app: FastAPI, ops: OperationsPort, keys: Idempotency) -> None:
    """Add the writes to groups."""
    told = described(GroupOutcomeDocument, *REFUSALS, body=WriteBody)

    @app.put("/v1/groups/{group}/codes/{code}", **told)
    @app.put("/v1/groups/{group}/codes/{code}/{subcode}", **told)
    async def write_group(
        request: Request, group: str, code: str, subcode: str = "", key: Key = None
    ) -> Response:
        """A write to every member of a group, with an outcome per member."""
        check_query(request)
        wanted = code_of(code, subcode)
        body, raw = await read_body(request, WriteBody)

        async def act() -> Response:
            return group_response(
                await ops.write_group(
                    group, wanted, body.value, expires_s=body.expires_s, verify=body.verify
                )
            )

        return await keys.run(key, content_of(request, raw), act)


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


def add_description(app: FastAPI) -> None:
    """Add `/openapi.json`, made once: making it takes many milliseconds."""
    described_app = app.openapi()
    schemas = described_app["components"]["schemas"]
    schemas[ProblemDocument.__name__] = ProblemDocument.model_json_schema()
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    text = json.dumps(described_app).encode()

    @app.get("/openapi.json", include_in_schema=False)
    async def openapi() -> Response:
        """The description of this interface."""
        return Response(text, media_type=JSON_TYPE)


def answer_errors_with_problems(app: FastAPI) -> None:
    """Make a problem document of whatever goes wrong."""

    @app.exception_handler(LecombusError)
    async def known(request: Request, exc: LecombusError) -> Response:
        place = request.path_params
        code = "/".join(place[part] for part in ("code", "subcode") if place.get(part))
        problem = problem_of(exc, drive=short(place.get("drive", "")), code=short(code))
        detail = problem.detail
        for sent in place.values():  # messages quote what was asked for, however long it is
            detail = detail.replace(str(sent), short(str(sent)))
        return replace(problem, detail=detail).shortened().response()

    @app.exception_handler(RequestValidationError)
    async def not_understood(request: Request, exc: RequestValidationError) -> Response:
        mistakes = "; ".join(f"{one['loc'][-1]}: {one['msg']}" for one in exc.errors())
        return Problem("bad-request", mistakes, remedy="see /openapi.json").response()

    @app.exception_handler(HTTPException)
    async def not_routed(request: Request, exc: HTTPException) -> Response:
        path = short(request.url.path)
        if exc.status_code == 405:
            allowed = ", ".join(allowed_methods(app, request))
            return Problem(
                "wrong-method",
                f"{short(request.method)} is not possible on {path}",
                remedy=f"{allowed} {'are' if ', ' in allowed else 'is'} possible there",
                headers={"Allow": allowed},
            ).response()
        return Problem(
            "no-such-path", f"there is nothing at {path}", remedy="paths stand in /openapi.json"
        ).response()

    @app.exception_handler(Exception)
    async def mistake(request: Request, exc: Exception) -> Response:
        return Problem(
            "internal",
            f"{type(exc).__name__} while answering {short(request.url.path)}",
            remedy="this is a mistake in lecombus: please report it with the daemon's log",
        ).response()


def allowed_methods(app: FastAPI, request: Request) -> list[str]:
    """Return what may be asked of a path; HEAD is answered wherever GET is (`doors`)."""
    found: set[str] = set()
    for route in app.routes:
        if isinstance(route, Route) and route.matches(request.scope)[0] is not Match.NONE:
            found |= route.methods or set()
    return sorted(found | {"HEAD"} if "GET" in found else found)


async def drive_text(store: Store, info: DriveInfo) -> str:
    """Return a drive with its values as JSON text, letting others run now and then."""
    texts = [text async for text in value_texts(store, info.name)]
    return encode(info.as_json())[:-1] + ', "values": [' + ", ".join(texts) + "]}"


async def value_texts(store: Store, drive: str) -> AsyncIterator[str]:
    """Yield every value of a drive as JSON text."""
    for number, code in enumerate(store.codes(drive)):
        if number % VALUES_AT_ONCE == 0:
            await anyio.lowlevel.checkpoint()
        reading = store.reading(drive, code)
        if reading is not None:
            yield encode(reading.as_json())
