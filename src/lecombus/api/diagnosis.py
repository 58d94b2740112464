"""The path that says why a drive does not turn.

What must not live here: what keeps a drive from turning (`operations.why`).
"""

from __future__ import annotations

from typing import Annotated

from fastapi import FastAPI, Query
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import described, json_response
from lecombus.api.checking import check_query
from lecombus.api.documents import WhyDocument
from lecombus.api.seam import OperationsPort
from lecombus.drives import Language

__all__ = ["add_diagnosis"]


def add_diagnosis(app: FastAPI, ops: OperationsPort) -> None:
    """Add the path."""

    @app.get("/v1/drives/{drive}/why", **described(WhyDocument, 404, 422))
    async def why(
        request: Request,
        drive: str,
        fresh: Annotated[bool, Query(description="Read the few codes that matter first")] = False,
        lang: Annotated[Language, Query(description="en or de")] = Language.EN,
    ) -> Response:
        """Why a drive does not turn: what is known to keep it from that, and what to do next."""
        check_query(request, ("fresh", "lang"))
        report = await ops.why(drive, fresh=fresh)
        return json_response(report.as_json(lang))
