"""Who a drive is, how often its memory was written, and how long it was measured to think."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lecombus.api.documents.common import Document, Exact

__all__ = [
    "AnswerTimeDocument",
    "CodeWearDocument",
    "ForgottenTimesDocument",
    "IdentityDocument",
    "WearDocument",
]


class IdentityDocument(Document):
    """Who a drive is, was, and should be; each by code."""

    drive: str
    found: Annotated[dict[str, str], Field(description="What it said when last asked")]
    accepted: Annotated[dict[str, str], Field(description="What is recorded of it")]
    roster: Annotated[dict[str, str], Field(description="What the roster says")]
    accepted_at: Annotated[str | None, Field(description="When the record was made, RFC 3339")]
    problem: Annotated[str | None, Field(description="Why nothing is written to it")]


class CodeWearDocument(Document):
    """How often one code was written."""

    code: Annotated[str, Field(examples=["C0012"])]
    name: Annotated[str, Field(description="Empty where no description knows the code")]
    writes: Annotated[int, Field(description="That may have reached the memory, for ever")]
    to_this_device: Annotated[int, Field(description="Since the present device was accepted")]
    wait_s: Annotated[Exact, Field(description="Until it may be written again; 0: now")]


class WearDocument(Document):
    """How often a drive's memory was written, and how often it may be."""

    drive: str
    burst: Annotated[int, Field(description="Writes of one code that may follow each other")]
    every_s: Annotated[Exact, Field(description="Until one more may follow; 0: no limit")]
    codes: list[CodeWearDocument]


class AnswerTimeDocument(Document):
    """How long one code was measured to take."""

    code: Annotated[str, Field(examples=["C0150"])]
    write: Annotated[bool, Field(description="Written rather than read")]
    manual_s: Annotated[Exact, Field(description="The longest that manual and roster tell")]
    measured_s: Annotated[Exact, Field(description="What was measured, the adapter taken off")]


class ForgottenTimesDocument(Document):
    """What was reckoned with of a drive's answer times, and no longer is."""

    drive: str
    forgotten: list[AnswerTimeDocument]
