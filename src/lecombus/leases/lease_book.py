"""The leases of one line: at most one holder for a drive, and no token that counts again.

Theory of operation. A lease holds drives for a time; a renewal with a larger counter moves its end.
Each call that takes a time first ends what has lapsed by then (`advance`), so that no renewal and
no write counts after the end, however late a timer is. The ends are handed out once, by
`take_ended`, to be carried out.

A drive is latched when its lease lapses. A drive whose roster requires a lease is also latched when
its lease is given up, and at a start and when a reload begins to require one. Nothing that could
move a latched drive is sent until a new lease is held and the drive was enabled with it (a family
without the verb `enable`: until a new lease is held). While the drive shows a stop, a setpoint
cannot move it, and its holder may write one. Taking over keeps the drive as it is: only the token
changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from lecombus.durations import format_duration
from lecombus.errors import OperationError
from lecombus.leases.lease_records import (
    DriveControl,
    EndedLease,
    EndOfLease,
    HeldLease,
    Latch,
    LeaseTerms,
    Use,
    is_same_token,
)

__all__ = ["LEAST_TIME_S", "NEEDED_STOPS", "LeaseBook"]

LEAST_TIME_S = 0.1
"""The shortest time of a lease, seconds: a client must be able to renew it some times within it."""

NEEDED_STOPS: Mapping[Use, str] = {Use.SETPOINT: "a stop", Use.TAKE_CONTROL: "an inhibit"}
"""What a latched drive must show so that it takes a write: no motor starts by it then."""

TAKE_AND_ENABLE = "take a lease, then enable the drive with it"


class LeaseBook:
    """The leases of one line.

    Args:
        number: The largest number that was ever used on this line.
    """

    def __init__(self, number: int = 0) -> None:
        self.number = number
        self._leases: dict[str, HeldLease] = {}
        self._drives: dict[str, DriveControl] = {}
        self._ended: list[EndedLease] = []

    # -- what is known ----------------------------------------------------------------------------

    @property
    def drives(self) -> Mapping[str, DriveControl]:
        """The control of each drive by name."""
        return self._drives

    def leases(self, now_s: float) -> list[HeldLease]:
        """List the leases held, the oldest first."""
        self.advance(now_s)
        return list(self._leases.values())

    def next_s(self) -> float | None:
        """Give when the next lease lapses, or the next drive is due after a start."""
        ends = [lease.ends_at_s for lease in self._leases.values()]
        due = [control.due_s for control in self._drives.values() if control.due_s is not None]
        return min((*ends, *due), default=None)

    def due(self, now_s: float) -> list[str]:
        """Name the drives for which no lease was taken in time after a start."""
        self.advance(now_s)
        return [
            name
            for name, control in self._drives.items()
            if control.due_s is not None and control.due_s <= now_s
        ]

    def take_ended(self, now_s: float) -> list[EndedLease]:
        """Hand out the ends that are to be carried out, each once."""
        self.advance(now_s)
        ended, self._ended = self._ended, []
        return ended

    # -- the roster -------------------------------------------------------------------------------

    def set_terms(self, terms: Mapping[str, LeaseTerms], now_s: float) -> None:
        """Take what the roster says, at the start and at every reload.

        A drive that needs a lease from now on is latched, and due after its lease time. A drive
        that leaves the roster leaves its lease.
        """
        self.advance(now_s)
        for name in [one for one in self._drives if one not in terms]:
            lease = self._drives.pop(name).lease
            if lease is not None:
                self._take_out(lease, name)
        for name, now in terms.items():
            control = self._drives.get(name)
            if control is None:
                control = self._drives[name] = DriveControl(now)
                self._require(control, now_s)
                continue
            before, control.terms = control.terms, now
            if now.required and not before.required:
                self._require(control, now_s)
            elif not now.required and control.latch is Latch.STARTED:
                control.latch, control.due_s = None, None
        for lease in self._leases.values():
            longest_s = min(self._drives[name].terms.time_s for name in lease.drives)
            if lease.time_s > longest_s:
                lease.time_s = longest_s
                lease.ends_at_s = min(lease.ends_at_s, now_s + longest_s)

    def _require(self, control: DriveControl, now_s: float) -> None:
        if control.terms.required and control.lease is None and control.latch is None:
            control.latch, control.due_s = Latch.STARTED, now_s + control.terms.time_s

    def _take_out(self, lease: HeldLease, drive: str) -> None:
        lease.drives = tuple(name for name in lease.drives if name != drive)
        if not lease.drives:
            del self._leases[lease.name]

    # -- what clients do --------------------------------------------------------------------------

    def take(
        self,
        name: str,
        targets: Sequence[str],
        drives: Iterable[str],
        time_s: float,
        counter: int,
        now_s: float,
        *,
        secret: str,
        take_over: str = "",
        holder: Mapping[str, str] | None = None,
    ) -> HeldLease:
        """Grant a lease.

        Args:
            name: Its name.
            targets: What the client named.
            drives: The drives of these, all in the roster.
            time_s: How long it lasts without a renewal, seconds.
            counter: The client's counter; a renewal needs a larger one.
            now_s: Now.
            secret: The random part of the token.
            take_over: The lease whose drives it takes over; its token counts no more.
            holder: Who takes it, as logged.

        Raises:
            OperationError: `lease-held`, `no-such-lease` or `bad-value`; nothing was changed.
        """
        self.advance(now_s)
        wanted = tuple(dict.fromkeys(drives))
        self._check_time(wanted, time_s)
        former = self._former(name, wanted, take_over)
        self.number += 1
        lease = HeldLease(
            name, self.number, secret, tuple(targets), wanted, time_s, counter, now_s,
            now_s + time_s, dict(holder or {}),
        )  # fmt: skip
        if former is not None:
            del self._leases[former.name]
        self._leases[name] = lease
        for drive in wanted:
            control = self._drives[drive]
            if former is not None and control.lease is former:
                control.ended = ended_of(former, (drive,), EndOfLease.TAKEN_OVER, now_s)
                control.successor = name
            control.lease, control.due_s = lease, None
            if not control.terms.has_enable:
                control.latch = None
        return lease

    def renew(self, name: str, token: str, counter: int, now_s: float) -> HeldLease:
        """Move the end of a lease.

        Args:
            name: Its name.
            token: Its token.
            counter: Larger than every one before: what comes late or twice renews nothing.
            now_s: Now.

        Raises:
            OperationError: `lease-lost` or `stale-counter`; nothing was changed.
        """
        lease = self._held(name, token, now_s)
        if counter <= lease.counter:
            raise OperationError(
                f"lease {name} was renewed with counter {lease.counter} already, {counter} is not "
                "larger: it was not renewed",
                kind="stale-counter",
                remedy="increment the counter before each renewal",
            )
        lease.counter = counter
        lease.ends_at_s = now_s + lease.time_s
        return lease

    def release(self, name: str, token: str, now_s: float) -> HeldLease:
        """End a lease on purpose; drives that need one are to be stopped as if it had lapsed.

        Raises:
            OperationError: `lease-lost`.
        """
        lease = self._held(name, token, now_s)
        self._end(lease, EndOfLease.RELEASED, now_s)
        return lease

    def enabled(self, drive: str, token: str, now_s: float) -> bool:
        """Note that a drive was enabled; it takes setpoints if the token is that of its lease.

        Returns:
            Whether it was latched until now.
        """
        self.advance(now_s)
        control = self._drives.get(drive)
        if control is None or control.latch is None or control.lease is None:
            return False
        if not is_same_token(token, control.lease.token):
            return False
        control.latch = None
        return True

    def start_done(self, drive: str) -> None:
        """Note that a drive was seen stopped, or was stopped, after a start."""
        self._drives[drive].due_s = None

    # -- what is permitted ------------------------------------------------------------------------

    def objection(
        self,
        drive: str,
        token: str,
        use: Use,
        now_s: float,
        holds_stop: Callable[[Use], bool] = lambda use: False,
    ) -> OperationError | None:
        """Say why a write may not be made, or sent, now; None: it may.

        Args:
            drive: The drive.
            token: The token that came with the write; empty: none.
            use: What the write is for.
            now_s: Now.
            holds_stop: Whether the drive shows the stop that this use needs while it is latched;
                asked only then.
        """
        self.advance(now_s)
        control = self._drives.get(drive)
        if control is None:
            return None
        lease = control.lease
        is_free = lease is None and not control.terms.required and control.latch is None
        if not token:
            return None if is_free else self._needed(drive, control, now_s)
        if lease is None or not is_same_token(token, lease.token):  # also where none is needed
            return self._lost(drive, control, now_s)
        if control.latch is None or use in (Use.SETTING, Use.ENABLE) or holds_stop(use):
            return None
        text = f"{drive} is latched: {why_latched(control)}"
        remedy = f"enable it with the lease (POST /v1/drives/{drive}/verbs/enable)"
        if use in NEEDED_STOPS:
            text += f", and it does not show {NEEDED_STOPS[use]} of the line"
            remedy += f"; or have it show {NEEDED_STOPS[use]} first (POST /v1/stop)"
        return OperationError(text, kind="latched", drive=drive, remedy=remedy)

    def _needed(self, drive: str, control: DriveControl, now_s: float) -> OperationError:
        if control.lease is not None:
            text = f"{drive} is controlled under the lease {control.lease.name}"
            remedy = "send its token in the header Lecombus-Lease, or take the lease over by name"
        elif control.latch is not None:
            text = f"{drive} is latched: {why_latched(control)}"
            remedy = TAKE_AND_ENABLE
        else:
            text, remedy = f"control of {drive} needs a lease", TAKE_AND_ENABLE
        text += "; a stop needs none"
        return OperationError(text, kind="lease-required", drive=drive, remedy=remedy)

    def _lost(self, drive: str, control: DriveControl, now_s: float) -> OperationError:
        ended, lease = control.ended, control.lease
        text = f"the token is not that of a lease held for {drive}"
        if ended is not None:
            text += f": lease {ended.name} {words_of_end(control)}"
            text += f" {format_duration(round(max(0.0, now_s - ended.at_s), 1))} ago"
        remedy = TAKE_AND_ENABLE
        if lease is not None:
            remedy = f"lease {lease.name} is held for it: only its holder controls the drive"
        return OperationError(text, kind="lease-lost", drive=drive, remedy=remedy)

    # -- inside -----------------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """End the leases that have lapsed by now."""
        for lease in [one for one in self._leases.values() if one.ends_at_s <= now_s]:
            self._end(lease, EndOfLease.LAPSED, now_s)

    def _end(self, lease: HeldLease, end: EndOfLease, now_s: float) -> None:
        """End a lease without a successor, and latch its drives."""
        del self._leases[lease.name]
        lapsed, left = end is EndOfLease.LAPSED, []
        ended = ended_of(lease, lease.drives, end, now_s)
        for name in lease.drives:
            control = self._drives[name]
            control.lease, control.ended, control.successor = None, ended, ""
            if lapsed or control.terms.required:
                control.latch = Latch.LAPSED if lapsed else Latch.RELEASED
                left.append(name)
        if left:
            self._ended.append(ended_of(lease, tuple(left), end, now_s))

    def _held(self, name: str, token: str, now_s: float) -> HeldLease:
        self.advance(now_s)
        lease = self._leases.get(name)
        if lease is None or not is_same_token(token, lease.token):
            text = f"the token is not that of lease {name}, which was taken again by another"
            if lease is None:
                text = f"no lease {name} is held: it lapsed, was taken over or was given up"
            raise OperationError(text, kind="lease-lost", remedy=TAKE_AND_ENABLE)
        return lease

    def _check_time(self, drives: Sequence[str], time_s: float) -> None:
        if not drives:
            raise OperationError("a lease needs a drive", kind="bad-value", remedy="name targets")
        first = min(drives, key=lambda name: self._drives[name].terms.time_s)
        longest_s = self._drives[first].terms.time_s
        if LEAST_TIME_S <= time_s <= longest_s:
            return
        raise OperationError(
            f"a lease time of {format_duration(time_s)} is not possible: the roster allows "
            f"{format_duration(longest_s)} for {first}",
            kind="bad-value",
            drive=first,
            remedy=f"ask for {format_duration(LEAST_TIME_S)} to {format_duration(longest_s)}",
        )

    def _former(self, name: str, drives: Sequence[str], take_over: str) -> HeldLease | None:
        """Find the lease that is taken over, and see that no other stands against it."""
        former = None
        if take_over:
            former = self._leases.get(take_over)
            if former is None:
                raise OperationError(
                    f"there is no lease {take_over} to take over: it lapsed or was given up",
                    kind="no-such-lease",
                    remedy="take the lease without take_over",
                )
            left_out = [one for one in former.drives if one not in drives]
            if left_out:
                raise held(former, f"it also holds {', '.join(left_out)}", "name all its drives")
        same = self._leases.get(name)
        if same is not None and same is not former:
            raise held(same, "a lease of this name is held", f"take it over: take_over: {name}")
        for drive in drives:
            lease = self._drives[drive].lease
            if lease is not None and lease is not former:
                remedy = f"take it over by name: take_over: {lease.name}"
                raise held(lease, f"it holds {drive}", remedy)
        return former


def held(lease: HeldLease, why: str, remedy: str) -> OperationError:
    """Make the error for drives or a name that another lease has."""
    text = f"lease {lease.name} stands against it: {why}"
    return OperationError(text, kind="lease-held", remedy=remedy)


def ended_of(
    lease: HeldLease, drives: tuple[str, ...], end: EndOfLease, now_s: float
) -> EndedLease:
    """Make the record of the end of a lease."""
    return EndedLease(lease.name, lease.number, drives, end, now_s)


def words_of_end(control: DriveControl) -> str:
    """Say how the last lease of a drive ended, to stand after its name."""
    assert control.ended is not None
    if control.ended.end is EndOfLease.TAKEN_OVER:
        return f"was taken over by {control.successor}"
    return "was given up" if control.ended.end is EndOfLease.RELEASED else "lapsed"


def why_latched(control: DriveControl) -> str:
    """Say why a drive must be enabled again."""
    if control.latch is Latch.STARTED or control.ended is None:
        return "no lease was taken for it since the start or since the roster requires one"
    how = {Latch.LAPSED: "lapsed", Latch.RELEASED: "was given up"}
    assert control.latch is not None
    return f"its lease {how[control.latch]}"
