"""The paths of verbs: what a person wants of a drive, in a person's words.

`inhibit` and `quick-stop` are stops: no body is looked at, so that none can be wrong, a query or a
key that is none is ignored (`stopping`), they are never refused for there being too many requests,
and a repeat with the same `Idempotency-Key` stops again once the first is over. The others are done
once per key.

What must not live here: what a verb comes to (`drives`), how it is carried out (`operations`).
"""

from __future__ import annotations

from collections.abc import Awaitable, Mapping, Sequence
from decimal import Decimal
from typing import Final

from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import (
    REFUSALS,
    Key,
    content_of,
    described,
    ignored_json,
    json_response,
)
from lecombus.api.bodies import SpeedBody, VerbBody
from lecombus.api.checking import check_query, read_body
from lecombus.api.documents import VerbDocument
from lecombus.api.exact import short
from lecombus.api.idempotency import Idempotency, SharedStops
from lecombus.api.problems import Problem, ProblemError, verb_problem
from lecombus.api.seam import OperationsPort, VerbReport
from lecombus.api.stopping import ignored_of
from lecombus.drives import Verb
from lecombus.readings import Json

__all__ = ["add_verbs"]

BODIES: Final[Mapping[Verb, type[VerbBody]]] = {
    Verb.ENABLE: VerbBody,
    Verb.SET_SPEED: SpeedBody,
    Verb.RESET_FAULT: VerbBody,
}
"""What a verb takes; those that are not here are stops."""


def add_verbs(app: FastAPI, ops: OperationsPort, keys: Idempotency) -> None:
    """Add the paths."""
    stops = SharedStops()
    told = described(VerbDocument, *REFUSALS, body=SpeedBody)
    told["openapi_extra"]["requestBody"]["required"] = False

    @app.post("/v1/drives/{drive}/verbs/{verb}", **told)
    async def do(request: Request, drive: str, verb: str, key: Key = None) -> Response:
        """Have a drive do something: enable, inhibit, quick-stop, set-speed or reset-fault.

        Only set-speed needs a body: `{"value": 35.4, "unit": "Hz"}`.
        """
        wanted = verb_of(verb)
        model = BODIES.get(wanted)
        if model is None:
            ignored = ignored_of(request, key)
            return await stops.run(
                key, content_of(request, b""), lambda: answered(ops.verb(drive, wanted), ignored)
            )
        check_query(request)
        body, raw = await read_body(request, model, may_be_empty=True)
        return await keys.run(
            key, content_of(request, raw), lambda: answered(carry_out(ops, drive, wanted, body))
        )


MORE: Final = ("verb", "states", "written")
"""What a problem document of a verb has besides."""


async def answered(ending: Awaitable[VerbReport], ignored: Sequence[str] = ()) -> Response:
    """Return the answer to a verb once it has ended.

    Args:
        ending: The verb.
        ignored: What of a stop's request was not looked at (`stopping`).
    """
    report = await ending
    document, spare = verb_json(report), ignored_json(ignored)
    problem = verb_problem(report, {name: document[name] for name in MORE} | spare)
    return problem.response() if problem else json_response(document | spare)


def verb_of(word: str) -> Verb:
    """Return the verb a path names.

    Raises:
        ProblemError: It names none.
    """
    try:
        return Verb(word)
    except ValueError:
        remedy = f"they are {', '.join(Verb)}"
        raise ProblemError(
            Problem("no-such-path", f"there is no verb {short(word)}", remedy=remedy)
        ) from None


async def carry_out(ops: OperationsPort, drive: str, verb: Verb, body: VerbBody) -> VerbReport:
    """Have a drive do what a body says."""
    if not isinstance(body, SpeedBody):
        return await ops.verb(drive, verb, expires_s=body.expires_s)
    unit = body.unit.strip()
    return await ops.verb(
        drive,
        verb,
        value=Decimal(body.value),
        unit="Hz" if unit.lower() == "hz" else unit,
        expires_s=body.expires_s,
        verify=bool(body.verify),
    )


def verb_json(report: VerbReport) -> dict[str, Json]:
    """Return a verb's JSON form."""
    return {
        "drive": report.drive,
        "verb": report.verb.value,
        "outcome": report.outcome.value,
        "reason": report.reason or None,
        "cause": report.cause or None,
        "remedy": report.remedy or None,
        "states": [state.value for state in report.states],
        "written": [
            {"code": f"C{code.number:04d}", "subcode": code.subcode, "raw": raw}
            for code, raw in report.written
        ],
        "reading": None if report.reading is None else report.reading.as_json(),
        "proof": None if report.proof is None else report.proof.as_json(),
    }
