"""Saying that a line is silent as a whole, or that another program reads its port.

A program that reads the port too, a plain `cat` is enough, takes bytes that lecombus waits for:
all drives are silent then, or answers come in pieces. A wrong baud rate looks the same.

Strategy: failures are counted. When the port was opened, when no drive answers, and now and then
while exchanges fail, the daemon is asked to look who else has the port open, which takes too long
for the event loop. What was found is logged once and stands as a remark until it is over.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from typing import Final

from lecombus.config import LineEntry
from lecombus.drive_state.store import Store
from lecombus.line.devices import END_IT, shared, unheard_remedy

__all__ = ["SILENCE", "PortWatch"]

logger = logging.getLogger(__name__)

SILENCE: Final = "silence"
"""The key of the remark."""

SUSPECT_AFTER: Final = 3
"""Failed exchanges since the last look that are worth another."""

BURST: Final = 3
"""Failed exchanges within a second: one drive that is away is not asked so often."""

FIRST_PAUSE_S: Final = 5.0
LONGEST_PAUSE_S: Final = 300.0
"""Looks that find nothing become ever more seldom: a drive that is away for days is no reason."""


class PortWatch:
    """Watches the port of one line.

    Args:
        store: Gets the remark.
        line: The line, as in the roster.
    """

    def __init__(self, store: Store, line: LineEntry) -> None:
        self._store = store
        self._line = line
        self._others: tuple[str, ...] = ()
        self._silent = False
        self._heard = False
        self._have_ended = False  # the others, at the last look
        self._is_new = True  # opened since the last look
        self._logged = ""
        self._looked_at_s = -math.inf
        self._pause_s = FIRST_PAUSE_S
        self._failures = 0  # at the last look
        self._last_failures = 0

    def note(
        self, failures: int, now_s: float, *, is_open: bool, silent: bool, heard: bool
    ) -> bool:
        """Take the figures of the moment; about once a second.

        Args:
            failures: Exchanges that failed since the start.
            now_s: Monotonic seconds.
            is_open: Whether the line is open.
            silent: Whether all drives were asked and none answers.
            heard: Whether any drive has answered since the line was opened.

        Returns:
            Whether to look who else has the port open, and to call `found` with it.
        """
        if not is_open:
            self._failures, self._others, self._silent = failures, (), False
            self._have_ended = False
            self._looked_at_s, self._pause_s = -math.inf, FIRST_PAUSE_S
            self._is_new = True
            self._store.note_line(SILENCE, None)  # why the line is not open says it all
            return False
        self._heard = heard
        is_news = self._is_new or (silent and not self._silent)
        if self._silent and not silent:
            self._silent, self._others = False, ()
            self._show()
        if is_news or failures - self._last_failures >= BURST:
            self._pause_s = FIRST_PAUSE_S / 2.0
        self._last_failures = failures
        suspects = bool(self._others) or silent or failures - self._failures >= SUSPECT_AFTER
        pause_s = max(FIRST_PAUSE_S, self._pause_s) if not self._others else FIRST_PAUSE_S
        if not is_news and (not suspects or now_s - self._looked_at_s < pause_s):
            return False
        self._silent, self._failures, self._looked_at_s = silent, failures, now_s
        self._is_new = False
        return True

    def found(self, others: Sequence[str]) -> None:
        """Take what a look brought: the other programs that have the port open.

        When they have ended the drives get until the next look to be heard: baud rate and wires are
        no likely cause then.
        """
        if self._others and not others and self._silent and not self._have_ended:
            self._have_ended = True
            return
        self._have_ended = False
        self._others = tuple(others)
        self._pause_s = FIRST_PAUSE_S if others else min(2.0 * self._pause_s, LONGEST_PAUSE_S)
        self._show()

    def _show(self) -> None:
        """Set the remark, and log what is new."""
        text = ""
        if self._others:
            text = f"{shared(self._line.port, self._others)}: {END_IT}"
        elif self._silent:
            text = unheard_remedy(self._line.port, self._line.baud)
        if self._silent:
            text = f"no drive answers: {text}"
        if text and text != self._logged:
            event = "line-silent" if self._silent else "port-shared"
            logger.warning("line=%s event=%s reason=%s", self._line.name, event, text)
            self._logged = text
        elif self._logged and not text and self._heard:  # just opened: not heard yet
            logger.info("line=%s event=line-heard", self._line.name)
            self._logged = ""
        self._store.note_line(SILENCE, text or None)
