"""The description of the interface says what is so: by a validator, and by what it promises."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from openapi_schema_validator import OAS31Validator
from openapi_spec_validator import validate

from lecombus.api.idempotency import KEY_CHARS
from lecombus.api.limits import EVENTS_PATH
from openapi.document import FILE, OPERATIONS, document_of, endpoints_of
from support.api_line import Line

pytestmark = pytest.mark.anyio

API_DOC = (Path(__file__).parents[2] / "docs" / "api.md").read_text()


@pytest.fixture
def document(line: Line) -> dict[str, Any]:
    return document_of(line.app)


def test_the_file_is_what_make_openapi_writes(document: dict[str, Any]) -> None:
    assert json.loads(FILE.read_text()) == document


async def test_the_file_is_served_with_the_version(client: httpx2.AsyncClient) -> None:
    answer = await client.get("/openapi.json")
    assert answer.headers["content-type"] == "application/json"
    assert answer.json() == json.loads(FILE.read_text()) | {
        "info": {"title": "lecombus", "version": "0"}
    }


def test_every_route_is_described(line: Line) -> None:
    stops = {("post", f"/v1/drives/{{drive}}/verbs/{verb}") for verb in ("inhibit", "quick-stop")}
    assert {place for place, _ in endpoints_of(line.app)} == set(OPERATIONS) | stops


def operations(document: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for path, methods in document["paths"].items():
        for operation in methods.values():
            yield path, operation


def references(part: object) -> Iterator[str]:
    if isinstance(part, dict):
        for key, inner in part.items():
            if key == "$ref":
                yield inner
            yield from references(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from references(inner)


def test_the_document_is_valid_and_whatever_it_refers_to_is_in_it(
    document: dict[str, Any],
) -> None:
    validate(document)
    for reference in references(document):
        assert reference.startswith("#/components/schemas/"), reference
        assert reference.rpartition("/")[2] in document["components"]["schemas"]
    assert "#/components/schemas/Urgency" in set(references(document))


async def test_every_query_parameter_that_is_described_is_taken(
    document: dict[str, Any], client: httpx2.AsyncClient
) -> None:
    values = {"fresh": "true", "priority": "background", "addressing": "standard"}
    values |= {"family": "generic", "patient": "true", "lang": "de"}
    values |= {"after": "1", "since": "2026-11-23T06:00:00Z", "limit": "5", "last": "true"}
    values |= {"head": f"1:{'0' * 64}"}
    values |= {"drive": "feeder"}
    values |= {"kind": "value,state", "last_event_id": "run-1", "drive": "feeder"}
    places = {"drive": "feeder", "code": "C0046", "subcode": "0", "address": "21", "group": "all"}
    taken = set()
    for path, operation in operations(document):
        query = [one["name"] for one in operation.get("parameters", ()) if one["in"] == "query"]
        for name in query:
            if path == EVENTS_PATH:  # events have no end
                answer = await client.head(path, params={name: values[name]})
                assert answer.status_code == 200
                taken.add(name)
                continue
            answer = await client.get(path.format(**places), params={name: values[name]})
            no_journal = answer.json().get("type", "").endswith(":no-journal")
            assert answer.status_code == 200 or no_journal, (path, name, answer.text)
            taken.add(name)
    assert taken == set(values)


def test_a_key_is_described_with_its_bounds(document: dict[str, Any]) -> None:
    keys = [
        one["schema"]
        for _, operation in operations(document)
        for one in operation.get("parameters", ())
        if one["name"] == "Idempotency-Key"
    ]
    assert keys
    for schema in keys:
        assert (schema["minLength"], schema["maxLength"]) == (1, KEY_CHARS)


def examples() -> Iterator[tuple[str, str, Any]]:
    """Yield method, path and answer of each example in docs/api.md that is shown in full."""
    shown = re.compile(r"^\$ ((?:ask|curl) (?:.*\\\n)*.*)\n(\{.*)$", re.MULTILINE)
    for call, answer in shown.findall(API_DOC):
        path = re.search(r"http://[^/]+(/[^?'\s]*)", call)
        assert path is not None, call
        method = re.search(r"-X (\w+)", call)
        if ", ..]" not in answer:
            yield ("GET" if method is None else method[1]), path[1], json.loads(answer)


def described(document: dict[str, Any], method: str, path: str) -> dict[str, Any]:
    for template, operations in document["paths"].items():
        pattern = re.sub(r"\{\w+\}", "[^/]+", template)
        if re.fullmatch(pattern, path) and method.lower() in operations:
            found: dict[str, Any] = operations[method.lower()]
            return found
    raise AssertionError(f"{method} {path} is not described")


def test_examples_of_the_documentation_are_as_described(document: dict[str, Any]) -> None:
    shown = list(examples())
    assert len(shown) > 12
    for method, path, answer in shown:
        responses = described(document, method, path)["responses"]
        status = "default" if "status" in answer else "200"
        (content,) = responses[status]["content"].values()
        schema = {**content["schema"], "components": document["components"]}
        OAS31Validator(schema).validate(answer)


def test_the_documentation_lists_every_path(document: dict[str, Any]) -> None:
    for path in document["paths"]:
        written = path.replace("/codes/{code}/{subcode}", "/codes/{code}[/{subcode}]")
        written = written.replace("/drives/{drive}/accept", "../accept").replace("/v1..", "..")
        assert f"{written}`" in API_DOC or f"{written}[/{{subcode}}]`" in API_DOC, path
