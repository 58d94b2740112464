"""`/openapi.json`: the description of the interface, for programs.

Making it takes some hundred milliseconds, in which no telegram is sent. So it is made before the
line runs, once a process: every application of a version has the same paths.

What must not live here: what stands in it (`documents`, and the paths themselves).
"""

from __future__ import annotations

import json
from typing import Final

from fastapi import FastAPI
from starlette.responses import Response

from lecombus.api.answers import JSON_TYPE
from lecombus.api.documents import ProblemDocument

__all__ = ["add_description"]

DESCRIPTIONS: Final[dict[str, bytes]] = {}
"""By lecombus' version; what is in it never changes, so nobody minds who made it."""


def add_description(app: FastAPI) -> None:
    """Add `/openapi.json`, with all paths that the application has now."""
    text = DESCRIPTIONS.get(app.version) or DESCRIPTIONS.setdefault(app.version, text_of(app))

    @app.get("/openapi.json", include_in_schema=False)
    async def openapi() -> Response:
        """The description of this interface."""
        return Response(text, media_type=JSON_TYPE)


def text_of(app: FastAPI) -> bytes:
    """Return the description of an application."""
    described_app = app.openapi()
    schemas = described_app["components"]["schemas"]
    schemas[ProblemDocument.__name__] = ProblemDocument.model_json_schema()
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    return json.dumps(described_app).encode()
