"""Every telegram in the log, decoded, one line each: for `--log-level debug` alone.

Received bytes are collected and logged at the end of the exchange; unsolicited bytes are logged
together before the next telegram.
"""

from __future__ import annotations

import logging
from typing import Final

from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.fieldbus.requests import Job

from ..protocol.telegrams import (
    AckAnswer,
    NakAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)

__all__ = ["TelegramLog"]

# Not the name of this module: users search and filter their logs by it.
logger = logging.getLogger("lecombus.line.telegram_log")

MOST_UNSOLICITED: Final = 256
"""With this many unsolicited bytes they are logged immediately."""

KINDS: Final = {
    ValueAnswer: "value",
    AckAnswer: "ack",
    NakAnswer: "nak",
    UnknownCodeAnswer: "no-such-code",
    TransmissionErrorAnswer: "transmission-error",
}


class TelegramLog:
    """Logs the telegrams of one line.

    Args:
        line: Its name.
    """

    def __init__(self, line: str) -> None:
        self._line = line
        self._sent = b""
        self._heard = bytearray()

    def sent(self, job: Job, telegram: bytes) -> None:
        """Log a telegram that was sent to the port."""
        self._log_unsolicited()
        self._sent = telegram
        step = job.step
        value = "" if step.value is None else f" value={step.value.raw}"
        logger.debug(
            "line=%s drive=%s event=telegram direction=sent kind=%s code=%s bytes=%s%s",
            self._line, job.station.name, step.kind, step.code, telegram.hex(" "), value,
        )  # fmt: skip

    def heard(self, data: bytes) -> None:
        """Collect bytes of the answer that is awaited."""
        self._heard += data

    def unsolicited(self, data: bytes) -> None:
        """Collect unsolicited bytes."""
        self._heard += data
        if len(self._heard) >= MOST_UNSOLICITED:
            self._log_unsolicited()

    def ended(self, job: Job, result: Result) -> None:
        """Log the result of an exchange, before its job gets it."""
        heard, self._heard = bytes(self._heard), bytearray()
        if result.kind is ResultKind.SENT:
            return  # a multicast has no answer
        echo = len(self._sent) > 1 and heard.startswith(self._sent)
        answer = result.answer
        kind = KINDS.get(type(answer)) or result.kind.name.lower().replace("_", "-")
        more = " echo=removed" if echo else ""
        if isinstance(answer, ValueAnswer):
            more += f" value={answer.value.raw}"
        elif result.fault:
            more += f" reason={result.fault}"
        logger.debug(
            "line=%s drive=%s event=telegram direction=received kind=%s code=%s ms=%.1f "
            "bytes=%s%s",
            self._line, job.station.name, kind, job.step.code,
            (result.ended_s - result.started_s) * 1000.0,
            (heard[len(self._sent) :] if echo else heard).hex(" ") or "none", more,
        )  # fmt: skip

    def _log_unsolicited(self) -> None:
        if self._heard:
            logger.debug(
                "line=%s event=telegram direction=received kind=unasked bytes=%s",
                self._line, self._heard.hex(" "),
            )  # fmt: skip
            self._heard.clear()
