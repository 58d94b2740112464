"""Which commands came before, also before the bridge was started: by their keys.

A sender that got no acknowledgement sends a command again, maybe much later. Keys are kept in a
file, one a line, appended before the command is carried out: so it is never carried out again, not
even if the bridge ended in the middle. What a command said, and how it ended, is remembered only
while the bridge runs, and only of the latest.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

__all__ = ["KEPT", "OUTCOMES_KEPT", "SeenCommands"]

KEPT: Final = 20_000
"""Keys; a line of the file has some 50 bytes."""

OUTCOMES_KEPT: Final = 1000

END: Final = "."
"""At the end of a line that was written whole."""


class SeenCommands:
    """The commands that came.

    Args:
        file: Where they are kept; None: only while this runs.
    """

    def __init__(self, file: Path | None) -> None:
        self._file = file
        self._keys: dict[str, None] = {}
        self._ended: dict[str, tuple[str, Mapping[str, Any]]] = {}
        self._lines = 0
        self._noting = threading.Lock()
        if file is not None:
            with suppress(FileNotFoundError):
                for line in file.read_text(errors="replace").splitlines():
                    self._lines += 1
                    key, _, end = line.partition(" ")
                    if end == END:
                        self._keys[key] = None

    @property
    def is_kept(self) -> bool:
        """Whether commands are kept on the disk, for which `note` waits."""
        return self._file is not None

    def __contains__(self, key: str) -> bool:
        """Whether a command came before."""
        return key in self._keys

    def outcome(self, key: str) -> Mapping[str, Any] | None:
        """Return how a command ended; None: that is not known any more."""
        found = self._ended.get(key)
        return None if found is None else found[1]

    def said_else(self, key: str, said: str) -> bool:
        """Whether the command that came before said something else, as far as that is known."""
        found = self._ended.get(key)
        return found is not None and found[0] != said

    def ended(self, key: str, said: str, document: Mapping[str, Any]) -> None:
        """Remember what a command said, and how it ended."""
        self._ended[key] = (said, document)
        while len(self._ended) > OUTCOMES_KEPT:
            del self._ended[next(iter(self._ended))]

    def note(self, key: str) -> None:
        """Keep that a command came, on the disk before this returns.

        Called in threads: commands for several drives are kept at the same time.

        Raises:
            OSError: It cannot be kept.
        """
        with self._noting:
            self._note(key)

    def _note(self, key: str) -> None:
        self._keys[key] = None
        while len(self._keys) > KEPT:
            del self._keys[next(iter(self._keys))]
        if self._file is None:
            return
        if self._lines >= 2 * KEPT:
            self._write_all(self._file)
        else:
            with self._file.open("a") as file:
                # A line that was cut off must not take the next one with it.
                file.write(f"{key} {END}\n" if self._ends_whole() else f"\n{key} {END}\n")
                file.flush()
                os.fdatasync(file.fileno())
            self._lines += 1

    def _ends_whole(self) -> bool:
        """Whether the file ends with a whole line."""
        assert self._file is not None
        with self._file.open("rb") as file:
            if file.seek(0, os.SEEK_END) == 0:
                return True
            file.seek(-1, os.SEEK_END)
            return file.read(1) == b"\n"

    def _write_all(self, file: Path) -> None:
        beside = file.with_suffix(".new")
        with beside.open("w") as new:
            new.writelines(f"{key} {END}\n" for key in self._keys)
            new.flush()
            os.fdatasync(new.fileno())
        beside.replace(file)
        self._lines = len(self._keys)
