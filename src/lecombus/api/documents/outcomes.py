"""How a write, a verb or a stop ended."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from lecombus.api.documents.common import Document
from lecombus.api.documents.known import ReadingDocument

__all__ = ["GroupOutcomeDocument", "OutcomeDocument", "VerbDocument", "WrittenDocument"]

IGNORED: Any = Field(description="Only for stops: what of the request was not looked at")


class ProofDocument(Document):
    """The reading that `verified` comes from."""

    code: str
    subcode: int
    raw: Annotated[str, Field(description="As on the wire")]
    shows: Annotated[
        str,
        Field(
            description="inhibited, quick stop, command held (it reads back, no more), enabled, "
            "no fault or value"
        ),
    ]


class OutcomeDocument(Document):
    """How one write ended."""

    drive: str
    code: Annotated[str | None, Field(description="Null where none could be written")]
    subcode: int | None
    outcome: Annotated[
        str, Field(description="done, verified, refused, expired, superseded or unknown")
    ]
    reason: str | None
    cause: str | None
    remedy: str | None
    reading: Annotated[ReadingDocument | None, Field(description="What was read back")]
    proof: Annotated[
        ProofDocument | None, Field(description="Only where the outcome is verified")
    ] = None


class WrittenDocument(Document):
    """One value that a verb wrote."""

    code: str
    subcode: int
    raw: Annotated[str, Field(description="As on the wire")]


class VerbDocument(Document):
    """How a verb ended."""

    drive: str
    verb: str
    outcome: Annotated[
        str, Field(description="done, verified, refused, expired, superseded or unknown")
    ]
    reason: str | None
    cause: str | None
    remedy: str | None
    states: Annotated[
        list[str],
        Field(
            description="What the drive's words show afterwards, such as inhibited, quick_stop or "
            "fault; empty where they were not read"
        ),
    ]
    written: Annotated[list[WrittenDocument], Field(description="What was written, in order")]
    reading: Annotated[ReadingDocument | None, Field(description="What was read back")]
    proof: Annotated[
        ProofDocument | None, Field(description="Only where the outcome is verified")
    ] = None
    ignored: Annotated[list[str] | None, IGNORED] = None


class GroupOutcomeDocument(Document):
    """How a group write or a stop ended."""

    target: str
    how: str
    outcome: str
    reason: str | None
    members: list[OutcomeDocument]
    ignored: Annotated[list[str] | None, IGNORED] = None
