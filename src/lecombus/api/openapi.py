"""`/openapi.json`: the description of the interface, for programs.

Making it takes some hundred milliseconds, in which no telegram is sent. So it is made before the
line runs, once a process: every application of a version has the same paths.

What must not live here: what stands in it (`documents`, and the paths themselves).
"""

from __future__ import annotations

import json
from typing import Any, Final

from fastapi import FastAPI
from starlette.responses import Response

from lecombus.api.answers import JSON_TYPE
from lecombus.api.documents import ProblemDocument
from lecombus.api.problems import PROBLEM_TYPE

__all__ = ["add_description"]

ANY_REFUSAL: Final[dict[str, Any]] = {
    "description": "What any path may be refused with: 400, 405, 414, 421, 429, 431, 503",
    "content": {
        PROBLEM_TYPE: {"schema": {"$ref": f"#/components/schemas/{ProblemDocument.__name__}"}}
    },
}

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
    for path, operations in described_app["paths"].items():
        for operation in operations.values():
            operation["responses"]["default"] = ANY_REFUSAL
            drop_subcode(path, operation)
    return json.dumps(described_app).encode()


def drop_subcode(path: str, operation: dict[str, Any]) -> None:
    """Take the subcode out of a path without one, where FastAPI makes a query parameter of it."""
    parameters = operation.get("parameters", [])
    if "{subcode}" not in path:
        parameters[:] = [one for one in parameters if one["name"] != "subcode"]
