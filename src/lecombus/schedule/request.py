"""What waits in a schedule: one request for a drive, and how it may end.

A request is a drive, an opaque piece of work, what it costs on the line in seconds and by when it
must have begun. Nothing here knows a line protocol: the codes and values are inside `work`, which
only the line reads. Everyone who puts a request into a schedule is told its end exactly once
through `settle`.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

__all__ = ["Outcome", "Priority", "Request", "Settle"]


class Priority(IntEnum):
    """The six classes, highest first."""

    STOP = 0
    CONTROL = 1
    WATCHDOG = 2
    INTERACTIVE = 3
    CYCLIC = 4
    BACKGROUND = 5


class Outcome(StrEnum):
    """How a request ended; every request ends in exactly one of these.

    `DONE`: the drive acknowledged (a read: it answered). `VERIFIED`: read back and equal.
    `REFUSED`: nothing was changed, for the reason given. `EXPIRED`: too late, never sent.
    `SUPERSEDED`: a later request or a stop took its place, never sent. `UNKNOWN`: it may have
    happened: the answer was lost and could not be read back.
    """

    DONE = "done"
    VERIFIED = "verified"
    REFUSED = "refused"
    EXPIRED = "expired"
    SUPERSEDED = "superseded"
    UNKNOWN = "unknown"


Settle = Callable[[Outcome, str], None]


@dataclass(slots=True, eq=False)
class Request:
    """One thing to be said to one drive (or, as a multicast, to several).

    Args:
        drive: The drive it speaks to; for a multicast the group's name.
        priority: Its class.
        cost_s: Line time when answered normally, seconds.
        worst_s: The longest one attempt can hold the line, time-outs included, seconds.
        settle: Called exactly once with outcome and reason.
        work: What the line is to say; opaque here.
        expires_at_s: It is not begun after this time.
        supersedes: A later request with the same key takes the place of this one while it waits.
        motion: A stop for the drive ends it while it waits.
        stops: For a stop: the drives whose waiting motion writes it ends.
        members: For a multicast: the drives it reaches.
        submitted_at_s: When the schedule took it.
    """

    drive: str
    priority: Priority
    cost_s: float
    worst_s: float
    settle: Settle
    work: object = None
    expires_at_s: float | None = None
    supersedes: Hashable | None = None
    motion: bool = False
    stops: tuple[str, ...] = ()
    members: tuple[str, ...] = ()
    submitted_at_s: float = 0.0
    settled: bool = field(default=False, repr=False)

    def end(self, outcome: Outcome, reason: str = "") -> None:
        """Settle the request.

        A second call is a programming error: it would give one request two outcomes.
        """
        assert not self.settled, f"{self!r} ended twice"
        self.settled = True
        self.settle(outcome, reason)
