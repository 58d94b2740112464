"""Controllers of a random line: they take leases, renew them, die, stall, and come back too late.

Each lives again and again under its own name: it takes the lease of some drives or of a group, now
and then over from another by its name, enables them, gives them setpoints and renews, until it
ends in one of the ways of `ENDS`. Whoever comes back uses its old token for a renewal, setpoints
and an enable, as a program does that does not know what has passed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from decimal import Decimal
from random import Random

import anyio

from lecombus.config import DriveEntry
from lecombus.drives import Verb
from lecombus.errors import LecombusError, OperationError
from lecombus.line_runtime import LineRuntime
from lecombus.operations.lease_operations import LEASE
from lecombus.parameters import Code
from proof.invariants import Invariants
from proof.lease_checks import ASKED_WITH, ENABLING, Held, LeaseChecks
from proof.lines import RandomLine

__all__ = ["Controllers"]

MOST = 4
ENDS = ("die", "stall", "release", "burst", "burst")
SETPOINT_CODES = {"smvector": 1061, "93xx": 141}
EXPIRY_S = 20.0
LEAST_S = 0.1
CONTROLLERS = 3_000_017
"""What controllers do is drawn by itself."""


class Controllers:
    """The controllers of one line.

    Args:
        site: The line.
        line: What it is.
        seen: Told of every request.
        checks: Told of every lease.
        value: Gives a setpoint that a drive has not had for long.
    """

    def __init__(
        self,
        site: LineRuntime,
        line: RandomLine,
        seen: Invariants,
        checks: LeaseChecks,
        value: Callable[[DriveEntry], Decimal],
    ) -> None:
        self._operations = site.operations
        self._line = line
        self._seen = seen
        self._checks = checks
        self._value = value
        self._entries = {drive.name: drive for drive in line.roster.drives}
        self._random = Random(line.seed + CONTROLLERS)
        self._over = asyncio.Event()

    def stop(self) -> None:
        """Begin nothing more."""
        self._over.set()

    async def run(self) -> None:
        """Control until stopped; returns when every request has ended."""
        async with anyio.create_task_group() as tasks:
            for number in range(min(MOST, 1 + len(self._entries))):
                tasks.start_soon(self._lives, f"c{number}")

    async def _pause(self, least_s: float, most_s: float) -> bool:
        """Wait; say whether to go on."""
        with anyio.move_on_after(self._random.uniform(least_s, most_s)):
            await self._over.wait()
        return not self._over.is_set()

    async def _lives(self, name: str) -> None:
        while await self._pause(0.0, 4.0):
            held = self._take(name)
            if held is not None:
                await self._live(held)

    async def _live(self, held: Held) -> None:
        """Control the drives of a lease until it ends in some way."""
        alive = asyncio.Event()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._renews, held, alive)
            tasks.start_soon(self._works, held, alive)
            with anyio.move_on_after(self._random.uniform(0.0, 12.0)):
                await self._over.wait()
            alive.set()
            end = self._random.choice(ENDS)
            if end == "burst":  # its writes wait, or are under way, when another takes over
                for drive in held.drives * 2:
                    tasks.start_soon(self._set, held, drive)
                await anyio.sleep(self._random.choice((0.0, 0.001, 0.02, 0.1)))
                self._take(held.name + "x", held.drives)
            elif end == "release":
                self._release(held)
            elif end == "stall":
                await self._pause(0.0, 2.5 * held.time_s)
        if end != "die" and not self._over.is_set():
            await self._come_back(held)

    async def _come_back(self, held: Held) -> None:
        """Go on with the token of before, as if no time had passed."""
        self._renew(held)
        for drive in held.drives[:2]:
            await self._set(held, drive)
            await self._enable(held, drive)
            await self._set(held, drive)

    # -- leases ------------------------------------------------------------------------------

    def _take(self, name: str, drives: tuple[str, ...] = ()) -> Held | None:
        """Take a lease of drives, or of some that are drawn; None: it is refused."""
        wanted = drives or self._drawn()
        holders = {one.name: one for drive in wanted if (one := self._checks.holder(drive))}
        over = ""
        if holders and (drives or self._random.random() < 0.5):
            over = next(iter(holders))
            wanted = tuple(dict.fromkeys((*wanted, *holders[over].drives)))
        longest_s = min(self._entries[drive].lease.time_s for drive in wanted)
        time_s = max(LEAST_S, self._random.uniform(0.2, 1.0) * longest_s)
        self._seen.asked()
        try:
            lease = self._operations.leases.take(name, wanted, wanted, time_s, 1, over)
        except OperationError as exc:
            self._seen.answered(exc.kind)
            return None
        self._seen.answered("done")
        now_s = asyncio.get_running_loop().time()
        held = Held(name, lease.token, wanted, time_s, now_s + time_s)
        former = holders.get(over)
        if former is not None and self._checks.holder(former.drives[0]) is not former:
            former = None
        self._checks.taken(held, former)
        return held

    def _drawn(self) -> tuple[str, ...]:
        """Draw some drives, or a group."""
        groups = self._line.roster.groups
        if groups and self._random.random() < 0.3:
            return tuple(groups[self._random.choice(sorted(groups))].members)
        names = list(self._entries)
        return tuple(self._random.sample(names, min(len(names), self._random.randint(1, 3))))

    async def _renews(self, held: Held, ended: asyncio.Event) -> None:
        while not ended.is_set():
            with anyio.move_on_after(held.time_s * self._random.uniform(0.1, 0.9)):
                await ended.wait()
                return
            if not self._renew(held):
                return

    def _renew(self, held: Held) -> bool:
        stale = self._random.random() < 0.1
        counter = held.counter + (0 if stale else self._random.randint(1, 3))
        self._seen.asked()
        try:
            self._operations.leases.renew(held.name, held.token, counter)
        except OperationError as exc:
            self._seen.answered(exc.kind)
            if exc.kind == "stale-counter" and stale:
                return True
            self._checks.lost(held)
            return False
        self._seen.answered("done")
        if stale:
            self._seen.say(f"lease {held.name} was renewed with counter {counter} twice")
        held.counter = counter
        held.end_s = asyncio.get_running_loop().time() + held.time_s
        self._checks.renewed(held)
        return True

    def _release(self, held: Held) -> None:
        self._seen.asked()
        try:
            self._operations.leases.release(held.name, held.token)
        except OperationError as exc:
            self._seen.answered(exc.kind)
            self._checks.lost(held)
        else:
            self._seen.answered("done")
            self._checks.released(held)

    # -- drives ------------------------------------------------------------------------------

    async def _works(self, held: Held, ended: asyncio.Event) -> None:
        for drive in held.drives:
            if ended.is_set():
                return
            if self._random.random() < 0.8:
                await self._enable(held, drive)
        while not ended.is_set():
            await self._set(held, self._random.choice(held.drives))
            with anyio.move_on_after(self._random.uniform(0.0, 0.5)):
                await ended.wait()

    async def _enable(self, held: Held, drive: str) -> None:
        self._seen.shown.enable_asked(drive)
        with asking(held.token, enabling=True):
            try:
                await self._ask(held, self._enabled(held, drive))
            finally:
                self._seen.shown.enable_ended(drive)

    async def _enabled(self, held: Held, drive: str) -> str:
        report = await self._operations.verb(drive, Verb.ENABLE, expires_s=EXPIRY_S)
        if report.outcome.is_good:
            self._checks.enabled(drive, held.token)
        return report.outcome

    async def _set(self, held: Held, drive: str) -> None:
        with asking(held.token):
            await self._ask(held, self._written(self._entries[drive]))

    async def _written(self, drive: DriveEntry) -> str:
        code = Code(SETPOINT_CODES.get(drive.family, 46))
        value, verify = self._value(drive), self._random.random() < 0.3
        report = await self._operations.write(
            drive.name, code, value, expires_s=EXPIRY_S, verify=verify
        )
        return report.outcome

    async def _ask(self, held: Held, work: Awaitable[str]) -> None:
        self._seen.asked()
        try:
            outcome = await work
        except LecombusError as exc:
            self._seen.answered(type(exc).__name__)
            if getattr(exc, "kind", "") in ("lease-lost", "lease-required"):
                self._checks.lost(held)
        else:
            self._seen.answered(outcome)


@contextmanager
def asking(token: str, *, enabling: bool = False) -> Iterator[None]:
    """Ask with a token, which the checks are told besides."""
    resets = LEASE.set(token), ASKED_WITH.set(token), ENABLING.set(enabling)
    try:
        yield
    finally:
        LEASE.reset(resets[0])
        ASKED_WITH.reset(resets[1])
        ENABLING.reset(resets[2])
