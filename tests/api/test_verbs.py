"""Verbs over HTTP: what is passed on, how it is answered, and what is not understood."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import anyio
import httpx2
import pytest

from lecombus.api.limits import RequestLimiter
from lecombus.drives import Verb
from lecombus.errors import OperationError
from lecombus.operations.operation_reports import WriteReport
from lecombus.schedule.request import Outcome
from openapi.answer_models import VerbDocument
from support.api_line import Line
from support.golden import Golden

pytestmark = [pytest.mark.anyio, pytest.mark.clock]

PATH = "/v1/drives/feeder/verbs/"


async def say(client: httpx2.AsyncClient, verb: str, content: str = "", **headers: str) -> Any:
    return await client.post(PATH + verb, content=content, headers=headers)


@pytest.mark.usefixtures("standing_clock")
async def test_a_speed_is_passed_on_exactly(client: httpx2.AsyncClient, line: Line) -> None:
    body = '{"value": 35.40, "unit": "hz", "expires": "2s", "verify": true}'
    answer = await say(client, "set-speed", body)
    assert answer.status_code == 200
    VerbDocument.model_validate(answer.json())
    asked = ("verb", "feeder", Verb.SET_SPEED, Decimal("35.40"), "Hz", 2.0, True)
    assert line.ops.asked == [asked]


@pytest.mark.usefixtures("standing_clock")
@pytest.mark.parametrize("verb", ["enable", "reset-fault"])
@pytest.mark.parametrize("body", ["", "{}", '{"expires": 1}'])
async def test_the_others_need_no_body(
    client: httpx2.AsyncClient, line: Line, verb: str, body: str
) -> None:
    answer = await say(client, verb, body)
    document = answer.json()
    assert (answer.status_code, document["verb"], document["states"]) == (200, verb, ["enabled"])
    assert document["written"] == [{"code": "C0040", "subcode": 0, "raw": "1"}]
    assert line.ops.asked[0][5] == (1.0 if "expires" in body else None)


@pytest.mark.parametrize("verb", ["inhibit", "quick-stop"])
@pytest.mark.parametrize("body", ["", "{}", '{"value": 1}', "nonsense"])
async def test_a_stop_is_refused_for_no_body(
    client: httpx2.AsyncClient, line: Line, verb: str, body: str
) -> None:
    assert (await say(client, verb, body)).status_code == 200
    assert line.ops.asked == [("verb", "feeder", Verb(verb), None, "", None, False)]


@pytest.mark.parametrize("verb", ["inhibit", "quick-stop"])
@pytest.mark.parametrize("outcome", [Outcome.DONE, Outcome.UNKNOWN])
async def test_a_stop_is_refused_for_no_query_and_no_key(
    client: httpx2.AsyncClient, line: Line, verb: str, outcome: Outcome
) -> None:
    line.ops.report = lambda drive, code: WriteReport(drive, code, outcome)
    answer = await say(client, f"{verb}?now=1", **{"Idempotency-Key": "x" * 256})
    assert (answer.status_code, len(line.ops.asked)) == (200 if outcome is Outcome.DONE else 504, 1)
    query, key = answer.json()["ignored"]
    assert (query, key[:15]) == ("a stop takes no query: now=1", "Idempotency-Key")
    if outcome is Outcome.DONE:
        VerbDocument.model_validate(answer.json())


@pytest.mark.parametrize(
    ("verb", "body"),
    [
        ("set-speed", ""),
        ("set-speed", '{"value": 35}'),
        ("set-speed", '{"value": "35", "unit": "Hz"}'),
        ("set-speed", '{"value": 1E+99, "unit": "Hz"}'),
        ("set-speed", '{"value": 35, "unt": "Hz"}'),
        ("set-speed", '{"value": 35, "unit": "Hz", "expires": "2h"}'),
        ("enable", '{"value": 1}'),
        ("enable", "[]"),
    ],
)
async def test_a_body_that_is_not_understood_says_what_is_right(
    client: httpx2.AsyncClient, line: Line, verb: str, body: str, golden: Golden
) -> None:
    answer = await say(client, verb, body)
    assert (answer.status_code, line.ops.asked) == (422, [])
    golden(answer.json()["detail"])
    assert answer.json()["remedy"].startswith("send {")


async def test_a_word_that_is_no_verb_is_no_path(client: httpx2.AsyncClient) -> None:
    answer = await say(client, "fly")
    assert (answer.status_code, answer.json()["detail"]) == (404, "there is no verb fly")
    assert "reset-fault" in answer.json()["remedy"]
    assert (await client.get(PATH + "enable")).status_code == 405
    assert (await client.post(PATH + "enable?fast=1")).status_code == 422


async def test_a_verb_that_was_not_done_is_a_problem_with_what_was_written(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.report = lambda drive, code: WriteReport(
        drive, code, Outcome.REFUSED, "it does not show it", "a terminal", "not-in-effect", "look"
    )
    answer = await say(client, "enable")
    problem = answer.json()
    assert (answer.status_code, problem["outcome"]) == (409, "refused")
    assert (problem["verb"], problem["states"]) == ("enable", ["enabled"])
    assert problem["written"][0]["raw"] == "1"
    assert (problem["cause"], problem["remedy"]) == ("a terminal", "look")


@pytest.mark.parametrize(
    ("kind", "status"),
    [("no-verb", 409), ("setting", 409), ("fault-active", 409), ("busy", 409), ("bad-value", 422)],
)
async def test_a_refusal_keeps_its_kind_and_remedy(
    client: httpx2.AsyncClient, line: Line, kind: str, status: int
) -> None:
    line.ops.error = OperationError("no", kind=kind, drive="feeder", remedy="set C0001 = 3")
    answer = await say(client, "enable")
    assert (answer.status_code, answer.json()["type"]) == (status, f"urn:lecombus:problem:{kind}")
    assert answer.json()["remedy"] == "set C0001 = 3"


async def test_a_verb_is_done_once_per_key_and_a_stop_each_time(
    client: httpx2.AsyncClient, line: Line
) -> None:
    key = {"Idempotency-Key": "a"}
    first, again = [await say(client, "enable", **key) for _ in range(2)]
    assert (first.text, len(line.ops.asked)) == (again.text, 1)
    assert (await say(client, "reset-fault", **key)).status_code == 422, "the key is used"
    for _ in range(2):
        assert (await say(client, "inhibit", **{"Idempotency-Key": "b"})).status_code == 200
    assert len(line.ops.asked) == 3


async def test_a_stop_is_let_in_where_too_many_wait(line: Line) -> None:
    line.ops.gate = anyio.Event()
    transport = httpx2.ASGITransport(
        app=RequestLimiter(line.app, limit=1), raise_app_exceptions=False
    )
    async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client:
        with anyio.fail_after(10):
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(say, client, "enable")
                await anyio.wait_all_tasks_blocked()
                assert (await say(client, "enable")).status_code == 503
                for verb in ("inhibit", "quick-stop"):
                    tasks.start_soon(say, client, verb)
                await anyio.wait_all_tasks_blocked()
                line.ops.gate.set()
    verbs = [asked[2] for asked in line.ops.asked]
    assert verbs == [Verb.ENABLE, Verb.INHIBIT, Verb.QUICK_STOP]
