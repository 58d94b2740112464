"""The OpenAPI document, made from the routes, the answer models and the models of bodies.

`make openapi` writes it into src/lecombus/api/openapi.json, which the daemon serves; a test checks
that the file is up to date. The text of an operation is the docstring of its route; its parameters,
body and answers stand here in `OPERATIONS`, in the order of the document.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema
from starlette.applications import Starlette
from starlette.routing import Route

import lecombus.api
from lecombus.api import request_models as bodies
from lecombus.api.answers import PROBLEM_TYPE, STATUS_BY_KIND
from lecombus.api.event_routes import EVENTS_TYPE
from lecombus.api.idempotency import KEY_CHARS
from lecombus.api.journal_routes import JournalQuery, VerifyQuery
from lecombus.api.limits import EVENTS_PATH
from openapi import answer_models
from openapi.answer_models import ProblemDocument
from support.api_line import make_line

__all__ = ["FILE", "OPERATIONS", "UNDESCRIBED", "document_of", "main"]

FILE: Final = Path(lecombus.api.__file__).with_name("openapi.json")

REF: Final = "#/components/schemas/{model}"
JSON_TYPE: Final = "application/json"

REFUSALS: Final = (400, 403, 404, 409, 413, 422, 502, 503, 504)
"""The statuses of a write or a stop besides 200."""

UNDESCRIBED: Final = frozenset(("/metrics", "/openapi.json"))
"""Paths for programs that know them."""

KEY: Final = {
    "name": "Idempotency-Key",
    "in": "header",
    "required": False,
    "schema": {
        "anyOf": [{"type": "string"}, {"type": "null"}],
        "description": "Makes a repeat safe; a new one per request",
        # Bounds for readers of the document only: a stop is not refused for its key.
        "minLength": 1,
        "maxLength": KEY_CHARS,
        "title": "Idempotency-Key",
    },
    "description": "Makes a repeat safe; a new one per request",
}

ASKED: Final = {
    "name": "Lecombus-Asked",
    "in": "header",
    "required": False,
    "schema": {"type": "string", "pattern": "^[0-9]{1,3}(\\.[0-9]{1,6})?$"},
    "description": "In a repeat with its Idempotency-Key: how long ago it was asked first, seconds",
}

LEASE_TOKEN: Final = {
    "name": "Lecombus-Lease",
    "in": "header",
    "required": False,
    "schema": {"type": "string", "title": "Lecombus-Lease"},
    "description": "The token of the lease that is held for the drive; a stop needs none",
}


LAST_ID: Final = {
    "name": "Last-Event-ID",
    "in": "header",
    "required": False,
    "schema": {"type": "string"},
    "description": "The last event that the client had; counts more than `last_event_id`",
}


@dataclass(frozen=True)
class Operation:
    """What a route takes and answers.

    Args:
        answer: What a 200 carries.
        problems: The other statuses.
        query: Its query parameters.
        body: What it takes.
        body_required: Whether it needs one.
        stream: The media type of an answer without end; empty: it is one JSON document.
    """

    answer: type[BaseModel] | None
    problems: tuple[int, ...]
    query: type[bodies.Query] | None = None
    body: type[bodies.Body] | None = None
    body_required: bool = True
    stream: str = ""


DRIVE: Final = "/v1/drives/{drive}"
AT_ADDRESS: Final = "/v1/line/addresses/{address}"
GROUP: Final = "/v1/groups/{group}"
LEASE: Final = "/v1/leases/{lease}"
CODE: Final = "/codes/{code}"
SUBCODE: Final = "/codes/{code}/{subcode}"

TAKES_LEASE: Final = (
    DRIVE + CODE, DRIVE + SUBCODE, GROUP + CODE, GROUP + SUBCODE, f"{DRIVE}/verbs/{{verb}}",
    f"{DRIVE}/address",
)  # fmt: skip

READ_CODE: Final = Operation(
    answer_models.ReadingDocument, (404, 409, 422, 502, 503, 504), bodies.ValueQuery
)
READ_ADDRESS: Final = Operation(
    answer_models.HeardDocument, (403, 404, 409, 422, 503), bodies.AddressQuery
)


def writing(answer: type[BaseModel], body: type[bodies.Body]) -> Operation:
    """Return an operation that writes."""
    return Operation(answer, REFUSALS, body=body)


WRITE_CODE: Final = writing(answer_models.OutcomeDocument, bodies.DriveWriteBody)
WRITE_GROUP: Final = writing(answer_models.GroupOutcomeDocument, bodies.WriteBody)

OPERATIONS: Final[Mapping[tuple[str, str], Operation]] = {
    ("get", "/v1/line"): Operation(answer_models.LineDocument, (422,)),
    ("get", DRIVE): Operation(answer_models.DriveDocument, (404, 422)),
    ("get", f"{DRIVE}/restore"): Operation(answer_models.RestoreDocument, (404, 422)),
    ("get", "/v1/groups"): Operation(answer_models.GroupsDocument, (422,)),
    ("get", "/v1/drives"): Operation(answer_models.DrivesDocument, (422,)),
    ("get", f"{DRIVE}/described"): Operation(answer_models.DescribedDocument, (404, 422)),
    ("get", DRIVE + SUBCODE): READ_CODE,
    ("put", DRIVE + SUBCODE): WRITE_CODE,
    ("get", DRIVE + CODE): READ_CODE,
    ("put", DRIVE + CODE): WRITE_CODE,
    ("get", AT_ADDRESS + SUBCODE): READ_ADDRESS,
    ("get", AT_ADDRESS + CODE): READ_ADDRESS,
    ("put", GROUP + SUBCODE): WRITE_GROUP,
    ("put", GROUP + CODE): WRITE_GROUP,
    ("get", "/v1/leases"): Operation(answer_models.LeasesDocument, (422,)),
    ("put", LEASE): Operation(
        answer_models.HeldLeaseDocument, (400, 403, 404, 409, 413, 422, 503), body=bodies.LeaseBody
    ),
    ("delete", LEASE): Operation(answer_models.EndedLeaseDocument, (400, 403, 409, 422)),
    ("post", "/v1/stop"): writing(answer_models.GroupOutcomeDocument, bodies.StopBody),
    ("post", f"{DRIVE}/verbs/{{verb}}"): Operation(
        answer_models.VerbDocument, REFUSALS, body=bodies.SpeedBody, body_required=False
    ),
    ("get", f"{DRIVE}/identity"): Operation(answer_models.IdentityDocument, (404, 422)),
    ("get", f"{DRIVE}/wear"): Operation(answer_models.WearDocument, (404, 422)),
    ("post", f"{DRIVE}/address"): writing(answer_models.OutcomeDocument, bodies.AddressBody),
    ("post", f"{DRIVE}/accept"): writing(answer_models.IdentityDocument, bodies.AcceptBody),
    ("post", f"{DRIVE}/forget-times"): writing(
        answer_models.ForgottenTimesDocument, bodies.NoKeysBody
    ),
    ("post", "/v1/reload"): Operation(
        answer_models.ReloadDocument, REFUSALS, body=bodies.NoKeysBody, body_required=False
    ),
    ("get", f"{DRIVE}/why"): Operation(answer_models.WhyDocument, (404, 422), bodies.WhyQuery),
    ("get", "/v1/journal"): Operation(answer_models.JournalDocument, (404, 422, 503), JournalQuery),
    ("get", "/v1/journal/verify"): Operation(
        answer_models.VerifiedDocument, (404, 422, 503), VerifyQuery
    ),
    ("get", EVENTS_PATH): Operation(
        None, (403, 404, 422, 503), bodies.EventQuery, stream=EVENTS_TYPE
    ),
    ("get", "/v1/plan"): Operation(answer_models.PlanDocument, (422,)),
    ("get", "/healthz"): Operation(answer_models.StatusDocument, (503,)),
    ("get", "/readyz"): Operation(answer_models.StatusDocument, (503,)),
}


def main() -> None:
    """Write the file, unless it says the same already."""
    document = document_of(make_line().app)
    if json.loads(FILE.read_text()) != document:
        FILE.write_text(json.dumps(document, indent=1) + "\n")


def document_of(app: Starlette) -> dict[str, Any]:
    """Return the document of an application; its version is put in when it is served."""
    endpoints = dict(endpoints_of(app))
    models = [one.answer for one in OPERATIONS.values() if one.answer is not None]
    models += [one.query for one in OPERATIONS.values() if one.query is not None]
    _, found = models_json_schema(
        [(model, "validation") for model in dict.fromkeys(models)], ref_template=REF
    )
    queries = {one.query.__name__ for one in OPERATIONS.values() if one.query is not None}
    schemas = {name: found["$defs"][name] for name in sorted(found["$defs"].keys() - queries)}
    schemas[ProblemDocument.__name__] = ProblemDocument.model_json_schema()
    paths: dict[str, dict[str, Any]] = {}
    for (method, path), operation in OPERATIONS.items():
        described = described_operation(endpoints[method, path], method, path, operation)
        paths.setdefault(path, {})[method] = described
    made = {
        "openapi": "3.1.0",
        "info": {"title": "lecombus", "version": "0"},
        "paths": paths,
        "components": {"schemas": schemas},
    }
    return cast(dict[str, Any], without_null_defaults(made))


def without_null_defaults(part: Any) -> Any:
    """Return a part of the document without defaults of null, which say nothing."""
    if isinstance(part, list):
        return [without_null_defaults(one) for one in part]
    if not isinstance(part, dict):
        return part
    kept = {key: one for key, one in part.items() if not (key == "default" and one is None)}
    return {key: without_null_defaults(one) for key, one in kept.items()}


def endpoints_of(app: Starlette) -> Iterator[tuple[tuple[str, str], Any]]:
    """Yield the function behind each method and path that the document may describe."""
    for route in app.routes:
        assert isinstance(route, Route)
        for method in route.methods or ():
            if method != "HEAD" and route.path not in UNDESCRIBED:
                yield (method.lower(), route.path), route.endpoint


def described_operation(
    endpoint: Any, method: str, path: str, operation: Operation
) -> dict[str, Any]:
    """Return what the document says of one operation."""
    parameters = [path_parameter(name) for name in re.findall(r"{(\w+)}", path)]
    if operation.query is not None:
        parameters += query_parameters(operation.query)
    if operation.body is not None and path != LEASE:
        parameters += [KEY, ASKED]
    if (path in TAKES_LEASE and method != "get") or (path, method) == (LEASE, "delete"):
        parameters.append(LEASE_TOKEN)
    if operation.stream:
        parameters.append(LAST_ID)
    name: str = endpoint.__name__
    summary, _, rest = endpoint.__doc__.partition("\n")
    found: dict[str, Any] = {
        "summary": name.replace("_", " ").title(),
        "description": f"{summary}\n{textwrap.dedent(rest)}".strip(),
        "operationId": re.sub(r"\W", "_", f"{name}{path}_{method}"),
    }
    if parameters:
        found["parameters"] = parameters
    answer = {"schema": {"type": "string"}}
    if operation.answer is not None:
        answer = {"schema": reference(operation.answer)}
    content = {operation.stream or JSON_TYPE: answer}
    found["responses"] = {
        "200": {"description": "Successful Response", "content": content},
        **{str(status): problem_response(titles(status)) for status in operation.problems},
        "default": problem_response(
            "What any path may be refused with: 400, 401, 403, 405, 414, 421, 429, 431, 503"
        ),
    }
    if operation.body is not None:
        schema = operation.body.model_json_schema(ref_template=REF)
        schema.pop("$defs", None)  # what it refers to is a component of a query already
        content = {JSON_TYPE: {"schema": schema}}
        found["requestBody"] = {"required": operation.body_required, "content": content}
    return found


def path_parameter(name: str) -> dict[str, Any]:
    """Return a part of a path."""
    schema = {"type": "string", "title": name.title()}
    return {"name": name, "in": "path", "required": True, "schema": schema}


def query_parameters(model: type[bodies.Query]) -> Iterator[dict[str, Any]]:
    """Yield the parameters of a query."""
    for name, schema in model.model_json_schema(ref_template=REF)["properties"].items():
        text = schema["description"]
        yield {
            "name": name,
            "in": "query",
            "required": False,
            "schema": schema,
            "description": text,
        }


def reference(model: type[BaseModel]) -> dict[str, str]:
    """Return a reference to a model's schema."""
    return {"$ref": REF.format(model=model.__name__)}


def titles(status: int) -> str:
    """Return the problems of a status."""
    return ", ".join(
        f"{title} ({kind})"
        for kind, (its_status, title) in STATUS_BY_KIND.items()
        if its_status == status
    )


def problem_response(text: str) -> dict[str, Any]:
    """Return a response with a problem document."""
    content = {PROBLEM_TYPE: {"schema": reference(ProblemDocument)}}
    return {"description": text, "content": content}


if __name__ == "__main__":
    main()
