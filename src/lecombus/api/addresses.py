"""Asking addresses that the roster does not have, for a scan through the daemon.

A question that goes out to whoever may be there, and may be anybody's: on the Unix socket only
(`server` keeps it off TCP), in the background class, and never a write.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import FastAPI, Query
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import code_of, described, json_response
from lecombus.api.checking import check_query
from lecombus.api.documents import HeardDocument
from lecombus.api.problems import Problem, ProblemError
from lecombus.api.seam import OperationsPort
from lecombus.protocol.addressing import Form
from lecombus.readings import json_value

__all__ = ["ADDRESSES_PATH", "add_addresses"]

ADDRESSES_PATH = "/v1/line/addresses"


def add_addresses(app: FastAPI, ops: OperationsPort) -> None:
    """Add the reads of addresses."""
    told = described(HeardDocument, 403, 404, 409, 422, 503)
    path = f"{ADDRESSES_PATH}/{{address}}/codes/{{code}}"

    @app.get(path, **told)
    @app.get(path + "/{subcode}", **told)
    async def read_address(
        request: Request,
        address: str,
        code: str,
        subcode: str = "",
        addressing: Annotated[str, Query(description="standard or extended")] = "standard",
        family: Annotated[str, Query(description="By whose answer times to wait")] = "generic",
        patient: Annotated[bool, Query(description="Wait longer than any family needs")] = False,
    ) -> Response:
        """What answers at an address that the roster does not have; Unix socket only."""
        check_query(request, ("addressing", "family", "patient"))
        wanted, number = code_of(code, subcode), number_of(address)
        heard = await ops.read_address(
            number, wanted, form=form_of(addressing), family_name=family, patient=patient
        )
        value = heard.value
        return json_response(
            {
                "address": number,
                "code": f"C{wanted.number:04d}",
                "subcode": wanted.subcode,
                "heard": heard.kind.value,
                "value": None if value is None else json_value(value),
                "raw": None if value is None else value.raw,
                "format": None if value is None else value.format.value,
                "received": heard.received.hex() or None,
                "disturbances": heard.disturbances,
            }
        )


def number_of(address: str) -> int:
    """Return the address a path names.

    Raises:
        ProblemError: It names none.
    """
    if not (address.isascii() and address.isdecimal() and len(address) <= 2):
        raise ProblemError(
            Problem("no-such-address", f"{address!r} is no address", remedy="it is 1 to 99")
        )
    return int(address)


def form_of(addressing: str) -> Form:
    """Return the addressing form a query names.

    Raises:
        ProblemError: It names none.
    """
    try:
        return Form(addressing)
    except ValueError as exc:
        known = "standard or extended"
        raise ProblemError(
            Problem("bad-request", f"addressing takes {known}", remedy=f"give {known}")
        ) from exc
