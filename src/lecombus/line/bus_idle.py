"""When the bus may be used again: turnaround, quarantine, and unsolicited bytes.

After each answer the turnaround is kept. After an exchange without its answer nothing is sent for
30 ms and twice the adapter's latency (quarantine): an adapter gives on what it still holds. An
answer may come later than that; `late_replies` deals with it. Bytes received during the quarantine
extend it, up to a limit: otherwise a line with constant noise would never send again.

Pure: the time is an argument. Source: EDB2102EN 8.3.5 (time monitoring).
"""

from __future__ import annotations

__all__ = ["BusIdleTimer"]

AFTER_OPEN_S = 0.05
"""Quarantine after opening a port, seconds: bytes that an adapter had buffered are dropped."""

LONGEST_CHATTER_S = 1.0
"""Limit of the delay by unsolicited bytes, seconds; longer than any late answer."""


class BusIdleTimer:
    """Calculates when one line may send.

    Args:
        turnaround_s: Least pause between the end of an answer and the next telegram, seconds.

    Attributes:
        free_at_s: End of the turnaround; nothing is sent before it.
        quiet_until_s: End of the quarantine; only a stop is sent before it.
    """

    def __init__(self, turnaround_s: float) -> None:
        self._turnaround_s = turnaround_s
        self._chatter_ends_s = 0.0
        self._least_until_s = 0.0  # without extended listen
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
        """An exchange ended, with or without its answer."""
        self.free_at_s = ended_s + self._turnaround_s

    def answer_missing(self, ended_s: float, quarantine_s: float) -> None:
        """It ended without its answer."""
        self._quarantine(ended_s, quarantine_s)

    def draw_out(self, until_s: float) -> None:
        """Extend the quarantine, to receive an answer that is very late."""
        self.quiet_until_s = until_s
        self._chatter_ends_s = until_s + LONGEST_CHATTER_S

    def cut_short(self, at_s: float) -> None:
        """End the extension at this time at the latest."""
        self.quiet_until_s = min(self.quiet_until_s, max(at_s, self._least_until_s))

    def give_up(self, now_s: float) -> None:
        """End the quarantine although bytes still come: they are longer than any answer.

        The EOT of the next telegram stops the drive that sends them (EDB2102EN 8.3). If that was
        tried within the last second, the drive does not receive it, and the quarantine is kept.
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
            gap_s: They end with a gap of this length, seconds.
            nothing_in_doubt: They completed the last late answer: the quarantine may end.
        """
        if now_s - self._heard_s > gap_s:
            self._chatter_ends_s = max(self._chatter_ends_s, now_s + LONGEST_CHATTER_S)
        self._heard_s = now_s
        over_s = now_s + gap_s
        wanted_s = over_s if nothing_in_doubt else max(self.quiet_until_s, over_s)
        self.quiet_until_s = min(wanted_s, self._chatter_ends_s)
        self._least_until_s = min(max(self._least_until_s, over_s), self.quiet_until_s)
