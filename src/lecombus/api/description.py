"""The path that says what is known of a drive's codes.

What must not live here: what a description says (`descriptions`), values.
"""

from __future__ import annotations

from typing import Final

import anyio.lowlevel
from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import described, text_response
from lecombus.api.checking import check_query
from lecombus.api.documents import DescribedDocument
from lecombus.api.exact import encode
from lecombus.descriptions import code_document, family_document
from lecombus.store import Store

__all__ = ["add_description_of_drives"]

CODES_AT_ONCE: Final = 8
"""Codes written before others get their turn: about a third of a millisecond."""


def add_description_of_drives(app: FastAPI, store: Store) -> None:
    """Add the path."""

    @app.get("/v1/drives/{drive}/described", **described(DescribedDocument, 404, 422))
    async def described_codes(request: Request, drive: str) -> Response:
        """What is known of a drive's codes: names, ranges, selections, where they are stored."""
        check_query(request)
        family = store.family(drive)
        texts = []
        for number, info in enumerate(family.described()):
            if number % CODES_AT_ONCE == 0:
                await anyio.lowlevel.checkpoint()
            texts.append(encode(code_document(family, info)))
        head = encode({"drive": drive, **family_document(family)})
        return text_response(head[:-1] + ', "codes": [' + ", ".join(texts) + "]}")
