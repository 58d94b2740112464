"""The paths of writes to codes, of one drive and of a group.

What must not live here: stops (`stopping`), verbs (`verbs`), what a write means (`operations`).
"""

from __future__ import annotations

from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import (
    REFUSALS,
    Key,
    code_of,
    content_of,
    described,
    group_response,
    json_response,
    report_json,
)
from lecombus.api.bodies import DriveWriteBody, WriteBody
from lecombus.api.checking import check_query, read_body
from lecombus.api.documents import GroupOutcomeDocument, OutcomeDocument
from lecombus.api.idempotency import Idempotency
from lecombus.api.problems import report_problem
from lecombus.api.seam import OperationsPort

__all__ = ["add_group_writes", "add_writes"]


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
                unless_stopped_since=body.stops,
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
