"""The paths of looking after a drive: who it is, another in its place, wear, address, times.

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
    report_json,
)
from lecombus.api.bodies import AcceptBody, AddressBody, NoKeysBody
from lecombus.api.checking import check_query, read_body
from lecombus.api.documents import (
    ForgottenTimesDocument,
    IdentityDocument,
    OutcomeDocument,
    WearDocument,
)
from lecombus.api.idempotency import Idempotency
from lecombus.api.problems import report_problem
from lecombus.api.seam import CustodyPort
from lecombus.operations.requests import refuse_for_gone_client

__all__ = ["add_custody"]


def add_custody(app: FastAPI, custody: CustodyPort, keys: Idempotency) -> None:
    """Add the paths."""
    add_what_is_known(app, custody)
    add_what_is_done(app, custody, keys)
    add_what_is_forgotten(app, custody, keys)


def add_what_is_known(app: FastAPI, custody: CustodyPort) -> None:
    """Add identity and wear, which send nothing to the line."""

    @app.get("/v1/drives/{drive}/identity", **described(IdentityDocument, 404, 422))
    async def identity(request: Request, drive: str) -> Response:
        """Who a drive is by its own word, by the record, and by the roster."""
        check_query(request)
        return json_response(custody.identity(drive).as_json())

    @app.get("/v1/drives/{drive}/wear", **described(WearDocument, 404, 422))
    async def wear(request: Request, drive: str) -> Response:
        """How often the codes that wear a drive's memory were written, for ever."""
        check_query(request)
        return json_response(custody.wear(drive).as_json())


def add_what_is_done(app: FastAPI, custody: CustodyPort, keys: Idempotency) -> None:
    """Add another address, and another drive."""

    @app.post(
        "/v1/drives/{drive}/address", **described(OutcomeDocument, *REFUSALS, body=AddressBody)
    )
    async def address(request: Request, drive: str, key: Key = None) -> Response:
        """Give a drive another address, find it there, and follow it; answers when that is known.

        The roster must allow it, the drive must stand, and nothing may answer at the new address.
        """
        check_query(request)
        body, raw = await read_body(request, AddressBody)

        async def act() -> Response:
            refuse_for_gone_client(drive)
            report = await custody.readdress(drive, body.address)
            problem = report_problem(report)
            return problem.response() if problem else json_response(report_json(report))

        return await keys.run(key, content_of(request, raw), act)

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
            refuse_for_gone_client(drive)
            return json_response(custody.accept(drive, body.identity).as_json())

        return await keys.run(key, content_of(request, raw), act)


def add_what_is_forgotten(app: FastAPI, custody: CustodyPort, keys: Idempotency) -> None:
    """Add measured answer times that are dropped."""

    @app.post(
        "/v1/drives/{drive}/forget-times",
        **described(ForgottenTimesDocument, *REFUSALS, body=NoKeysBody),
    )
    async def forget_times(request: Request, drive: str, key: Key = None) -> Response:
        """Forget how long a drive was measured to think; manual and roster count from then on.

        What it takes is measured all the time, so a drive that is slow is soon learnt again.
        """
        check_query(request)
        _, raw = await read_body(request, NoKeysBody, may_be_empty=True)

        async def act() -> Response:
            return json_response(custody.forget_times(drive).as_json())

        return await keys.run(key, content_of(request, raw), act)
