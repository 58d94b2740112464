"""Which missed watchdogs are new, from one page of metrics to the next."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager

import anyio
import httpx2
import pytest

from client.conftest import line_of
from lecombus.bridges.mqtt.summary import LineSummarizer
from lecombus.bridges.mqtt.topics import Topics
from lecombus.bridges.watchdog_misses import watch_misses
from lecombus.client import Line, UnreachableError
from support.virtual_loop import run


def page(start: str, feeder: int) -> str:
    started = f"process_start_time_seconds {start}\n" if start else ""
    return f'lecombus_watchdog_misses_total{{line="hall-3",drive="feeder"}} {feeder}\n{started}'


@pytest.mark.parametrize(
    ("pages", "missed"),
    [
        ([page("1.79e+09", 1), page("1.79e+09", 1)], 0),
        ([page("1.79e+09", 1), page("1.79e+09", 2)], 1),
        ([page("1.79e+09", 1), None, page("1.79e+09", 1)], 0),
        ([page("1.79e+09", 1), None, page("1.8e+09", 0), page("1.8e+09", 0)], 0),
        # The new daemon has counted as many as the former one: these are others.
        ([page("1.79e+09", 1), None, page("1.8e+09", 1), page("1.8e+09", 1)], 1),
        ([page("1.79e+09", 1), page("1.8e+09", 3)], 1),
        ([page("", 1), None, page("", 1), page("", 0), page("", 1)], 1),
    ],
)  # fmt: skip
def test_misses_are_counted_anew_when_the_daemon_was_started_again(
    monkeypatch: pytest.MonkeyPatch, pages: list[str | None], missed: int
) -> None:
    left = list(pages)

    def answer(request: httpx2.Request) -> httpx2.Response:
        found = left.pop(0) if left else pages[-1]
        if found is None:
            raise httpx2.ReadError("gone")
        return httpx2.Response(200, text=found)

    @asynccontextmanager
    async def connect(socket: str) -> AsyncIterator[Line]:
        if left and left[0] is None:
            left.pop(0)
            raise UnreachableError("no daemon answers")
        line = line_of(httpx2.MockTransport(answer))
        async with line.connection.http:
            yield line

    monkeypatch.setattr("lecombus.bridges.watchdog_misses.connect", connect)
    found: list[float] = []
    summary = LineSummarizer(Topics("lecombus", "hall-3"), "hall-3")

    def take(counts: Mapping[str, int]) -> None:
        before = dict(summary._missed_s)
        summary.watchdog_missed(counts, anyio.current_time())
        if summary._missed_s != before:
            found.append(anyio.current_time())

    async def watch() -> None:
        with anyio.move_on_after(100):
            await watch_misses("/run/x.sock", 5.0, take)

    run(watch())
    assert len(found) == missed
