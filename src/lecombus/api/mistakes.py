"""What goes wrong becomes a problem document, here for everything that the application raises.

What must not live here: what a problem looks like and which kinds there are (`problems`).
"""

from __future__ import annotations

from dataclasses import replace

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Match, Route

from lecombus.api.exact import short
from lecombus.api.problems import Problem, problem_of
from lecombus.errors import LecombusError

__all__ = ["answer_errors_with_problems"]


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
