"""The port's coming and going: opening with backoff, and the reason it is not there.

Opened always by the name the roster gives (a stable one, if its writer was wise), never by the
device number it happened to have. What a loss means for requests is the worker's business.
"""

from __future__ import annotations

import logging

from ..errors import LineLostError
from .port import Port, PortOpener, PortSettings, Receiver

__all__ = ["Connection"]

logger = logging.getLogger(__name__)

FIRST_BACKOFF_S = 0.1
LONGEST_BACKOFF_S = 5.0


class Connection:
    """One port, opened again whenever it is lost.

    Args:
        settings: What to open.
        opener: Opens it.
        receiver: Gets the bytes.
    """

    def __init__(self, settings: PortSettings, opener: PortOpener, receiver: Receiver) -> None:
        self._settings = settings
        self._opener = opener
        self._receiver = receiver
        self._failures = 0
        self._reason = "the port has not been opened yet"
        self._last_logged = ""
        self.port: Port | None = None
        self.is_lost = False
        self.losses_total = 0

    async def open(self) -> bool:
        """Try to open the port once; on failure `why_not` says why."""
        self.is_lost = False
        try:
            port = await self._opener(self._settings, self._receiver)
        except LineLostError as exc:
            self._failures += 1
            self._note(str(exc))
            return False
        if self.is_lost:
            port.abort()
            return False
        port.discard_input()
        self.port = port
        self._last_logged = ""
        logger.info("line=%s event=port-open port=%s", self._settings.line, port.describe())
        return True

    def say(self, telegram: bytes) -> LineLostError | None:
        """Hand a telegram to the port; gives the loss, if that is how it is found out."""
        assert self.port is not None
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
        """Take note that the port is unusable; the worker drops it when it gets there."""
        if self.is_lost:
            return
        self.is_lost = True
        self.losses_total += 1
        self._failures += 1
        self._note(str(exc) if exc is not None else "the port was closed at the other end")

    def drop(self) -> None:
        """Close the port, if there is one."""
        port, self.port = self.port, None
        if port is not None:
            port.abort()

    def why_not(self) -> str:
        """Say why there is no port."""
        return f"line {self._settings.line}: {self._reason}"

    def describe(self) -> str:
        """Name the port for people."""
        return self.port.describe() if self.port is not None else self._settings.url

    def _note(self, reason: str) -> None:
        """Remember the reason and log it once per change, not at every try."""
        self._reason = reason
        if reason != self._last_logged:
            self._last_logged = reason
            logger.warning("line=%s event=port-lost reason=%s", self._settings.line, reason)
