"""The times of a line and of the exchanges on it, in seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from lecombus.parameters import Code, Value
from lecombus.roster import DriveEntry

__all__ = ["Cost", "ExchangeCosts", "LineTiming"]


@dataclass(frozen=True, slots=True)
class LineTiming:
    """How fast a line is and what stands between it and us.

    Args:
        baud: Bits a second, one of those that the protocol knows.
        turnaround_s: Least pause between an answer's end and the next telegram, seconds; kept by
            the sender, no part of a cost.
        adapter_latency_s: What the adapter or device server may add, seconds: about 0.016 for a
            USB adapter, 0.050 over TCP, 0.005 for the built-in simulator.
        quarantine_s: How long the line must be silent after an answer that did not come or was
            garbled, seconds.
        paced: False where bytes take no time (a simulator without a baud rate).
        bits_per_char: Bits of a character, start, parity and stop bits included.
    """

    baud: int
    turnaround_s: float = 0.002
    adapter_latency_s: float = 0.016
    quarantine_s: float = 0.5
    paced: bool = True
    bits_per_char: int = 10

    @property
    def char_s(self) -> float:
        """Time of one character, seconds."""
        return self.bits_per_char / self.baud if self.paced else 0.0


@dataclass(frozen=True, slots=True)
class Cost:
    """The times of one exchange, in seconds; deadlines count from handing over the request.

    Args:
        expected_s: Request, thinking and answer, as they usually are.
        first_byte_s: When the answer's first byte must have come.
        whole_s: When the whole answer must have come.
        gap_s: The longest silence inside an answer.
        worst_s: How long one attempt can hold the line, quarantine included.
        request_s: The request's time on the wire.
    """

    expected_s: float
    first_byte_s: float
    whole_s: float
    gap_s: float
    worst_s: float
    request_s: float


class ExchangeCosts(Protocol):
    """What the exchanges with the drives of a roster cost; the turnaround is in none of it."""

    def reads(self, timing: LineTiming, drive: DriveEntry, code: Code) -> Sequence[Cost]:
        """Return the cost of a read in each way in which the drive may be asked, the usual first.

        There is at least one.
        """

    def write(self, timing: LineTiming, drive: DriveEntry, code: Code, value: Value) -> Cost:
        """Return the cost of a write, in the usual way."""

    def stop_attempts(self, timing: LineTiming, drive: DriveEntry) -> Sequence[Cost]:
        """Return the cost of every telegram, in any way, that a stop of the drive may send.

        None for a family that knows no stop.
        """
