"""The errors that several rooms share, in one tree; those of one room stand in that room.

::

    LecombusError
    ├── ConfigError (ValueError)          file, where
    │   └── DescriptionError              + drive_type, code, path, value
    ├── CodeValueError (ValueError)       code, value, low, high
    ├── LineError                         line
    │   ├── LineLostError
    │   └── LineClosedError
    ├── ExchangeError                     record: address, code, attempt, elapsed_s, bytes
    │   ├── NoReplyError
    │   ├── CutReplyError
    │   ├── GarbledReplyError             + expected_bcc, got_bcc
    │   ├── UnexpectedReplyError
    │   ├── EchoError
    │   └── RefusedError
    │       ├── NakError
    │       ├── ChecksumReportedError
    │       └── UnknownCodeError
    ├── ScheduleError
    │   └── QueueFullError                priority, depth, limit
    └── OperationError                    kind, drive, code, remedy

Strategy: data travels as attributes, the message is made from them, and `retryable` is a class
attribute, so that a caller decides without reading text. A programming error is an assertion,
never one of these. What a drive says that is valid but unwelcome (NAK, unknown code) is an event
inside `protocol/` and becomes an error only above it. This module imports nothing of lecombus.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches

__all__ = [
    "ChecksumReportedError",
    "CodeValueError",
    "ConfigError",
    "CutReplyError",
    "DescriptionError",
    "EchoError",
    "ExchangeError",
    "ExchangeRecord",
    "GarbledReplyError",
    "LecombusError",
    "LineClosedError",
    "LineError",
    "LineLostError",
    "NakError",
    "NoReplyError",
    "OperationError",
    "QueueFullError",
    "RefusedError",
    "ScheduleError",
    "UnexpectedReplyError",
    "UnknownCodeError",
    "meant",
]

LONGEST_COMPARED = 64
"""Characters of a word that are compared with those known: a word may come from anybody."""


def meant(word: str, known: Iterable[str], what: str) -> str:
    """Return the remedy for a name that is not known: the nearest there is, or all of them.

    Args:
        word: What was given.
        known: What would be right.
        what: What these are, such as `the drives`.
    """
    folded = {name.casefold(): name for name in known}
    near = get_close_matches(word[:LONGEST_COMPARED].casefold(), folded, n=1)
    if near:
        return f"did you mean {folded[near[0]]}?"
    return f"{what} are: {', '.join(folded.values()) or 'none'}"


class LecombusError(Exception):
    """The root: catching this catches everything lecombus raises on purpose."""

    retryable = False


class ConfigError(LecombusError, ValueError):
    """Something written by a person cannot be used.

    Args:
        message: What is wrong and what would be right.
        file: The file it stands in.
        where: The place in it, such as `12:7` or a key path.
    """

    def __init__(self, message: str, *, file: str = "", where: str = "") -> None:
        place = ":".join(part for part in (file, where) if part)
        super().__init__(f"{place}: {message}" if place else message)
        self.file = file
        self.where = where


class DescriptionError(ConfigError):
    """A data file of lecombus or a backup is wrong.

    Args:
        message: What is wrong and what would be right.
        file: The file.
        where: `LINE:COLUMN`.
        drive_type: The family that was read.
        code: The code concerned, as text.
        path: The keys and numbers that lead to the value, such as `codes.3.format`.
        value: The value as it stands in the file, where it is known.
    """

    def __init__(
        self,
        message: str,
        *,
        file: str = "",
        where: str = "",
        drive_type: str = "",
        code: str = "",
        path: str = "",
        value: object = None,
    ) -> None:
        super().__init__(message, file=file, where=where)
        self.drive_type = drive_type
        self.code = code
        self.path = path
        self.value = value


class CodeValueError(LecombusError, ValueError):
    """A code, subcode, address or value lies outside what the protocol can carry.

    Args:
        message: What is wrong and what would be right.
        code: The code concerned, as text.
        value: The value given.
        low: The least allowed value, where there is one.
        high: The greatest allowed value, where there is one.
    """

    def __init__(
        self,
        message: str,
        *,
        code: str = "",
        value: object = None,
        low: object = None,
        high: object = None,
    ) -> None:
        super().__init__(message)
        self.code = code
        self.value = value
        self.low = low
        self.high = high


class LineError(LecombusError):
    """The line as a whole cannot be used."""

    def __init__(self, message: str, *, line: str = "") -> None:
        super().__init__(message)
        self.line = line


class LineLostError(LineError):
    """The port went away or cannot be opened; it is being reopened."""

    retryable = True


class LineClosedError(LineError):
    """The line is being shut down and takes no more requests."""


@dataclass(frozen=True, slots=True)
class ExchangeRecord:
    """What was on the wire in one exchange, for errors, traces and logs."""

    line: str = ""
    address: int = -1
    code: int = -1
    subcode: int = 0
    attempt: int = 1
    elapsed_s: float = 0.0
    sent: bytes = b""
    received: bytes = b""


class ExchangeError(LecombusError):
    """One exchange with one drive did not give what was asked for.

    Args:
        message: What happened, in the user's words.
        record: What was on the wire.
    """

    retryable = True

    def __init__(self, message: str, record: ExchangeRecord | None = None) -> None:
        super().__init__(message)
        self.record = record or ExchangeRecord()
        self.cause = ""
        """The likely cause, filled in where the family is known."""
        self.remedy = ""


class NoReplyError(ExchangeError):
    """The drive said nothing in time.

    Not a `TimeoutError`, so that no caller's own time-out handling swallows it.
    """


class CutReplyError(ExchangeError):
    """The line was lost before the answer was whole: that says nothing about the drive."""


class GarbledReplyError(ExchangeError):
    """Something came, but not a valid answer: wrong BCC, parity, form, or too long."""

    def __init__(
        self,
        message: str,
        record: ExchangeRecord | None = None,
        *,
        expected_bcc: int | None = None,
        got_bcc: int | None = None,
    ) -> None:
        super().__init__(message, record)
        self.expected_bcc = expected_bcc
        self.got_bcc = got_bcc


class UnexpectedReplyError(ExchangeError):
    """A valid answer, but not one to the question that was asked."""


class EchoError(ExchangeError):
    """The echo differs from what was sent: a collision or a broken line."""


class RefusedError(ExchangeError):
    """The drive understood and said no."""

    retryable = False


class NakError(RefusedError):
    """The drive answered with NAK: a value was not changed, a question not answered."""


class ChecksumReportedError(RefusedError):
    """The drive answered a read with `?`: it saw a transmission error."""

    retryable = True


class UnknownCodeError(RefusedError):
    """The drive answered a read with EOT: it has no such code."""


class ScheduleError(LecombusError):
    """A request cannot be taken or kept by the schedule."""


class QueueFullError(ScheduleError):
    """A bounded queue is full; nothing was sent."""

    retryable = True

    def __init__(self, *, priority: str, depth: int, limit: int) -> None:
        super().__init__(
            f"{depth} requests of class {priority} are waiting already, {limit} is the limit: "
            "nothing was sent; ask less often or wait for answers"
        )
        self.priority = priority
        self.depth = depth
        self.limit = limit


class OperationError(LecombusError):
    """What a user asked for cannot be done.

    Args:
        message: What is wrong.
        kind: A stable word for programs, such as `no-such-drive` or `not-writable`.
        drive: The drive's name.
        code: The code as text.
        remedy: What the user can do about it.
        retry_after_s: When it may be asked for again, seconds from now; None: no time helps.
    """

    def __init__(
        self,
        message: str,
        *,
        kind: str,
        drive: str = "",
        code: str = "",
        remedy: str = "",
        retry_after_s: float | None = None,
    ) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s
        self.kind = kind
        self.drive = drive
        self.code = code
        self.remedy = remedy
