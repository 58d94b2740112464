"""Problems, health, and what a plan is made from."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, Field

from lecombus.api.documents.common import Document
from lecombus.api.problems import PROBLEM_TYPE, STATUS_BY_KIND

__all__ = ["PlanDocument", "ProblemDocument", "StatusDocument", "problem_responses"]


class PlanDocument(Document):
    """What a plan of the running line is made from, and what its last five minutes showed."""

    roster: Annotated[
        dict[str, Any], Field(description="The line and the drives, as far as a plan needs them")
    ]
    measured: Annotated[
        dict[str, Any],
        Field(description="Waits and line time by class, margins by drive, gaps by cyclic code"),
    ]
    answers: Annotated[
        dict[str, Any], Field(description="Answer times measured, by drive, the slowest first")
    ]
    state: Annotated[str, Field(description="How the line is: open, closed or lost")]
    away: Annotated[list[str], Field(description="The drives that do not answer now")]


class ProblemDocument(BaseModel):
    """A problem document (RFC 9457); group problems also carry `target`, `how` and `members`."""

    type: Annotated[str, Field(examples=["urn:lecombus:problem:no-answer"])]
    title: str
    status: int
    detail: str
    drive: str | None
    code: str | None
    cause: str | None
    remedy: str | None
    outcome: str | None


class StatusDocument(Document):
    """Health or readiness."""

    status: str
    detail: str


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return what the OpenAPI document says of the given error statuses."""
    schema = {"$ref": "#/components/schemas/ProblemDocument"}
    return {
        status: {
            "description": ", ".join(
                f"{title} ({kind})"
                for kind, (its_status, title) in STATUS_BY_KIND.items()
                if its_status == status
            ),
            "content": {PROBLEM_TYPE: {"schema": schema}},
        }
        for status in statuses
    }
