"""The routes of the journal: its rows, and whether they are whole.

Strategy: the file is read in the journal's thread, a bounded number of rows at a time; answers are
written giving way to other tasks. A client that wants all rows asks again behind `next`.
"""

from __future__ import annotations

from collections.abc import Awaitable, Mapping
from datetime import datetime
from typing import Annotated, ClassVar, Final, TypeVar

import anyio.lowlevel
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from lecombus.api.answers import (
    ProblemDocument,
    RefusedRequestError,
    json_response,
    text_response,
)
from lecombus.api.decimal_json import encode
from lecombus.api.request_checks import read_query, refusal, shown
from lecombus.api.request_models import Query
from lecombus.drive_state.readings import rfc3339
from lecombus.journal.chain import Head
from lecombus.journal.journal import Journal
from lecombus.journal.journal_file import JournalFileError
from lecombus.journal.reading import StoredRow
from lecombus.operations.facade import Operations
from lecombus.parameters import Json

__all__ = ["JournalQuery", "JournalRoutes", "VerifyQuery"]

ROWS_AT_ONCE: Final = 16
"""Rows written before other tasks run: about a quarter of a millisecond."""

ROWS_MOST: Final = 500

LARGEST_NUMBER: Final = 2**53
"""Far above any row's number; SQLite counts to 2**63, programs that read JSON often less."""

TIME_EXAMPLE: Final = "such as 2026-11-23T06:00:00Z"

T = TypeVar("T")


class JournalQuery(Query):
    """Which rows are wanted."""

    right: ClassVar[Mapping[str, str]] = {
        "after": f"the number of a row, 0 to {LARGEST_NUMBER}",
        "since": f"a time of at most 40 characters, {TIME_EXAMPLE}",
        "drive": "the name of a drive or a group",
        "limit": f"a whole number, 1 to {ROWS_MOST}",
        "last": "true or false",
    }

    after: Annotated[
        int, Field(ge=0, le=LARGEST_NUMBER, description="Only rows with a larger number")
    ] = 0
    since: Annotated[
        str, Field(max_length=40, description="Only rows of that time or later, RFC 3339")
    ] = ""
    drive: Annotated[
        str,
        Field(
            max_length=64, description="Only rows of that drive and its groups, or of that group"
        ),
    ] = ""
    limit: Annotated[int, Field(ge=1, le=ROWS_MOST, description="How many rows at most")] = 100
    last: Annotated[bool, Field(description="The newest rows; without after and since")] = False


class VerifyQuery(Query):
    """What the chain is compared with."""

    right: ClassVar[Mapping[str, str]] = {
        "head": "NUMBER:HASH as in the log's event journal-head, with 64 digits 0-9a-f as HASH",
    }

    head: Annotated[
        str, Field(pattern="^([0-9]{1,18}:[0-9a-f]{64})?$", description="A head that was logged")
    ] = ""


class JournalRoutes:
    """The routes of the journal.

    Args:
        journal: The journal; None: the roster names none.
        ops: Knows the groups.
    """

    def __init__(self, journal: Journal | None, ops: Operations) -> None:
        self._journal = journal
        self._ops = ops
        self._verifying = anyio.Lock()

    def routes(self) -> list[Route]:
        """Return the routes."""
        return [Route("/v1/journal", self.rows), Route("/v1/journal/verify", self.verify)]

    async def rows(self, request: Request) -> Response:
        """Rows of the journal in their order; `next` says behind which there may be more."""
        query, journal = read_query(request, JournalQuery), self._there()
        since_ms = unix_ms(query.since)
        if query.last and (query.after or query.since):
            raise refusal("last takes no after and no since", "leave out last, or the others")
        drives, head = self._names(query.drive), journal.head
        if query.last:
            rows = await answered(journal.last_rows(drives=drives, most=query.limit))
            behind = None
        else:
            rows, behind = await answered(
                journal.rows_after(
                    after=query.after, since_ms=since_ms, drives=drives, most=query.limit
                )
            )
        if rows and rows[-1].number > head.number:
            head = Head(rows[-1].number, rows[-1].hash)  # never beyond what was looked at
        texts = []
        for number, row in enumerate(rows):
            if number % ROWS_AT_ONCE == 0:
                await anyio.lowlevel.checkpoint()
            texts.append(encode(row_json(row)))
        end = encode({"next": behind, "head": str(head), "trouble": journal.trouble})
        return text_response(f'{{"rows": [{", ".join(texts)}], {end[1:]}')

    async def verify(self, request: Request) -> Response:
        """Whether the chain of hashes is whole, and holds a head that was logged."""
        query, journal = read_query(request, VerifyQuery), self._there()
        logged = None
        if query.head:
            number, _, digest = query.head.partition(":")
            logged = Head(int(number), bytes.fromhex(digest))
        async with self._verifying:
            found = await answered(journal.verify(logged))
        return json_response(
            {
                "whole": not found.problem,
                "rows": found.rows,
                "first": found.first.number + 1,
                "last": found.head.number,
                "head": str(found.head),
                "problem": found.problem or None,
            }
        )

    def _names(self, drive: str) -> list[str]:
        """Return a drive with the groups that it is in: what was done to them was done to it."""
        groups = self._ops.context.groups.items()
        return [drive, *(name for name, one in groups if drive in one.members)] if drive else []

    def _there(self) -> Journal:
        if self._journal is None:
            raise RefusedRequestError(
                ProblemDocument(
                    "no-journal",
                    "the roster names no journal",
                    remedy="write `journal: FILE` into it and restart lecombus",
                )
            )
        return self._journal


def row_json(row: StoredRow) -> dict[str, Json]:
    """Return the JSON form of a row."""
    return {
        "number": row.number,
        "time": rfc3339(row.time_ms / 1000),
        "what": row.kind,
        "drive": row.drive or None,
        "asked": row.intent,
        "outcome": row.outcome or None,
        "ended": row.is_ended,
        "fields": dict(row.whole()),
        "hash": row.hash.hex(),
    }


async def answered(work: Awaitable[T]) -> T:
    """Wait for the journal's thread.

    Raises:
        RefusedRequestError: It cannot be read now.
    """
    try:
        return await work
    except (JournalFileError, TimeoutError) as exc:
        raise RefusedRequestError(
            ProblemDocument("journal-failing", str(exc) or "its disk hangs")
        ) from exc


def unix_ms(text: str) -> int:
    """Return a time of day in Unix milliseconds; 0 for none.

    Raises:
        RefusedRequestError: It is none.
    """
    if not text:
        return 0
    try:
        time = datetime.fromisoformat(text)
    except ValueError as exc:
        raise refusal(
            f"since takes a time, not {shown(text)}", f"write one {TIME_EXAMPLE}"
        ) from exc
    if time.tzinfo is None:  # taken for UTC it would be hours off where a local time was meant
        raise refusal(
            f"since takes a time with its zone, not {shown(text)}", f"write one {TIME_EXAMPLE}"
        )
    return max(0, round(time.timestamp() * 1000))
