"""An asyncio loop whose time jumps: seconds of line time pass in microseconds, always the same.

When nothing is ready, time jumps to the next timer; when there is no timer either, nothing could
ever happen again and `DeadlockError` is raised out of `run`. Time starts at 1000 s and never
flows on its own. Callbacks of real threads and sockets are not waited for.

Hours of simulated lines run on it, so its own work is kept small: timers lie in a heap of plain
tuples (those of one time in the order in which they were made), callbacks are run without a frame
between, and the kernel is asked only when there is a socket to ask for.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine, Sequence
from contextvars import Context, copy_context
from heapq import heappop, heappush
from typing import Any, Protocol, TypeVar, TypeVarTuple

__all__ = [
    "DeadlockError",
    "Machine",
    "Paused",
    "Starved",
    "TimeLimitError",
    "VirtualLoop",
    "run",
]

from lecombus.fieldbus.lecom.simulator.memory import MemoryPort

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

_START_S = 1000.0
_OWN_DESCRIPTORS = 1
"""Every loop watches a pipe of its own, by which other threads wake it."""


class DeadlockError(AssertionError):
    """Nothing is ready and no timer is set: everyone waits for someone else."""


class TimeLimitError(AssertionError):
    """Virtual time went past the limit given."""


class Machine(Protocol):
    """When a process that wants to run does run."""

    def runs_s(self, wanted_s: float) -> float:
        """Tell when it runs on; `wanted_s` or later."""


class Paused:
    """A machine that does not run the process in some spans of time (SIGSTOP and SIGCONT).

    Args:
        spans: From when to when it is paused, in order.
    """

    def __init__(self, spans: Sequence[tuple[float, float]]) -> None:
        self._spans = list(spans)
        self._all = tuple(spans)

    def paused_s(self, from_s: float, to_s: float) -> float:
        """Tell for how long of a stretch of time the process did not run."""
        return sum(max(min(to_s, end_s) - max(from_s, at_s), 0.0) for at_s, end_s in self._all)

    def runs_s(self, wanted_s: float) -> float:
        """See `Machine`."""
        while self._spans and self._spans[0][1] <= wanted_s:
            del self._spans[0]
        if self._spans and self._spans[0][0] <= wanted_s:
            return self._spans[0][1]
        return wanted_s


class Starved:
    """A machine that lets the process wait, now and then, wherever it is.

    Args:
        rng: Decides when and for how long.
        chance: Of each step, 0..1.
        most_s: The longest it waits, seconds.
        until_s: Until when.
    """

    def __init__(self, rng: random.Random, chance: float, most_s: float, until_s: float) -> None:
        self._rng, self._chance, self._most_s = rng, chance, most_s
        self._until_s = until_s

    def runs_s(self, wanted_s: float) -> float:
        """See `Machine`."""
        if wanted_s < self._until_s and self._rng.random() < self._chance:
            return wanted_s + self._rng.uniform(0.0, self._most_s)
        return wanted_s


class _Timer(asyncio.TimerHandle):
    """A timer in one step: asyncio's takes three calls to make and two to cancel."""

    __slots__ = ()
    _repr = None
    _source_traceback = None
    _scheduled = False

    def __init__(
        self,
        when: float,
        callback: Callable[..., object],
        args: Sequence[object],
        loop: asyncio.AbstractEventLoop,
        context: Context | None,
    ) -> None:
        self._when = when
        self._callback = callback
        self._args = args
        self._loop = loop
        self._cancelled = False
        self._context = copy_context() if context is None else context

    def cancel(self) -> None:
        self._cancelled = True
        self._callback, self._args = _nothing, ()  # what they kept alive need not live on


def _nothing() -> None:
    """Stand for the callback of a timer that was cancelled."""


class VirtualLoop(asyncio.SelectorEventLoop):
    """The loop.

    With a `machine` it does not always run when it wants to. It then finds its timers first and
    the bytes that came meanwhile last, as a loop does whose wait was interrupted by a signal.

    Args:
        limit_s: How much virtual time may pass before `TimeLimitError`.

    Attributes:
        machine: When it runs; None: always.
    """

    machine: Machine | None = None

    def __init__(self, limit_s: float = 1e6) -> None:
        self._virtual_s = _START_S
        self._limit_s = _START_S + limit_s
        self._timers: list[tuple[float, int, asyncio.TimerHandle]] = []
        self._count = 0
        super().__init__()
        self._sockets = self._selector._fd_to_key  # type: ignore[attr-defined]

    def time(self) -> float:
        if self.machine is not None:  # taken from the processor in the middle of a callback
            self._virtual_s = self.machine.runs_s(self._virtual_s)
        return self._virtual_s

    def call_at(
        self,
        when: float,
        callback: Callable[[*Ts], object],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        timer = _Timer(when, callback, args, self, context)
        self._count += 1
        heappush(self._timers, (when, self._count, timer))
        return timer

    def _run_once(self) -> None:
        """Run what is ready; if nothing is, let time jump and run what is due then."""
        ready, timers = self._ready, self._timers  # type: ignore[attr-defined]
        if not ready:
            if len(self._sockets) > _OWN_DESCRIPTORS:
                self._ask_sockets()
            if not ready and not self._stopping:  # type: ignore[attr-defined]
                self._jump()
        if self.machine is None:
            while timers and timers[0][0] <= self._virtual_s:
                ready.append(heappop(timers)[2])
        else:
            ready.extend(self._due_bytes_last())
        for _ in range(len(ready)):
            handle = ready.popleft()
            if not handle._cancelled:
                try:
                    handle._context.run(handle._callback, *handle._args)
                except (SystemExit, KeyboardInterrupt):
                    raise
                except BaseException as exc:  # noqa: BLE001 - as asyncio's own handles do
                    self._report(handle, exc)

    def _report(self, handle: asyncio.Handle, exc: BaseException) -> None:
        message = f"Exception in callback {handle!r}"
        self.call_exception_handler({"message": message, "exception": exc, "handle": handle})

    def _due_bytes_last(self) -> list[asyncio.TimerHandle]:
        """Take the timers that are due; those that stand for bytes from a port come last."""
        due = []
        while self._timers and self._timers[0][0] <= self._virtual_s:
            due.append(heappop(self._timers)[2])
        return sorted(due, key=_is_of_port)

    def _ask_sockets(self) -> None:
        events = self._selector.select(0)  # type: ignore[attr-defined]
        self._process_events(events)  # type: ignore[attr-defined]

    def _jump(self) -> None:
        """Move time to the next timer exactly."""
        timers = self._timers
        while timers and timers[0][2]._cancelled:
            heappop(timers)
        if not timers:
            raise DeadlockError("nothing is ready and no timer is set")
        if timers[0][0] > self._virtual_s:
            self._virtual_s = timers[0][0]
        if self.machine is not None:
            self._virtual_s = self.machine.runs_s(self._virtual_s)
        if self._virtual_s > self._limit_s:
            raise TimeLimitError(f"more than {self._limit_s - _START_S} s of virtual time passed")


def _is_of_port(handle: asyncio.TimerHandle) -> bool:
    callback = handle._callback  # type: ignore[attr-defined]
    return isinstance(getattr(callback, "__self__", None), MemoryPort)


def run(main: Coroutine[Any, Any, T], *, limit_s: float = 1e6) -> T:
    """Run a coroutine to its end in virtual time."""
    with asyncio.Runner(loop_factory=lambda: VirtualLoop(limit_s)) as runner:
        return runner.run(main)
