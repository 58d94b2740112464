"""The port's coming and going: opening with backoff, and the reason it is not there.

Opened always by the name the roster gives (a stable one, if its writer was wise), never by the
device number it happened to have. Its changes are logged as far as `link_flap_limiter` says. What a
loss means for requests is the worker's business.
"""

from __future__ import annotations

import asyncio
import logging

from lecombus.fieldbus.port import Port, PortOpener, PortSettings, Receiver

from ..errors import LineLostError
from .link_flap_limiter import FlapMessage, LinkFlapLimiter

__all__ = ["PortConnection"]

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
