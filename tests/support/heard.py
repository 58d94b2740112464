"""What a port gives on, kept for a test that looks at it or waits for it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import anyio

__all__ = ["Heard"]


class Heard:
    """A receiver that keeps what it was told, and can be waited for."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.losses: list[Exception | None] = []
        self._changed = asyncio.Event()

    def received(self, data: bytes) -> None:
        assert data, "a port never gives on nothing"
        self.data += data
        self._changed.set()

    def lost(self, exc: Exception | None) -> None:
        self.losses.append(exc)
        self._changed.set()

    async def until(self, condition: Callable[[], bool], within_s: float = 5.0) -> None:
        with anyio.fail_after(within_s):
            while not condition():
                self._changed.clear()
                await self._changed.wait()
