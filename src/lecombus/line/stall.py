"""Noticing a port that is open and dead: some adapters stall for hours without an error.

Only time in which drives were asked counts: an idle line is no fault. If
nothing answers after a reopening either, the drives are probably switched off, and the port is
reopened less and less often.
"""

from __future__ import annotations

from lecombus.fieldbus.loop_interface import ExchangeResult, ResultKind

__all__ = ["StallWatch"]

LONGEST_FACTOR = 20.0
"""The time between reopenings grows to this many times the roster's `stall`."""


class StallWatch:
    """Watches one line.

    Args:
        stall_s: Silence from all drives after which the port is reopened, seconds; 0: never.
    """

    def __init__(self, stall_s: float) -> None:
        self._configured_s = stall_s
        self._stall_s = stall_s
        self._unheard_from_s: float | None = None
        self.answered_since_open = False

    def opened(self) -> None:
        """The port was opened: start counting again."""
        self._unheard_from_s = None
        self.answered_since_open = False

    def answered(self) -> bool:
        """A drive answered; True: for the first time since the port was opened."""
        self._unheard_from_s = None
        if self.answered_since_open:
            return False
        self.answered_since_open = True
        self._stall_s = self._configured_s
        return True

    def excuse(self, for_s: float) -> None:
        """Take out of the count a time in which the process did not run."""
        if self._unheard_from_s is not None:
            self._unheard_from_s += for_s

    def failed(self, result: ExchangeResult) -> float | None:
        """An exchange had no answer.

        Returns:
            How long nothing has come, seconds, when that is too long; None while it is not.
        """
        if result.kind is ResultKind.GARBLED:
            self._unheard_from_s = None
            return None
        if self._unheard_from_s is None:
            self._unheard_from_s = result.started_s
        self._unheard_from_s += result.overdue_s
        silent_s = result.ended_s - self._unheard_from_s
        if not self._stall_s or silent_s < self._stall_s:
            return None
        if not self.answered_since_open:
            longest_s = LONGEST_FACTOR * self._configured_s
            self._stall_s = min(self._stall_s * 2.0, longest_s)
        return silent_s
