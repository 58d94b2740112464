"""Connections that break: what is repeated, what is not, and what is said then."""

from __future__ import annotations

import asyncio
import json
import socket
import ssl
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path

import anyio
import httpx2
import pytest

from cli.daemon_stub import serve_stub
from client.conftest import Handler, line_of
from lecombus.client import Line, Outcome, ProblemError, UnreachableError
from lecombus.client.connection import Json, body_text, finish, open_connection
from lecombus.client.finding import find_daemon
from support import api_line
from support.virtual_loop import run

DONE = httpx2.Response(200, json={"outcome": "done", "drive": "feeder"})


def broken(request: httpx2.Request) -> httpx2.Response:
    raise httpx2.RemoteProtocolError("server disconnected", request=request)


def absent(request: httpx2.Request) -> httpx2.Response:
    raise httpx2.ConnectError("refused", request=request)


def slow(request: httpx2.Request) -> httpx2.Response:
    raise httpx2.ReadTimeout("late", request=request)


class Script:
    """Answers requests one after the other, and remembers them."""

    def __init__(self, *steps: Handler | httpx2.Response) -> None:
        self.steps = list(steps)
        self.asked: list[httpx2.Request] = []

    def __call__(self, request: httpx2.Request) -> httpx2.Response:
        self.asked.append(request)
        step = self.steps.pop(0) if len(self.steps) > 1 else self.steps[0]
        return step if isinstance(step, httpx2.Response) else step(request)

    def keys(self) -> set[str]:
        return {request.headers["idempotency-key"] for request in self.asked}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock of the virtual loop."""
    monkeypatch.setattr("lecombus.client.connection.now_s", anyio.current_time)


def test_every_write_has_a_key_of_its_own() -> None:
    script = Script(DONE)
    line = line_of(httpx2.MockTransport(script))

    async def work() -> None:
        for _ in range(2):
            assert (await line.drive("feeder").write("C0046", 5)).outcome is Outcome.DONE

    run(work())
    assert len(script.keys()) == 2
    assert all("lecombus-asked" not in request.headers for request in script.asked)


@pytest.mark.usefixtures("clock")
def test_a_write_whose_connection_broke_is_repeated_with_its_key_and_its_age() -> None:
    script = Script(broken, absent, DONE)
    line = line_of(httpx2.MockTransport(script))

    async def work() -> None:
        assert (await line.drive("feeder").write("C0046", Decimal("35.40"))).outcome == "done"

    run(work())
    first, second, third = script.asked
    assert len(script.keys()) == 1
    assert "lecombus-asked" not in first.headers
    assert 0 < float(third.headers["lecombus-asked"]) < 1
    assert float(second.headers["lecombus-asked"]) < float(third.headers["lecombus-asked"])
    assert first.content == second.content == third.content == b'{"value": 35.40}'


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize("later", [broken, absent])
def test_an_answer_that_never_came_is_unknown(later: Handler) -> None:
    script = Script(broken, later)
    line = line_of(httpx2.MockTransport(script), repeat_for_s=5.0)

    async def work() -> None:
        began_s = anyio.current_time()
        result = await line.drive("feeder").enable()
        assert (result.outcome, result.kind, result.answer) == ("unknown", "answer-lost", None)
        assert (result.drive, result.verb) == ("feeder", "enable")
        assert "it may have happened" in result.remedy
        assert 4.0 < anyio.current_time() - began_s < 7.0
        script.steps[:] = [broken, later]
        group = await line.group("conveyors").write("C0046", 1)
        assert (group.outcome, group.target, group.members) == ("unknown", "conveyors", ())

    run(work())
    assert len(script.asked) > 4


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize("first", [slow])
def test_an_answer_that_is_late_is_unknown_and_not_asked_for_again(first: Handler) -> None:
    script = Script(first)
    line = line_of(httpx2.MockTransport(script))

    async def work() -> None:
        assert (await line.drive("feeder").write("C0046", 5)).outcome is Outcome.UNKNOWN

    run(work())
    assert len(script.asked) == 1


def test_a_daemon_that_is_not_there_is_an_error_and_nothing_is_repeated() -> None:
    script = Script(absent)
    line = line_of(httpx2.MockTransport(script))

    async def work() -> None:
        for act in (line.drive("feeder").enable, line.stop, line.status):
            with pytest.raises(UnreachableError, match="no daemon answers at here"):
                await act()

    run(work())
    assert len(script.asked) == 3


def test_a_question_is_repeated_once_without_a_key() -> None:
    script = Script(broken, httpx2.Response(200, json={"line": "hall-3"}), broken)
    line = line_of(httpx2.MockTransport(script))

    async def work() -> None:
        assert (await line.status()).name == "hall-3"
        with pytest.raises(UnreachableError, match="ended before it answered"):
            await line.status()

    run(work())
    assert len(script.asked) == 4
    assert all("idempotency-key" not in request.headers for request in script.asked)


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize("error", [
    httpx2.ReadError, httpx2.WriteError, httpx2.CloseError, httpx2.RemoteProtocolError,
    httpx2.DecodingError, httpx2.ReadTimeout, httpx2.WriteTimeout,
])  # fmt: skip
def test_whatever_breaks_once_a_request_may_have_been_sent_the_outcome_is_unknown(
    error: type[httpx2.RequestError],
) -> None:
    def fail(request: httpx2.Request) -> httpx2.Response:
        raise error("broken", request=request)

    line = line_of(httpx2.MockTransport(Script(fail)))

    async def work() -> None:
        assert (await line.drive("feeder").write("C0046", 5)).outcome is Outcome.UNKNOWN

    run(work())


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize("first", [None, broken])
def test_a_proxy_that_lost_the_answer_leaves_the_outcome_unknown(first: Handler | None) -> None:
    bad = httpx2.Response(502, text="<html>Bad Gateway</html>")
    script = Script(first, bad) if first is not None else Script(bad)
    line = line_of(httpx2.MockTransport(script))

    async def work() -> None:
        result = await line.drive("feeder").enable()
        assert (result.outcome, result.kind) == ("unknown", "answer-lost")
        assert "HTTP status 502" in result.reason or first is not None

    run(work())


@pytest.mark.parametrize("error", [httpx2.ReadError, httpx2.ConnectError, ssl.SSLError])
def test_a_daemon_that_does_not_take_the_certificate_is_said_to_be_so(
    error: type[Exception],
) -> None:
    """Without an event loop httpx2 makes an error of reading of it; nothing was sent."""

    def fail(request: httpx2.Request) -> httpx2.Response:
        raise error("[SSL: TLSV13_ALERT_CERTIFICATE_REQUIRED] tlsv13 alert certificate required")

    script = Script(fail)
    line = line_of(httpx2.MockTransport(script))

    async def work() -> None:
        for act in (line.stop, line.status):
            with pytest.raises(UnreachableError, match="does not accept your certificate"):
                await act()

    run(work())
    assert len(script.asked) <= 3


@pytest.mark.parametrize("said", [{}, {"status": "ok"}, []])
def test_an_answer_of_success_without_an_outcome_is_no_refusal(said: Json) -> None:
    """It is none of this daemon's; what became of the write is not known."""
    line = line_of(httpx2.MockTransport(Script(httpx2.Response(200, json=said))))

    async def work() -> None:
        assert (await line.drive("feeder").write("C0046", 5)).outcome is Outcome.UNKNOWN

    run(work())


def test_a_host_that_is_not_known_is_said_to_be_so() -> None:
    def fail(request: httpx2.Request) -> httpx2.Response:
        why = socket.gaierror(-2, "Name or service not known")
        raise httpx2.ConnectError(str(why), request=request) from why

    line = line_of(httpx2.MockTransport(Script(fail)))

    async def work() -> None:
        with pytest.raises(UnreachableError, match=r"the host of here is not known.*name server"):
            await line.stop()

    run(work())


def test_a_url_in_capitals_is_the_same_url() -> None:
    assert find_daemon(None, "HTTPS://Hall-3.example:9740") == ("", "https://hall-3.example:9740")


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize(
    ("status", "kind"), [(503, "queue-full"), (429, "too-many-failures"), (401, "bad-token")]
)
def test_a_repeat_that_is_turned_away_says_nothing_of_the_first_request(
    status: int, kind: str
) -> None:
    """The daemon refuses it before it looks at its key; the first may be under way, or done."""
    away = httpx2.Response(status, json={"type": f"urn:lecombus:problem:{kind}", "detail": kind})
    script = Script(broken, away)
    line = line_of(httpx2.MockTransport(script))

    async def work() -> None:
        result = await line.drive("feeder").write("C0046", 5)
        assert (result.outcome, result.kind) == ("unknown", "answer-lost")
        script.steps[:] = [broken, away, DONE]
        assert (await line.drive("feeder").write("C0046", 5)).outcome is Outcome.DONE

    run(work())


@pytest.mark.usefixtures("clock")
def test_a_repeat_that_is_refused_by_its_key_was_not_carried_out() -> None:
    said = {"type": "urn:lecombus:problem:queue-full", "outcome": "refused", "sent": False}
    script = Script(broken, httpx2.Response(503, json=said))
    line = line_of(httpx2.MockTransport(script))

    async def work() -> None:
        assert (await line.drive("feeder").write("C0046", 5)).outcome is Outcome.REFUSED

    run(work())
    assert len(script.asked) == 2


def test_what_is_not_lecombus_is_said_to_be_so() -> None:
    line = line_of(httpx2.MockTransport(Script(httpx2.Response(200, text="<html>"))))

    async def work() -> None:
        with pytest.raises(UnreachableError, match="is not lecombus"):
            await line.status()
        with pytest.raises(UnreachableError, match="is not lecombus"):
            await line.drive("feeder").enable()

    run(work())


def repeat(
    fake: api_line.Line, asked: str | None, key: str | None = "one"
) -> Callable[[], httpx2.Response]:
    headers = {"content-type": "application/json"}
    headers |= {"idempotency-key": key} if key else {}
    headers |= {"lecombus-asked": asked} if asked is not None else {}

    def ask() -> httpx2.Response:
        async def work() -> httpx2.Response:
            transport = httpx2.ASGITransport(app=fake.app)
            async with httpx2.AsyncClient(transport=transport, base_url="http://x") as http:
                path = "/v1/drives/feeder/codes/C0046"
                content = b'{"value": 5, "expires": "2s"}'
                return await http.put(path, content=content, headers=headers)

        return run(work())

    return ask


def test_the_daemon_gives_a_repeat_the_first_answer(fake: api_line.Line) -> None:
    fake.now_s = 100.0
    first = repeat(fake, None)()
    again = repeat(fake, "1.250")()
    assert (again.text, len(fake.ops.asked)) == (first.text, 1)


def test_the_daemon_carries_a_repeat_out_in_the_time_that_is_left(fake: api_line.Line) -> None:
    fake.now_s = 100.0
    assert repeat(fake, "0.5")().status_code == 200
    (asked,) = fake.ops.asked
    assert asked[4] == pytest.approx(1.5)


def test_a_repeat_from_before_the_start_is_not_carried_out(fake: api_line.Line) -> None:
    fake.now_s = 1.0
    answer = repeat(fake, "1.001")()
    assert (answer.status_code, answer.json()["outcome"]) == (504, "unknown")
    assert "started again since" in answer.json()["detail"]
    assert fake.ops.asked == []


@pytest.mark.parametrize("asked", ["", "-1", "1e9", "soon", "10000"])
def test_an_age_that_is_none_is_refused(fake: api_line.Line, asked: str) -> None:
    assert repeat(fake, asked)().status_code == 422
    assert fake.ops.asked == []


def test_an_age_without_a_key_is_refused(fake: api_line.Line) -> None:
    assert repeat(fake, "1", key=None)().status_code == 422


def test_decimals_stand_in_a_body_as_they_were_given() -> None:
    document: dict[str, Json] = {
        "value": Decimal("35.40"),
        "targets": ["a", Decimal("1E+2")],
        "x": {"y": True},
    }
    text = body_text(document)
    assert text == '{"value": 35.40, "targets": ["a", 100], "x": {"y": true}}'
    assert json.loads(text)["targets"] == ["a", 100]


def test_the_daemon_names_no_drive_is_an_error_of_the_request() -> None:
    problem = {"type": "urn:lecombus:problem:no-such-drive", "detail": "there is no drive `x`"}
    line = line_of(httpx2.MockTransport(Script(httpx2.Response(404, json=problem))))

    async def work() -> None:
        with pytest.raises(ProblemError, match="there is no drive"):
            await line.stop("x")

    run(work())


@pytest.mark.clock
def test_without_an_event_loop_requests_block(short_dir: Path) -> None:
    async def ask() -> tuple[str, str]:
        async with open_connection(str(short_dir / "s"), "", blocking=True) as connection:
            line = Line(connection)
            stopped = await line.stop()
            return (await line.status()).name, stopped.outcome

    with serve_stub(short_dir / "s") as stub:
        stub.answers["GET /v1/line"] = (200, '{"line": "hall-3"}')
        stub.answers["POST /v1/stop"] = (200, '{"outcome": "verified"}')
        assert finish(ask()) == ("hall-3", "verified")
        stub.answers["GET /v1/line"] = (200, None)
        with pytest.raises(UnreachableError, match="ended before it answered"):
            finish(ask())


def test_work_that_waits_for_another_task_needs_an_event_loop() -> None:
    with pytest.raises(RuntimeError, match="needs an event loop"):
        finish(asyncio.sleep(0))
