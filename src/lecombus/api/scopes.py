"""What each call needs: one table for the Unix socket and TCP, and the guard that asks it.

Strategy: every route is wrapped by `guarded`; a route without a row in `NEEDS` is a mistake that
ends the start, so no call is open because it was forgotten. The guard runs behind the router: what
it judges is the route and the parts of the path that the route will use, so that no spelling of a
path leads past it. What a request may do is the `grant` of its `Actor`, which the access check of
its socket has set: everything over the Unix socket, reads over TCP without tokens, what the token
says with them (`access`).

A call whose targets stand in its body asks `require_target` itself; its row says so. A token for
some drives is judged once more when the body has come: a reload may have changed a group by then.
A read-only daemon (`api.read_only`) refuses writes at every socket, and no stop.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from functools import wraps
from typing import Final

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import Message

from lecombus.api.answers import ProblemDocument, RefusedRequestError
from lecombus.api.decimal_json import short
from lecombus.api.limits import SparseLog
from lecombus.drives import Family
from lecombus.drives.verbs import may_move
from lecombus.errors import LecombusError
from lecombus.operations.actions import ACTOR
from lecombus.operations.facade import Operations
from lecombus.operations.lease_operations import LEASE
from lecombus.parameters import Code
from lecombus.tokens.grants import Scope

__all__ = [
    "LEASE_HEADER", "NEEDS", "Need", "Of", "guarded", "reaches", "require_drives", "require_target"
]  # fmt: skip

logger = logging.getLogger(__name__)

Endpoint = Callable[[Request], Awaitable[Response]]
FamilyOf = Callable[[str], Family]
"""Gives the family of a drive by its name, or raises an error of lecombus."""


class Of(Enum):
    """What a call is about."""

    NO_DRIVE = auto()
    """No drive, or of several those that the request may see."""
    ALL = auto()
    """The whole line: a token for some drives is not enough."""
    DRIVE = auto()
    """The drive in the path."""
    GROUP = auto()
    """Every member of the group in the path."""
    BODY = auto()
    """Drives or groups in the body; the route asks `require_target`."""


@dataclass(frozen=True, slots=True)
class Need:
    """What a call needs.

    Args:
        scope: The scope; None: `control` or `write`, by the code in the path.
        of: The drives that it is about.
        is_stop: It stops drives: a read-only daemon does that too.
    """

    scope: Scope | None
    of: Of
    is_stop: bool = False


METRICS: Final = Need(Scope.METRICS, Of.NO_DRIVE)
READ: Final = Need(Scope.READ, Of.NO_DRIVE)
READ_ALL: Final = Need(Scope.READ, Of.ALL)
READ_DRIVE: Final = Need(Scope.READ, Of.DRIVE)
WRITE_DRIVE: Final = Need(Scope.WRITE, Of.DRIVE)
CONTROL_DRIVE: Final = Need(Scope.CONTROL, Of.DRIVE)
STOP_DRIVE: Final = Need(Scope.CONTROL, Of.DRIVE, is_stop=True)

DRIVE: Final = "/v1/drives/{drive}"
ADDRESS: Final = "/v1/line/addresses/{address}"
GROUP: Final = "/v1/groups/{group}"
CODE: Final = "/codes/{code}"
SUBCODE: Final = "/codes/{code}/{subcode}"

NEEDS: Final[Mapping[tuple[str, str], Need]] = {
    ("POST", "/v1/stop"): Need(Scope.CONTROL, Of.BODY, is_stop=True),
    ("POST", f"{DRIVE}/verbs/inhibit"): STOP_DRIVE,
    ("POST", f"{DRIVE}/verbs/quick-stop"): STOP_DRIVE,
    ("POST", f"{DRIVE}/verbs/{{verb}}"): CONTROL_DRIVE,
    ("PUT", DRIVE + SUBCODE): Need(None, Of.DRIVE),
    ("PUT", DRIVE + CODE): Need(None, Of.DRIVE),
    ("PUT", GROUP + SUBCODE): Need(None, Of.GROUP),
    ("PUT", GROUP + CODE): Need(None, Of.GROUP),
    ("POST", f"{DRIVE}/address"): WRITE_DRIVE,
    ("POST", f"{DRIVE}/accept"): WRITE_DRIVE,
    ("POST", f"{DRIVE}/forget-times"): WRITE_DRIVE,
    ("PUT", "/v1/leases/{lease}"): Need(Scope.CONTROL, Of.BODY),
    ("DELETE", "/v1/leases/{lease}"): Need(Scope.CONTROL, Of.NO_DRIVE),
    ("GET", "/v1/leases"): READ,
    ("POST", "/v1/reload"): Need(Scope.WRITE, Of.ALL),
    ("GET", "/v1/journal"): READ_ALL,
    ("GET", "/v1/journal/verify"): READ_ALL,
    ("GET", "/v1/line"): READ,
    ("GET", "/v1/drives"): READ,
    ("GET", "/v1/groups"): READ,
    ("GET", DRIVE): READ_DRIVE,
    ("GET", f"{DRIVE}/restore"): READ_DRIVE,
    ("GET", f"{DRIVE}/described"): READ_DRIVE,
    ("GET", DRIVE + SUBCODE): READ_DRIVE,
    ("GET", DRIVE + CODE): READ_DRIVE,
    ("GET", f"{DRIVE}/identity"): READ_DRIVE,
    ("GET", f"{DRIVE}/wear"): READ_DRIVE,
    ("GET", f"{DRIVE}/why"): READ_DRIVE,
    ("GET", ADDRESS + SUBCODE): READ_ALL,
    ("GET", ADDRESS + CODE): READ_ALL,
    ("GET", "/v1/plan"): READ_ALL,
    ("GET", "/v1/events"): READ,
    ("GET", "/metrics"): Need(Scope.METRICS, Of.ALL),
    ("GET", "/healthz"): METRICS,
    ("GET", "/readyz"): METRICS,
    ("GET", "/openapi.json"): METRICS,
}
"""What each call needs, by method and path; `read` includes `metrics`, the two above it `read`."""

LEASE_HEADER: Final = "Lecombus-Lease"

HERE_READ_ONLY: Final = ProblemDocument(
    "read-only",
    "this daemon is read-only: it writes to no drive, except to stop it",
    remedy="the roster says so (`api.read_only`)",
)


def guarded(
    routes: Sequence[Route], ops: Operations, family_of: FamilyOf, *, read_only: bool
) -> list[Route]:
    """Return routes that are answered only to who may ask.

    Args:
        routes: The routes of the application, in order.
        ops: Knows the groups.
        family_of: Knows the families of the drives.
        read_only: Whether all but reads and stops are refused.
    """
    refused = SparseLog(logger, "not-permitted")
    return [with_guard(route, ops, family_of, refused, read_only=read_only) for route in routes]


def with_guard(
    route: Route, ops: Operations, family_of: FamilyOf, refused: SparseLog, *, read_only: bool
) -> Route:
    """Return a route behind the guard."""
    methods = sorted((route.methods or set()) - {"HEAD"})  # HEAD is GET without a body
    needs = {method: NEEDS.get((method, route.path)) for method in methods}
    missing = [method for method, need in needs.items() if need is None]
    assert not missing, f"no row in api.scopes.NEEDS for {', '.join(missing)} {route.path}"
    inner: Endpoint = route.endpoint

    @wraps(inner)
    async def endpoint(request: Request) -> Response:
        method = "GET" if request.method == "HEAD" else request.method
        need = needs[method]
        assert need is not None

        def judge() -> None:
            try:
                check(request, need, ops, family_of, read_only=read_only)
            except RefusedRequestError as exc:
                who = ACTOR.get().fields()
                refused.log(**who, call=f"{method}_{route.path}", reason=exc.problem.kind)
                raise

        async def receive() -> Message:
            message = await request.receive()
            if message["type"] == "http.request" and not message.get("more_body"):
                judge()
            return message

        judge()
        if not need.is_stop:
            LEASE.set(lease_token(request))
        if ACTOR.get().grant.is_whole:
            return await inner(request)
        return await inner(Request(request.scope, receive))

    return Route(route.path, endpoint, methods=methods)


def lease_token(request: Request) -> str:
    """Return the token of a lease that a request carries; empty: none.

    Raises:
        RefusedRequestError: It carries two.
    """
    found = request.headers.getlist(LEASE_HEADER)
    if len(found) > 1:
        text = (
            f"header {LEASE_HEADER} stands {len(found)} times: it is not clear which token to use"
        )
        raise RefusedRequestError(
            ProblemDocument("doubled-header", text, remedy="send the header once")
        )
    return found[0].strip() if found else ""


def check(
    request: Request, need: Need, ops: Operations, family_of: FamilyOf, *, read_only: bool
) -> None:
    """Refuse a request that may not be made.

    Raises:
        RefusedRequestError: `not-permitted` or `read-only`.
    """
    place, grant = request.path_params, ACTOR.get().grant
    if read_only and need.scope not in (Scope.METRICS, Scope.READ) and not need.is_stop:
        raise RefusedRequestError(HERE_READ_ONLY)
    if need.of is Of.DRIVE:
        require_target(place["drive"], ops)
    elif need.of is Of.GROUP:
        require_target(place["group"], ops)
    elif need.of is Of.ALL and not grant.is_whole:
        raise not_permitted("the token is for some drives, and this is about the whole line")
    scope = need.scope
    if scope is None:
        scope = scope_of_write(place, ops, family_of)
    if scope not in grant.scopes:
        raise not_permitted(f"this needs the scope {scope}, which the token does not have", scope)


def scope_of_write(place: Mapping[str, str], ops: Operations, family_of: FamilyOf) -> Scope:
    """Return what the write of a code needs: `control` where one of the drives may move by it.

    A code that is none is refused by the route.
    """
    try:
        subcode = place.get("subcode")
        code = Code.parse(f"{place['code']}/{subcode}" if subcode else place["code"])
    except LecombusError:
        return Scope.WRITE
    names = members_of(place["group"], ops) if "group" in place else (place["drive"],)
    moves = any(ops.is_command(name, code) or may_move(family_of(name), code) for name in names)
    return Scope.CONTROL if moves else Scope.WRITE


def require_target(target: str, ops: Operations) -> None:
    """Refuse what is asked of a drive or a group that the request may not see or move.

    Whether there is such a drive is not said then.

    Raises:
        RefusedRequestError: `not-permitted`.
    """
    if not reaches(members_of(target, ops), ops):
        raise not_permitted(f"the token is not for {short(target)}, or not for all of it")


def require_drives(drives: Sequence[str], ops: Operations) -> None:
    """Refuse what is asked of drives that the request may not see or move.

    Raises:
        RefusedRequestError: `not-permitted`.
    """
    if not reaches(drives, ops):
        raise not_permitted("the token is not for all drives of this lease")


def reaches(drives: Sequence[str], ops: Operations) -> bool:
    """Return whether the request may see and move some drives."""
    grant = ACTOR.get().grant
    return grant.is_whole or grant.reaches(drives, {one.name: one.members for one in ops.groups()})


def members_of(target: str, ops: Operations) -> Sequence[str]:
    """Return the drives of a group, or the drive itself."""
    return next((one.members for one in ops.groups() if one.name == target), (target,))


def not_permitted(why: str, scope: Scope | None = None) -> RefusedRequestError:
    """Return the error for a request that its token does not allow."""
    more = "" if scope is None else f', scope="{scope}"'
    return RefusedRequestError(
        ProblemDocument(
            "not-permitted",
            why,
            remedy="ask who keeps this line's tokens; `lecombus token list` shows their scopes",
            headers={"WWW-Authenticate": f'Bearer error="insufficient_scope"{more}'},
        )
    )
