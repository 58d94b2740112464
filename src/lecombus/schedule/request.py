"""What waits in a schedule: one request for a drive, and how it may end.

A request is a drive, an opaque piece of work, what it costs on the line in seconds and by when it
must have begun. Nothing here knows a line protocol: the codes and values are inside `work`, which
only the line reads. Everyone who puts a request into a schedule gets its end exactly once
through `settle`.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Any, Final

__all__ = [
    "CLIENT_GONE",
    "DEFERRED",
    "LEASE_ENDED",
    "OUT",
    "OUTDATED",
    "QUEUED",
    "REPLACED",
    "STOPPED",
    "TAKEN_OUT",
    "UNDER_WAY",
    "DispatchReason",
    "Outcome",
    "Priority",
    "Request",
    "Settle",
    "ignore_end",
]

# Where a request is: not in a schedule, in its lane, waiting for a time, or on the line.
OUT: Final = 0
QUEUED: Final = 1
DEFERRED: Final = 2
UNDER_WAY: Final = 3


STOPPED: Final = "ended by a stop of the drive"
"""Why a write ended for which a stop came while it waited, or between two of its steps."""

CLIENT_GONE: Final = "its client closed the connection before it was sent"
"""Why a write ended that waited when the client that asked for it left."""

OUTDATED: Final = "it was made from what is not true any more"
"""Why a stop of several drives was not sent as one telegram."""

REPLACED: Final = "a later request took its place"
"""Why a write ended behind which a later one of the same went out."""

TAKEN_OUT: Final = "was taken out of the roster"
"""Why what waits for a drive ends at a reload that removed or changed it; behind its name."""

LEASE_ENDED: Final = "its lease ended before it was sent"
"""Why a write ended that waited when its lease lapsed, was given up, or was taken over."""


class Priority(IntEnum):
    """The six classes, highest first."""

    STOP = 0
    CONTROL = 1
    WATCHDOG = 2
    INTERACTIVE = 3
    CYCLIC = 4
    BACKGROUND = 5


class DispatchReason(IntEnum):
    """By what an exchange went when it did.

    `RIGHT`: it was the first of the highest class. `CREDIT`: by its class's share, before a higher
    class that waited. `FEED`: a watchdog asked for it. `FEED_AHEAD`: the same, before a control
    request that waited. `KEPT`: a higher class had its drive left alone while it waited.
    """

    RIGHT = 0
    CREDIT = 1
    FEED = 2
    FEED_AHEAD = 3
    KEPT = 4


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

    @property
    def is_good(self) -> bool:
        """Whether what was asked for was done."""
        return self is Outcome.DONE or self is Outcome.VERIFIED


Settle = Callable[[Outcome, str], None]


def ignore_end(outcome: Outcome, reason: str) -> None:
    """The end of a request without a waiter: its result is in the store."""


@dataclass(slots=True, eq=False)
class Request:
    """One thing to be sent to one drive (or, as a multicast, to several).

    Args:
        drive: The drive it speaks to; for a multicast the group's name.
        priority: Its class.
        cost_s: Line time when answered normally, seconds.
        worst_s: The longest one attempt can hold the line, time-outs included, seconds.
        settle: Called exactly once with outcome and reason.
        work: The work of the line; opaque here.
        expires_at_s: It is not begun after this time.
        supersedes: A later request with the same key takes the place of this one while it waits.
        writes: It may change the drive: a stop of the drive ends it while it waits.
        stops: For a stop: the drives whose waiting writes it ends.
        members: For a multicast: the drives it reaches.
        submitted_at_s: When the schedule took it; for a cyclic slot, when it was due.
        documented: Cost and longest time by manual and roster alone, seconds, where measured times
            made them longer; None: they did not.
        cut_outcome: How it ends when a stop, a later request, a parked drive or a lost line cuts
            it off between two of its steps. The line sets it after each step.
        yields: For a stop: its drive shows it already, and it waits for feeds (`silent_stops`).
        hold_s: Its drive may have to be left alone for so long afterwards, also if it is not
            answered, seconds.
        is_gone: Says whether the client that asked for it has left. The line asks directly before
            the first telegram; None: it is sent even if its client has left.
        lease_ended: Says whether the lease has ended by which it was permitted. The line asks
            directly before each telegram that writes; None: it needs no lease.
        is_outdated: Says whether its telegram is made from what is not true any more. The line asks
            directly before the first one; None: it is made from nothing that changes.
        says: For a write: what it changes, such as a code; equal for two that change the same.
        halts: It is a plain write that stops its drives.
        lifts_nothing: Besides, it stops them in any state, and can lift no other stop.
        may_move: It is a write that can move its drives.
        repeats: It is a write that says again what its drives were told last.

    The fields after it belong to the schedule; no other module writes them.
    """

    drive: str
    priority: Priority
    cost_s: float
    worst_s: float
    settle: Settle
    work: object = None
    expires_at_s: float | None = None
    supersedes: Hashable | None = None
    writes: bool = False
    stops: tuple[str, ...] = ()
    members: tuple[str, ...] = ()
    submitted_at_s: float = 0.0
    cut_outcome: Outcome | None = None
    documented: tuple[float, float] | None = None
    yields: bool = False
    hold_s: float = 0.0
    is_gone: Callable[[], bool] | None = None
    lease_ended: Callable[[], bool] | None = None
    is_outdated: Callable[[], bool] | None = None
    says: Hashable | None = None
    halts: bool = False
    lifts_nothing: bool = False
    may_move: bool = False
    repeats: bool = False
    settled: bool = field(default=False, repr=False)
    # -- bookkeeping of the schedule ------------------------------------------------------------
    state: int = field(default=0, init=False, repr=False)  # OUT, QUEUED, DEFERRED, UNDER_WAY
    serial: int = field(default=0, init=False, repr=False)  # order of submission
    place: int = field(default=0, init=False, repr=False)  # order within its class
    cell: list[Any] | None = field(default=None, init=False, repr=False)  # where it stands
    attempts: int = field(default=0, init=False, repr=False)  # exchanges made for it
    rooms: int = field(default=0, init=False, repr=False)  # feeds run first so that it fits
    eased: int = field(default=0, init=False, repr=False)  # times its room was made in vain
    fed_first: int = field(default=0, init=False, repr=False)  # feeds of its drive run first
    late_first: int = field(default=0, init=False, repr=False)  # late feeds run first
    kept_first: bool = field(default=False, init=False, repr=False)  # what a hold kept ran first
    latest_s: float | None = field(default=None, init=False, repr=False)  # no feed before it then
    cut_by_s: float = field(default=0.0, init=False, repr=False)  # taken off its time-outs
    turn: DispatchReason = field(
        default=DispatchReason.RIGHT, init=False, repr=False
    )  # by what it went
    source: object = field(default=None, init=False, repr=False)  # the entry or probe behind it
    home: object = field(default=None, init=False, repr=False)  # its drive when it was submitted
    overtaken: str = field(default="", init=False, repr=False)  # why it writes nothing any more

    def shorten(self, worst_s: float) -> None:
        """Have it hold the line no longer than this, but for what its manual allows."""
        if self.documented is not None and worst_s < self.worst_s:
            least_s = min(max(worst_s, self.documented[1]), self.worst_s)
            self.cut_by_s += self.worst_s - least_s
            self.worst_s = least_s

    def cut(self, outcome: Outcome, reason: str) -> None:
        """End it though it may have been sent already.

        `SUPERSEDED` and `REFUSED` promise that nothing was changed. A write of which a step has
        been on the line cannot promise that: it ends as `cut_outcome` says, or, when that is not
        set, as `UNKNOWN`.
        """
        if self.cut_outcome is not None:
            outcome = self.cut_outcome
        elif self.attempts and (self.writes or self.supersedes is not None):
            outcome = Outcome.UNKNOWN
        if outcome is Outcome.UNKNOWN:
            reason = f"{reason}; it was sent before, and not proven"
        self.end(outcome, reason)

    @property
    def unfed_s(self) -> float:
        """The longest until its drive can be spoken to again after it was not answered, seconds."""
        return self.worst_s + self.hold_s

    def why_unwanted(self, *, writes: bool) -> str:
        """Say why its next telegram may not be sent any more; empty: it may.

        Args:
            writes: That telegram writes; a lease that ended does not keep a proof from being read,
                nor does a later write that went out first.
        """
        if writes and self.overtaken:
            return self.overtaken
        if self.is_gone is not None and not self.attempts and self.is_gone():
            return CLIENT_GONE
        if self.is_outdated is not None and not self.attempts and self.is_outdated():
            return OUTDATED
        if writes and self.lease_ended is not None and self.lease_ended():
            return LEASE_ENDED
        return ""

    def end(self, outcome: Outcome, reason: str = "") -> None:
        """Settle the request.

        A second call is a programming error: it would give one request two outcomes.
        """
        assert not self.settled, f"{self!r} ended twice"
        self.settled = True
        self.settle(outcome, reason)
