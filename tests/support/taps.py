"""Taps between the parts of a line: they show what passes, and change nothing.

`ObserverTap` stands before the books, `PortTap` and `ReceiverTap` on both sides of the port;
`running` keeps a site's tasks alive meanwhile.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable

import anyio

from lecombus.fieldbus.loop_interface import ExchangeReport, Observer
from lecombus.fieldbus.port import Port, Receiver
from lecombus.line_runtime import LineRuntime

__all__ = ["STRIPPED", "WALL_S", "ObserverTap", "PortTap", "ReceiverTap", "running"]

STRIPPED = bytes(range(128)) * 2
"""Takes the parity off bytes: `data.translate(STRIPPED)`."""
WALL_S = 1_795_000_000.0
"""The time of day at which virtual time would be 0."""


class ObserverTap:
    """Shows every report before the books get it.

    Args:
        inner: The books.
        ended: Called with every report.
    """

    def __init__(self, inner: Observer, ended: Callable[[ExchangeReport], None]) -> None:
        self._inner = inner
        self._ended = ended
        self.line_changed = inner.line_changed
        self.thinking = inner.thinking
        self.stray_bytes = inner.stray_bytes

    def exchange_ended(self, report: ExchangeReport) -> None:
        self._ended(report)
        self._inner.exchange_ended(report)


class PortTap:
    """Shows every telegram before it goes out.

    Args:
        inner: The port.
        said: Called with the bytes as they are handed over, parity bits included.
    """

    def __init__(self, inner: Port, said: Callable[[bytes], None]) -> None:
        self._inner = inner
        self._said = said
        self.carries_parity = inner.carries_parity
        self.discard_input = inner.discard_input
        self.look = inner.look
        self.abort = inner.abort
        self.describe = inner.describe

    def write(self, data: bytes) -> None:
        self._said(data)
        self._inner.write(data)


class ReceiverTap:
    """Shows all bytes that come in before the line gets them.

    Args:
        inner: The line.
        heard: Called with the bytes as they came, parity bits included.
    """

    def __init__(self, inner: Receiver, heard: Callable[[bytes], None]) -> None:
        self._inner = inner
        self._heard = heard
        self.lost = inner.lost

    def received(self, data: bytes) -> None:
        self._heard(data)
        self._inner.received(data)


@contextlib.asynccontextmanager
async def running(site: LineRuntime) -> AsyncIterator[None]:
    """Work a site's line as long as the block lasts."""
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(site.supervision.drives.run)
        tasks.start_soon(site.supervision.leases.run)
        tasks.start_soon(site.worker.run)
        yield
        tasks.cancel_scope.cancel()
