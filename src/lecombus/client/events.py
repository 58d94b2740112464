"""The events of a line, one after the other, also across a connection that breaks.

Strategy: an answer of server-sent events (WHATWG HTML 9.2) is read line by line. When it breaks,
the next request names the last event that came (`Last-Event-ID`), and the daemon goes on behind it,
or says with an event `gap` that some are missing. A daemon that stays away for too long is an
error: who waits for a trip must know that none can come.
"""

from __future__ import annotations

import json
import math
import ssl
from collections.abc import AsyncGenerator, Iterator, Mapping
from contextlib import aclosing
from dataclasses import dataclass
from decimal import Decimal
from typing import Final

import anyio
import httpx2

from lecombus.client.connection import CONNECT_WITHIN_S, Connection, problem_error
from lecombus.client.documents import Document, Reading, text_of
from lecombus.client.errors import ClientError, UnreachableError

__all__ = ["Event", "FrameReader", "read_events"]

SILENT_S: Final = 40.0
"""The daemon says something every 15 s, if only that it is there."""

FIRST_PAUSE_S: Final = 0.1
LONGEST_PAUSE_S: Final = 2.0

BYTES_LIMIT: Final = 1 << 20
"""Of one line; no event is a hundredth of it."""

EVENTS_TYPE: Final = "text/event-stream"

PASSING: Final = frozenset((429, 502, 503, 504))
"""HTTP statuses that may be better the next time."""


@dataclass(frozen=True, slots=True)
class Event:
    """One event.

    Args:
        id: What `Line.events` takes as `after` to go on behind it.
        kind: `value`, `state`, `remark`, `trip`, `write`, `lease` or `line`; `gap`: some events
            are missing.
        drive: The drive or group that it is about; empty: the line.
        data: What happened, as docs/api.md describes it; decimals as `Decimal`.
    """

    id: str
    kind: str
    drive: str
    data: Document

    @property
    def reading(self) -> Reading:
        """The value of an event of kind `value`.

        Raises:
            ClientError: It is of another kind.
        """
        if self.kind != "value":
            raise ClientError(f"an event of kind {self.kind} has no value")
        return Reading.of(self.data)


class FrameReader:
    """Turns bytes into events.

    Attributes:
        last_id: The last id that came, also one without an event.
    """

    def __init__(self, last_id: str = "") -> None:
        self.last_id = last_id
        self._rest = b""
        self._id = last_id
        self._kind = ""
        self._data: list[str] = []

    def feed(self, data: bytes) -> Iterator[Event]:
        """Take bytes, and give the events that are complete with them.

        Raises:
            UnreachableError: They are not events.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > BYTES_LIMIT:
            raise UnreachableError("what the daemon sends are not events", "look at the URL")
        for line in lines:
            event = self._take(line.decode(errors="replace").removesuffix("\r"))
            if event is not None:
                yield event

    def _take(self, line: str) -> Event | None:
        if not line:
            return self._end()
        name, _, text = line.partition(":")
        text = text.removeprefix(" ")
        if name == "id":
            self._id = text
        elif name == "event":
            self._kind = text
        elif name == "data":
            self._data.append(text)
        return None

    def _end(self) -> Event | None:
        """End a frame; one without data only says where the stream is."""
        kind, text = self._kind, "\n".join(self._data)
        self.last_id = self._id
        self._kind, self._data = "", []
        if not text:
            return None
        try:
            data = json.loads(text, parse_float=Decimal)
        except ValueError as exc:
            raise UnreachableError(
                "what the daemon sends are not events", "look at its log"
            ) from exc
        found: Document = data if isinstance(data, dict) else {"data": data}
        return Event(self.last_id, kind or "message", text_of(found, "drive"), found)


async def read_events(
    connection: Connection, params: Mapping[str, str], after: str, patience_s: float
) -> AsyncGenerator[Event, None]:
    """Give events, for as long as the daemon can be reached.

    Args:
        connection: Speaks with the daemon.
        params: The query of `GET /v1/events`.
        after: The id of the last event had; empty: begin now.
        patience_s: How long the daemon may be away, seconds.

    Raises:
        ProblemError: The daemon refuses.
        UnreachableError: It is away for longer, or was not there at the beginning.
    """
    last_id, heard_s, pause_s = after, -math.inf, 0.0
    while True:
        frames, asked_s = FrameReader(last_id), anyio.current_time()
        try:
            async with aclosing(answer_bytes(connection, params, last_id)) as answer:
                async for data in answer:
                    heard_s, pause_s = anyio.current_time(), 0.0
                    for event in frames.feed(data):
                        yield event
                    last_id = frames.last_id
        except UnreachableError as exc:
            may_pass = isinstance(exc.__cause__, httpx2.HTTPError | ssl.SSLError | PassingError)
            if not may_pass or anyio.current_time() - heard_s >= patience_s:
                raise
        if heard_s < asked_s and anyio.current_time() - heard_s >= patience_s:
            problem = f"the daemon at {connection.where} says nothing: its answers end"
            raise UnreachableError(problem, "look at its log")
        # An answer that ends: the daemon stops, or has dropped a reader that was too slow.
        pause_s = min(max(FIRST_PAUSE_S, 2 * pause_s), LONGEST_PAUSE_S)
        await anyio.sleep(pause_s)


class PassingError(Exception):
    """The daemon cannot give events just now."""


async def answer_bytes(
    connection: Connection, params: Mapping[str, str], last_id: str
) -> AsyncGenerator[bytes, None]:
    """Ask for events, and give the bytes of the answer as they come.

    Raises:
        ProblemError: The daemon refuses.
        UnreachableError: It cannot be reached, or refuses for now.
    """
    headers = {"accept": EVENTS_TYPE} | ({"last-event-id": last_id} if last_id else {})
    timeout = httpx2.Timeout(CONNECT_WITHIN_S, read=SILENT_S)
    try:
        async with connection.http.stream(
            "GET", "/v1/events", params=params, headers=headers, timeout=timeout
        ) as response:
            if response.status_code != 200:
                await response.aread()
                problem = refusal_of(connection, response)
                if response.status_code in PASSING:
                    text = f"the daemon at {connection.where} gives no events: {problem.problem}"
                    raise UnreachableError(text, problem.remedy, problem.kind) from PassingError()
                raise problem
            if not response.headers.get("content-type", EVENTS_TYPE).startswith(EVENTS_TYPE):
                text = f"what answers at {connection.where} is not lecombus, or gives no events"
                raise UnreachableError(text, "look at the address and the port")
            async for data in response.aiter_bytes():
                yield data
    except (httpx2.HTTPError, ssl.SSLError) as exc:
        raise connection.unreachable(exc) from exc


def refusal_of(connection: Connection, response: httpx2.Response) -> ClientError:
    """Return the error that an answer without events stands for; a proxy's is none of lecombus."""
    try:
        return problem_error(connection.answer_of(response))
    except UnreachableError as exc:
        return exc
