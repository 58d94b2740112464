"""The path that gives what a plan of the running line is made from, and its last minutes.

What must not live here: the plan itself (`planning`; reckoning it here would hold up telegrams).
"""

from __future__ import annotations

from collections.abc import Callable

from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import described, json_response
from lecombus.api.checking import check_query
from lecombus.api.documents import PlanDocument
from lecombus.readings import Json

__all__ = ["add_plan"]


def add_plan(app: FastAPI, facts: Callable[[], dict[str, Json]]) -> None:
    """Add the path."""

    @app.get("/v1/plan", **described(PlanDocument, 422))
    async def plan(request: Request) -> Response:
        """What a plan is made from, and what the last five minutes showed; sends nothing."""
        check_query(request)
        return json_response(facts())
