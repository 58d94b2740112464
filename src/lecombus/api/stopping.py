"""The stop, by the long way: what is plain is answered before (`stops`).

A stop must go through. So it is refused only for what cannot be guessed: no way to stop, no target,
a body that is no JSON object. Whatever else is wrong with the request (a query, keys of the body
that nobody knows, an `Idempotency-Key` that cannot be kept) is ignored, and the answer says so in
`ignored`: whoever misspelt a key finds out, after the drives stand.

What must not live here: what a stop is (`operations`), how its body is judged (`bodies`).
"""

from __future__ import annotations

from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import REFUSALS, Key, content_of, described, group_response
from lecombus.api.bodies import StopBody
from lecombus.api.checking import read_stop
from lecombus.api.documents import GroupOutcomeDocument
from lecombus.api.exact import short
from lecombus.api.idempotency import SharedStops, key_mistake
from lecombus.api.seam import OperationsPort

__all__ = ["add_stop", "ignored_of"]


def add_stop(app: FastAPI, ops: OperationsPort) -> None:
    """Add the path."""
    stops = SharedStops()

    @app.post("/v1/stop", **described(GroupOutcomeDocument, *REFUSALS, body=StopBody))
    async def stop(request: Request, key: Key = None) -> Response:
        """Stop a drive, a group or all, before everything else on the line.

        A repeat with the same key shares the result only while the first is under way; after that
        it stops again. What is superfluous in the request is ignored and told in `ignored`.
        """
        body, raw, superfluous = await read_stop(request)
        ignored = (*ignored_of(request, key), *superfluous)

        async def act() -> Response:
            return group_response(await ops.stop(body.action, body.target), ignored)

        return await stops.run(key, content_of(request, raw), act)


def ignored_of(request: Request, key: str | None) -> tuple[str, ...]:
    """Return what is ignored of a stop besides its body: its query, and a key that is none."""
    query = request.scope["query_string"].decode("latin-1")
    said = (
        f"a stop takes no query: {short(query)}" if query else "",
        "" if key is None else key_mistake(key),
    )
    return tuple(one for one in said if one)
