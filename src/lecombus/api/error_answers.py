"""What an error becomes while a request is answered: a problem document."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from typing import Any, Final

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Match, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lecombus.api.answers import ProblemDocument, problem_of
from lecombus.api.decimal_json import short
from lecombus.errors import LecombusError
from lecombus.schedule import Outcome

__all__ = ["ERROR_ANSWERS", "answered_at_the_end", "known_error", "unexpected_error"]

WRONG_REQUESTS: Final = frozenset((400, 401, 404, 405, 413, 414, 421, 422, 431))
"""Statuses of a request that is none: what it asks for cannot be written at all."""

INTERNAL: Final = "internal"
"""The kind of an error that no part of lecombus raises on purpose: what was done is not known."""


async def known_error(request: Request, exc: Exception) -> Response:
    """Answer with the problem of an error that lecombus raises on purpose."""
    assert isinstance(exc, LecombusError)
    place = request.path_params
    code = "/".join(place[part] for part in ("code", "subcode") if place.get(part))
    problem = problem_of(exc, drive=short(place.get("drive", "")), code=short(code))
    if is_write(request) and problem.kind == INTERNAL:
        problem = replace(problem, outcome=Outcome.UNKNOWN.value)
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
        INTERNAL,
        f"{type(exc).__name__} while answering {short(request.url.path)}",
        outcome=Outcome.UNKNOWN.value if is_write(request) else "",
        remedy="this is a mistake in lecombus: please report it with the daemon's log",
    ).response()


CUT_OFF: Final = "lecombus ended while this was under way"

ENDED_QUESTION: Final = ProblemDocument("line-closed", CUT_OFF, remedy="ask again once it runs")
ENDED_ACT: Final = ProblemDocument(
    "unknown",
    f"{CUT_OFF}: what was asked may have happened",
    remedy="look at the drive before you ask for it again",
    outcome=Outcome.UNKNOWN.value,
)


def answered_at_the_end(app: ASGIApp) -> ASGIApp:
    """Answer each request that the server cancels because it closes and can wait no longer."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        has_begun = False

        async def send_noted(message: Message) -> None:
            nonlocal has_begun
            has_begun = True
            await send(message)

        try:
            await app(scope, receive, send_noted)
        except asyncio.CancelledError:
            if has_begun:
                raise
            problem = ENDED_QUESTION if scope["method"] in ("GET", "HEAD") else ENDED_ACT
            await problem.response()(scope, receive, send)

    return answer


def allowed_methods(request: Request) -> list[str]:
    """Return the methods that the path of a request has."""
    found: set[str] = set()
    for route in request.app.routes:
        if isinstance(route, Route) and route.matches(request.scope)[0] is not Match.NONE:
            found |= route.methods or set()
    return sorted(found)


ERROR_ANSWERS: Final[Mapping[Any, Callable[[Request, Exception], Awaitable[Response]]]] = {
    LecombusError: known_error,
    HTTPException: not_routed,
    Exception: unexpected_error,
}
