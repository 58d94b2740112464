"""An asyncio loop whose time jumps: seconds of line time pass in microseconds, always the same.

When nothing is ready, time jumps to the next timer; when there is no timer either, nothing could
ever happen again and `DeadlockError` is raised out of `run`. Time starts at 1000 s and never
flows on its own. Callbacks of real threads and sockets are not waited for.
"""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Coroutine
from typing import Any, TypeVar

__all__ = ["DeadlockError", "TimeLimitError", "VirtualLoop", "run"]

T = TypeVar("T")

_START_S = 1000.0


class DeadlockError(AssertionError):
    """Nothing is ready and no timer is set: everyone waits for someone else."""


class TimeLimitError(AssertionError):
    """Virtual time went past the limit given."""


class _JumpingSelector(selectors.DefaultSelector):
    """Never waits: moves the loop's time instead."""

    loop: VirtualLoop

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if ready or timeout == 0:
            return ready
        self.loop.jump(timeout)
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """The loop.

    Args:
        limit_s: How much virtual time may pass before `TimeLimitError`.
    """

    def __init__(self, limit_s: float = 1e6) -> None:
        self._virtual_s = _START_S
        self._limit_s = _START_S + limit_s
        selector = _JumpingSelector()
        selector.loop = self
        super().__init__(selector)

    def time(self) -> float:
        return self._virtual_s

    def jump(self, timeout: float | None) -> None:
        """Move time to the next timer exactly; called when nothing is ready."""
        if timeout is None:
            raise DeadlockError("nothing is ready and no timer is set")
        scheduled = self._scheduled  # type: ignore[attr-defined]
        due_s = scheduled[0].when() if scheduled else self._virtual_s + timeout
        # Exactly the timer's time: adding the difference may fall short by rounding.
        self._virtual_s = max(self._virtual_s, due_s)
        if self._virtual_s > self._limit_s:
            raise TimeLimitError(f"more than {self._limit_s - _START_S} s of virtual time passed")


def run(main: Coroutine[Any, Any, T], *, limit_s: float = 1e6) -> T:
    """Run a coroutine to its end in virtual time."""
    with asyncio.Runner(loop_factory=lambda: VirtualLoop(limit_s)) as runner:
        return runner.run(main)
