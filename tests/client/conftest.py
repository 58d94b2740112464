"""Fixtures of the tests of the client library."""

from __future__ import annotations

import tempfile
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import httpx2
import pytest

from lecombus.client import Line
from lecombus.client.connection import Connection
from support import api_line

Handler = Callable[[httpx2.Request], httpx2.Response]


def line_of(transport: httpx2.AsyncBaseTransport, *, repeat_for_s: float = 5.0) -> Line:
    """A line behind a transport of the test's."""
    http = httpx2.AsyncClient(transport=transport, base_url="http://localhost")
    return Line(Connection(http, "here", repeat_for_s=repeat_for_s))


@pytest.fixture
def fake() -> api_line.Line:
    """A line with a fake of the operations behind the real HTTP application."""
    return api_line.make_line()


@pytest.fixture
async def line(fake: api_line.Line) -> AsyncIterator[Line]:
    """The same, seen through the library."""
    made = line_of(httpx2.ASGITransport(app=fake.app, raise_app_exceptions=False))
    async with made.connection.http:
        yield made


@pytest.fixture
def short_dir() -> Iterator[Path]:
    """A directory whose path is short enough for a Unix socket."""
    with tempfile.TemporaryDirectory(prefix="lb-") as name:
        yield Path(name)


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def standing_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """No time passes between a request and what it asks for."""
    monkeypatch.setattr("lecombus.api.idempotency.current_time", lambda: 5.0)
