"""When the line may be spoken on again: turnaround, quarantine, and bytes nobody asked for.

After every answer the drives are left the turnaround. After an exchange without its answer the
line must have been silent for as long as the old answer could still come (quarantine). Bytes that
come meanwhile put the end of the silence off, but not for ever: a line that never falls silent
would otherwise leave everybody waiting.

Pure: the time is an argument. Source: EDB2102EN 8.3.5 (time monitoring).
"""

from __future__ import annotations

__all__ = ["BusIdleTimer"]

AFTER_OPEN_S = 0.05
"""Silence kept after opening a port: what an adapter had buffered comes out and is dropped."""

LONGEST_CHATTER_S = 1.0
"""For so long bytes nobody asked for put off the next telegram; longer than any late answer."""


class BusIdleTimer:
    """Keeps the pauses of one line.

    Args:
        turnaround_s: Least pause between the end of an answer and the next telegram, seconds.

    Attributes:
        free_at_s: Nothing at all is said before this.
        quiet_until_s: Nothing but a stop is said before this.
    """

    def __init__(self, turnaround_s: float) -> None:
        self._turnaround_s = turnaround_s
        self._chatter_ends_s = 0.0
        self._least_until_s = 0.0  # without what it was drawn out by
        self._heard_s = self._gave_up_s = -LONGEST_CHATTER_S
        self.free_at_s = 0.0
        self.quiet_until_s = 0.0

    def is_over(self, now_s: float) -> bool:
        """Whether there is no quarantine; the turnaround may still run."""
        return now_s >= self.quiet_until_s

    def opened(self, now_s: float) -> None:
        """A port was opened."""
        self._quarantine(now_s, AFTER_OPEN_S)

    def exchange_ended(self, ended_s: float) -> None:
        """An exchange ended, however it did."""
        self.free_at_s = ended_s + self._turnaround_s

    def answer_missing(self, ended_s: float, quarantine_s: float) -> None:
        """It ended without its answer."""
        self._quarantine(ended_s, quarantine_s)

    def draw_out(self, until_s: float) -> None:
        """Be silent longer, to hear an answer that is very late."""
        self.quiet_until_s = until_s
        self._chatter_ends_s = until_s + LONGEST_CHATTER_S

    def cut_short(self, at_s: float) -> None:
        """Draw it out no longer than until a time."""
        self.quiet_until_s = min(self.quiet_until_s, max(at_s, self._least_until_s))

    def give_up(self, now_s: float) -> None:
        """Wait for no end of what comes: it is longer than any answer.

        The next telegram's EOT silences the drive that says it (EDB2102EN 8.3). If that did not
        help just now, the drive does not hear it: then others only collide with it.
        """
        if now_s - self._gave_up_s < LONGEST_CHATTER_S:
            return
        self._gave_up_s = now_s
        self.quiet_until_s = self._least_until_s = self._chatter_ends_s = now_s

    def _quarantine(self, from_s: float, for_s: float) -> None:
        self.quiet_until_s = self._least_until_s = from_s + for_s
        self._chatter_ends_s = self.quiet_until_s + LONGEST_CHATTER_S

    def heard(self, now_s: float, gap_s: float, *, nothing_in_doubt: bool) -> None:
        """Bytes came outside an exchange.

        Args:
            now_s: When.
            gap_s: After so much silence they are over, seconds.
            nothing_in_doubt: They were the late answer that was waited for: no need to wait more.
        """
        if now_s - self._heard_s > gap_s:
            self._chatter_ends_s = max(self._chatter_ends_s, now_s + LONGEST_CHATTER_S)
        self._heard_s = now_s
        over_s = now_s + gap_s
        wanted_s = over_s if nothing_in_doubt else max(self.quiet_until_s, over_s)
        self.quiet_until_s = min(wanted_s, self._chatter_ends_s)
        self._least_until_s = min(max(self._least_until_s, over_s), self.quiet_until_s)
