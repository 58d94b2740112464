"""Every telegram in the log, decoded, one line each: for `--log-level debug` alone.

Received bytes are collected and logged at the end of the exchange; unsolicited bytes are logged
together before the next telegram.

The values of codes that hold a password are replaced by `***`, and so are the bytes that carry
them.
"""

from __future__ import annotations

import logging
from typing import Final

from lecombus.drives import PASSWORDS
from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.fieldbus.requests import Job, StepKind
from lecombus.parameters import Code

from ..protocol.addressing import EXTENDED_MARK, Form, encode_code
from ..protocol.controls import STX, strip_parity
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

HIDDEN: Final = "***"

SECRET_STARTS: Final = (
    *(b"%c%b" % (STX, encode_code(Code(number), Form.STANDARD)) for number in PASSWORDS),
    *(b"%c%c%04X" % (STX, EXTENDED_MARK, number) for number in PASSWORDS),
)
"""What a text that carries a password begins with: extended addressing with any subcode."""

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
        data, value = telegram.hex(" "), ""
        if step.value is not None:
            hidden = _is_secret(job)
            data = HIDDEN if hidden else data
            value = f" value={HIDDEN if hidden else step.value.raw}"
        logger.debug(
            "line=%s drive=%s event=telegram direction=sent kind=%s code=%s bytes=%s%s",
            self._line, job.station.name, step.kind, step.code, data, value,
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
        hidden = _is_secret(job)
        if isinstance(answer, ValueAnswer):
            more += f" value={HIDDEN if hidden else answer.value.raw}"
        elif result.fault:
            more += f" reason={result.fault}"
        logger.debug(
            "line=%s drive=%s event=telegram direction=received kind=%s code=%s ms=%.1f "
            "bytes=%s%s",
            self._line, job.station.name, kind, job.step.code,
            (result.ended_s - result.started_s) * 1000.0,
            _shown(heard[len(self._sent) :] if echo else heard, hidden=hidden), more,
        )  # fmt: skip

    def _log_unsolicited(self) -> None:
        if self._heard:
            logger.debug(
                "line=%s event=telegram direction=received kind=unasked bytes=%s",
                self._line, _shown(bytes(self._heard), hidden=False),
            )  # fmt: skip
            self._heard.clear()


def _is_secret(job: Job) -> bool:
    """Return whether the code of the step holds a password; of a multicast, in any family."""
    step = job.step
    if step.kind is StepKind.MULTICAST and step.code.number in PASSWORDS:
        return True
    return job.station.family.is_secret(step.code)


def _shown(data: bytes, *, hidden: bool) -> str:
    if not data:
        return "none"
    return HIDDEN if hidden or _carries_secret(data) else data.hex(" ")


def _carries_secret(data: bytes) -> bool:
    """Return whether a value of a code that is a password in any family begins in these bytes.

    Late answers and the telegrams of another master come unasked; a damaged one counts too.
    """
    characters, _ = strip_parity(data)
    return any(start in characters for start in SECRET_STARTS)
