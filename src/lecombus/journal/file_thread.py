"""The thread that a journal's file is used in: one call after the other.

It dies with the process: the end of the daemon does not wait for a disk that hangs.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, TypeVar

__all__ = ["FileThread"]

T = TypeVar("T")
Done = Callable[[Any, Exception | None], None]
"""Takes the result of a call, or the error that it ended with."""


class FileThread:
    """Carries out calls in their order, in one separate thread."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._calls: SimpleQueue[tuple[Callable[[], Any], Done]] = SimpleQueue()
        threading.Thread(target=self._run, name="journal", daemon=True).start()

    def submit(self, call: Callable[[], T], done: Done) -> None:
        """Have a call carried out; `done` is called in the event loop then."""
        self._calls.put((call, done))

    async def ask(self, call: Callable[[], T]) -> T:
        """Have a call carried out and return its result, or raise its error."""
        future: asyncio.Future[T] = self._loop.create_future()

        def done(result: T, error: Exception | None) -> None:
            if future.done():
                return
            if error is None:
                future.set_result(result)
            else:
                future.set_exception(error)

        self.submit(call, done)
        return await future

    def _run(self) -> None:
        while True:
            call, done = self._calls.get()
            result, error = None, None
            try:
                result = call()
            except Exception as exc:  # noqa: BLE001 - raised again where it is waited for
                error = exc
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(done, result, error)
