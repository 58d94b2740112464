"""An asyncio event loop whose timers are accurate to some 50 µs.

Why: the standard loop waits with `epoll_wait`, which counts whole milliseconds and rounds up, so
a turnaround of 2.0 ms becomes 2.1 to 3.1 ms. At 19200 baud with a short answer that is some 3 % of
the line, for nothing.

Strategy: an epoll descriptor is itself readable when something waits in it, and `select` takes
microseconds. So the selector waits long times in epoll, but ends that wait at least a millisecond
early with nothing ready, which costs the loop one empty turn, and waits the last stretch in
`select` on the epoll descriptor. Waits that end because bytes came, which are nearly all waits of
an exchange, take the same single system call as before, unless the timer was due within 3 ms.
`run` also asks the kernel not to bundle this thread's timers with others (its slack is 50 µs).
"""

from __future__ import annotations

import asyncio
import contextlib
import select
import selectors
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar, TypeVarTuple

import anyio

__all__ = ["FineSelector", "new_event_loop", "run"]

_T = TypeVar("_T")
_Ts = TypeVarTuple("_Ts")

FINE_BELOW_S = 0.003
"""Waits shorter than this are made by `select` alone: the worker's turnaround is 2 ms."""

EARLY_S = 0.001
"""By how much a long wait ends early: epoll rounds up by less than 1 ms."""

_SELECT_LIMIT = 1024
"""FD_SETSIZE: `select` refuses descriptors from here on."""

_SLACK_FILE = Path("/proc/self/timerslack_ns")
_SLACK_NS = 1000

Ready = list[tuple[selectors.SelectorKey, int]]


class FineSelector(selectors.EpollSelector):
    """An epoll selector that keeps time-outs to microseconds instead of milliseconds.

    It may return early with nothing ready, which asyncio allows: it looks at the clock again.

    Attributes:
        fine: Short waits are accurate; not if 1024 descriptors were open before this one.
    """

    def __init__(self) -> None:
        """Open the epoll descriptor, and choose the plain way if `select` cannot take it."""
        super().__init__()
        self._watched = [self.fileno()]
        self.fine = self.fileno() < _SELECT_LIMIT

    def select(self, timeout: float | None = None) -> Ready:
        """Wait for a descriptor to become ready.

        Args:
            timeout: How long at most, seconds; None: no limit; 0 or less: do not wait.

        Returns:
            What is ready, empty when the time is over or nearly over.
        """
        if timeout is None or timeout <= 0.0 or not self.fine:
            return super().select(timeout)
        if timeout >= FINE_BELOW_S:
            return super().select(timeout - EARLY_S)
        if not select.select(self._watched, (), (), timeout)[0]:
            return []
        return super().select(0)


def new_event_loop() -> asyncio.SelectorEventLoop:
    """Make an event loop with accurate timers.

    Returns:
        A loop that is not running and not set as the current one; the caller closes it.
    """
    return asyncio.SelectorEventLoop(FineSelector())


def run(
    main: Callable[[*_Ts], Awaitable[_T]],
    *args: *_Ts,
) -> _T:
    """Run a coroutine function to its end in a new event loop with accurate timers.

    To be called from the process's main thread, whose timer slack it sets.

    Args:
        main: The coroutine function; anyio works in it as after `anyio.run`.
        args: Its arguments.

    Returns:
        What it returned.
    """
    _tighten_timers()
    options = {"loop_factory": new_event_loop}
    return anyio.run(main, *args, backend="asyncio", backend_options=options)


def _tighten_timers() -> None:
    """Let the kernel end this thread's waits within 1 µs instead of 50 µs, where it offers that."""
    with contextlib.suppress(OSError):
        _SLACK_FILE.write_text(str(_SLACK_NS))
