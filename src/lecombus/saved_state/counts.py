"""Write counts between two savings: appended to a side file, so that a crash keeps them.

The state file is written every few seconds, which costs a trip to the disk. A count must not wait
for that: a process that is killed would lose all of the last seconds. So each count goes into a
file of its own, `NAME.counts`, as one line that the kernel has as soon as it is written. Such a
line holds the whole count and not an increment: reading it twice, or after the state file has it
too, changes nothing. When the state file was saved the side file is emptied.

Strategy: counting never waits. A thread writes, one line after the other, and a disk that
hangs holds up that thread alone.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Final

from lecombus.saved_state.state import State, open_regular

__all__ = ["Counts"]

LARGEST: Final = 8 * 1024 * 1024
"""Bytes read; a restore of a full line writes under one megabyte between two savings."""


class Counts:
    """The side file of one state file.

    Args:
        path: The state file itself, where a link leads.

    Attributes:
        failure: Why the last count was not written; empty where it was.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.with_name(f"{path.name}.counts")
        self.failure = ""
        self._noted = 0
        self._queue: SimpleQueue[bytes | threading.Event] = SimpleQueue()
        self._lock = threading.Lock()
        self._descriptor: int | None = None
        self._thread: threading.Thread | None = None

    @property
    def noted(self) -> int:
        """How many counts were noted since the start."""
        return self._noted

    def load(self, state: State) -> None:
        """Take the counts that were not saved; a line that is none is passed over.

        Raises:
            OSError: It cannot be read.
        """
        for drive, code, count in self._lines():
            writes = state.drive(drive).writes
            if count > writes.get(code, 0):
                writes[code] = count
                state.touch()

    def note(self, drive: str, code: str, count: int) -> None:
        """Have a count written; returns immediately."""
        self._noted += 1
        self._queue.put((json.dumps([drive, code, count]) + "\n").encode())
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="counts", daemon=True)
            self._thread.start()

    def saved(self, noted: int) -> None:
        """Empty the file, for the state file holds all of it; runs in a thread.

        Args:
            noted: What `noted` was when the saved state was taken: counts noted since then stay.
        """
        with self._lock:
            if self._noted == noted and self._size():
                os.ftruncate(self._opened(), 0)

    def flush(self, timeout_s: float) -> bool:
        """Wait until everything noted is written; False: it takes longer than that."""
        if self._thread is None:
            return True
        done = threading.Event()
        self._queue.put(done)
        return done.wait(timeout_s)

    def _size(self) -> int:
        try:
            return self.path.lstat().st_size
        except FileNotFoundError:
            return 0

    def _lines(self) -> Iterator[tuple[str, str, int]]:
        try:
            descriptor = open_regular(self.path, os.O_RDONLY)
        except FileNotFoundError:
            return
        with os.fdopen(descriptor, "rb") as file:
            data = file.read(LARGEST)
        for line in data.splitlines():
            try:
                drive, code, count = json.loads(line)
            except (ValueError, TypeError, RecursionError):  # cut short when it was killed
                continue
            is_text = isinstance(drive, str) and isinstance(code, str)
            if is_text and (drive + code).isprintable() and type(count) is int and count > 0:
                yield drive, code, count

    def _run(self) -> None:
        while True:
            item = self._queue.get()
            if isinstance(item, threading.Event):
                item.set()
                continue
            try:
                with self._lock:
                    self._append(item)
                self.failure = ""
            except OSError as exc:
                self.failure = f"{self.path} cannot be written: {exc.strerror}"

    def _append(self, line: bytes) -> None:
        os.write(self._opened(), line)

    def _opened(self) -> int:
        """Give the descriptor, of the file that stands there now: it may have been removed."""
        if self._descriptor is not None and not os.fstat(self._descriptor).st_nlink:
            os.close(self._descriptor)
            self._descriptor = None
        if self._descriptor is None:
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW
            self._descriptor = open_regular(self.path, flags)
        return self._descriptor
