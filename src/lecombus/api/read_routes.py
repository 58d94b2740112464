"""The routes that read: what is known of line, drives and groups, and reads of the line itself.

Strategy: answers are written straight from the store, and long ones give way to other tasks
between values, so that no request holds the event loop for long. The line is asked only by
`?fresh=true` and for addresses that the roster does not have.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from typing import Final

import anyio
import anyio.lowlevel
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from lecombus.api.answers import ProblemDocument, RefusedRequestError, json_response, text_response
from lecombus.api.decimal_json import encode
from lecombus.api.limits import is_paced
from lecombus.api.request_checks import code_of, read_query, refuse_query
from lecombus.api.request_models import AddressQuery, Urgency, ValueQuery, WhyQuery
from lecombus.api.scopes import reaches
from lecombus.drive_state.readings import DriveInfo, json_value
from lecombus.drive_state.store import Store
from lecombus.drives.descriptions import code_document, family_document
from lecombus.errors import OperationError
from lecombus.operations.actions import ACTOR
from lecombus.operations.facade import Operations
from lecombus.parameters import Json

__all__ = ["ADDRESSES_PATH", "KEEPS_S", "PageCache", "ReadRoutes"]

ADDRESSES_PATH: Final = "/v1/line/addresses"

KEEPS_S: Final = 0.1
"""How long the page of all drives is served again, seconds."""

VALUES_AT_ONCE: Final = 16
"""Values written before other tasks run: about a tenth of a millisecond."""

CODES_AT_ONCE: Final = 8
"""Described codes written before other tasks run: about a third of a millisecond."""


class ReadRoutes:
    """The routes that read.

    Args:
        ops: What reads from the line.
        store: What is known.
        facts: The line's name, port and baud rate.
        plan_facts: What a plan is made from, and what the last minutes showed.
        clock: A monotonic clock, seconds.
    """

    def __init__(
        self,
        ops: Operations,
        store: Store,
        facts: Mapping[str, Json],
        plan_facts: Callable[[], dict[str, Json]],
        clock: Callable[[], float],
    ) -> None:
        self._ops = ops
        self._store = store
        self._facts = facts
        self._plan_facts = plan_facts
        self._every_drive = PageCache(self._drives_text, lambda: store.changes, clock)

    def routes(self) -> list[Route]:
        """Return the routes."""
        drive = "/v1/drives/{drive}"
        address = f"{ADDRESSES_PATH}/{{address}}"
        return [
            Route("/v1/line", self.line),
            Route(drive, self.one_drive),
            Route(f"{drive}/restore", self.restore),
            Route("/v1/groups", self.groups),
            Route("/v1/drives", self.drives),
            Route(f"{drive}/described", self.described_codes),
            Route(f"{drive}/codes/{{code}}/{{subcode}}", self.read_code),
            Route(f"{drive}/codes/{{code}}", self.read_code),
            Route(f"{address}/codes/{{code}}/{{subcode}}", self.read_address),
            Route(f"{address}/codes/{{code}}", self.read_address),
            Route(f"{drive}/identity", self.identity),
            Route(f"{drive}/wear", self.wear),
            Route(f"{drive}/why", self.why),
            Route("/v1/plan", self.plan),
        ]

    async def line(self, request: Request) -> Response:
        """The line: its state, and how many drives are in which state."""
        refuse_query(request)
        states = Counter(info.state.value for info in self._visible())
        line = self._store.line().as_json()
        return json_response({**self._facts, **line, "drives": {**states}})

    async def one_drive(self, request: Request) -> Response:
        """One drive with its state and every value known, with age and quality."""
        refuse_query(request)
        info = self._store.drive(request.path_params["drive"])
        return text_response(await self._drive_text(info))

    async def restore(self, request: Request) -> Response:
        """Whether a backup may be restored into a drive, and what it leaves alone there."""
        refuse_query(request)
        return json_response(self._ops.restore_rights(request.path_params["drive"]).as_json())

    async def groups(self, request: Request) -> Response:
        """Every group, its members and whether it is spoken to by multicast."""
        refuse_query(request)
        found = [one for one in self._ops.groups() if reaches(one.members, self._ops)]
        return json_response({"groups": [one.as_json() for one in found]})

    async def drives(self, request: Request) -> Response:
        """Every drive with its state and every value known, with age and quality.

        Values and ages may be 0.1 s behind; states, failures and writes never are.
        """
        refuse_query(request)
        if ACTOR.get().grant.is_whole:
            return text_response(await self._every_drive.get())
        return text_response(await self._drives_text())

    async def described_codes(self, request: Request) -> Response:
        """What is known of a drive's codes: names, ranges, selections, where they are stored."""
        refuse_query(request)
        drive = request.path_params["drive"]
        family = self._store.family(drive)
        texts = []
        for number, info in enumerate(family.described()):
            if number % CODES_AT_ONCE == 0:
                await anyio.lowlevel.checkpoint()
            texts.append(encode(code_document(family, info)))
        head = encode({"drive": drive, **family_document(family)})
        return text_response(head[:-1] + ', "codes": [' + ", ".join(texts) + "]}")

    async def read_code(self, request: Request) -> Response:
        """A value from the store, or read now."""
        query = read_query(request, ValueQuery)
        drive, code = request.path_params["drive"], code_of(request)
        if query.fresh:
            urgency = urgency_of(request, query.priority)
            read = await self._ops.read(
                drive, code, priority=urgency.priority, timeout_s=urgency.timeout_s
            )
            return json_response(read.as_json())
        reading = self._store.reading(drive, code) or self._store.unread(drive, code)
        return json_response(reading.as_json())

    async def read_address(self, request: Request) -> Response:
        """What answers at an address that the roster does not have; Unix socket only."""
        query = read_query(request, AddressQuery)
        code, number = code_of(request), number_of(request.path_params["address"])
        heard = await self._ops.read_address(
            number,
            code,
            addressing=query.addressing,
            family_name=query.family,
            patient=query.patient,
        )
        value = heard.value
        return json_response(
            {
                "address": number,
                "code": f"C{code.number:04d}",
                "subcode": code.subcode,
                "heard": heard.kind.value,
                "value": None if value is None else json_value(value),
                "raw": None if value is None else value.raw,
                "format": None if value is None else value.format.value,
                "received": heard.received.hex() or None,
                "disturbances": heard.disturbances,
            }
        )

    async def identity(self, request: Request) -> Response:
        """Who a drive is by its own word, by the record, and by the roster."""
        refuse_query(request)
        return json_response(self._ops.identity(request.path_params["drive"]).as_json())

    async def wear(self, request: Request) -> Response:
        """How often the codes that wear a drive's memory were written, for ever."""
        refuse_query(request)
        return json_response(self._ops.wear(request.path_params["drive"]).as_json())

    async def why(self, request: Request) -> Response:
        """Why a drive does not turn: what is known to keep it from that, and what to do next."""
        query = read_query(request, WhyQuery)
        report = await self._ops.why(
            request.path_params["drive"],
            fresh=query.fresh,
            priority=urgency_of(request, Urgency.INTERACTIVE).priority,
        )
        return json_response(report.as_json(query.lang))

    async def plan(self, request: Request) -> Response:
        """What a plan is made from, and what the last five minutes showed; sends nothing."""
        refuse_query(request)
        return json_response(self._plan_facts())

    def _visible(self) -> list[DriveInfo]:
        """Return the drives that the request may see."""
        return [info for info in self._store.drives() if reaches((info.name,), self._ops)]

    async def _drives_text(self) -> bytes:
        texts = []
        for info in self._visible():
            with contextlib.suppress(OperationError):  # a reload took it out in between
                texts.append(await self._drive_text(info))
        return ('{"drives": [' + ", ".join(texts) + "]}").encode()

    async def _drive_text(self, info: DriveInfo) -> str:
        """Return a drive with its values as JSON text, giving way to other tasks in between."""
        texts = [text async for text in self._value_texts(info.name)]
        head, motion = encode(info.as_json()), encode(self._store.motion(info.name).as_json())
        return f'{head[:-1]}, "motion": {motion}, "values": [{", ".join(texts)}]}}'

    async def _value_texts(self, drive: str) -> AsyncIterator[str]:
        family = self._store.family(drive)
        shown = (code for code in self._store.codes(drive) if not family.is_secret(code))
        for number, code in enumerate(shown):
            if number % VALUES_AT_ONCE == 0:
                await anyio.lowlevel.checkpoint()
            reading = self._store.reading(drive, code)
            if reading is not None:
                yield encode(reading.as_json())


def urgency_of(request: Request, asked: Urgency) -> Urgency:
    """Return how soon a request's reads run: over TCP, where anybody may ask, never ahead.

    A module's own code takes the line for up to 0.5 s, and `why` reads a dozen codes: as
    interactive requests they took a quarter of the margin that feeds have before the watchdogs act.
    """
    return Urgency.BACKGROUND if is_paced(request.scope) else asked


def number_of(address: str) -> int:
    """Return the address that a path names.

    Raises:
        ProblemError: It names none.
    """
    if not (address.isascii() and address.isdecimal() and len(address) <= 2):
        raise RefusedRequestError(
            ProblemDocument(
                "no-such-address", f"{address!r} is not an address", remedy="it is 1 to 99"
            )
        )
    return int(address)


class PageCache:
    """A page that many clients ask for, rendered once for all of them.

    Rendering every drive with every value takes milliseconds of a full line's time, and a hundred
    clients may ask for it over and over. So it is kept for `KEEPS_S`, and requests that come while
    it is rendered wait for that rendering. A kept page is never wrong about states: when a drive or
    the line changed its state, a value could not be read or was written, it is rendered again. Only
    values read in between may be missing, and ages be too small by that time.

    Args:
        render: Makes the page.
        changes: A number that changes when the kept page would be wrong.
        clock: A monotonic clock, seconds.
    """

    def __init__(
        self,
        render: Callable[[], Awaitable[bytes]],
        changes: Callable[[], int],
        clock: Callable[[], float],
    ) -> None:
        self._render = render
        self._changes = changes
        self._clock = clock
        self._page = b""
        self._begun_s = 0.0  # when the rendering of the page began
        self._changes_then = 0
        self._begun = 0  # renderings begun
        self._number = 0  # which of them the page is; 0: there is none
        self._rendering: anyio.Event | None = None

    async def get(self) -> bytes:
        """Return a page that was begun after this was asked, or is still good."""
        begun_before = self._begun
        while self._number <= begun_before and not self._is_good():
            if self._rendering is not None:
                await self._rendering.wait()
            else:
                await self._make()
        return self._page

    def _is_good(self) -> bool:
        age_s = self._clock() - self._begun_s
        return self._number > 0 and age_s < KEEPS_S and self._changes() == self._changes_then

    async def _make(self) -> None:
        self._rendering = anyio.Event()
        self._begun += 1
        number, begun_s, changes = self._begun, self._clock(), self._changes()
        try:
            self._page = await self._render()
            self._number, self._begun_s, self._changes_then = number, begun_s, changes
        finally:
            self._rendering.set()
            self._rendering = None
