"""The routes of leases: take, renew, take over, give up, and who holds which.

A renewal is short and waits for nothing, so that a full line does not end a lease. The token of a
lease is in the answer to who takes it, in the body of a renewal, and in the header `Lecombus-Lease`
of writes and of `DELETE`; no other answer and no log has it.
"""

from __future__ import annotations

from typing import Final

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from lecombus.api.answers import ProblemDocument, RefusedRequestError, json_response
from lecombus.api.decimal_json import short
from lecombus.api.limits import LEASES_PATH
from lecombus.api.request_checks import read_body, refuse_query
from lecombus.api.request_models import NAME, LeaseBody
from lecombus.api.scopes import LEASE_HEADER, reaches, require_drives, require_target
from lecombus.leases import HeldLease
from lecombus.operations.facade import Operations
from lecombus.operations.lease_operations import LEASE, Leases

__all__ = ["LeaseRoutes"]

NAME_REMEDY: Final = "1 to 60 letters, digits, `.`, `_` and `-` make a name"


class LeaseRoutes:
    """The routes of leases.

    Args:
        ops: Knows the drives and has the leases.
    """

    def __init__(self, ops: Operations) -> None:
        self._ops = ops

    @property
    def _leases(self) -> Leases:
        return self._ops.leases

    def routes(self) -> list[Route]:
        """Return the routes."""
        return [
            Route(LEASES_PATH, self.leases),
            Route(f"{LEASES_PATH}/{{lease}}", self.take_or_renew, methods=["PUT"]),
            Route(f"{LEASES_PATH}/{{lease}}", self.release, methods=["DELETE"]),
        ]

    async def leases(self, request: Request) -> Response:
        """The leases that are held, and the drives that need one or are latched.

        No answer has a token.
        """
        refuse_query(request)
        seen = [lease for lease in self._leases.held() if reaches(lease.drives, self._ops)]
        drives = [
            one for one in self._leases.drives_json() if reaches((str(one["drive"]),), self._ops)
        ]
        return json_response(
            {"leases": [self._leases.lease_json(lease) for lease in seen], "drives": [*drives]}
        )

    async def take_or_renew(self, request: Request) -> Response:
        """Take a lease, take one over by its name, or renew one.

        To take: `{"targets": ["feeder"], "time": "2s", "counter": 1}`; with `take_over` the named
        lease ends and its token counts no more. To renew: `{"token": "..", "counter": 2}`, with a
        larger counter each time. The drives stop when `time` passes without a renewal.
        """
        refuse_query(request)
        body, _ = await read_body(request, LeaseBody)
        name = lease_name(request)
        if not body.is_right:
            text = "targets and time take a lease, a token alone renews it"
            raise refused(text, f"send {body.example}")
        self._check_reach(name)
        if body.token is not None:
            lease = self._leases.renew(name, body.token, body.counter)
            return json_response(self._leases.lease_json(lease, token=True))
        return json_response(self._leases.lease_json(self._take(name, body), token=True))

    def _take(self, name: str, body: LeaseBody) -> HeldLease:
        if body.take_over:
            self._check_reach(body.take_over)
        drives: list[str] = []
        for target in body.targets or ():
            require_target(target, self._ops)
            drives += self._ops.context.members(target)
        return self._leases.take(
            name, body.targets or (), drives, body.time_s, body.counter, body.take_over or ""
        )

    def _check_reach(self, name: str) -> None:
        """Refuse a lease that is held for drives that the request may not move."""
        for lease in self._leases.held():
            if lease.name == name:
                require_drives(lease.drives, self._ops)

    async def release(self, request: Request) -> Response:
        """Give a lease up; its token is in the header `Lecombus-Lease`.

        Drives that need a lease are stopped as if it had lapsed.
        """
        refuse_query(request)
        name = lease_name(request)
        self._check_reach(name)
        token = LEASE.get()
        if not token:
            raise refused(
                f"the request has no token of lease {name}: it was not given up",
                f"send the token in the header {LEASE_HEADER}",
            )
        lease = self._leases.release(name, token)
        return json_response(
            {"name": lease.name, "number": lease.number, "drives": list(lease.drives)}
        )


def lease_name(request: Request) -> str:
    """Return the lease's name in the path.

    Raises:
        RefusedRequestError: It is none.
    """
    name: str = request.path_params["lease"]
    if NAME.fullmatch(name) is None:
        raise refused(f"{short(name)!r} is not a name of a lease", NAME_REMEDY)
    return name


def refused(text: str, remedy: str) -> RefusedRequestError:
    """Return the error for a request that is not as it should be."""
    return RefusedRequestError(ProblemDocument("bad-request", text, remedy=remedy))
