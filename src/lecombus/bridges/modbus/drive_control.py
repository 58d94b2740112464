"""What a PLC writes to a drive: its heartbeat holds a lease, its commands and setpoints go out.

Rules, each so that nothing moves unasked:

- The lease is held for the PLC, not by the bridge: it is taken when the heartbeat register has
  counted up twice, and each renewal is the direct consequence of a further count. No timer renews.
  A PLC that stops, hangs or loses its network writes no new count, and the lease lapses. A count
  that goes back (a program that was started again) renews nothing either.
- `enable` and `reset-fault` are taken when the command register changes from 0, and the 0 was
  written under the same lease. A register that was set before the lease began starts nothing.
- Stops need no lease, and go out when they are written. While a PLC holds one (writes it in every
  cycle) it is sent again only until it ended well; one that a client had not written for
  `STOP_AGAIN_S` is a new one: a button that writes 1 each time it is pressed never writes 0. What
  waits in the bridge when a stop comes is not sent.
- A setpoint goes out when it differs from the one that the drive was given last, so that a PLC that
  writes in every cycle costs the line nothing. The newest one counts.
- One PLC controls a drive at a time: by its address, until its lease has ended.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from typing import Final, Literal, Protocol

import anyio
from anyio.abc import TaskGroup

from lecombus.bridges.modbus.register_map import OUTCOMES, REASONS, SCALE, Command, WriteReason
from lecombus.client import (
    ClientError,
    Lease,
    LeaseLostError,
    Line,
    ProblemError,
    Result,
    UnreachableError,
)

__all__ = ["ControlledDrives", "LastWrite", "PlcControl", "StopControl"]

logger = logging.getLogger(__name__)

EXPIRES_S: Final = 2.0
"""A command that could not be sent for so long is not sent any more: the PLC has gone on."""

FORWARD: Final = 4096
"""A heartbeat that is larger by at most this, modulo 65536, has counted up. A larger step is that
of a program that was started again and counts from 0."""

RENEWALS: Final = 8
"""Most renewals within a lease time; a count that comes sooner is not passed on."""

LEASE_AGAIN_S: Final = 1.0
STOP_AGAIN_S: Final = 2.0
FIRST_RETRY_S: Final = 1.0
LONGEST_RETRY_S: Final = 60.0

PENDING: Final = OUTCOMES.index("pending")
REFUSED: Final = OUTCOMES.index("refused")
SUPERSEDED: Final = OUTCOMES.index("superseded")
EXPIRED: Final = OUTCOMES.index("expired")
UNKNOWN: Final = OUTCOMES.index("unknown")
GOOD: Final = (OUTCOMES.index("done"), OUTCOMES.index("verified"))


@dataclass(slots=True)
class LastWrite:
    """The last command or setpoint, as the PLC reads how it ended.

    Args:
        sequence: Counts them, 1 to 65535 and then 0.
        command: What it was.
        outcome: A number of `OUTCOMES`.
        reason: Why it was not done.
    """

    sequence: int = 0
    command: Command = Command.NONE
    outcome: int = 0
    reason: WriteReason = WriteReason.NONE

    @property
    def is_good(self) -> bool:
        """Whether it happened."""
        return self.outcome in GOOD

    def begin(self, command: Command = Command.NONE) -> int:
        """Take the next one, which is pending; returns its number."""
        self.sequence = (self.sequence + 1) & 0xFFFF
        self.command, self.outcome, self.reason = command, PENDING, WriteReason.NONE
        return self.sequence

    def end(self, sequence: int, outcome: int, reason: WriteReason = WriteReason.NONE) -> None:
        """Say how one ended, unless a later one was begun."""
        if sequence == self.sequence and self.outcome == PENDING:
            self.outcome, self.reason = outcome, reason


class ControlledDrives(Protocol):
    """What is known of a drive that its control depends on."""

    def is_online(self, drive: str) -> bool:
        """Whether it answers."""

    def setpoint_unit(self, drive: str) -> Literal["Hz", "%"] | None:
        """Return the unit of its setpoint; None: it takes none."""

    def lease_time_s(self, drive: str) -> float:
        """Return the longest time that a lease of it may last, seconds."""


async def outcome_of(what: str, ask: Callable[[], Awaitable[Result]]) -> tuple[int, WriteReason]:
    """Have something done, and return how it ended as the numbers of the map."""
    try:
        result = await ask()
    except ProblemError as exc:
        logger.warning("event=write-refused what=%s reason=%s", what, exc.problem)
        return REFUSED, REASONS.get(exc.kind, WriteReason.OTHER)
    except UnreachableError as exc:
        logger.warning("event=write-refused what=%s reason=%s", what, exc.problem)
        return REFUSED, WriteReason.DAEMON_AWAY
    outcome = OUTCOMES.index(str(result.outcome))
    if outcome in GOOD:
        return outcome, WriteReason.NONE
    logger.warning('event=write-not-done what=%s outcome=%s reason=%s',
                   what, result.outcome, result.reason)  # fmt: skip
    if outcome == SUPERSEDED:
        return outcome, WriteReason.STOPPED
    return outcome, REASONS.get(result.kind or str(result.outcome), WriteReason.OTHER)


class StopControl:
    """Stops of one drive, or of all: when they are written, and again where they did not end well.

    Args:
        target: The drive, or `all`.
        line: Speaks with the daemon.
        tasks: In which stops are carried out.
        last: Where their outcome is shown.
    """

    def __init__(
        self, target: str, line: Callable[[], Line], tasks: TaskGroup, last: LastWrite
    ) -> None:
        self._target = target
        self._line = line
        self._tasks = tasks
        self._last = last
        self._again_s = 0.0
        self._written_s: dict[str, float] = {}
        self.count = 0

    def write(self, command: Command, before: int, client: str = "") -> None:
        """Take a stop that was written.

        Args:
            command: A stop.
            before: What its register held before.
            client: Who wrote it.
        """
        is_held = self._is_held_by(client)
        is_repeat = is_held and before == command and self._last.command == command
        if is_repeat and (self._last.is_good or self._last.outcome == PENDING):
            return
        if is_repeat and self._last.reason is WriteReason.NOT_PERMITTED:
            return  # such as a family without this stop: the next one would end as this one
        if is_repeat and anyio.current_time() < self._again_s:
            return
        self.count += 1
        self._tasks.start_soon(self._send, command, self._last.begin(command))

    def _is_held_by(self, client: str) -> bool:
        """Whether a client that writes a stop now wrote one shortly before."""
        now_s = anyio.current_time()
        self._written_s = {
            one: at_s for one, at_s in self._written_s.items() if now_s - at_s <= STOP_AGAIN_S
        }
        is_held = client in self._written_s
        self._written_s[client] = now_s
        return is_held

    async def _send(self, command: Command, sequence: int) -> None:
        outcome, reason = UNKNOWN, WriteReason.DAEMON_AWAY
        action: Literal["quick-stop", "inhibit"] = (
            "inhibit" if command is Command.INHIBIT else "quick-stop"
        )
        logger.info("event=stop target=%s action=%s", self._target, action)
        try:
            what = f"{action} of {self._target}"
            outcome, reason = await outcome_of(
                what, lambda: self._line().stop(self._target, action)
            )
        finally:
            self._again_s = anyio.current_time() + STOP_AGAIN_S
            self._last.end(sequence, outcome, reason)


class PlcControl:
    """The control of one drive by one PLC at a time.

    Args:
        drive: Its name.
        line: Speaks with the daemon.
        tasks: In which leases are held and stops carried out.
        facts: What is known of the drive.
        stop_line: Speaks with the daemon for stops, and repeats them; None: as for all else.
    """

    def __init__(
        self,
        drive: str,
        line: Callable[[], Line],
        tasks: TaskGroup,
        facts: ControlledDrives,
        stop_line: Callable[[], Line] | None = None,
    ) -> None:
        self.drive = drive
        self._line = line
        self._tasks = tasks
        self._facts = facts
        self._last_command = LastWrite()
        self._last_setpoint = LastWrite()
        self._stops = StopControl(drive, stop_line or line, tasks, self._last_command)
        self._heartbeat = 0
        self._command = 0
        self._demand = 0
        self._owner = ""
        self._heard_s = 0.0
        self._counted: int | None = None
        self._has_counted = False
        self._counts = anyio.Event()
        self._is_taking = False
        self._take_again_s = 0.0
        self._lease: Lease | None = None
        self._lease_reason = WriteReason.NO_LEASE
        self._under_lease: TaskGroup | None = None
        self._is_armed = False
        self._giving = anyio.Lock()
        self._wanted: int | None = None
        self._given: int | None = None
        self._setpoint_due = anyio.Event()
        self._retry_at_s = 0.0
        self._retry_s = FIRST_RETRY_S

    # -- what a PLC reads --------------------------------------------------------------------------

    def registers(self) -> Mapping[str, int]:
        """Return the registers of the map that are known here, by name."""
        held = self._holds
        is_counting = self._has_counted and self._is_heard
        return {
            "control state": 3 if held else 2 if is_counting else 1,
            "lease reason": WriteReason.NONE if held else self._lease_reason,
            "command sequence": self._last_command.sequence,
            "last command": self._last_command.command,
            "command outcome": self._last_command.outcome,
            "command reason": self._last_command.reason,
            "setpoint sequence": self._last_setpoint.sequence,
            "setpoint outcome": self._last_setpoint.outcome,
            "setpoint reason": self._last_setpoint.reason,
            "heartbeat": self._heartbeat,
            "command": self._command,
            "setpoint demand": self._demand,
        }

    @property
    def _holds(self) -> bool:
        return self._lease is not None and self._lease.is_valid

    @property
    def _is_heard(self) -> bool:
        """Whether the PLC has written a heartbeat within the lease time."""
        return anyio.current_time() - self._heard_s < self._facts.lease_time_s(self.drive)

    # -- what it writes ----------------------------------------------------------------------------

    def is_busy_for(self, client: str) -> bool:
        """Whether another PLC controls the drive."""
        return self._owner not in ("", client) and (self._holds or self._is_taking or
                                                    self._is_heard)  # fmt: skip

    def write_heartbeat(self, client: str, count: int) -> None:
        """Take a heartbeat; each one that counts up holds the lease."""
        self._heartbeat = count
        now_s = anyio.current_time()
        if self._owner != client or not (self._is_heard or self._holds):
            self._owner, self._counted, self._wanted = client, None, None
            self._has_counted = False
        before = self._counted
        if before is None:
            self._counted, self._heard_s = count, now_s
            return
        if not 1 <= (count - before) & 0xFFFF <= FORWARD:
            if not self._holds and count != before:
                self._counted = count  # a PLC that was started again counts from where it is
            return
        self._counted, self._heard_s, self._has_counted = count, now_s, True
        self._counts.set()
        if not self._is_taking and now_s >= self._take_again_s:
            self._is_taking = True
            self._tasks.start_soon(self._hold_lease)

    def write_stop(self, command: Command, client: str = "") -> None:
        """Take a stop; it needs no lease, and may come from any PLC that may connect."""
        before, self._command = self._command, int(command)
        self._is_armed = False
        self._stops.write(command, before, client)

    def stopped_with_all(self) -> None:
        """All drives were stopped: what waits here is not sent."""
        self._stops.count += 1
        self._is_armed = False

    def write_command(self, client: str, command: Command) -> None:
        """Take what is not a stop: `enable`, `reset-fault`, or 0."""
        before, self._command = self._command, int(command)
        holds = self._holds and self._owner == client
        if command is Command.NONE:
            self._is_armed = holds
            return
        if before == command:
            return
        sequence = self._last_command.begin(command)
        is_armed, self._is_armed = self._is_armed, False
        if not holds or self._under_lease is None:
            self._last_command.end(sequence, REFUSED, WriteReason.NO_LEASE)
        elif not is_armed:
            self._last_command.end(sequence, REFUSED, WriteReason.NOT_FROM_0)
        else:
            self._under_lease.start_soon(self._carry_out, command, sequence, self._stops.count)

    def write_setpoint(self, client: str, demand: int) -> None:
        """Take a setpoint, in 1/10000 of its unit."""
        is_new, self._demand = demand != self._demand, demand
        if is_new:
            self._retry_at_s, self._retry_s = 0.0, FIRST_RETRY_S
            if not self._holds or self._owner != client:
                self._refuse_setpoint(WriteReason.NO_LEASE)
        if self._owner == client:
            self._wanted = demand
            self._setpoint_due.set()

    # -- the lease ---------------------------------------------------------------------------------

    async def _hold_lease(self) -> None:
        """Take the lease, and hold it while the heartbeat counts."""
        time_s = self._facts.lease_time_s(self.drive)
        try:
            async with self._line().lease(
                f"modbus-{self.drive}", [self.drive], time_s, renews=False
            ) as lease:
                logger.info("drive=%s event=lease-taken client=%s", self.drive, self._owner)
                self._lease, self._lease_reason = lease, WriteReason.NONE
                await self._work_under(lease)
        except LeaseLostError as exc:
            logger.warning('drive=%s event=lease-ended client=%s reason=%s',
                           self.drive, self._owner, exc.problem)  # fmt: skip
            self._lease_reason = WriteReason.NO_LEASE
        except ClientError as exc:
            reason = REASONS.get(exc.kind, WriteReason.OTHER)
            self._lease_reason = (
                WriteReason.DAEMON_AWAY if isinstance(exc, UnreachableError) else reason
            )
            logger.warning('drive=%s event=lease-refused client=%s reason=%s',
                           self.drive, self._owner, exc.problem)  # fmt: skip
        finally:
            self._forget()

    async def _work_under(self, lease: Lease) -> None:
        """Renew the lease with each count, and carry out what is written, until it ends."""
        self._counts = anyio.Event()
        async with anyio.create_task_group() as tasks:
            self._under_lease = tasks
            tasks.start_soon(self._give_setpoints)
            every_s = lease.time_s / RENEWALS
            while True:
                await self._counts.wait()
                self._counts = anyio.Event()
                next_s = anyio.current_time() + every_s
                with suppress(UnreachableError), anyio.move_on_after(min(2 * every_s, 1.0)):
                    await lease.renew()
                await anyio.sleep_until(next_s)
                # A count that came while this slept is old: only a later one renews.
                self._counts = anyio.Event()

    def _forget(self) -> None:
        """Forget the PLC: what it wrote under the former lease starts nothing under the next."""
        self._is_taking = False
        self._take_again_s = anyio.current_time() + LEASE_AGAIN_S
        self._lease = self._under_lease = None
        self._owner, self._counted, self._counts = "", None, anyio.Event()
        self._has_counted = False
        self._is_armed = False
        self._wanted = self._given = None
        self._retry_at_s, self._retry_s = 0.0, FIRST_RETRY_S

    # -- what goes out under it --------------------------------------------------------------------

    async def _carry_out(self, command: Command, sequence: int, stops: int) -> None:
        """Carry a command out, unless a stop was written since."""
        outcome, reason = UNKNOWN, WriteReason.NO_LEASE
        written_s = anyio.current_time()
        try:
            if command is Command.ENABLE:
                outcome, reason = await self._enable(stops, written_s)
            else:
                outcome, reason = await self._ask(command, written_s)
        finally:
            self._last_command.end(sequence, outcome, reason)

    async def _enable(self, stops: int, written_s: float) -> tuple[int, WriteReason]:
        """Give the setpoint first, so that the drive does not start at an old one.

        That takes time: it counts as asked for when it was written, so that it expires, and that a
        stop from elsewhere ends it.
        """
        outcome, reason = await self._give_setpoint()
        if outcome not in GOOD:
            return REFUSED, reason
        if self._stops.count != stops:
            return SUPERSEDED, WriteReason.STOPPED
        outcome, reason = await self._ask(Command.ENABLE, written_s)
        self._retry_at_s = 0.0
        self._setpoint_due.set()
        return outcome, reason

    async def _ask(self, command: Command, written_s: float) -> tuple[int, WriteReason]:
        ago_s = max(0.001, anyio.current_time() - written_s)
        if ago_s >= EXPIRES_S:
            return EXPIRED, WriteReason.OVERLOADED
        drive = self._line().drive(self.drive)
        ask = drive.reset_fault
        if command is Command.ENABLE:
            ask = partial(drive.enable, asked_ago_s=ago_s)
        logger.info("drive=%s event=command command=%s client=%s",
                    self.drive, command.verb, self._owner)  # fmt: skip
        return await outcome_of(f"{command.verb} of {self.drive}", lambda: ask(expires_s=EXPIRES_S))

    async def _give_setpoints(self) -> None:
        """Give the drive each new setpoint; one that failed again, ever more seldom."""
        while True:
            await self._setpoint_due.wait()
            self._setpoint_due = anyio.Event()
            if not self._facts.is_online(self.drive):
                self._given = None  # with its mains it may have lost its setpoint
                if self._last_setpoint.reason is not WriteReason.NO_ANSWER:
                    self._refuse_setpoint(WriteReason.NO_ANSWER)
                continue
            if anyio.current_time() >= self._retry_at_s:
                await self._give_setpoint()

    async def _give_setpoint(self) -> tuple[int, WriteReason]:
        """Send the newest setpoint, one at a time; nothing, where the drive has it."""
        async with self._giving:
            wanted = self._wanted
            if wanted is None or wanted == self._given:
                return GOOD[0], WriteReason.NONE
            sequence = self._last_setpoint.begin()
            outcome, reason = UNKNOWN, WriteReason.NO_LEASE
            try:
                outcome, reason = await self._send_setpoint(wanted)
            finally:
                self._last_setpoint.end(sequence, outcome, reason)
                self._given = wanted if outcome in GOOD else None
        if outcome in GOOD:
            self._retry_s = FIRST_RETRY_S
        else:
            self._retry_at_s = anyio.current_time() + self._retry_s
            self._retry_s = min(2 * self._retry_s, LONGEST_RETRY_S)
        if self._wanted != wanted:
            self._setpoint_due.set()
        return outcome, reason

    async def _send_setpoint(self, wanted: int) -> tuple[int, WriteReason]:
        unit = self._facts.setpoint_unit(self.drive)
        if unit is None:
            return REFUSED, WriteReason.NOT_PERMITTED
        drive, speed = self._line().drive(self.drive), Decimal(wanted) / SCALE
        return await outcome_of(
            f"set-speed of {self.drive} to {speed} {unit}",
            lambda: drive.set_speed(speed, unit, expires_s=EXPIRES_S),
        )

    def _refuse_setpoint(self, reason: WriteReason) -> None:
        """Say of a setpoint that it was not sent."""
        self._last_setpoint.end(self._last_setpoint.begin(), REFUSED, reason)
