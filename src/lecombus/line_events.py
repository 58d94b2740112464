"""What happens on the line, in plain words, and what may be asked of the line because of it.

`supervision.exchange_recorder` makes one `ExchangeEvent` of each exchange and gives it to its
subscribers in one fixed order. What a subscriber then wants of the line goes through
`LineRequests`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from lecombus.drive_state.drive_runtime import Drive
    from lecombus.drives import Family
    from lecombus.fieldbus.loop_interface import ExchangeReport
    from lecombus.parameters import Code, Value
    from lecombus.schedule import Settle

__all__ = ["ExchangeEvent", "LineChange", "LineRequests"]


@dataclass(slots=True)
class ExchangeEvent:
    """What one exchange means; no subscriber changes it (freezing it would double its cost).

    Args:
        report: The exchange as the worker reports it.
        drives: Who was addressed: one drive, or the members of a multicast.
        code: The code that was read or written.
        ended_s: When it ended, monotonic seconds.
        outcome: How it ended, as the metrics name it.
        read: The value that was read; None: none was.
        read_s: When that value was right, monotonic seconds.
        read_failure: Why a read brought no value; None: it did, or nothing was read.
        written: The value that a write may have put into the drives; None: nothing was written, or
            the drive refused it.
        is_write: A write may have taken effect.
        acknowledged: The drive acknowledged the write.
        to_all: It was a multicast, and it was sent.
        answered: The drive answered, with a value, an acknowledgement or a refusal.
        lapsed: It answered, and was silent before for its watchdog's time, or was never heard.
    """

    report: ExchangeReport
    drives: tuple[Drive, ...]
    code: Code
    ended_s: float
    outcome: str
    read: Value | None = None
    read_s: float = 0.0
    read_failure: str | None = None
    written: Value | None = None
    is_write: bool = False
    acknowledged: bool = False
    to_all: bool = False
    answered: bool = False
    lapsed: bool = False


@dataclass(frozen=True, slots=True)
class LineChange:
    """The port was opened or lost; `reason` says why."""

    is_open: bool
    reason: str


class LineRequests(Protocol):
    """What may be asked of the line by those that follow its events."""

    def read_soon(self, drive: Drive, code: Code, settle: Settle) -> None:
        """Read a code before the cyclic ones, without waiting for it here.

        Raises:
            LecombusError: That cannot be asked now.
        """

    def read_later(self, drive: Drive, code: Code, settle: Settle) -> None:
        """Read a code when the line has time for it.

        Raises:
            LecombusError: That cannot be asked now.
        """

    def audit_soon(self, drive: Drive) -> None:
        """Audit a drive; one under audit is audited once more after that."""

    def doubt(self, drive: Drive, reason: str) -> None:
        """Write nothing but stops to a drive until it was audited again."""

    def use_family(self, drive: Drive, family: Family) -> None:
        """Use another description of its family for a drive, such as a signal configuration's."""

    def use_early_answers(self, drive: Drive, early: bool | None) -> None:
        """Leave a drive alone after each write unless it does not acknowledge early.

        Args:
            drive: The drive.
            early: Whether it acknowledges a write before it has passed it on; None: not known.
        """

    def use_answer_times(self, drive: Drive) -> None:
        """Use the answer times that a drive was measured with, where they are others now."""
