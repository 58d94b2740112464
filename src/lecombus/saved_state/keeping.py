"""Writing the state every few seconds, without delaying the line.

Strategy: the content is made in the event loop, where it does not change, and a thread writes it
to the disk. Later changes are written the next time, and at the end. Write counts also go directly
into a side file (`counts`). A failing disk is logged once per reason, tried again more seldom, and
fails nothing else. A hanging disk blocks threads: it is logged while it lasts; at the start nothing
is kept then, and the end does not wait for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

import anyio

from lecombus.saved_state.counts import Counts
from lecombus.saved_state.state import State, StateFile

__all__ = ["Keeping"]

logger = logging.getLogger("lecombus.state.keeping")  # users search their logs for this name

EVERY_S = 2.0
AFTER_FAILURE_S = 30.0

HANGS_AFTER_S: Final = 5.0
"""A disk that takes longer than this over one small file hangs, seconds; SD cards take one."""

END_S: Final = 3.0
"""How long the end of the daemon waits for the disk, seconds."""


T = TypeVar("T")


class Keeping:
    """Keeps the state of one line.

    Args:
        path: The file; None: nothing is kept.

    Attributes:
        state: What was read, to be changed by the owner of each fact.
    """

    def __init__(self, path: Path | None) -> None:
        self._file = StateFile(path)
        self.state: State = self._file.load()
        self.state.saver = self._save_now
        self._counts = self._load_counts()
        self._written = 0
        self._failure = "" if self._file.is_usable else self._file.trouble
        self._hangs = ""
        self._say: Callable[[str | None], None] = lambda text: None
        self._saving = threading.Lock()
        if self._file.kept:
            logger.info("event=state-migrated file=%s kept=%s", path, self._file.kept)
        if self._file.trouble:
            logger.warning("event=state-not-kept reason=%s", self._file.trouble)

    @classmethod
    async def opened(cls, path: Path | None) -> Keeping:
        """Read the state beside the event loop; where the disk hangs, go on without."""
        with anyio.move_on_after(HANGS_AFTER_S):
            return await _in_daemon_thread(partial(cls, path))
        keeping = cls(None)
        keeping._failure = (
            f"{path} could not be read within {HANGS_AFTER_S:.0f} s, nothing is kept: look at its "
            "disk and restart"
        )
        logger.warning("event=state-not-kept reason=%s", keeping._failure)
        return keeping

    async def run(self, say: Callable[[str | None], None]) -> None:
        """Write what changed, every few seconds, until cancelled.

        Args:
            say: Given what is wrong with keeping it, or None when nothing is.
        """
        self._say = say
        self._tell()
        while True:
            await anyio.sleep(AFTER_FAILURE_S if self._failure else EVERY_S)
            if self._is_due():
                changes, noted, text = self._taken()
                async with anyio.create_task_group() as tasks:
                    tasks.start_soon(self._tell_when_it_hangs)
                    failure = await _in_daemon_thread(partial(self._save, text, noted))
                    tasks.cancel_scope.cancel()
                self._took(changes, failure)
            elif self._counts is not None and self._counts.failure:
                self._tell()

    async def _save_now(self) -> None:
        """Write what changed; a disk that hangs is not waited for longer than at the end."""
        if not self._is_due():
            return
        changes, noted, text = self._taken()
        with anyio.move_on_after(END_S):
            self._took(changes, await _in_daemon_thread(partial(self._save, text, noted)))

    def close(self) -> None:
        """Write what is left, at the end, when nothing else runs any more."""
        if not self._is_due():
            return
        changes, noted, text = self._taken()
        failures: list[str] = []
        # A thread that dies with the process: the end must not wait for a disk that hangs.
        thread = threading.Thread(
            target=lambda: failures.append(self._save(text, noted)), name="state", daemon=True
        )
        thread.start()
        thread.join(END_S)
        hangs = f"{self._file.name} could not be written within {END_S:.0f} s"
        self._took(changes, failures[0] if failures else hangs)

    def _load_counts(self) -> Counts | None:
        """Take the counts that a crash left behind, and have further ones written immediately."""
        if not self._file.is_usable:
            return None
        counts = Counts(self._file.target)
        try:
            counts.load(self.state)
        except OSError as exc:
            logger.warning(
                "event=state-not-kept reason=%s cannot be read: %s", counts.path, exc.strerror
            )
        self.state.counted = counts.note
        return counts

    def _taken(self) -> tuple[int, int, str]:
        """Take the content, with how much had changed and how much was counted by then."""
        noted = 0 if self._counts is None else self._counts.noted
        return self.state.changes, noted, self.state.text()

    def _is_due(self) -> bool:
        return self._file.is_usable and self.state.changes != self._written

    def _save(self, text: str, noted: int) -> str:
        """Write; return why that failed. Runs in a thread."""
        with self._saving:
            try:
                self._file.save(text)
                if self._counts is not None:
                    self._counts.saved(noted)
            except OSError as exc:
                where = f" ({exc.filename})" if exc.filename else ""
                return f"{self._file.name} cannot be written: {exc.strerror}{where}"
        return ""

    async def _tell_when_it_hangs(self) -> None:
        await anyio.sleep(HANGS_AFTER_S)
        self._hangs = (
            f"its disk has not taken {self._file.name} for {HANGS_AFTER_S:.0f} s and more: what "
            "changes now is not kept"
        )
        logger.warning("event=state-not-kept reason=%s", self._hangs)
        self._tell()

    def _took(self, changes: int, failure: str) -> None:
        if failure and failure != self._failure:
            logger.warning("event=state-not-kept reason=%s", failure)
        if not failure:
            self._written = changes
            if self._failure or self._hangs:
                logger.info("event=state-kept file=%s", self._file.path)
        self._failure, self._hangs = failure, ""
        self._tell()

    def _tell(self) -> None:
        """Set the remark: what happened to the file stands beside what is wrong now."""
        counts = "" if self._counts is None else self._counts.failure
        said = (self._file.trouble, self._failure, self._hangs, counts)
        parts = dict.fromkeys(part for part in said if part)
        self._say(f"the state file: {'; '.join(parts)}" if parts else None)


async def _in_daemon_thread(work: Callable[[], T]) -> T:
    """Do work in a thread that the end of the process does not wait for, as it does for anyio's."""
    loop, done = asyncio.get_running_loop(), asyncio.Event()
    results: list[T] = []

    def run() -> None:
        try:
            results.append(work())
        finally:
            with contextlib.suppress(RuntimeError):  # the loop has ended, and who waited with it
                loop.call_soon_threadsafe(done.set)

    threading.Thread(target=run, name="state", daemon=True).start()
    await done.wait()
    return results[0]
