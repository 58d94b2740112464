"""A stop is the first route, is taken with anything superfluous, and says what it ignored."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import httpx2
import pytest
from starlette.applications import Starlette
from starlette.routing import Route

from lecombus.api.limits import is_stop
from lecombus.drives import StopAction, Verb
from lecombus.errors import LecombusError, LineLostError, OperationError
from lecombus.operations.operation_reports import WriteReport
from lecombus.parameters import Code
from lecombus.schedule.request import Outcome
from openapi.answer_models import GroupOutcomeDocument
from support.api_line import Line

pytestmark = pytest.mark.anyio

PLAIN = {"action": "inhibit", "target": "all"}


def over(app: Starlette) -> httpx2.AsyncClient:
    return httpx2.AsyncClient(transport=httpx2.ASGITransport(app=app), base_url="http://localhost")


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The routes that requests were compared with."""
    seen: list[str] = []
    plain = Route.matches

    def watched(self: Route, scope: Any) -> Any:
        seen.append(self.path)
        return plain(self, scope)

    monkeypatch.setattr(Route, "matches", watched)
    return seen


async def test_a_stop_is_compared_with_no_other_route(line: Line, tried: list[str]) -> None:
    async with over(line.app) as client:
        answer = await client.post("/v1/stop", json=PLAIN)
    assert (answer.status_code, answer.json()["outcome"]) == (200, "done")
    assert answer.headers["content-type"] == "application/json"
    assert line.ops.asked == [("stop", StopAction.INHIBIT, "all")]
    assert tried == ["/v1/stop"]


@pytest.mark.parametrize(
    ("body", "headers", "query", "status"),
    [
        (b'{"action": "inhibit", "target": "all"}', {"Idempotency-Key": "k"}, "", 200),
        (b'{"action": "inhibit", "target": "all"}', {}, "?x=1", 200),
        (b'{"action": "inhibit"}', {}, "", 422),
        (b'{"action": "inhibit", "target": "all", "now": true}', {}, "", 200),
        (b'{"action": "halt", "target": "all"}', {}, "", 422),
        (b'{"action": ["inhibit"], "target": "all"}', {}, "", 422),
        (b'{"action": "inhibit", "target": ""}', {}, "", 422),
        (b'{"action": "inhibit", "target": "%s"}' % (b"x" * 201), {}, "", 422),
        (b'{"action": "inhibit", "target": 7}', {}, "", 422),
        (b'[{"action": "inhibit", "target": "all"}]', {}, "", 422),
        (b"stop!", {}, "", 422),
        (b"", {}, "", 422),
    ],
)
async def test_an_odd_stop_takes_the_same_route(
    line: Line, tried: list[str], body: bytes, headers: dict[str, str], query: str, status: int
) -> None:
    async with over(line.app) as client:
        answer = await client.post(f"/v1/stop{query}", content=body, headers=headers)
    assert answer.status_code == status
    assert tried == ["/v1/stop"]
    assert len(line.ops.asked) == (status == 200)


async def test_a_stop_with_two_keys_stops_and_says_that_it_uses_none(line: Line) -> None:
    headers = [("Idempotency-Key", "a"), ("Idempotency-Key", "b")]
    async with over(line.app) as client:
        answer = await client.post("/v1/stop", json=PLAIN, headers=headers)
    assert answer.status_code == 200
    assert line.ops.asked == [("stop", StopAction.INHIBIT, "all")]
    (ignored,) = answer.json()["ignored"]
    assert "Idempotency-Key stands 2 times" in ignored


@pytest.mark.parametrize("outcome", [Outcome.VERIFIED, Outcome.UNKNOWN])
@pytest.mark.parametrize(
    ("more", "headers", "query", "says"),
    [
        ({"now": True}, {}, "", ["there is no key now: known are: action, target"]),
        ({"acton": "x", "b": []}, {}, "", ["did you mean action?", "there is no key b"]),
        ({}, {"Idempotency-Key": ""}, "", ["Idempotency-Key has 0 characters, 1 to 255 are"]),
        ({}, {"Idempotency-Key": "x" * 256}, "", ["Idempotency-Key has 256 characters"]),
        ({}, {}, "?fresh=true", ["a stop takes no query: fresh=true"]),
        ({"k": 1}, {"Idempotency-Key": ""}, "?x=1", ["no query", "has 0 char", "no key k"]),
    ],
)
async def test_a_stop_is_taken_whatever_is_superfluous_and_says_what_it_ignored(
    line: Line,
    more: dict[str, object],
    headers: dict[str, str],
    query: str,
    says: list[str],
    outcome: Outcome,
) -> None:
    line.ops.report = lambda drive, code: WriteReport(drive, code, outcome)
    async with over(line.app) as client:
        answer = await client.post(f"/v1/stop{query}", json=PLAIN | more, headers=headers)
        plain = await client.post("/v1/stop", json=PLAIN)
    assert line.ops.asked == [("stop", StopAction.INHIBIT, "all")] * 2
    ignored = answer.json()["ignored"]
    assert [part in text for part, text in zip(says, ignored, strict=True)] == [True] * len(says)
    assert answer.status_code == plain.status_code
    assert answer.json() == {**plain.json(), "ignored": ignored}
    if outcome is Outcome.VERIFIED:
        GroupOutcomeDocument.model_validate(answer.json())


async def test_a_stop_with_many_superfluous_keys_says_some_of_them(line: Line) -> None:
    async with over(line.app) as client:
        answer = await client.post("/v1/stop", json=PLAIN | {f"k{n}": n for n in range(30)})
    assert (len(answer.json()["ignored"]), answer.json()["ignored"][-1]) == (11, "and 20 more")


async def test_a_stop_with_a_misspelt_key_for_a_needed_one_is_told_both(line: Line) -> None:
    async with over(line.app) as client:
        answer = await client.post("/v1/stop", json={"action": "inhibit", "taget": "all"})
    assert (answer.status_code, line.ops.asked) == (422, [])
    assert "key target is missing" in answer.json()["detail"]
    assert "did you mean target?" in answer.json()["detail"]


@pytest.mark.parametrize("size", [1, 5, 20])
async def test_a_body_in_pieces_stops(line: Line, size: int) -> None:
    body = b'{"action": "inhibit", "target": "all"}'
    pieces = [body[at : at + size] for at in range(0, len(body), size)]
    answers: list[dict] = []  # type: ignore[type-arg]

    async def receive() -> dict:  # type: ignore[type-arg]
        return {"type": "http.request", "body": pieces.pop(0), "more_body": bool(pieces)}

    async def send(message: dict) -> None:  # type: ignore[type-arg]
        answers.append(message)

    scope = {
        "type": "http", "method": "POST", "path": "/v1/stop", "raw_path": b"/v1/stop",
        "query_string": b"", "headers": [(b"host", b"x")], "root_path": "", "scheme": "http",
    }  # fmt: skip
    await line.app(scope, receive, send)  # type: ignore[arg-type]
    assert answers[0]["status"] == 200
    assert line.ops.asked == [("stop", StopAction.INHIBIT, "all")]


@pytest.mark.parametrize(
    "error",
    [
        None,
        LineLostError("line hall-3: pulled"),
        OperationError("no such thing", kind="no-such-drive", drive="x" * 300, remedy="look"),
        OperationError("none known", kind="no-stop", drive="feeder"),
    ],
)
@pytest.mark.parametrize("outcome", [Outcome.VERIFIED, Outcome.UNKNOWN, Outcome.REFUSED])
async def test_a_stop_is_answered_alike_with_a_key_and_without(
    line: Line, error: LecombusError | None, outcome: Outcome
) -> None:
    line.ops.error = error

    def report(drive: str, code: Code) -> WriteReport:
        return replace(WriteReport(drive, code, outcome), reason="so it is")

    line.ops.report = report
    async with over(line.app) as client:
        plain = await client.post("/v1/stop", json=PLAIN)
        keyed = await client.post("/v1/stop", json=PLAIN, headers={"Idempotency-Key": "k"})
    assert (plain.status_code, plain.content) == (keyed.status_code, keyed.content)
    assert dict(plain.headers) == dict(keyed.headers)


async def test_a_mistake_of_ours_is_told_as_one(line: Line) -> None:
    line.ops.error = RuntimeError("oh")
    transport = httpx2.ASGITransport(app=line.app, raise_app_exceptions=False)
    async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client:
        answer = await client.post("/v1/stop", json=PLAIN)
    assert answer.status_code == 500
    assert answer.json()["type"] == "urn:lecombus:problem:internal"


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("POST", "/v1/drives/feeder/codes/C0046", "GET, HEAD, PUT"),
        ("GET", "/v1/stop", "POST"),
        ("PUT", "/healthz", "GET, HEAD"),
        ("DELETE", "/v1/line", "GET, HEAD"),
    ],
)
async def test_a_wrong_method_is_told_the_right_ones(
    line: Line, method: str, path: str, allowed: str
) -> None:
    async with over(line.app) as client:
        answer = await client.request(method, path)
    assert answer.status_code == 405
    assert answer.headers["allow"] == allowed
    assert allowed in answer.json()["remedy"]


ODD = [
    b'{"action": "inhibit", "target": "all", "n": %s}' % (b"7" * 5000),
    b'{"action": "inhibit", "target": "all", "n": [-%s]}' % (b"7" * 5000),
    b'{"action": "inhibit", "target": "all", "n": NaN, "m": -Infinity}',
    b'{"action": "inhibit", "target": "all", "n": 1e9999999999999999999}',
    b'{"n": 1, "action": "inhibit", "n": 2, "target": "all"}',
    b'{"action": "inhibit", "target": "all", "n": {"action": 1, "action": 2, "k": [], "k": 0}}',
]


@pytest.mark.parametrize("body", ODD)
async def test_a_stop_is_taken_whatever_its_superfluous_keys_hold(line: Line, body: bytes) -> None:
    async with over(line.app) as client:
        answer = await client.post("/v1/stop", content=body)
    assert (answer.status_code, line.ops.asked) == (200, [("stop", StopAction.INHIBIT, "all")])
    assert answer.json()["ignored"][0].startswith("there is no key n")


async def test_a_byte_order_mark_before_a_stop_is_skipped(line: Line) -> None:
    body = b'\xef\xbb\xbf{"action": "inhibit", "target": "all"}'
    async with over(line.app) as client:
        answer = await client.post("/v1/stop", content=body)
    assert (answer.status_code, line.ops.asked) == (200, [("stop", StopAction.INHIBIT, "all")])


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (b'{"action": "inhibit", "target": "a", "target": "b"}', "key target stands twice"),
        (b'{"action": "inhibit", "\\u0061ction": "quick-stop", "target": "a"}', "key action"),
        (b'{"action": "inhibit", "target": %s}' % (b"7" * 5000), "target takes the name"),
        (b'{"action": "inhibit", "target": NaN}', "not NaN"),
        (b'{"action": "inhibit", "target": ""}', 'target takes the name of a drive or a group, or'),
        (b'{"action": "inhibit"}', "key target is missing"),
        (b'{"action": 1e99999999999999999999, "target": "all"}', "action takes"),
        (b'{"action": {"k": 1, "k": 2}, "target": "all"}', "not an object"),
        (b'{"k": 1, "k": 2, "target": "all"}', "key action is missing"),
        (b'[{"k": 1, "k": 2}]', "not a JSON object"),
        (b'{"action": "inhibit", "target": "all", "k": %s}' % (b"[" * 4000 + b"]" * 4000),
         "it has 4001 brackets that open; at most 256 are read"),
        (b'{"action": "inhibit", "target": "all", "k": "\xff"}', "not JSON"),
    ],
)  # fmt: skip
async def test_a_stop_that_cannot_be_understood_is_refused(
    line: Line, body: bytes, says: str
) -> None:
    async with over(line.app) as client:
        answer = await client.post("/v1/stop", content=body)
    assert (answer.status_code, line.ops.asked) == (422, [])
    assert says in answer.json()["detail"]


@pytest.mark.parametrize("path", ["/v1/stop/", "//v1/stop", "//v1/stop//"])
async def test_slashes_too_many_around_the_path_of_a_stop_are_dropped(
    line: Line, path: str
) -> None:
    async with over(line.app) as client:
        plain = await client.post(f"http://localhost{path}", json=PLAIN)
        long = await client.post(f"http://localhost{path}", json=PLAIN | {"k": 1})
    assert (plain.status_code, long.status_code) == (200, 200)
    assert line.ops.asked == [("stop", StopAction.INHIBIT, "all")] * 2
    assert is_stop(path)


async def test_slashes_around_the_path_of_a_verb_that_stops_are_dropped(line: Line) -> None:
    async with over(line.app) as client:
        stop = await client.post("http://localhost//v1/drives/feeder/verbs/quick-stop/")
        start = await client.post("/v1/drives/feeder/verbs/enable/")
    assert (stop.status_code, start.status_code) == (200, 404)
    assert [what[1:3] for what in line.ops.asked] == [("feeder", Verb.QUICK_STOP)]
