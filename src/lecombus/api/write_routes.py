"""The routes that write: codes of a drive or a group, verbs, address, acceptance, and stops.

The reload of the roster is one of them. A write is carried out once per `Idempotency-Key`
(`idempotency`).

Stops (`POST /v1/stop` and the verbs `inhibit` and `quick-stop`) are the first routes of the
application, so a stop passes no other. It is refused only for what cannot be guessed: no way to
stop, no target, a body that is no JSON object. The rest is ignored, and the answer lists it in
`ignored`: a query, unknown keys of the body, an `Idempotency-Key` that cannot be kept. A person who
misspelt a key reads so after the drives have stopped. The body of such a verb is not read at all.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from decimal import Decimal
from typing import Final

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from lecombus.api.answers import (
    ProblemDocument,
    RefusedRequestError,
    json_response,
    report_response,
    roster_problem,
)
from lecombus.api.decimal_json import short
from lecombus.api.idempotency import Idempotency, SharedStops, key_mistake, keys_of, time_left
from lecombus.api.limits import STOP_PATH, is_stop
from lecombus.api.refusals import AskedWrite, Refusals
from lecombus.api.request_checks import code_of, read_body, read_stop, refuse_query
from lecombus.api.request_models import (
    AcceptBody,
    AddressBody,
    DriveWriteBody,
    NoKeysBody,
    SpeedBody,
    VerbBody,
    WriteBody,
)
from lecombus.api.scopes import require_target
from lecombus.config import RosterChanges, RosterError
from lecombus.drives import Verb
from lecombus.operations.awaited_requests import refuse_for_gone_client
from lecombus.operations.facade import Operations

__all__ = ["StopRoutes", "WriteRoutes", "with_plain_stop_paths"]

BODIES: Final[Mapping[Verb, type[VerbBody]]] = {
    Verb.ENABLE: VerbBody,
    Verb.SET_SPEED: SpeedBody,
    Verb.RESET_FAULT: VerbBody,
}
"""What a verb takes; the others are stops."""


class WriteRoutes:
    """The routes that write.

    Args:
        ops: What writes to drives.
        keys: The idempotency keys used.
        refusals: Counts what is refused.
        reload: Reads the roster again and applies it.
    """

    def __init__(
        self,
        ops: Operations,
        keys: Idempotency,
        refusals: Refusals,
        reload: Callable[[], Awaitable[RosterChanges]],
    ) -> None:
        self._ops = ops
        self._keys = keys
        self._refusals = refusals
        self._reload = reload

    def routes(self) -> list[Route]:
        """Return the routes."""
        drive = "/v1/drives/{drive}"
        code, subcode = "/codes/{code}", "/codes/{code}/{subcode}"
        return [
            Route(f"{drive}{subcode}", self.write_code, methods=["PUT"]),
            Route(f"{drive}{code}", self.write_code, methods=["PUT"]),
            Route(f"/v1/groups/{{group}}{subcode}", self.write_group, methods=["PUT"]),
            Route(f"/v1/groups/{{group}}{code}", self.write_group, methods=["PUT"]),
            Route(f"{drive}/verbs/{{verb}}", self.do, methods=["POST"]),
            Route(f"{drive}/address", self.address, methods=["POST"]),
            Route(f"{drive}/accept", self.accept, methods=["POST"]),
            Route(f"{drive}/forget-times", self.forget_times, methods=["POST"]),
            Route("/v1/reload", self.reload, methods=["POST"]),
        ]

    async def write_code(self, request: Request) -> Response:
        """A write; answers when its outcome is known."""
        refuse_query(request)
        drive, code = request.path_params["drive"], code_of(request)
        body, raw = await read_body(request, DriveWriteBody)
        left_s = time_left(request, body.expires_s)

        async def act() -> Response:
            report = await self._ops.write(
                drive,
                code,
                body.value,
                expires_s=left_s(),
                verify=bool(body.verify),
                urgency=None if body.priority is None else body.priority.priority,
                restoring=bool(body.restore),
                unless_stopped_since=body.stops,
            )
            return report_response(report)

        write = AskedWrite(drive, code, body.value, restoring=bool(body.restore))
        return await self._keys.run(request, raw, lambda: self._refusals.write("write", write, act))

    async def write_group(self, request: Request) -> Response:
        """A write to every member of a group, with an outcome per member."""
        refuse_query(request)
        group, code = request.path_params["group"], code_of(request)
        body, raw = await read_body(request, WriteBody)
        left_s = time_left(request, body.expires_s)

        async def act() -> Response:
            report = await self._ops.write_group(
                group,
                code,
                body.value,
                expires_s=left_s(),
                verify=body.verify,
            )
            return report_response(report)

        write = AskedWrite(group, code, body.value)
        return await self._keys.run(
            request, raw, lambda: self._refusals.write("group-write", write, act)
        )

    async def do(self, request: Request) -> Response:
        """Have a drive do something: enable, inhibit, quick-stop, set-speed or reset-fault.

        Only set-speed needs a body: `{"value": 35.4, "unit": "Hz"}`.
        """
        drive, verb = request.path_params["drive"], verb_of(request.path_params["verb"])
        refuse_query(request)
        body, raw = await read_body(request, BODIES[verb], may_be_empty=True)
        left_s = time_left(request, body.expires_s)

        async def act() -> Response:
            if not isinstance(body, SpeedBody):
                return report_response(await self._ops.verb(drive, verb, expires_s=left_s()))
            unit = body.unit.strip()
            report = await self._ops.verb(
                drive,
                verb,
                value=Decimal(body.value),
                unit="Hz" if unit.lower() == "hz" else unit,
                expires_s=left_s(),
                verify=bool(body.verify),
            )
            return report_response(report)

        return await self._keys.run(request, raw, lambda: self._refusals.verb(drive, verb, act))

    async def address(self, request: Request) -> Response:
        """Give a drive another address, find it there, and follow it; answers when that is known.

        The roster must allow it, the drive must stand, and nothing may answer at the new address.
        """
        refuse_query(request)
        drive = request.path_params["drive"]
        body, raw = await read_body(request, AddressBody)

        async def act() -> Response:
            refuse_for_gone_client(drive)
            return report_response(await self._ops.readdress(drive, body.address))

        return await self._keys.run(
            request, raw, lambda: self._refusals.other("readdress-asked", drive, act)
        )

    async def accept(self, request: Request) -> Response:
        """Take the drive that is there for the drive of this name; it may be written to then.

        The body repeats its identity as `GET ../identity` gives it under `found`.
        """
        refuse_query(request)
        drive = request.path_params["drive"]
        body, raw = await read_body(request, AcceptBody)

        async def act() -> Response:
            refuse_for_gone_client(drive)
            return json_response(self._ops.accept(drive, body.identity).as_json())

        return await self._keys.run(
            request, raw, lambda: self._refusals.other("accept", drive, act)
        )

    async def forget_times(self, request: Request) -> Response:
        """Forget how long a drive was measured to think; manual and roster count from then on.

        What it takes is measured all the time, so a drive that is slow is soon learnt again.
        """
        refuse_query(request)
        drive = request.path_params["drive"]
        _, raw = await read_body(request, NoKeysBody, may_be_empty=True)

        async def act() -> Response:
            return json_response(self._ops.forget_times(drive).as_json())

        return await self._keys.run(
            request, raw, lambda: self._refusals.other("forget-times", drive, act)
        )

    async def reload(self, request: Request) -> Response:
        """Read the roster again and apply it; answers what changed, or every mistake.

        A wrong roster is refused whole and the old one stays, as a remark on the line says until
        a reload is good. Two reloads run one after the other. Over TCP it needs a token with the
        scope `write` for every drive.
        """
        refuse_query(request)
        _, raw = await read_body(request, NoKeysBody, may_be_empty=True)

        async def act() -> Response:
            try:
                return json_response((await self._reload()).as_json())
            except RosterError as exc:
                return roster_problem(exc).response()

        return await self._keys.run(request, raw, act)


def verb_of(word: str) -> Verb:
    """Return the verb that a path names.

    Raises:
        ProblemError: It names none.
    """
    try:
        return Verb(word)
    except ValueError:
        remedy = f"they are {', '.join(Verb)}"
        raise RefusedRequestError(
            ProblemDocument("no-such-path", f"there is no verb {short(word)}", remedy=remedy)
        ) from None


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


def with_plain_stop_paths(app: ASGIApp) -> ASGIApp:
    """Remove extra slashes around the path of a stop; the router would not find it."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        path = scope["path"] if scope["type"] == "http" else ""
        if is_stop(path) and path != (plain := f"/{path.strip('/')}"):
            scope = {**scope, "path": plain}
        await app(scope, receive, send)

    return answer
