"""The paths of looking after a drive: who it is, and taking another in its place.

What must not live here: what an identity is, when a drive is written to (`operations`).
"""

from __future__ import annotations

from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import (
    REFUSALS,
    Key,
    content_of,
    described,
    json_response,
)
from lecombus.api.bodies import AcceptBody, check_query, read_body
from lecombus.api.documents import IdentityDocument
from lecombus.api.idempotency import Idempotency
from lecombus.api.seam import CustodyPort

__all__ = ["add_custody"]


def add_custody(app: FastAPI, custody: CustodyPort, keys: Idempotency) -> None:
    """Add the paths."""

    @app.get("/v1/drives/{drive}/identity", **described(IdentityDocument, 404, 422))
    async def identity(request: Request, drive: str) -> Response:
        """Who a drive is by its own word, by the record, and by the roster."""
        check_query(request)
        return json_response(custody.identity(drive).as_json())

    @app.post(
        "/v1/drives/{drive}/accept", **described(IdentityDocument, *REFUSALS, body=AcceptBody)
    )
    async def accept(request: Request, drive: str, key: Key = None) -> Response:
        """Take the drive that is there for the drive of this name; it may be written to then.

        The body repeats its identity as `GET ../identity` gives it under `found`.
        """
        check_query(request)
        body, raw = await read_body(request, AcceptBody)

        async def act() -> Response:
            return json_response(custody.accept(drive, body.identity).as_json())

        return await keys.run(key, content_of(request, raw), act)
