"""Why a drive does not turn."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lecombus.api.documents.common import Document, Exact, Scalar

__all__ = [
    "FindingDocument",
    "LastEnableDocument",
    "MemoryDocument",
    "OutputDocument",
    "WhyDocument",
]


class FindingDocument(Document):
    """One thing found about a drive that does not turn."""

    name: Annotated[str, Field(description="A word that stays the same", examples=["inhibited"])]
    weight: Annotated[str, Field(description="reason: keeps it from turning; hint: may; note")]
    text: str
    remedy: str | None
    shown_by: Annotated[str | None, Field(examples=["C0150 reads H0380"])]
    age_s: Annotated[Exact | None, Field(description="Age of the oldest value it rests on")]
    stale: Annotated[bool, Field(description="One of these values is not fresh")]


class MemoryDocument(Document):
    """One fault in a fault memory: it was once, which says nothing of now."""

    code: str
    number: int
    keypad: str | None
    kind: str | None
    meaning: str | None
    age_s: Exact | None
    stale: bool


class OutputDocument(Document):
    """Output frequency or speed, as known."""

    value: Scalar
    unit: str | None
    age_s: Exact | None
    stale: bool


class LastEnableDocument(Document):
    """The last enable, where it was refused or taken back and none succeeded since."""

    time: str
    outcome: Annotated[str, Field(description="refused, or unknown")]
    taken_back: Annotated[
        bool, Field(description="The drive did not show the enable and was stopped again")
    ]
    reason: str | None
    cause: Annotated[str | None, Field(description="Why, probably")]
    remedy: str | None


class WhyDocument(Document):
    """Why a drive does not turn."""

    drive: str
    family: str
    state: str
    reason: str | None
    since: str
    answer: Annotated[str, Field(description="The most important finding in one sentence")]
    findings: list[FindingDocument]
    states: Annotated[list[str], Field(description="What its status words show")]
    output: OutputDocument | None
    history: list[MemoryDocument]
    history_known: Annotated[bool, Field(description="Whether a fault memory has been read")]
    last_enable: LastEnableDocument | None
