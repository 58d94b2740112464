"""A page that many clients ask for and that is rendered once for all of them.

Rendering every drive with every value takes milliseconds of a full line's time, and a hundred
clients may ask for it over and over. So it is kept for `KEEPS_S`, and requests that come while it
is rendered wait for that rendering. A kept page is never wrong about states: when a drive or the
line changed its state, a value could not be read or was written, it is rendered again. Only values
read in between may be missing, and ages be too small by that time.

What must not live here: what stands on a page.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Final

import anyio

__all__ = ["KEEPS_S", "PageCache"]

KEEPS_S: Final = 0.1


class PageCache:
    """One page and its age.

    Args:
        render: Makes the page.
        changes: A number that changes when the kept page would be wrong.
        clock: A monotonic clock, seconds.
    """

    def __init__(
        self,
        render: Callable[[], Awaitable[bytes]],
        changes: Callable[[], int],
        clock: Callable[[], float],
    ) -> None:
        self._render = render
        self._changes = changes
        self._clock = clock
        self._page = b""
        self._begun_s = 0.0  # when the rendering of the page began
        self._changes_then = 0
        self._begun = 0  # renderings begun
        self._number = 0  # which of them the page is; 0: there is none
        self._rendering: anyio.Event | None = None

    async def get(self) -> bytes:
        """Return a page that was begun after this was asked, or is still good."""
        begun_before = self._begun
        while self._number <= begun_before and not self._is_good():
            if self._rendering is not None:
                await self._rendering.wait()
            else:
                await self._make()
        return self._page

    def _is_good(self) -> bool:
        age_s = self._clock() - self._begun_s
        return self._number > 0 and age_s < KEEPS_S and self._changes() == self._changes_then

    async def _make(self) -> None:
        self._rendering = anyio.Event()
        self._begun += 1
        number, begun_s, changes = self._begun, self._clock(), self._changes()
        try:
            self._page = await self._render()
            self._number, self._begun_s, self._changes_then = number, begun_s, changes
        finally:
            self._rendering.set()
            self._rendering = None
