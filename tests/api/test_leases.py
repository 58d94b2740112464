"""Leases over HTTP: taken, renewed, taken over, given up; and their tokens on writes."""

from __future__ import annotations

from typing import Any

import httpx2
import pytest

from lecombus.operations.lease_operations import LEASE
from openapi.answer_models import EndedLeaseDocument, HeldLeaseDocument, LeasesDocument
from support.api_line import Line

pytestmark = [pytest.mark.anyio, pytest.mark.clock]

PLC = "/v1/leases/plc"
TAKE: dict[str, Any] = {"targets": ["feeder"], "time": "2s", "counter": 1}


async def put(client: httpx2.AsyncClient, path: str = PLC, **document: Any) -> httpx2.Response:
    return await client.put(path, json=document)


def kind(answer: httpx2.Response) -> str:
    return str(answer.json()["type"]).rsplit(":", maxsplit=1)[-1]


async def test_a_lease_is_taken_renewed_and_given_up(client: httpx2.AsyncClient) -> None:
    taken = await put(client, **TAKE)
    assert taken.status_code == 200
    lease = HeldLeaseDocument.model_validate_json(taken.text)
    assert (lease.drives, lease.counter, lease.on_lapse) == (
        ["feeder"],
        1,
        {"feeder": "quick-stop"},
    )
    assert lease.token.startswith(f"{lease.number}-")
    assert len(lease.token.split("-")[1]) == 32
    renewed = await put(client, token=lease.token, counter=2)
    assert HeldLeaseDocument.model_validate_json(renewed.text).token == lease.token
    again = await put(client, token=lease.token, counter=2)
    assert (again.status_code, kind(again)) == (409, "stale-counter")
    without = await client.delete(PLC)
    assert (without.status_code, kind(without)) == (422, "bad-request")
    assert without.json()["remedy"] == "send the token in the header Lecombus-Lease"
    refused = await client.delete(PLC, headers={"Lecombus-Lease": f"{lease.token}x"})
    assert (refused.status_code, kind(refused)) == (409, "lease-lost")
    ended = await client.delete(PLC, headers={"Lecombus-Lease": lease.token})
    assert EndedLeaseDocument.model_validate_json(ended.text).drives == ["feeder"]
    lost = await put(client, token=lease.token, counter=3)
    assert (lost.status_code, kind(lost)) == (409, "lease-lost")


async def test_a_group_is_taken_with_all_its_drives_and_no_answer_to_others_has_the_token(
    client: httpx2.AsyncClient,
) -> None:
    lease = (await put(client, targets=["conveyors"], time=1, counter=0)).json()
    assert lease["drives"] == ["feeder", "belt"]
    answer = await client.get("/v1/leases")
    LeasesDocument.model_validate_json(answer.text)
    assert lease["token"].split("-")[1] not in answer.text
    assert [one["lease"] for one in answer.json()["drives"]] == ["plc", "plc"]


async def test_it_is_taken_over_by_name(client: httpx2.AsyncClient) -> None:
    first = (await put(client, **TAKE)).json()
    held = await put(client, "/v1/leases/hmi", **TAKE)
    assert (held.status_code, kind(held)) == (409, "lease-held")
    assert "take_over: plc" in held.json()["remedy"]
    missing = await put(client, "/v1/leases/hmi", **TAKE, take_over="nobody")
    assert (missing.status_code, kind(missing)) == (404, "no-such-lease")
    taken = await put(client, "/v1/leases/hmi", **TAKE, take_over="plc")
    assert taken.json()["number"] > first["number"]
    assert kind(await put(client, token=first["token"], counter=9)) == "lease-lost"


async def test_a_counter_that_is_too_large_is_told_with_the_largest(
    client: httpx2.AsyncClient,
) -> None:
    answer = await put(client, **{**TAKE, "counter": 2**53 + 1})  # of a clock in nanoseconds
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith("counter takes a whole number, 0 to 9007199254740992")


async def test_a_name_that_is_none_is_named(client: httpx2.AsyncClient) -> None:
    answer = await client.put("/v1/leases/a%20b", json=TAKE)
    assert (answer.status_code, answer.json()["detail"]) == (422, "'a b' is not a name of a lease")


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"counter": 1},
        {"targets": ["feeder"], "counter": 1},
        {"time": "2s", "counter": 1},
        {**TAKE, "token": "1-2"},
        {"token": "1-2", "counter": 2, "take_over": "plc"},
        {**TAKE, "targets": []},
        {**TAKE, "targets": "feeder"},
        {**TAKE, "counter": -1},
        {**TAKE, "counter": True},
        {**TAKE, "counter": "1"},
        {**TAKE, "time": "0s"},
        {**TAKE, "time": "2 hours"},
        {**TAKE, "take_over": "../plc"},
        {**TAKE, "tokn": "1"},
        {"token": "x" * 300, "counter": 2},
    ],
)
async def test_a_body_that_is_neither_is_refused(
    client: httpx2.AsyncClient, document: dict[str, Any]
) -> None:
    answer = await client.put(PLC, json=document)
    assert (answer.status_code, kind(answer)) == (422, "bad-request"), answer.text


@pytest.mark.parametrize("name", ["a b", "%2e%2e", "x" * 61, "-a", "ü"])
async def test_a_name_that_is_none_is_refused(client: httpx2.AsyncClient, name: str) -> None:
    answer = await put(client, f"/v1/leases/{name}", **TAKE)
    assert answer.status_code in (404, 422)


async def test_targets_that_are_not_there_and_times_too_long_are_refused(
    client: httpx2.AsyncClient,
) -> None:
    assert (await put(client, **{**TAKE, "targets": ["fedder"]})).status_code == 404
    answer = await put(client, **{**TAKE, "time": "3s"})
    assert (answer.status_code, kind(answer)) == (422, "bad-value")
    assert answer.json()["remedy"] == "ask for 100ms to 2s"


async def test_a_write_carries_the_token_and_two_of_them_are_refused(
    client: httpx2.AsyncClient, line: Line
) -> None:
    seen: list[str] = []
    ask = line.ops._ask

    async def noting(*what: object) -> None:
        seen.append(LEASE.get())
        await ask(*what)

    line.ops._ask = noting  # type: ignore[method-assign]
    path, value = "/v1/drives/feeder/codes/C0046", {"value": 1}
    await client.put(path, json=value, headers={"Lecombus-Lease": "7-abc"})
    await client.put(path, json=value)
    assert seen == ["7-abc", ""]
    two = [("Lecombus-Lease", "7-abc"), ("Lecombus-Lease", "8-abc")]
    refused = await client.put(path, json=value, headers=two)
    assert (refused.status_code, kind(refused)) == (400, "doubled-header")
    stop = {"action": "inhibit", "target": "all"}
    assert (await client.post("/v1/stop", json=stop, headers=two)).status_code == 200
    assert len(seen) == 3
