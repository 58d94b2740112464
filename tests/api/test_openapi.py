"""The description of the interface says what is so: by a validator, and by what it promises."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from openapi_spec_validator import validate

from lecombus.api.idempotency import KEY_CHARS
from lecombus.api.openapi import text_of
from support.api_line import Line

pytestmark = pytest.mark.anyio


@pytest.fixture
def document(line: Line) -> dict[str, Any]:
    made: dict[str, Any] = json.loads(text_of(line.app))
    return made


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
    document: dict[str, Any], client: httpx.AsyncClient
) -> None:
    values = {"fresh": "true", "priority": "background", "addressing": "standard"}
    values |= {"family": "generic", "patient": "true", "lang": "de"}
    places = {"drive": "feeder", "code": "C0046", "subcode": "0", "address": "21", "group": "all"}
    taken = set()
    for path, operation in operations(document):
        query = [one["name"] for one in operation.get("parameters", ()) if one["in"] == "query"]
        for name in query:
            answer = await client.get(path.format(**places), params={name: values[name]})
            assert answer.status_code == 200, (path, name, answer.text)
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
