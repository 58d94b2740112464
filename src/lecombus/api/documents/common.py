"""What all documents share."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated

from pydantic import BaseModel, ConfigDict, WithJsonSchema

__all__ = ["Document", "Exact", "Scalar"]

Exact = Annotated[Decimal, WithJsonSchema({"type": "number"})]
Scalar = Annotated[
    int | Decimal | str | None,
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}, {"type": "null"}]}),
]


class Document(BaseModel):
    """The common rules."""

    model_config = ConfigDict(extra="forbid")
