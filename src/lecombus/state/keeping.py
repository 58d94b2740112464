"""Writing the state now and then, beside the line and never in its way.

Strategy: every few seconds the content is made in the event loop, where nobody changes it
meanwhile, and a thread puts it on disk. What changed since is written the next time, and at the
end. A disk that fails is said once per reason, tried again more seldom, and fails nothing else.

What must not live here: what is kept, how a file is written.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import anyio
import anyio.to_thread

from lecombus.state.document import State
from lecombus.state.file import StateFile

__all__ = ["Keeping"]

logger = logging.getLogger(__name__)

EVERY_S = 2.0
AFTER_FAILURE_S = 30.0


class Keeping:
    """Keeps the state of one line.

    Args:
        path: The file; None: nothing is kept.

    Attributes:
        state: What was read, to be changed by whoever owns a subject.
    """

    def __init__(self, path: Path | None) -> None:
        self._file = StateFile(path)
        self.state: State = self._file.load()
        self._written = 0
        self._failure = "" if self._file.is_usable else self._file.trouble
        self._say: Callable[[str | None], None] = lambda text: None
        if self._file.trouble:
            logger.warning("event=state-not-kept reason=%s", self._file.trouble)

    async def run(self, say: Callable[[str | None], None]) -> None:
        """Write what changed, every few seconds, until cancelled.

        Args:
            say: Given what is wrong with keeping it, or None when nothing is.
        """
        self._say = say
        self._tell(self._failure)
        while True:
            await anyio.sleep(AFTER_FAILURE_S if self._failure else EVERY_S)
            if self._is_due():
                changes, text = self.state.changes, self.state.text()
                self._took(changes, await anyio.to_thread.run_sync(self._save, text))

    def close(self) -> None:
        """Write what is left, at the end, when nothing else runs any more."""
        if self._is_due():
            self._took(self.state.changes, self._save(self.state.text()))

    def _is_due(self) -> bool:
        return self._file.is_usable and self.state.changes != self._written

    def _save(self, text: str) -> str:
        """Write; return why that failed. Runs in a thread."""
        try:
            self._file.save(text)
        except OSError as exc:
            return f"{self._file.name} cannot be written: {exc.strerror}"
        return ""

    def _took(self, changes: int, failure: str) -> None:
        if failure and failure != self._failure:
            logger.warning("event=state-not-kept reason=%s", failure)
        if not failure:
            self._written = changes
            if self._failure:
                logger.info("event=state-kept file=%s", self._file.path)
        self._failure = failure
        self._tell(failure)

    def _tell(self, failure: str) -> None:
        """Set the remark: what happened to the file stands beside what is wrong now."""
        parts = dict.fromkeys(part for part in (self._file.trouble, failure) if part)
        self._say(f"the state file: {'; '.join(parts)}" if parts else None)
