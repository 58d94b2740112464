"""What the descriptions say of a drive's codes."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lecombus.api.documents.common import Document, Exact

__all__ = ["BitDocument", "CodeDocument", "DescribedDocument", "MeaningDocument"]


class MeaningDocument(Document):
    """What one value means."""

    value: int
    en: str
    de: str


class BitDocument(Document):
    """One bit or field of a word."""

    low: int
    high: int
    kind: Annotated[str, Field(description="bit, field, free (its user assigns it) or reserved")]
    name: Annotated[str | None, Field(description="A word that stays the same in every language")]
    name_de: str | None
    meanings: list[MeaningDocument]


class CodeDocument(Document):
    """What is known of one code."""

    code: Annotated[str, Field(examples=["C0046"])]
    subcode: int
    name: str
    name_de: str
    unit: str | None
    format: Annotated[str, Field(description="VD, VH, VS or VO")]
    low: Exact | None
    high: Exact | None
    step: Exact | None
    selection: Annotated[
        list[MeaningDocument],
        Field(description="Without low and high: all values there are, unless selection_partial"),
    ]
    selection_partial: Annotated[
        bool, Field(description="The drive takes values that its manual for the line does not name")
    ]
    array: Annotated[
        bool, Field(description="Its values have subcodes; its manual does not say how many")
    ]
    default: Annotated[str | None, Field(description="As on the wire")]
    readable: bool
    writable: bool
    write_class: Annotated[str, Field(description="plain, edge, step, save, address or reset")]
    needs_inhibit: bool
    motion: Annotated[bool, Field(description="Writing it can move the drive")]
    storage: Annotated[str, Field(description="stored, module (lost at power-off) or volatile")]
    parameter_set: int
    secret: bool
    bits: list[BitDocument]
    source: str


class DescribedDocument(Document):
    """A drive's described codes; what its manual does not give is null."""

    drive: str
    family: str
    title: str
    configuration: Annotated[
        str | None, Field(description="The signal configuration its words follow, such as 1xx1")
    ]
    configured_by: str | None
    saved_by: Annotated[str | None, Field(description="What makes stored values stay")]
    parameter_set_offsets: list[int]
    codes: list[CodeDocument]
