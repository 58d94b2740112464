"""The paths of what is known, and reads.

Strategy: answers are written straight from the store, and lists give others their turn between
drives, so that no request holds up the loop for long. Only `?fresh=true` asks the line.

What must not live here: what is written to drives (`writing`), how an answer looks (`documents`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Annotated, Final

import anyio.lowlevel
from fastapi import FastAPI, Query
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import code_of, described, group_json, json_response, text_response
from lecombus.api.bodies import RIGHT, Urgency
from lecombus.api.checking import check_query
from lecombus.api.documents import (
    DriveDocument,
    DrivesDocument,
    GroupsDocument,
    LineDocument,
    ReadingDocument,
    RestoreDocument,
)
from lecombus.api.exact import encode
from lecombus.api.pages import KeptPage
from lecombus.api.seam import OperationsPort
from lecombus.readings import DriveInfo, Json
from lecombus.store import Store

__all__ = ["add_drive_list", "add_known", "add_reads"]

VALUES_AT_ONCE: Final = 16
"""Values written before others get their turn: about a tenth of a millisecond."""


def add_known(
    app: FastAPI,
    store: Store,
    facts: Mapping[str, Json],
    ops: OperationsPort,
) -> None:
    """Add what is known now: line, drives, drive, groups."""

    @app.get("/v1/line", **described(LineDocument, 422))
    async def line(request: Request) -> Response:
        """The line: its state, and how many drives are in which state."""
        check_query(request)
        states = Counter(info.state.value for info in store.drives())
        return json_response({**facts, **store.line().as_json(), "drives": {**states}})

    @app.get("/v1/drives/{drive}", **described(DriveDocument, 404, 422))
    async def one_drive(request: Request, drive: str) -> Response:
        """One drive with its state and every value known, with age and quality."""
        check_query(request)
        return text_response(await drive_text(store, store.drive(drive)))

    @app.get("/v1/drives/{drive}/restore", **described(RestoreDocument, 404, 422))
    async def restore(request: Request, drive: str) -> Response:
        """Whether a backup may be restored into a drive, and what it leaves alone there."""
        check_query(request)
        return json_response(ops.restore_rights(drive).as_json())

    @app.get("/v1/groups", **described(GroupsDocument, 422))
    async def groups(request: Request) -> Response:
        """Every group, its members and whether it is spoken to by multicast."""
        check_query(request)
        return json_response({"groups": [group_json(one) for one in ops.groups()]})


def add_drive_list(app: FastAPI, store: Store, clock: Callable[[], float]) -> None:
    """Add the list of all drives, which is written once for all who ask at the same time."""

    async def every_drive() -> bytes:
        texts = [await drive_text(store, info) for info in store.drives()]
        return ('{"drives": [' + ", ".join(texts) + "]}").encode()

    page = KeptPage(every_drive, lambda: store.changes, clock)

    @app.get("/v1/drives", **described(DrivesDocument, 422))
    async def drives(request: Request) -> Response:
        """Every drive with its state and every value known, with age and quality.

        Values and ages may be 0.1 s behind; states, failures and writes never are.
        """
        check_query(request)
        return text_response(await page.get())


def add_reads(app: FastAPI, ops: OperationsPort, store: Store) -> None:
    """Add the reads of codes."""
    told = described(ReadingDocument, 404, 409, 422, 502, 503, 504)

    @app.get("/v1/drives/{drive}/codes/{code}", **told)
    @app.get("/v1/drives/{drive}/codes/{code}/{subcode}", **told)
    async def read_code(
        request: Request,
        drive: str,
        code: str,
        subcode: str = "",
        fresh: Annotated[bool, Query(description="Read it now")] = False,
        priority: Annotated[Urgency, Query(description=RIGHT["priority"])] = Urgency.INTERACTIVE,
    ) -> Response:
        """A value from the store, or read now."""
        check_query(request, ("fresh", "priority"))
        wanted = code_of(code, subcode)
        if fresh:
            read = await ops.read(
                drive, wanted, priority=priority.priority, timeout_s=priority.timeout_s
            )
            return json_response(read.as_json())
        reading = store.reading(drive, wanted) or store.unread(drive, wanted)
        return json_response(reading.as_json())


async def drive_text(store: Store, info: DriveInfo) -> str:
    """Return a drive with its values as JSON text, letting others run now and then."""
    texts = [text async for text in value_texts(store, info.name)]
    motion = encode(store.motion(info.name).as_json())
    return f'{encode(info.as_json())[:-1]}, "motion": {motion}, "values": [{", ".join(texts)}]}}'


async def value_texts(store: Store, drive: str) -> AsyncIterator[str]:
    """Yield every value of a drive as JSON text."""
    for number, code in enumerate(store.codes(drive)):
        if number % VALUES_AT_ONCE == 0:
            await anyio.lowlevel.checkpoint()
        reading = store.reading(drive, code)
        if reading is not None:
            yield encode(reading.as_json())
