"""The tokens that are valid now: the file is read again when it changed, in a thread.

A file that is refused changes nothing: the tokens read before it stay, and the caller is given the
reason until a good file is there. Before the first good one, and without a file, no token is valid.
A file that the system does not give is asked for again at each look: it may hold a revocation, and
nothing of it need change before it can be read.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Final

import anyio
import anyio.to_thread

from lecombus.errors import OperationError
from lecombus.tokens.token_file import TokenEntry, Tokens, read_tokens

__all__ = ["LOOK_S", "TokenWatch"]

logger = logging.getLogger(__name__)

LOOK_S: Final = 1.0
"""From one look at the file to the next, seconds: a revoked token is refused by then."""

Mark = tuple[int, ...] | None


class TokenWatch:
    """The tokens of a file.

    Args:
        path: The file.
        wall: The time of day, Unix seconds.
        note: Gets why the file is not used, and None when it is used again.
    """

    def __init__(
        self,
        path: Path,
        wall: Callable[[], float],
        note: Callable[[str | None], None] = lambda text: None,
    ) -> None:
        self._path = path
        self._wall = wall
        self._note = note
        self._tokens = Tokens()
        self._mark: Mark | str = "not read yet"
        self._refused = ""  # why the file is not used
        self._looking = anyio.Lock()

    def find(self, secret: str) -> TokenEntry | None:
        """Return the valid token with a secret, if there is one."""
        return self._tokens.find(secret, self._wall())

    def holds(self, entry: TokenEntry) -> bool:
        """Return whether a token that was found is still valid, with the same rights."""
        return self._tokens.holds(entry, self._wall())

    async def run(self) -> None:
        """Look at the file again and again."""
        while True:
            await anyio.sleep(LOOK_S)
            await self.look()

    async def look(self, *, always: bool = False) -> None:
        """Read the file if it changed since it was read.

        Args:
            always: Also if it did not.
        """
        async with self._looking:  # of two reads the later one must count
            mark = await anyio.to_thread.run_sync(mark_of, self._path, abandon_on_cancel=True)
            if always or mark != self._mark:
                await self._read(mark, always=always)

    async def _read(self, mark: Mark, *, always: bool) -> None:
        try:
            tokens = await anyio.to_thread.run_sync(read_tokens, self._path, abandon_on_cancel=True)
        except OperationError as exc:
            self._mark = "not read" if isinstance(exc.__cause__, OSError) else mark
            if always or str(exc) != self._refused:
                logger.error("event=tokens-refused reason=%s", exc)
                self._note(f"{exc}; the tokens that were read before stay valid ({exc.remedy})")
            self._refused = str(exc)
            return
        logger.info("event=tokens-read file=%s tokens=%d", self._path, len(tokens.entries))
        self._tokens, self._mark, self._refused = tokens, mark, ""
        self._note(None)


def mark_of(path: Path) -> Mark:
    """Return what changes when a file is written, replaced or given other rights."""
    try:
        found = path.stat()
    except OSError as exc:
        return None if isinstance(exc, FileNotFoundError) else (exc.errno or 0,)
    return (
        found.st_dev, found.st_ino, found.st_mtime_ns, found.st_ctime_ns, found.st_size,
        found.st_mode, found.st_uid,
    )  # fmt: skip
