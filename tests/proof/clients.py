"""Who asks a random line for things, and what happens to its drives."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from random import Random

import anyio

from lecombus.config import DriveEntry
from lecombus.drives import StopAction
from lecombus.errors import LecombusError
from lecombus.protocol.addressing import Code
from lecombus.schedule import Priority
from lecombus.simulator.line import SimLine
from lecombus.site import Site
from proof.invariants import Invariants
from proof.lines import RandomLine

WRITERS = 4
"""Clients that write setpoints as fast as they are done, on a saturated line."""
READERS = 12
"""Clients that read as fast as they are answered, on a loaded line."""


class Clients:
    """The clients of one line; `run` returns after `stop` when every request has ended.

    Args:
        site: The line.
        line: What kind of load.
        invariants: Told of every request.
        sim: The drives, for taking some away.
    """

    def __init__(self, site: Site, line: RandomLine, invariants: Invariants, sim: SimLine) -> None:
        self._site = site
        self._line = line
        self._seen = invariants
        self._sim = sim
        self._random = Random(line.seed + 1)
        self._drives = line.roster.drives
        self._over = asyncio.Event()

    def stop(self) -> None:
        """Ask for nothing more."""
        self._over.set()

    async def run(self) -> None:
        """Ask until stopped."""
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._one_thing_after_the_other)
            if self._line.kind == "loaded":
                for _ in range(READERS):
                    tasks.start_soon(self._reads, Priority.BACKGROUND)
                    if self._line.is_crowded:
                        tasks.start_soon(self._reads, Priority.INTERACTIVE)
                for drive in self._drives[:WRITERS] if self._line.is_saturated else ():
                    tasks.start_soon(self._writes, drive)
            if self._line.kind == "absent":
                tasks.start_soon(self._come_and_go)

    async def _pause(self, least_s: float, most_s: float) -> bool:
        """Wait; say whether to go on."""
        pause_s = self._random.uniform(least_s, most_s)
        with anyio.move_on_after(pause_s):
            await self._over.wait()
        return not self._over.is_set()

    async def _one_thing_after_the_other(self) -> None:
        deeds: list[Callable[[], Awaitable[None]]]
        deeds = [self._read, self._read, self._write, self._write, self._stop_some]
        if self._line.kind == "quiet":
            deeds.append(self._read_idly)
        while await self._pause(0.0, 3.0):
            await self._random.choice(deeds)()

    async def _reads(self, priority: Priority) -> None:
        while await self._pause(0.0, 0.05):
            await self._read(priority)

    async def _writes(self, drive: DriveEntry) -> None:
        now = asyncio.get_running_loop().time
        while not self._over.is_set():
            asked_s = now()
            await self._write(drive)
            if now() == asked_s:  # refused, unsaid
                await self._pause(1.0, 1.0)

    async def _read_idly(self) -> None:
        await self._read(Priority.BACKGROUND)

    async def _read(self, priority: Priority = Priority.INTERACTIVE) -> None:
        """Ask a drive for its own address: nobody else's answer looks like it."""
        drive = self._random.choice(self._drives)
        code = Code(1410 if drive.family == "smvector" else 9)
        self._seen.asked()
        self._seen.turns.asked(priority)
        try:
            station = self._site.requests.station(drive.name)
            value = await self._site.requests.read(station, code, priority, timeout_s=60.0)
        except LecombusError as exc:
            self._seen.answered(type(exc).__name__)
        else:
            self._seen.answered("done")
            self._seen.told_address(drive.name, drive.address, value.raw)
        finally:
            self._seen.turns.answered(priority)

    async def _write(self, drive: DriveEntry | None = None) -> None:
        """Write a setpoint, to any drive if none is given."""
        drive = drive or self._random.choice(self._drives)
        code = Code({"smvector": 140, "93xx": 141}.get(drive.family, 46))
        self._seen.asked()
        try:
            report = await self._site.operations.write(
                drive.name, code, self._random.randrange(50), expires_s=60.0
            )
        except LecombusError as exc:
            self._seen.answered(type(exc).__name__)
        else:
            self._seen.answered(report.outcome)

    async def _stop_some(self) -> None:
        """Stop a drive, there or not, or one that is there and some that are not."""
        count = self._random.choice((1, 1, 1, 3, 10))
        drives = self._random.sample(self._drives, len(self._drives))
        absent = self._sim.faults.absent
        await self._stop([*drives[:1], *[d for d in drives[1:] if d.address in absent]][:count])

    async def _stop(self, drives: Sequence[DriveEntry]) -> None:
        action = self._random.choice(list(StopAction))
        async with anyio.create_task_group() as tasks:
            for drive in drives:
                tasks.start_soon(self._stop_one, drive.name, action)

    async def _stop_one(self, drive: str, action: StopAction) -> None:
        self._seen.asked()
        self._seen.stop_asked(drive)
        try:
            report = await self._site.operations.stop(action, drive)
        except LecombusError as exc:
            self._seen.answered(type(exc).__name__)
        else:
            self._seen.answered(report.members[0].outcome)
        finally:
            self._seen.stop_ended(drive)

    async def _come_and_go(self) -> None:
        """Switch drives off and on, one after the other has been given up or found again."""
        times = [drive.watchdog.time_s for drive in self._drives if drive.watchdog]
        rest_s = 2.0 * max(times, default=1.0)
        while await self._pause(rest_s, rest_s + 15.0):
            drive = self._random.choice(self._drives)
            absent = self._sim.faults.absent
            if drive.address in absent:
                absent.discard(drive.address)
            else:
                absent.add(drive.address)
                self._seen.left(drive.name)
                if self._random.random() < 0.5:  # somebody sees it and wants it stopped
                    await self._stop([drive])
