"""Who a drive is, its wear and its address over HTTP."""

from __future__ import annotations

import httpx2
import pytest

from lecombus.errors import OperationError
from openapi.answer_models import (
    ForgottenTimesDocument,
    IdentityDocument,
    OutcomeDocument,
    WearDocument,
)
from support.api_line import Line

pytestmark = pytest.mark.anyio


async def test_identity_and_wear_are_the_documents_they_are_described_as(
    client: httpx2.AsyncClient,
) -> None:
    answer = await client.get("/v1/drives/feeder/identity")
    assert IdentityDocument.model_validate_json(answer.content).found == {"C1810": "NEW"}
    answer = await client.get("/v1/drives/feeder/wear")
    assert WearDocument.model_validate_json(answer.content).codes[0].writes == 7


async def test_accept_takes_the_identity_that_was_shown(client: httpx2.AsyncClient) -> None:
    path = "/v1/drives/feeder/accept"
    answer = await client.post(path, json={"identity": {"C1810": "NEW"}})
    assert answer.status_code == 200
    assert IdentityDocument.model_validate_json(answer.content).accepted == {"C1810": "NEW"}
    mistakes: tuple[dict[str, object], ...] = (
        {}, {"identity": "NEW"}, {"identity": {"C1810": 5}}, {"identiy": {}},
    )  # fmt: skip
    for wrong in mistakes:
        answer = await client.post(path, json=wrong)
        assert answer.status_code == 422
        assert "identity" in answer.json()["detail"]


async def test_measured_answer_times_are_forgotten_and_shown(client: httpx2.AsyncClient) -> None:
    path = "/v1/drives/feeder/forget-times"
    for body in (b"", b"{}"):
        answer = await client.post(path, content=body)
        assert answer.status_code == 200
        (row,) = ForgottenTimesDocument.model_validate_json(answer.content).forgotten
        assert (row.code, row.write, float(row.measured_s)) == ("C0150", False, 0.25)
    assert (await client.post(path, json={"code": "C0150"})).status_code == 422
    assert (await client.get(path)).status_code == 405


async def test_an_address_is_a_whole_number(client: httpx2.AsyncClient) -> None:
    path = "/v1/drives/feeder/address"
    answer = await client.post(path, json={"address": 35})
    assert OutcomeDocument.model_validate_json(answer.content).outcome == "verified"
    for wrong in ("35", 3.5, None, True, [35]):
        answer = await client.post(path, json={"address": wrong})
        assert answer.status_code == 422
        assert "1 to 99" in answer.json()["detail"]


async def test_a_write_that_comes_too_soon_says_when_it_may_come(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.error = OperationError(
        "too soon", kind="too-many-writes", drive="feeder", retry_after_s=90.2
    )
    answer = await client.put("/v1/drives/feeder/codes/C0012", json={"value": 5})
    assert (answer.status_code, answer.headers["Retry-After"]) == (429, "91")
