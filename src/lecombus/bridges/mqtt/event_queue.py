"""Events that wait for the broker: the latest of them, on the disk while it is away.

What is in memory is written to the disk when the broker is lost and at the end, and from then on
each event as it comes; the files are removed when all was sent. There are two files, each for half
of what is kept: when the second is full, the first is removed and they change places. So the disk
takes no more than `BYTES_KEPT`, and how many events were lost is counted. A file begins with the
number of those that came before it and were not sent: without the other file they are lost.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

__all__ = ["BYTES_KEPT", "EVENTS_KEPT", "EventQueue"]

EVENTS_KEPT: Final = 10_000
BYTES_KEPT: Final = 8 * 1024 * 1024

Entry = tuple[str, str]
"""The drive that an event is about (empty: the line), and the event as JSON text."""


class EventQueue:
    """Events in the order in which they came.

    Args:
        directory: Where they are kept while the broker is away; None: in memory only.
        events_kept: How many, at most.
        bytes_kept: How many bytes they may have.

    Attributes:
        lost: How many were dropped because too many waited, of which `told_lost` knows nothing.
        is_on_disk: Whether all that waits is on the disk.
    """

    def __init__(
        self,
        directory: Path | None,
        *,
        events_kept: int = EVENTS_KEPT,
        bytes_kept: int = BYTES_KEPT,
    ) -> None:
        self._files = [] if directory is None else [directory / "events.1", directory / "events.2"]
        self._waiting: deque[Entry] = deque()
        self._bytes = 0
        self._events_kept = events_kept
        self._bytes_kept = bytes_kept
        self.is_on_disk = False
        self.lost = 0
        self._unsent = 0
        """Of those that came since `save`: also those that are dropped by now."""
        for file in self._files:
            with suppress(FileNotFoundError):
                for found in read_lines(file):
                    if not isinstance(found, int):
                        self._append(found)
                        self._unsent += 1
                    elif not self._waiting:
                        self.lost = self._unsent = found
                self.is_on_disk = True

    def __len__(self) -> int:
        """Return how many wait."""
        return len(self._waiting)

    def put(self, drive: str, text: str) -> None:
        """Let an event wait.

        Raises:
            OSError: It could not be written to the disk; it waits in memory.
        """
        entry = (drive, text)
        self._append(entry)
        before, self._unsent = self._unsent, self._unsent + 1
        if self.is_on_disk and self._files:
            with self._files[1].open("a") as file:
                file.write(line_of(entry) if file.tell() else f"{before}\n{line_of(entry)}")
                size = file.tell()
            if size > self._bytes_kept // 2:
                self._files[1].replace(self._files[0])

    def first(self) -> Entry | None:
        """Return the oldest event; None: none waits."""
        return self._waiting[0] if self._waiting else None

    def done(self, entry: Entry) -> None:
        """Drop the oldest event: it was sent; after the last one the files are removed."""
        if self._waiting and self._waiting[0] is entry:
            self._waiting.popleft()
            self._bytes -= len(entry[1])
            self._unsent -= 1
        if not self._waiting and self.is_on_disk:
            for file in self._files:
                file.unlink(missing_ok=True)
            self.is_on_disk = False

    def save(self, *, at_end: bool = False) -> None:
        """Write what waits to the disk: the broker is away, or the bridge ends.

        Args:
            at_end: Also if it is there already, so that nothing that was sent is left there.

        Raises:
            OSError: It cannot be written; it waits in memory.
        """
        if not self._files or not self._waiting or (self.is_on_disk and not at_end):
            return
        beside = self._files[0].with_suffix(".new")
        with beside.open("w") as file:
            file.write(f"{self.lost}\n")
            file.writelines(map(line_of, self._waiting))
        beside.replace(self._files[0])
        self._files[1].unlink(missing_ok=True)
        self.is_on_disk = True
        self._unsent = self.lost + len(self._waiting)

    def told_lost(self, lost: int) -> None:
        """Count so many no more: it was said that they were dropped."""
        self.lost -= lost
        self._unsent -= lost

    def _append(self, entry: Entry) -> None:
        self._waiting.append(entry)
        self._bytes += len(entry[1])
        while len(self._waiting) > self._events_kept or self._bytes > self._bytes_kept:
            self._bytes -= len(self._waiting.popleft()[1])
            self.lost += 1


def line_of(entry: Entry) -> str:
    """Return an event as a line of a file."""
    return f"{json.dumps(entry)}\n"


def read_lines(file: Path) -> Iterator[Entry | int]:
    """Return the events and numbers of a file; a line that was cut off by a crash is left out."""
    for line in file.read_text(errors="replace").splitlines():
        with suppress(ValueError):
            found: Any = json.loads(line)
            if type(found) is int:
                yield found
            elif isinstance(found, list) and len(found) == 2 and all(map(is_text, found)):
                yield found[0], found[1]


def is_text(found: Any) -> bool:
    """Whether something is text."""
    return isinstance(found, str)
