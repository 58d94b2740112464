"""The route of the events: `GET /v1/events`, an answer without end.

Its form is that of server-sent events (WHATWG HTML 9.2), as a browser's `EventSource` reads them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from lecombus.api.event_readers import OUTLET, EventReaders
from lecombus.api.limits import EVENTS_PATH
from lecombus.api.request_checks import read_query, refusal
from lecombus.api.request_models import EventQuery
from lecombus.api.scopes import members_of, require_target
from lecombus.drive_state.store import Store
from lecombus.errors import meant
from lecombus.event_stream import KINDS, EventFilter
from lecombus.operations.actions import ACTOR
from lecombus.operations.facade import Operations

__all__ = ["EVENTS_TYPE", "EventRoutes"]

EVENTS_TYPE: Final = "text/event-stream"

LAST_ID: Final = "last-event-id"


class EventRoutes:
    """The route of the events.

    Args:
        readers: All who read.
        ops: Knows the groups.
        store: Knows the drives.
    """

    def __init__(self, readers: EventReaders, ops: Operations, store: Store) -> None:
        self._readers = readers
        self._ops = ops
        self._store = store

    def routes(self) -> list[Route]:
        """Return the routes."""
        return [Route(EVENTS_PATH, self.events)]

    async def events(self, request: Request) -> Response:
        """What happens, as server-sent events, until the client goes.

        Values as they change, and each cyclic one every 30 s; states, remarks, faults, writes,
        leases, the line. After a drop the header `Last-Event-ID` (or `last_event_id`) gives what
        came since, or first an event `gap`. The answer begins with the id from which it reads on;
        `GET /v1/drives` gives what is known by then.
        """
        query = read_query(request, EventQuery)
        over_tcp = ACTOR.get().who == "tcp"
        self._readers.require_room(over_tcp=over_tcp)
        last_id = request.headers.get(LAST_ID, query.last_event_id)
        wanted, words = self._filter(query), words_of(query.drive)

        def still_holds() -> bool:  # a reload may change what a group is
            return (self._drives_of(words), self._visible()) == (wanted.drives, wanted.visible)

        names_no_group = wanted.visible is None and wanted.drives == set(words)
        return EventResponse(
            self._readers, wanted, last_id, None if names_no_group else still_holds,
            over_tcp=over_tcp,
        )  # fmt: skip

    def _filter(self, query: EventQuery) -> EventFilter:
        """Return what a request may and wants to read."""
        kinds = words_of(query.kind)
        for kind in kinds:
            if kind not in KINDS:
                raise refusal(f"there are no events of kind {kind}", meant(kind, KINDS, "kinds"))
        names = words_of(query.drive)
        for name in names:
            require_target(name, self._ops)
            if members_of(name, self._ops) == (name,):
                self._store.family(name)  # there is such a drive
        return EventFilter(self._drives_of(names), frozenset(kinds), self._visible())

    def _drives_of(self, names: Sequence[str]) -> frozenset[str]:
        """Return drives, and for each group its members."""
        if not names:
            return frozenset()
        groups = {one.name: one.members for one in self._ops.groups()}
        return frozenset(drive for name in names for drive in groups.get(name, (name,)))

    def _visible(self) -> frozenset[str] | None:
        """Return the drives that the client may see; None: all."""
        grant = ACTOR.get().grant
        if grant.is_whole:
            return None
        groups = {one.name: one.members for one in self._ops.groups()}
        return frozenset(name for name in self._store.names() if grant.reaches((name,), groups))


class EventResponse(Response):
    """An answer that goes on until the client is gone.

    Args:
        readers: All who read.
        wanted: Which events it carries.
        last_id: The last event that the client had.
        still_holds: Whether it would carry the same events if it were asked for now; None: always.
        over_tcp: Whether the client came over TCP.
    """

    def __init__(
        self,
        readers: EventReaders,
        wanted: EventFilter,
        last_id: str,
        still_holds: Callable[[], bool] | None,
        *,
        over_tcp: bool,
    ) -> None:
        super().__init__(media_type=EVENTS_TYPE)
        self._readers = readers
        self._wanted = wanted
        self._last_id = last_id
        self._still_holds = still_holds
        self._over_tcp = over_tcp

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the head, and events until the end."""
        headers = [
            (b"content-type", EVENTS_TYPE.encode()),
            (b"cache-control", b"no-store"),
            (b"x-accel-buffering", b"no"),  # a proxy must not collect them
        ]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        if scope["method"] != "HEAD":

            async def check() -> bool:
                if self._over_tcp:  # the door's `send` ends the answer of a revoked token
                    await send({"type": "http.response.body", "body": b"", "more_body": True})
                return self._still_holds is None or self._still_holds()

            checked = self._over_tcp or self._still_holds is not None
            await self._readers.read(
                scope[OUTLET], self._wanted, self._last_id, check if checked else None,
                over_tcp=self._over_tcp,
            )  # fmt: skip
        await send({"type": "http.response.body", "body": b""})


def words_of(text: str) -> Sequence[str]:
    """Return the words of a list with commas, each once: a client may send very many."""
    return tuple(dict.fromkeys(word for part in text.split(",") if (word := part.strip())))
