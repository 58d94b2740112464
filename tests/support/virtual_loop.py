"""An asyncio loop whose time jumps: seconds of line time pass in microseconds, always the same.

When nothing is ready, time jumps to the next timer; when there is no timer either, nothing could
ever happen again and `DeadlockError` is raised out of `run`. Time starts at 1000 s and never
flows on its own. Callbacks of real threads and sockets are not waited for.

Hours of simulated lines run on it, so its own work is kept small: timers lie in a heap of plain
tuples (those of one time in the order in which they were made), and the kernel is asked only when
there is a socket to ask for.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextvars import Context
from heapq import heappop, heappush
from typing import Any, TypeVar, TypeVarTuple

__all__ = ["DeadlockError", "TimeLimitError", "VirtualLoop", "run"]

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

_START_S = 1000.0
_OWN_DESCRIPTORS = 1
"""Every loop watches a pipe of its own, by which other threads wake it."""


class DeadlockError(AssertionError):
    """Nothing is ready and no timer is set: everyone waits for someone else."""


class TimeLimitError(AssertionError):
    """Virtual time went past the limit given."""


class VirtualLoop(asyncio.SelectorEventLoop):
    """The loop.

    Args:
        limit_s: How much virtual time may pass before `TimeLimitError`.
    """

    def __init__(self, limit_s: float = 1e6) -> None:
        self._virtual_s = _START_S
        self._limit_s = _START_S + limit_s
        self._timers: list[tuple[float, int, asyncio.TimerHandle]] = []
        self._count = 0
        super().__init__()

    def time(self) -> float:
        return self._virtual_s

    def call_at(
        self,
        when: float,
        callback: Callable[[*Ts], object],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        timer = asyncio.TimerHandle(when, callback, args, self, context)
        self._count += 1
        heappush(self._timers, (when, self._count, timer))
        return timer

    def _timer_handle_cancelled(self, handle: asyncio.TimerHandle) -> None:
        """A cancelled timer stays in the heap until its turn; asyncio would count it."""

    def _run_once(self) -> None:
        """Run what is ready; if nothing is, let time jump and run what is due then."""
        ready, timers = self._ready, self._timers  # type: ignore[attr-defined]
        if not ready:
            self._ask_sockets()
        if not ready and not self._stopping:  # type: ignore[attr-defined]
            self._jump()
        while timers and timers[0][0] <= self._virtual_s:
            ready.append(heappop(timers)[2])
        for _ in range(len(ready)):
            handle = ready.popleft()
            if not handle.cancelled():
                handle._run()

    def _ask_sockets(self) -> None:
        selector = self._selector  # type: ignore[attr-defined]
        if len(selector.get_map()) > _OWN_DESCRIPTORS:
            self._process_events(selector.select(0))  # type: ignore[attr-defined]

    def _jump(self) -> None:
        """Move time to the next timer exactly."""
        timers = self._timers
        while timers and timers[0][2].cancelled():
            heappop(timers)
        if not timers:
            raise DeadlockError("nothing is ready and no timer is set")
        self._virtual_s = max(self._virtual_s, timers[0][0])
        if self._virtual_s > self._limit_s:
            raise TimeLimitError(f"more than {self._limit_s - _START_S} s of virtual time passed")


def run(main: Coroutine[Any, Any, T], *, limit_s: float = 1e6) -> T:
    """Run a coroutine to its end in virtual time."""
    with asyncio.Runner(loop_factory=lambda: VirtualLoop(limit_s)) as runner:
        return runner.run(main)
