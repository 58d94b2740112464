"""Fixtures of the API tests."""

from __future__ import annotations

from collections.abc import AsyncIterator

import httpx2
import pytest

from support.api_line import Line, make_line


@pytest.fixture
def line() -> Line:
    return make_line()


@pytest.fixture
async def client(line: Line) -> AsyncIterator[httpx2.AsyncClient]:
    transport = httpx2.ASGITransport(app=line.app, raise_app_exceptions=False)
    async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as made:
        yield made


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def standing_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """No time passes between a request and what it asks for."""
    monkeypatch.setattr("lecombus.api.idempotency.current_time", lambda: 5.0)
