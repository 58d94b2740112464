"""How answers are written and described: what every group of paths shares.

What must not live here: any path (`app`, `custody`), what a problem is (`problems`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Final

from fastapi import Header
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.bodies import Body
from lecombus.api.documents import problem_responses
from lecombus.api.exact import encode
from lecombus.api.idempotency import KEY_CHARS, fingerprint
from lecombus.api.problems import Problem, ProblemError, group_problem
from lecombus.errors import CodeValueError
from lecombus.operations.reports import GroupInfo, GroupReport, WriteReport
from lecombus.protocol.addressing import Code
from lecombus.readings import Json

__all__ = [
    "JSON_TYPE",
    "REFUSALS",
    "Key",
    "code_of",
    "content_of",
    "described",
    "group_json",
    "group_response",
    "ignored_json",
    "json_response",
    "report_json",
    "status_response",
    "text_response",
]

JSON_TYPE: Final = "application/json"

REFUSALS: Final = (403, 404, 409, 413, 422, 502, 503, 504)
"""What a write or a stop can end in besides 200."""

Key = Annotated[
    str | None,
    # Bounds for readers of the document only: a stop is not refused for its key.
    Header(
        alias="Idempotency-Key",
        description="Makes a repeat safe; a new one per request",
        json_schema_extra={"minLength": 1, "maxLength": KEY_CHARS},
    ),
]


def described(model: type[Any], *problems: int, body: type[Body] | None = None) -> dict[str, Any]:
    """Return what the OpenAPI document is told about an operation."""
    found: dict[str, Any] = {
        "response_model": None,
        "response_class": Response,
        "responses": {200: {"model": model}, **problem_responses(*problems)},
    }
    if body is not None:
        schema = body.model_json_schema(ref_template="#/components/schemas/{model}")
        schema.pop("$defs", None)  # what it refers to is a component of some query already
        content = {JSON_TYPE: {"schema": schema}}
        found["openapi_extra"] = {"requestBody": {"required": True, "content": content}}
    return found


def code_of(code: str, subcode: str) -> Code:
    """Return the code a path names.

    Raises:
        ProblemError: It names none; 404, because no drive has it.
    """
    text = f"{code}/{subcode}" if subcode else code
    try:
        return Code.parse(text)
    except CodeValueError as exc:
        raise ProblemError(
            Problem("no-such-code", str(exc), code=text, remedy="write C0150 or C0039/1")
        ) from exc


def content_of(request: Request, body: bytes) -> bytes:
    """Return what tells this request from another with the same key."""
    query = request.scope["query_string"]
    return fingerprint(request.method.encode(), request.url.path.encode(), query, body)


def group_json(group: GroupInfo) -> dict[str, Json]:
    """Return a group's JSON form."""
    return {
        "group": group.name,
        "members": list(group.members),
        "how": "one-by-one" if group.multicast_address is None else "multicast",
        "multicast_address": group.multicast_address,
        "writes": "multicast"
        if group.multicast and group.multicast_address is not None
        else "one-by-one",
    }


def report_json(report: WriteReport) -> dict[str, Json]:
    """Return a write's JSON form."""
    return {
        "drive": report.drive,
        "code": None if report.code is None else f"C{report.code.number:04d}",
        "subcode": None if report.code is None else report.code.subcode,
        "outcome": report.outcome.value,
        "reason": report.reason or None,
        "cause": report.cause or None,
        "remedy": report.remedy or None,
        "reading": None if report.reading is None else report.reading.as_json(),
        "proof": None if report.proof is None else report.proof.as_json(),
    }


def group_response(report: GroupReport, ignored: Sequence[str] = ()) -> Response:
    """Return the answer to a group write or a stop.

    Args:
        report: How it ended.
        ignored: What of a stop's request was not looked at (`stopping`).
    """
    members: list[Json] = [report_json(one) for one in report.members]
    problem = group_problem(report, members)
    if problem is not None:
        return replace(problem, more={**problem.more, **ignored_json(ignored)}).response()
    return json_response(
        {
            "target": report.target,
            "how": report.how,
            "outcome": report.outcome.value,
            "reason": report.reason or None,
            "members": members,
            **ignored_json(ignored),
        }
    )


def ignored_json(ignored: Sequence[str]) -> dict[str, Json]:
    """Return the member that says what was ignored; none where nothing was."""
    return {"ignored": list(ignored)} if ignored else {}


def status_response(kind: str, check: tuple[bool, str]) -> Response:
    """Return health or readiness."""
    good, detail = check
    if good:
        return json_response({"status": "ok", "detail": detail})
    return Problem(kind, detail).response()


def json_response(document: Json) -> Response:
    """Return a document."""
    return text_response(encode(document))


def text_response(text: str | bytes) -> Response:
    """Return JSON text; no cache may keep it, its age counts from now."""
    return Response(text, headers={"Cache-Control": "no-store"}, media_type=JSON_TYPE)
