"""How answers are written: the JSON of reports, and the responses made from it.

What must not live here: paths, and what a problem is (`problems`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from starlette.responses import Response

from lecombus.api.decimal_json import encode
from lecombus.api.problems import Problem, group_problem, report_problem, verb_problem
from lecombus.operations.reports import GroupInfo, GroupReport, VerbReport, WriteReport
from lecombus.readings import Json

__all__ = [
    "JSON_TYPE",
    "group_json",
    "group_response",
    "json_response",
    "status_response",
    "text_response",
    "verb_response",
    "write_response",
]

JSON_TYPE: Final = "application/json"


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


def verb_json(report: VerbReport) -> dict[str, Json]:
    """Return a verb's JSON form."""
    return {
        "drive": report.drive,
        "verb": report.verb.value,
        "outcome": report.outcome.value,
        "reason": report.reason or None,
        "cause": report.cause or None,
        "remedy": report.remedy or None,
        "states": [state.value for state in report.states],
        "written": [
            {"code": f"C{code.number:04d}", "subcode": code.subcode, "raw": raw}
            for code, raw in report.written
        ],
        "reading": None if report.reading is None else report.reading.as_json(),
        "proof": None if report.proof is None else report.proof.as_json(),
    }


def write_response(report: WriteReport) -> Response:
    """Return the answer to a write."""
    problem = report_problem(report)
    return problem.response() if problem else json_response(report_json(report))


def verb_response(report: VerbReport, ignored: Sequence[str] = ()) -> Response:
    """Return the answer to a verb.

    Args:
        report: How it ended.
        ignored: What of a stop's request was ignored.
    """
    document = verb_json(report) | ignored_json(ignored)
    more = {name: document[name] for name in ("verb", "states", "written")}
    problem = verb_problem(report, more | ignored_json(ignored))
    return problem.response() if problem else json_response(document)


def group_response(report: GroupReport, ignored: Sequence[str] = ()) -> Response:
    """Return the answer to a group write or a stop.

    Args:
        report: How it ended.
        ignored: What of a stop's request was ignored.
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
    """Return the member `ignored`; none where nothing was ignored."""
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
