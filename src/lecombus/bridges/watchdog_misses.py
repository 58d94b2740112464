"""Missed watchdogs: the daemon has no event for them, and counts them in its metrics."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Final, NoReturn

import anyio
import httpx2

from lecombus.client import ClientError, connect

__all__ = ["misses_of", "start_of", "watch_misses"]

MISSES: Final = re.compile(
    r'^lecombus_watchdog_misses_total\{[^}]*drive="([^"]+)"[^}]*\} ([0-9.e+]+)$', re.MULTILINE
)
START: Final = re.compile(r"^process_start_time_seconds ([0-9.e+]+)$", re.MULTILINE)


async def watch_misses(
    socket: str, every_s: float, take: Callable[[Mapping[str, int]], None]
) -> NoReturn:
    """Read the counts of missed watchdogs again and again; a daemon that is away has none.

    Args:
        socket: The path of the daemon's Unix socket.
        every_s: How often, seconds: each time a page of metrics is read.
        take: Takes by drive how often its watchdog was fed too late since the daemon's start; takes
            nothing first, if the daemon was started again: it counts from 0.
    """
    started = ""
    while True:
        try:
            async with connect(socket) as line:
                while True:
                    answer = await line.connection.http.get("/metrics")
                    if answer.status_code == 200:
                        before, started = started, start_of(answer.text) or started
                        if before not in ("", started):
                            take({})
                        take(misses_of(answer.text))
                    await anyio.sleep(every_s)
        except (ClientError, httpx2.HTTPError):
            await anyio.sleep(every_s)


def misses_of(page: str) -> Mapping[str, int]:
    """Return by drive how often its watchdog was missed, from a page of metrics."""
    return {drive: int(float(count)) for drive, count in MISSES.findall(page)}


def start_of(page: str) -> str:
    """Return when the daemon was started, from a page of metrics; empty: that is not known."""
    found = START.search(page)
    return "" if found is None else found[1]
