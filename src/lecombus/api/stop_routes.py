"""Stops over HTTP: `POST /v1/stop`, and the verbs `inhibit` and `quick-stop`.

Strategy: these are the first routes of the application, so a stop passes no other. It is refused
only for what cannot be guessed: no way to stop, no target, a body that is no JSON object. The rest
is ignored, and the answer lists it in `ignored`: a query, unknown keys of the body, an
`Idempotency-Key` that cannot be kept. A person who misspelt a key reads so after the drives have
stopped. The body of a verb is not read at all.
"""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from lecombus.api.answers import report_response
from lecombus.api.decimal_json import short
from lecombus.api.idempotency import SharedStops, key_mistake, keys_of
from lecombus.api.limits import STOP_PATH
from lecombus.api.request_checks import read_stop
from lecombus.api.scopes import require_target
from lecombus.drives import Verb
from lecombus.operations.facade import Operations

__all__ = ["StopRoutes"]


class StopRoutes:
    """The routes of stops.

    Args:
        ops: What stops.
    """

    def __init__(self, ops: Operations) -> None:
        self._ops = ops
        self._shared = SharedStops()

    def routes(self) -> list[Route]:
        """Return the routes; they go before all others."""
        verbs = [
            Route(f"/v1/drives/{{drive}}/verbs/{verb}", endpoint, methods=["POST"])
            for verb, endpoint in ((Verb.INHIBIT, self.inhibit), (Verb.QUICK_STOP, self.quick_stop))
        ]
        return [Route(STOP_PATH, self.stop, methods=["POST"]), *verbs]

    async def stop(self, request: Request) -> Response:
        """Stop a drive, a group or all, before everything else on the line.

        A repeat with the same key shares the result only while the first is under way; after that
        it stops again. What is superfluous in the request is ignored and told in `ignored`.
        """
        body, raw, superfluous = await read_stop(request)
        require_target(body.target, self._ops)
        ignored = (*ignored_of(request), *superfluous)

        async def act() -> Response:
            return report_response(await self._ops.stop(body.action, body.target), ignored)

        return await self._shared.run(request, raw, act)

    async def inhibit(self, request: Request) -> Response:
        """Inhibit a drive; its motor coasts."""
        return await self._verb(request, Verb.INHIBIT)

    async def quick_stop(self, request: Request) -> Response:
        """Stop a drive along its ramp."""
        return await self._verb(request, Verb.QUICK_STOP)

    async def _verb(self, request: Request, verb: Verb) -> Response:
        drive, ignored = request.path_params["drive"], ignored_of(request)

        async def act() -> Response:
            return report_response(await self._ops.verb(drive, verb), ignored)

        return await self._shared.run(request, b"", act)


def ignored_of(request: Request) -> tuple[str, ...]:
    """Return what is ignored of a stop besides its body: its query, and a wrong key."""
    query = request.scope["query_string"].decode("latin-1")
    said = (
        f"a stop takes no query: {short(query)}" if query else "",
        key_mistake(keys_of(request)),
    )
    return tuple(one for one in said if one)
