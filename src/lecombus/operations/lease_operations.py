"""Leases as clients ask for them, and what a write needs of them.

Every write to a drive needs the token of its lease, where the roster requires one or a lease is
held, except the one value that inhibits the drive in any state (`stops_every_drive`): no
description says of any other code that it cannot move a motor (ADR 42). Stops need none.

Asked twice: when a write comes in, and directly before each telegram that writes (`ended_check`),
so that nothing is sent for a token that was fenced off, or whose lease lapsed, while it waited.
"""

from __future__ import annotations

import logging
import secrets
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from typing import Final

from lecombus.config import DriveEntry
from lecombus.drive_state.readings import seconds
from lecombus.drives import Family, StopAction, family, knows_stop
from lecombus.drives.stops import stops_every_drive
from lecombus.drives.verbs import acts_on_setpoints, takes_control
from lecombus.errors import OperationError
from lecombus.leases import NEEDED_STOPS, HeldLease, LeaseBook, LeaseTerms, Use
from lecombus.operations.actions import ACTOR
from lecombus.parameters import Code, Json, Value
from lecombus.saved_state import State

__all__ = ["LEASE", "LeaseFollower", "Leases", "use_of"]

logger = logging.getLogger(__name__)

LEASE: Final[ContextVar[str]] = ContextVar("LEASE", default="")
"""The token that came with what is being done; empty: none."""

LEAP: Final = 10_000
"""Numbers left out at a start: those of the last seconds before it may not have been saved."""

SECRET_BYTES: Final = 16

LEASES_LIMIT: Final = 256


LeaseFollower = Callable[[str, Sequence[str], Mapping[str, str]], None]
"""Takes what happened (`taken`, `released`, `ended`, `unlatched`, `silenced`, `hold`), to which
drives, and what is to be known of it; it must return quickly and never raise."""


class Leases:
    """The leases of one line.

    Args:
        state: Keeps the largest number used.
        clock: Monotonic time, seconds.
        wall: The time of day, Unix seconds.

    Attributes:
        book: Who controls what.
        changed: Called when the next lapse may come at another time, or a drive was enabled.
        followers: Told what becomes of leases and their drives.
        held_stops: Gives the stops of the line that a drive has shown just now.
        is_silenced: Whether a drive is sent nothing but stops, so that its watchdog acts.
    """

    def __init__(self, state: State, clock: Callable[[], float], wall: Callable[[], float]) -> None:
        self._state = state
        self._clock = clock
        # Without a state file the time of day keeps numbers from repeating.
        self.book = LeaseBook(max(state.lease_number + LEAP, int(1000 * wall())))
        self.changed: Callable[[], None] = lambda: None
        self.followers: tuple[LeaseFollower, ...] = ()
        self.held_stops: Callable[[str], frozenset[StopAction]] = lambda drive: frozenset()
        self.is_silenced: Callable[[str], bool] = lambda drive: False
        self._entries: Mapping[str, DriveEntry] = {}

    def set_roster(self, entries: Sequence[DriveEntry]) -> None:
        """Take the roster's drives, at the start and at every reload."""
        self._entries = {entry.name: entry for entry in entries}
        self.book.set_terms({one.name: terms_of(one) for one in entries}, self._clock())
        self.changed()

    # -- what clients ask -------------------------------------------------------------------------

    def take(
        self,
        name: str,
        targets: Sequence[str],
        drives: Sequence[str],
        time_s: float,
        counter: int,
        take_over: str = "",
    ) -> HeldLease:
        """Grant a lease (`LeaseBook.take`).

        Raises:
            OperationError: Also `no-stop`: nothing could be done to a drive when it lapses.
        """
        for drive in drives:
            check_lapse(self._entries[drive])
        now_s = self._clock()
        if len(self.book.leases(now_s)) >= LEASES_LIMIT:
            text = f"{LEASES_LIMIT} leases are held already"
            raise OperationError(text, kind="queue-full", remedy="give up those not needed")
        lease = self.book.take(
            name, targets, drives, time_s, counter, now_s,
            secret=secrets.token_hex(SECRET_BYTES), take_over=take_over,
            holder=ACTOR.get().fields(),
        )  # fmt: skip
        self._state.lease_number = lease.number
        self._state.touch()
        self._log("lease-taken", lease, take_over=take_over)
        self.changed()
        return lease

    def renew(self, name: str, token: str, counter: int) -> HeldLease:
        """Renew a lease (`LeaseBook.renew`)."""
        lease = self.book.renew(name, token, counter, self._clock())
        self.changed()
        return lease

    def release(self, name: str, token: str) -> HeldLease:
        """End a lease on purpose (`LeaseBook.release`)."""
        lease = self.book.release(name, token, self._clock())
        self._log("lease-released", lease)
        self.changed()
        return lease

    def enabled(self, drive: str) -> None:
        """Take setpoints for a drive that was enabled just now with the token of its lease."""
        if self.book.enabled(drive, LEASE.get(), self._clock()):
            logger.info("drive=%s event=unlatched", drive)
            self.tell("unlatched", (drive,), ACTOR.get().fields())
            self.changed()

    # -- what a write needs -----------------------------------------------------------------------

    def check(self, drive: str, use: Use) -> None:
        """Refuse what the leases do not permit now.

        Raises:
            OperationError: `lease-required`, `lease-lost` or `latched`.
        """
        problem = self._objection(drive, LEASE.get(), use)
        if problem is not None:
            raise problem

    def ended_check(self, uses: Mapping[str, Use]) -> Callable[[], bool]:
        """Give what says directly before a telegram that it may not be sent any more.

        Args:
            uses: By drive that the telegram reaches: what the write is for.
        """
        token = LEASE.get()

        def has_ended() -> bool:
            return any(self._objection(one, token, use) is not None for one, use in uses.items())

        return has_ended

    def _objection(self, drive: str, token: str, use: Use) -> OperationError | None:
        def holds_stop(use: Use) -> bool:
            held = self.held_stops(drive) if use in NEEDED_STOPS else frozenset()
            return StopAction.INHIBIT in held if use is Use.TAKE_CONTROL else bool(held)

        return self.book.objection(drive, token, use, self._clock(), holds_stop)

    def needs_stop_shown(self, drive: str) -> bool:
        """Whether a setpoint that comes with this token depends on a stop that the drive shows."""
        found = self.book.objection(drive, LEASE.get(), Use.SETPOINT, self._clock())
        return found is not None and found.kind == "latched"

    # -- what is shown ----------------------------------------------------------------------------

    def held(self) -> list[HeldLease]:
        """Return the leases that are held now, the oldest first."""
        return self.book.leases(self._clock())

    def drives_json(self) -> list[dict[str, Json]]:
        """Return each drive with a lease, a latch, or the need of one."""
        self.book.advance(self._clock())
        return [
            {
                "drive": name,
                "required": control.terms.required,
                "on_lapse": control.terms.on_lapse,
                "time_s": seconds(control.terms.time_s),
                "lease": None if control.lease is None else control.lease.name,
                "latched": control.latch is not None,
                "because": None if control.latch is None else control.latch.value,
                "silenced": self.is_silenced(name),
            }
            for name, control in self.book.drives.items()
            if control.terms.required or control.lease is not None or control.latch is not None
        ]

    def lease_json(self, lease: HeldLease, *, token: bool = False) -> dict[str, Json]:
        """Return the JSON form of a lease; only its holder sees the token."""
        controls = self.book.drives
        secret: dict[str, Json] = {"token": lease.token} if token else {}
        return {
            "name": lease.name,
            "number": lease.number,
            **secret,
            "targets": list(lease.targets),
            "drives": list(lease.drives),
            "time_s": seconds(lease.time_s),
            "expires_in_s": seconds(max(0.0, lease.ends_at_s - self._clock())),
            "held_s": seconds(self._clock() - lease.taken_at_s),
            "counter": lease.counter,
            "on_lapse": {name: controls[name].terms.on_lapse for name in lease.drives},
            "latched": [name for name in lease.drives if controls[name].latch is not None],
            "holder": dict(lease.holder),
        }

    def _log(self, event: str, lease: HeldLease, take_over: str = "") -> None:
        fields = {
            **ACTOR.get().fields(), "lease": lease.name, "number": str(lease.number),
            "drives": ",".join(lease.drives), "time_s": f"{lease.time_s:g}", "over": take_over,
        }  # fmt: skip
        text = " ".join(f"{key}={value}" for key, value in fields.items() if value)
        logger.info("event=%s %s", event, text)
        del fields["drives"]
        self.tell(event.removeprefix("lease-"), lease.drives, fields)

    def tell(self, what: str, drives: Sequence[str], fields: Mapping[str, str]) -> None:
        """Tell the followers what became of a lease or of its drives."""
        for follower in self.followers:
            follower(what, drives, fields)


def use_of(of: Family, code: Code, wire: Value, *, restoring: bool = False) -> Use:
    """Say what a write is for; what no description knows may move the drive.

    Args:
        of: The drive's family.
        code: What is written.
        wire: The value.
        restoring: It belongs to the restore of a backup, which holds settings only.
    """
    info = of.info(code)
    if info is not None and info.control_source:
        return Use.TAKE_CONTROL if takes_control(of, code, wire) else Use.MOTION
    if info is not None and not info.motion and acts_on_setpoints(of, code):
        return Use.SETPOINT
    if restoring or (info is not None and not info.motion):
        return Use.SETTING
    setpoints = of.verbs.setpoints if of.verbs is not None else ()
    return Use.SETPOINT if any(rule.code == code for rule in setpoints) else Use.MOTION


def needs_lease(of: Family, code: Code, wire: Value) -> bool:
    """Return whether a write needs the token of its drive's lease: each but an inhibit does."""
    return not stops_every_drive(of, code, wire)


def terms_of(entry: DriveEntry) -> LeaseTerms:
    """Return what the roster says of the lease of a drive."""
    lease = entry.lease
    has_enable = family(entry.family).verbs is not None
    return LeaseTerms(lease.required, lease.time_s, lease.on_lapse, has_enable)


def check_lapse(entry: DriveEntry) -> None:
    """Refuse a lease at whose end nothing could be done to a drive.

    Raises:
        OperationError: `no-stop`.
    """
    wanted = entry.lease.on_lapse
    if wanted in set(StopAction) and not knows_stop(family(entry.family), StopAction(wanted)):
        raise OperationError(
            f"on_lapse of {entry.name} is {wanted}, and family {entry.family} knows no {wanted}",
            kind="no-stop",
            drive=entry.name,
            remedy="write `lease: {on_lapse: hold}` for it into the roster, or silence if its "
            "watchdog acts",
        )
