"""Addresses that the roster does not have, over HTTP: what is asked, and by whom."""

from __future__ import annotations

from pathlib import Path

import httpx2
import pytest

from api.test_server import over_tcp, over_unix, serving
from lecombus.errors import OperationError
from lecombus.operations.address_reads import Heard, HeardKind
from lecombus.parameters import Code, Value
from openapi.answer_models import HeardDocument
from support.api_line import Line

pytestmark = [pytest.mark.anyio, pytest.mark.clock]

PATH = "/v1/line/addresses/23/codes"


async def test_an_address_is_asked_as_the_query_says(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.heard = Heard(HeardKind.VALUE, Value.parse("35.40"), disturbances=3)
    query = {"addressing": "extended", "family": "820x", "patient": "true"}
    answer = await client.get(f"{PATH}/C0039/2", params=query)
    assert line.ops.asked == [("read_address", 23, Code(39, 2), "extended", "820x", True)]
    found = HeardDocument.model_validate(answer.json())
    assert (found.address, found.code, found.subcode) == (23, "C0039", 2)
    assert (found.heard, found.raw, found.format, found.disturbances) == ("value", "35.40", "VD", 3)
    assert '"value": 35.40,' in answer.text


async def test_silence_is_an_answer_and_no_error(client: httpx2.AsyncClient, line: Line) -> None:
    answer = await client.get(f"{PATH}/C0248")
    assert line.ops.asked == [("read_address", 23, Code(248), "standard", "generic", False)]
    assert (answer.status_code, answer.json()["heard"]) == (200, "silence")
    assert answer.json()["value"] is None


async def test_bytes_that_were_no_answer_are_given_as_hex(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.heard = Heard(HeardKind.GARBLED, received=b"\x02\xff")
    assert (await client.get(f"{PATH}/C0248")).json()["received"] == "02ff"


@pytest.mark.parametrize(
    ("path", "status", "kind"),
    [
        ("/v1/line/addresses/x/codes/C0009", 404, "no-such-address"),
        ("/v1/line/addresses/123/codes/C0009", 404, "no-such-address"),
        ("/v1/line/addresses/23/codes/nine", 404, "no-such-code"),
        ("/v1/line/addresses/23/codes/C0009?fresh=true", 422, "bad-request"),
    ],
)
async def test_what_cannot_be_asked_is_a_problem(
    client: httpx2.AsyncClient, line: Line, path: str, status: int, kind: str
) -> None:
    answer = await client.get(path)
    assert (answer.status_code, answer.json()["type"]) == (status, f"urn:lecombus:problem:{kind}")
    assert line.ops.asked == []


async def test_an_address_of_the_roster_is_refused(client: httpx2.AsyncClient, line: Line) -> None:
    line.ops.error = OperationError("it is feeder", kind="in-roster", drive="feeder")
    answer = await client.get(f"{PATH}/C0009")
    assert (answer.status_code, answer.json()["drive"]) == (409, "feeder")


async def test_addresses_are_asked_over_the_unix_socket_only(line: Line, tmp_path: Path) -> None:
    async with serving(line, tmp_path / "s") as served:
        async with over_tcp(served) as client:
            answer = await client.get(f"{PATH}/C0009")
            assert answer.status_code == 403
            assert answer.json()["type"] == "urn:lecombus:problem:not-permitted"
        assert line.ops.asked == []
        async with over_unix(served.socket_path) as client:
            assert (await client.get(f"{PATH}/C0009")).status_code == 200
