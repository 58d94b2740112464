"""What worker and exchange loop wait for besides bytes: a time, a nudge, a moving deadline.

All belong to one line and its event loop thread. `WakeableSleep` lets the worker's task sleep until
a time or until `nudge`. `WakeableTimer` is the same for callbacks: waking a task costs twice as
much. `Deadline` calls back at a time that moves on with every exchange: its timer is left alone as
long as it is early enough and looks again when it fires, because making and cancelling one timer
for each exchange costs more than the rare look.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from lecombus.fieldbus.loop_interface import LateWakes

__all__ = ["Deadline", "Lateness", "WakeableSleep", "WakeableTimer"]


class Lateness:
    """How late what waits for a time was woken at most: the machine's part in every delay."""

    __slots__ = ("_most_s",)

    def __init__(self) -> None:
        self._most_s = 0.0

    def note(self, late_s: float) -> None:
        """Take one; who was nudged before the time was not late."""
        if late_s > self._most_s:
            self._most_s = late_s

    def take_s(self) -> float:
        """Return the most since the last call."""
        most_s, self._most_s = self._most_s, 0.0
        return most_s


class WakeableSleep:
    """Lets one task sleep until a time, or until nudged.

    Args:
        lateness: Records how late it was woken.
    """

    __slots__ = ("_future", "_lateness")

    def __init__(self, lateness: LateWakes) -> None:
        self._lateness = lateness
        self._future: asyncio.Future[None] | None = None

    def nudge(self) -> None:
        """Wake the sleeper, if there is one."""
        if self._future is not None:
            _wake(self._future)

    async def until(self, at_s: float) -> None:
        """Sleep until `at_s` or until nudged."""
        loop = asyncio.get_running_loop()
        self._future = nap = loop.create_future()
        timer = loop.call_at(at_s, _wake, nap)
        try:
            await nap
            self._lateness.note(loop.time() - at_s)
        finally:
            self._future = None
            timer.cancel()


class WakeableTimer:
    """Calls back once: at a time, or when nudged before it.

    Args:
        over: Called.
        lateness: Records how late that was, if it was not nudged.

    Attributes:
        late_s: How late the last one was over, seconds; 0: it was nudged.
    """

    __slots__ = ("_handle", "_lateness", "_listens", "_over", "_until_s", "late_s")

    def __init__(self, over: Callable[[], None], lateness: LateWakes) -> None:
        self._over = over
        self._lateness = lateness
        self._handle: asyncio.Handle | None = None
        self._listens = False
        self._until_s = self.late_s = 0.0

    @property
    def is_on(self) -> bool:
        """Whether it will call back."""
        return self._handle is not None

    def until(self, at_s: float, *, deaf: bool = False) -> None:
        """Call back at `at_s` or, unless `deaf`, when nudged."""
        assert self._handle is None, "one pause at a time"
        self._until_s, self._listens = at_s, not deaf
        self.late_s = 0.0
        self._handle = asyncio.get_running_loop().call_at(at_s, self._passed)

    def nudge(self) -> None:
        """Call back soon, but not from inside this call, if it is on and listens."""
        if self._handle is not None and self._listens:
            self._handle.cancel()
            self._listens = False
            self._handle = asyncio.get_running_loop().call_soon(self._end)

    def clear(self) -> None:
        """Call back no more."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _passed(self) -> None:
        self.late_s = asyncio.get_running_loop().time() - self._until_s
        self._lateness.note(self.late_s)
        self._end()

    def _end(self) -> None:
        self._handle = None
        self._over()


class Deadline:
    """Calls back at a time that is set again often.

    Args:
        passed: Called when it may have passed; it sets the deadline again if it has not.
    """

    __slots__ = ("_passed", "_timer")

    def __init__(self, passed: Callable[[], None]) -> None:
        self._passed = passed
        self._timer: asyncio.TimerHandle | None = None

    def set(self, at_s: float) -> None:
        """Call back at `at_s` at the latest; it may also be called earlier, for one set before."""
        if self._timer is not None:
            if self._timer.when() <= at_s:
                return
            self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_at(at_s, self._fire)

    def clear(self) -> None:
        """Call back no more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _fire(self) -> None:
        self._timer = None
        self._passed()


def _wake(nap: asyncio.Future[None]) -> None:
    if not nap.done():
        nap.set_result(None)
