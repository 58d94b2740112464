"""Reports of the worker: each exchange, each change of the line.

The interface between the line and its recorder. Nothing here decides anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from lecombus.fieldbus.lecom.protocol.exchange import Result

from ..schedule import Priority
from .station import JobStep

__all__ = ["ExchangeReport", "Observer"]


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
    result: Result
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
