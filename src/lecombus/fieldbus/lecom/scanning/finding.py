"""What a scan has found at one address."""

from __future__ import annotations

from dataclasses import dataclass

from lecombus.parameters import Code

__all__ = ["Finding", "FoundWatchdog", "Unclear"]


@dataclass(frozen=True, slots=True)
class FoundWatchdog:
    """How a drive's watchdog is set.

    Args:
        time_s: Its monitoring time, seconds.
        action: The roster's word for what it does.
    """

    time_s: float
    action: str


@dataclass(frozen=True, slots=True)
class Finding:
    """A drive.

    Args:
        address: Where it answered.
        baud: At which baud rate, bit/s.
        family: What it is, in the roster's word; `generic` where that cannot be said for sure.
        certain: Whether its family follows from its answers alone.
        why: What the family follows from, or why it is not known.
        labels: What the drive says of its software and itself, by code.
        watchdog: How its watchdog is set; None where none is known or could be read.
        remarks: What stands to be said about it.
        late: It answered only when waited for longer than its description says.
    """

    address: int
    baud: int
    family: str
    certain: bool
    why: str
    labels: tuple[tuple[Code, str], ...] = ()
    watchdog: FoundWatchdog | None = None
    remarks: tuple[str, ...] = ()
    late: bool = False

    @property
    def name(self) -> str:
        """The name proposed for it."""
        return f"drive-{self.address}"


@dataclass(frozen=True, slots=True)
class Unclear:
    """An address from which something came, and never a whole answer.

    Args:
        address: The address that was asked.
        baud: The baud rate, bit/s.
        received: What came, the first bytes, parity bits included.
    """

    address: int
    baud: int
    received: bytes
