"""The remark on a line that cannot hold the cyclic reads it was asked for.

What a line could not do while it was closed, while its drives were being started, or while the
daemon did not run, is not what it cannot hold: the periods of that time are given as they were
(`cyclic_stretch_ratio`), and no remark is made of them.
"""

from __future__ import annotations

import math
from typing import Final

from lecombus.schedule.polling import STRETCH_WINDOW_S
from lecombus.store import Store

__all__ = ["PollOverload"]

REMARK: Final = "cadence"
SAID_FROM: Final = 1.05
"""A cadence stretched by less than this is not worth a remark."""

STARTING_MOST_S: Final = 600.0
"""A full line's first start takes minutes; a drive that is starting for longer than this, seconds,
is in some trouble of its own and hides nothing."""

PAUSED_FROM_S: Final = 1.5
"""The figure comes once a second; where it comes so much later, seconds, the daemon did not run."""


class PollOverload:
    """Says when the cyclic reads are more than the line can do.

    Args:
        store: Gets the factor, and the remark.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._closed_at_s = -math.inf  # when the line was last closed, starting or paused
        self._starting_from_s: float | None = None
        self._noted_s = math.inf

    def note(self, stretch: float, now_s: float, *, is_open: bool, starting: bool = False) -> None:
        """Take the figure of the moment; about once a second.

        Args:
            stretch: The factor by which cyclic periods grew in the last seconds, 1 or more.
            now_s: Monotonic seconds.
            is_open: Whether the line is open.
            starting: Whether drives are being started.
        """
        if not starting:
            self._starting_from_s = None
        elif self._starting_from_s is None:
            self._starting_from_s = now_s
        begun_s = self._starting_from_s
        paused = now_s - self._noted_s >= PAUSED_FROM_S
        self._noted_s = now_s
        if paused or not is_open or (begun_s is not None and now_s - begun_s < STARTING_MOST_S):
            self._closed_at_s = now_s
        self._store.set_stretch(stretch)
        text = None
        if stretch > SAID_FROM and now_s - self._closed_at_s > STRETCH_WINDOW_S:
            text = (
                f"the line cannot hold the cyclic reads asked for: every period is {stretch:.2f} "
                "times as long; ask for fewer, more seldom, or at a higher baud rate"
            )
        self._store.note_line(REMARK, text)
