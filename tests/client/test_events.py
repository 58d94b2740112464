"""Events across connections that break: what comes, where it goes on, when it is over."""

from __future__ import annotations

import ssl
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing
from decimal import Decimal

import anyio
import httpx2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from client.conftest import line_of
from lecombus.client import ClientError, Event, ProblemError, UnreachableError
from lecombus.client.events import FrameReader
from support.virtual_loop import run

STREAM = (
    ': \nid: R-0\n\n'
    'id: R-1\nevent: value\n'
    'data: {"drive": "feeder", "code": "C0050", "value": 35.40, "quality": "good"}\n\n'
    ": still here\n\n"
    'id: R-2\r\nevent: trip\r\n'
    'data: {"drive": "feeder",\r\ndata: "active": true, "x": "\u2028"}\r\n\r\n'
    'id: R-3\nevent: line\ndata: {"line": "hall-3", "state": "lost"}\n\n'
).encode()  # fmt: skip

Answers = Callable[[int], AsyncIterator[bytes] | httpx2.Response]


async def streamed(*parts: bytes, then: Exception | None = None) -> AsyncIterator[bytes]:
    for part in parts:
        yield part
    if then is not None:
        raise then


class Served:
    """Answers requests for events one after the other; remembers what they asked."""

    def __init__(self, *answers: AsyncIterator[bytes] | httpx2.Response | Exception) -> None:
        self.answers = list(answers)
        self.asked: list[httpx2.Request] = []

    def __call__(self, request: httpx2.Request) -> httpx2.Response:
        self.asked.append(request)
        answer = self.answers.pop(0) if self.answers else httpx2.ConnectError("gone")
        if isinstance(answer, Exception):
            raise answer
        if isinstance(answer, httpx2.Response):
            return answer
        return httpx2.Response(200, content=answer)


def frame(number: int) -> bytes:
    return f'id: R-{number}\nevent: trip\ndata: {{"drive": "a", "n": {number}}}\n\n'.encode()


def read(served: Served, *, count: int = 100, patience_s: float = 10.0) -> list[Event]:
    found: list[Event] = []

    async def work() -> None:
        line = line_of(httpx2.MockTransport(served))
        async with aclosing(
            line.events(kinds=["trip"], drives=["a"], patience_s=patience_s)
        ) as all_:
            async for event in all_:
                found.append(event)
                if len(found) == count:
                    return

    run(work())
    return found


@given(st.lists(st.integers(0, len(STREAM)), max_size=12))
def test_events_are_read_however_the_bytes_are_cut(cuts: list[int]) -> None:
    reader, at = FrameReader(), 0
    found: list[Event] = []
    for cut in (*sorted(cuts), len(STREAM)):
        found += reader.feed(STREAM[at:cut])
        at = cut
    assert [(one.id, one.kind, one.drive) for one in found] == [
        ("R-1", "value", "feeder"), ("R-2", "trip", "feeder"), ("R-3", "line", ""),
    ]  # fmt: skip
    assert found[0].reading.number == Decimal("35.40")
    assert found[1].data["x"] == "\u2028"
    with pytest.raises(ClientError, match="has no value"):
        _ = found[1].reading
    assert reader.last_id == "R-3"


def test_an_id_without_an_event_says_where_the_stream_is() -> None:
    reader = FrameReader()
    assert list(reader.feed(b": \nid: R-17\n\n")) == []
    assert reader.last_id == "R-17"


@pytest.mark.parametrize("data", [b"data: {\n\n", b"x" * (2 << 20)])
def test_what_is_no_event_is_an_error(data: bytes) -> None:
    with pytest.raises(UnreachableError, match="are not events"):
        list(FrameReader().feed(data))


@pytest.mark.parametrize("error", [httpx2.ReadError("cut"), httpx2.ReadTimeout("late"), None])
def test_a_stream_that_breaks_goes_on_behind_the_last_event(error: Exception | None) -> None:
    half = frame(3)[:20]
    served = Served(
        streamed(b": \nid: R-0\n\n", then=error),
        streamed(frame(1), frame(2), half, then=error),
        httpx2.ConnectError("restarting"),
        httpx2.Response(503, json={"type": "urn:lecombus:problem:not-ready", "detail": "wait"}),
        streamed(frame(3), frame(4)),
    )
    assert [event.data["n"] for event in read(served, count=4)] == [1, 2, 3, 4]
    sent = [request.headers.get("last-event-id") for request in served.asked]
    assert sent == [None, "R-0", "R-2", "R-2", "R-2"]
    assert served.asked[0].url.params.multi_items() == [("drive", "a"), ("kind", "trip")]


def test_a_daemon_that_stays_away_is_an_error_after_a_while() -> None:
    served = Served(streamed(frame(1)))
    found: list[float] = []

    async def work() -> None:
        line = line_of(httpx2.MockTransport(served))
        began_s = anyio.current_time()
        with pytest.raises(UnreachableError, match="no daemon answers"):
            async for _ in line.events(patience_s=10.0):
                pass
        found.append(anyio.current_time() - began_s)

    run(work())
    assert 10.0 <= found[0] <= 13.0


def test_a_daemon_that_is_not_there_at_the_beginning_is_an_error_then() -> None:
    served = Served()
    with pytest.raises(UnreachableError, match="no daemon answers"):
        read(served)
    assert len(served.asked) == 1


@pytest.mark.parametrize("status", [400, 403, 404, 422])
def test_a_refusal_is_an_error_also_after_events(status: int) -> None:
    refused = {"type": "urn:lecombus:problem:no-such-drive", "detail": "there is no drive a"}
    for before in ((), (streamed(frame(1)),)):
        served = Served(*before, httpx2.Response(status, json=refused))
        with pytest.raises(ProblemError, match="there is no drive a"):
            read(served)


@pytest.mark.parametrize("status", [502, 503, 504])
def test_a_proxy_that_cannot_reach_the_daemon_is_waited_for(status: int) -> None:
    """What a proxy says is not a problem document."""
    away = httpx2.Response(status, text="<html>Bad Gateway</html>")
    served = Served(streamed(frame(1)), away, streamed(frame(2)))
    assert [event.data["n"] for event in read(served, count=2)] == [1, 2]
    with pytest.raises(UnreachableError, match=f"HTTP status {status}"):
        read(Served(httpx2.Response(status, text="<html>")))


def test_a_stream_whose_tls_breaks_goes_on_too() -> None:
    """httpx2 leaves some errors of the ssl module as they are."""
    served = Served(
        streamed(frame(1), then=ssl.SSLError("bad record mac")),
        ssl.SSLError("bad record mac"),
        streamed(frame(2)),
    )
    assert [event.data["n"] for event in read(served, count=2)] == [1, 2]
    with pytest.raises(UnreachableError, match="broke"):
        read(Served(ssl.SSLError("bad record mac")))


def test_another_server_that_answers_is_not_taken_for_a_quiet_line() -> None:
    page = httpx2.Response(200, html="<html>\n\nWelcome</html>")
    with pytest.raises(UnreachableError, match="is not lecombus"):
        read(Served(page, page, streamed(frame(1))), count=1)


def test_answers_that_end_without_a_word_are_no_daemon_either() -> None:
    served = Served(streamed(frame(1)), *(streamed() for _ in range(50)))
    with pytest.raises(UnreachableError, match="says nothing"):
        read(served, patience_s=10.0)
    assert 5 < len(served.asked) < 15
