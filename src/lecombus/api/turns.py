"""Turns: one request begins at a time, so that a crowd never holds the loop for long.

The loop runs whatever is ready before it looks at its descriptors again. A hundred requests that
came together would thus be answered in one go, some thirty milliseconds in which no byte of a drive
is taken and no telegram sent. So requests wait here, and one is begun in each turn of the loop.

What must not live here: which requests need not wait for their turn (`connection`).
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

__all__ = ["Turns"]


class Turns:
    """Whoever waits to be begun, first come first served."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], None]] = deque()
        self._is_called = False

    def take(self, begin: Callable[[], None]) -> None:
        """Have something begun: at once if nobody waits, else in its turn."""
        if self._is_called:
            self._waiting.append(begin)
            return
        self._call()
        begin()

    def _call(self) -> None:
        self._is_called = True
        asyncio.get_running_loop().call_soon(self._next)

    def _next(self) -> None:
        self._is_called = False
        if self._waiting:
            begin = self._waiting.popleft()
            self._call()
            begin()
