"""The port's coming and going: opening with backoff, and the reason it is not there.

Opened always by the name that the roster gives (use a stable one from /dev/serial/by-id), never by
the device number it happened to have. Its changes are logged as far as `LinkFlapLimiter` says. A
port that is open and dead is given up and opened again (`StallWatch`). What a loss means for
requests is the worker's business.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from enum import StrEnum
from typing import Final

from lecombus.fieldbus.loop_interface import ExchangeResult, ResultKind
from lecombus.fieldbus.port import Port, PortOpener, PortSettings, Receiver

from ..errors import LineLostError

__all__ = ["FlapMessage", "LinkFlapLimiter", "PortConnection", "StallWatch"]

FEW: Final = 3
"""So many losses within `WHILE_S` make the port unsteady."""

WHILE_S: Final = 60.0
"""Losses are counted over this time; so long without a change is steady again, seconds."""

FIRST_PAUSE_S: Final = 60.0
LONGEST_PAUSE_S: Final = 3600.0


class FlapMessage(StrEnum):
    """What to log for a change."""

    NOTHING = "nothing"
    CHANGE = "change"
    SUM = "sum"
    STEADY = "steady"
    """The port is steady again, after losses that were only counted."""


class LinkFlapLimiter:
    """Limits log messages of a port that flaps. Times are in seconds of a monotonic clock.

    ::

        steady ──third loss in a minute──▶ unsteady: logged as sums, after 1, 2, 4 .. 60 minutes
           ▲                                   │
           └──── a minute without a change ────┘  logged, with the number of losses

    Each change of a steady port is logged immediately. The state of the line in the store does not
    depend on this: it always follows the port.

    Attributes:
        losses: In this time of unsteadiness, or in the one that has just ended.
        since_s: When it began.
        pause_s: How long nothing is logged after the sum that is due.
    """

    def __init__(self) -> None:
        self.losses = 0
        self.since_s = 0.0
        self.pause_s = FIRST_PAUSE_S
        self.is_steady = True
        self._latest: deque[float] = deque(maxlen=FEW)
        self._changed_s = 0.0
        self._next_s = 0.0

    def lost(self, now_s: float) -> FlapMessage:
        """Record a loss of the port."""
        self._changed_s = now_s
        self._latest.append(now_s)
        self.losses += 1
        if not self.is_steady:
            return self._sum(now_s)
        if len(self._latest) < FEW or now_s - self._latest[0] > WHILE_S:
            return FlapMessage.CHANGE
        self.is_steady = False
        self.since_s, self.losses = self._latest[0], FEW
        self._next_s, self.pause_s = now_s, FIRST_PAUSE_S / 2.0
        return self._sum(now_s)

    def opened(self, now_s: float) -> FlapMessage:
        """Record that the port was opened."""
        self._changed_s = now_s
        return FlapMessage.CHANGE if self.is_steady else self._sum(now_s)

    def looked(self, now_s: float) -> FlapMessage:
        """Record that the port has not changed since the last call."""
        if self.is_steady:
            return FlapMessage.CHANGE
        if now_s - self._changed_s < WHILE_S:
            return self._sum(now_s)
        self.is_steady = True
        self._latest.clear()
        return FlapMessage.STEADY

    def _sum(self, now_s: float) -> FlapMessage:
        if now_s < self._next_s:
            return FlapMessage.NOTHING
        self.pause_s = min(2.0 * self.pause_s, LONGEST_PAUSE_S)
        self._next_s = now_s + self.pause_s
        return FlapMessage.SUM


logger = logging.getLogger(__name__)

FIRST_BACKOFF_S = 0.1
LONGEST_BACKOFF_S = 5.0


class PortConnection:
    """One port, opened again whenever it is lost.

    Args:
        settings: What to open.
        opener: Opens it.
    """

    def __init__(self, settings: PortSettings, opener: PortOpener) -> None:
        self._settings = settings
        self._opener = opener
        self._failures = 0
        self._reason = "the port has not been opened yet"
        self._last_logged = ""
        self._is_loss_logged = (
            False  # a loss was logged: why it cannot be opened then belongs to it
        )
        self._flap_limiter = LinkFlapLimiter()
        self.port: Port | None = None
        self.is_lost = False
        self.is_reopened = False  # it was given up here, and no error of it is known

    async def open(self, receiver: Receiver) -> bool:
        """Try to open the port once; after a failure `why_not` gives the reason."""
        self.is_lost = self.is_reopened = False
        try:
            port = await self._opener(self._settings, receiver)
        except LineLostError as exc:
            self._failures += 1
            self._reason = str(exc)
            if self._is_loss_logged:
                self._is_loss_logged, self._last_logged = False, self._reason
            self._log_not_open(self._flap_limiter.looked(now_s()))
            return False
        if self.is_lost:
            port.abort()
            return False
        port.discard_input()
        self.port = port
        self._last_logged, self._is_loss_logged = "", False
        self._log_open(self._flap_limiter.opened(now_s()))
        return True

    def say(self, telegram: bytes) -> LineLostError | None:
        """Hand a telegram to the port; gives the loss, if that is how it is found out."""
        assert self.port is not None
        if not self._flap_limiter.is_steady:
            self._log_open(self._flap_limiter.looked(now_s()))
        try:
            self.port.write(telegram)
        except LineLostError as exc:
            return exc
        return None

    def settled(self) -> None:
        """Something was heard over the port: the next loss begins with the shortest backoff."""
        self._failures = 0

    def backoff_s(self) -> float:
        """How long to wait before the next try, seconds: 0.1 doubling to 5."""
        return min(FIRST_BACKOFF_S * 2.0 ** max(0, self._failures - 1), LONGEST_BACKOFF_S)

    def note_loss(self, exc: Exception | None) -> None:
        """Record that the port is unusable; the worker drops it later."""
        if self.is_lost:
            return
        self.is_lost = True
        self._failures += 1
        self._reason = str(exc) if exc is not None else "the port was closed at the other end"
        self._log_not_open(self._flap_limiter.lost(now_s()))
        self._is_loss_logged = True

    def reopen(self, why: str) -> None:
        """Give up a port of which no error is known, to open it again."""
        self.is_reopened = not self.is_lost
        self.note_loss(LineLostError(why))

    def drop(self) -> None:
        """Close the port, if there is one."""
        port, self.port = self.port, None
        if port is not None:
            port.abort()

    def why_not(self) -> str:
        """Return why there is no port."""
        return f"line {self._settings.line}: {self._reason}"

    def _log_not_open(self, message: FlapMessage) -> None:
        """Log why there is no port, once per reason, not at every try.

        A loss is logged by its own reason alone: that the port cannot be opened then, as its device
        is gone, is no other news. A later reason is.
        """
        if message is FlapMessage.SUM:
            self._log_sum()
        elif message is FlapMessage.STEADY or (
            message is FlapMessage.CHANGE and self._reason != self._last_logged
        ):
            self._last_logged = self._reason
            logger.warning(
                "line=%s event=port-lost reason=%s%s",
                self._settings.line, self._reason, self._losses(message),
            )  # fmt: skip

    def _log_open(self, message: FlapMessage) -> None:
        """Log that the port is open."""
        assert self.port is not None
        if message is FlapMessage.SUM:
            self._log_sum()
        elif message is not FlapMessage.NOTHING:
            logger.info(
                "line=%s event=port-open port=%s%s",
                self._settings.line, self.port.describe(), self._losses(message),
            )  # fmt: skip

    def _losses(self, message: FlapMessage) -> str:
        """Say what was left out before, where something was."""
        return (
            f", after {self._flap_limiter.losses} losses" if message is FlapMessage.STEADY else ""
        )

    def _log_sum(self) -> None:
        """Log how often the port was lost, and for how long nothing more is logged of it."""
        flap_limiter = self._flap_limiter
        logger.warning(
            "line=%s event=port-unsteady losses=%d in_s=%.0f silent_for_s=%.0f reason=%s",
            self._settings.line, flap_limiter.losses, now_s() - flap_limiter.since_s,
            flap_limiter.pause_s, self._reason,
        )  # fmt: skip


def now_s() -> float:
    """The loop's time, seconds."""
    return asyncio.get_running_loop().time()


LONGEST_FACTOR = 20.0
"""The time between reopenings grows to this many times the roster's `stall`."""


class StallWatch:
    """Notices a port that is open and dead: some adapters stall for hours without an error.

    Only time in which drives were asked counts: an idle line is not a fault. If nothing answers
    after a reopening either, the drives are probably switched off, and the port is reopened less
    and less often.

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
        self._unheard_from_s += result.older_by_s
        silent_s = result.ended_s - self._unheard_from_s
        if not self._stall_s or silent_s < self._stall_s:
            return None
        if not self.answered_since_open:
            longest_s = LONGEST_FACTOR * self._configured_s
            self._stall_s = min(self._stall_s * 2.0, longest_s)
        return silent_s
