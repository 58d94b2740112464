"""Reports of the worker: each exchange, each change of the line, in words of any protocol.

The interface between the line and its recorder. Nothing here decides anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Protocol

from lecombus.fieldbus.station import JobStep
from lecombus.parameters import Value
from lecombus.schedule import Priority

__all__ = [
    "AnswerKind",
    "DriveAnswer",
    "ExchangeReport",
    "ExchangeResult",
    "Observer",
    "ResultKind",
]


class ResultKind(StrEnum):
    """How an exchange ended on the wire."""

    ANSWERED = "answered"
    SENT = "sent"
    NO_REPLY = "no reply"
    GARBLED = "garbled"
    ECHO = "echo"
    LOST = "line lost"


class AnswerKind(Enum):
    """What a drive answered."""

    VALUE = "value"
    ACKNOWLEDGED = "acknowledged"
    REFUSED = "refused"
    NO_SUCH_CODE = "no such code"
    OTHER = "other"


class DriveAnswer(Protocol):
    """What a drive answered; a protocol's own classes of answers have these attributes."""

    @property
    def kind(self) -> AnswerKind:
        """What it is."""

    @property
    def value(self) -> Value | None:
        """The value that was read, if it is one."""

    @property
    def text(self) -> str:
        """Why a read brought no value, for people; empty where `kind` says it."""


class ExchangeResult(Protocol):
    """How one exchange ended; times are monotonic seconds."""

    @property
    def kind(self) -> ResultKind:
        """How it ended on the wire."""

    @property
    def answer(self) -> DriveAnswer | None:
        """The drive's answer, when `kind` is ANSWERED."""

    @property
    def started_s(self) -> float:
        """When the telegram was handed to the port."""

    @property
    def ended_s(self) -> float:
        """When the answer was complete, or when it was given up."""

    @property
    def overdue_s(self) -> float:
        """How much older than `ended_s` the answer may be, because the process did not run."""

    @property
    def fault(self) -> str:
        """Why it failed, in words; empty when it did not."""

    @property
    def late(self) -> int:
        """How many answers to something else came during the exchange."""

    @property
    def clean(self) -> bool:
        """False when anything but the answer was heard."""


@dataclass(slots=True)
class ExchangeReport:
    """One exchange that ended.

    Args:
        drive: The drive's (for a multicast the group's) name.
        step: What was sent.
        result: How it ended.
        priority: The class it ran in.
        waited_s: From the moment the schedule took the request to the telegram.
        quarantined_s: How long the line is left alone because of it.
        members: For a multicast: the drives it reached.
        address: The address that was used; the name may belong to another device by now.
        attempt: Which exchange of its request it was, 1 for the first.
    """

    drive: str
    step: JobStep
    result: ExchangeResult
    priority: Priority
    waited_s: float
    quarantined_s: float
    members: tuple[str, ...] = ()
    address: int = 0
    attempt: int = 1


class Observer(Protocol):
    """Receives the events of the line; its methods must return quickly and never raise."""

    def exchange_ended(self, report: ExchangeReport) -> None:
        """An exchange ended; called while the next drive is already thinking, if there is one."""

    def line_changed(self, up: bool, reason: str) -> None:
        """The port was opened (`up`) or lost."""

    def thinking(self, for_s: float) -> None:
        """A telegram went out; nothing can arrive for so many seconds."""

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        """Bytes came outside an exchange; `late_answer`: they were an old answer, whole."""
