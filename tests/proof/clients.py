"""Who asks a random line for things, and what happens to its drives."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from decimal import Decimal
from random import Random

import anyio

from lecombus.config import DriveEntry
from lecombus.drives import StopAction, Verb, family
from lecombus.errors import LecombusError
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.line_runtime import LineRuntime
from lecombus.parameters import Code
from lecombus.schedule import Priority
from proof.invariants import Invariants
from proof.lease_checks import ASKED_WITH
from proof.lines import TROUBLED, RandomLine

WRITERS = 4
"""Clients that write setpoints as fast as they are done, on a saturated line."""
READERS = 12
"""Clients that read as fast as they are answered, on a loaded line."""
STOPS_APART = 2.0
"""Watchdog times, of the shortest, between two stops: within one they outlast one stop."""
LOOK_EVERY_S = 1.0
LOST_TIME_S = 0.3
EXPIRY_S = 60.0
VALUES = 990
SETTING = Code(12)
"""Acceleration time: a setting that drives keep. An SMVector has it elsewhere."""
EDGE = Code(43)
"""TRIP reset: an edge, and without a fault it does nothing. An 820X has none."""


class Clients:
    """The clients of one line; `run` returns after `stop` when every request has ended.

    Args:
        site: The line.
        line: What kind of load.
        invariants: Told of every request.
        sim: The drives, for taking some away.
    """

    def __init__(
        self, site: LineRuntime, line: RandomLine, invariants: Invariants, sim: SimLine
    ) -> None:
        self._site = site
        self._line = line
        self._seen = invariants
        self._sim = sim
        self._random = Random(line.seed + 1)
        self._drives = line.roster.drives
        self._over = asyncio.Event()
        times_s = [drive.watchdog.time_s for drive in self._drives if drive.watchdog]
        judged = line.kind != "faulty"
        self._stops_apart_s = STOPS_APART * min(times_s, default=0.0) if judged else 0.0
        self._stopped_s = 0.0
        self._values = {drive.name: self._random.randrange(VALUES) for drive in self._drives}

    def stop(self) -> None:
        """Ask for nothing more."""
        self._over.set()

    async def run(self) -> None:
        """Ask until stopped."""
        ASKED_WITH.set("")
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._one_thing_after_the_other)
            tasks.start_soon(self._look)
            if self._line.is_loaded:
                for _ in range(READERS):
                    tasks.start_soon(self._reads, Priority.BACKGROUND)
                    if self._line.is_crowded:
                        tasks.start_soon(self._reads, Priority.INTERACTIVE)
                for drive in self._drives[:WRITERS] if self._line.is_saturated else ():
                    tasks.start_soon(self._writes, drive)
                if self._line.writes_groups:
                    tasks.start_soon(self._writes_groups)
            if self._line.storms:
                tasks.start_soon(self._weather)
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
        deeds = [self._read, self._read, self._write, self._write, self._reset, self._stop_some]
        if self._line.kind == "quiet":
            deeds.append(self._read_idly)
        if self._line.kind in TROUBLED:
            deeds += [self._write_and_stop, self._write_and_stop, self._write_twice]
            deeds.append(self._enable)
        if self._line.kind == "faulty" or not any(drive.watchdog for drive in self._drives):
            deeds.append(self._stop_group)  # of stops at once the watchdogs outlast one
        if self._line.is_idle:
            deeds += [self._write_then_stop, self._read_slow_then_stop] * 3
            if self._line.writes_groups:
                deeds += [self._write_group_then_stop] * 3
        while await self._pause(0.0, 3.0):
            await self._random.choice(deeds)()

    async def _reads(self, priority: Priority) -> None:
        while await self._pause(0.0, 0.05):
            await self._read(priority)

    async def _writes(self, drive: DriveEntry) -> None:
        now = asyncio.get_running_loop().time
        while not self._over.is_set():
            asked_s = now()
            await self._write_setpoint(drive)
            if now() == asked_s:  # refused, unsaid
                await self._pause(1.0, 1.0)

    async def _writes_groups(self) -> None:
        while await self._pause(0.0, 1.0):
            await self._write_group()

    async def _read_idly(self) -> None:
        await self._read(Priority.BACKGROUND)

    async def _read(self, priority: Priority = Priority.INTERACTIVE) -> None:
        """Ask a drive for its own address: nobody else's answer looks like it."""
        drive = self._random.choice(self._drives)
        code = Code(1410 if drive.family == "smvector" else 9)
        self._seen.asked()
        written = self._line.is_saturated and drive in self._drives[:WRITERS]
        alone = written and family(drive.family).hold_after_write_s > 0.0
        number = self._seen.turns.asked(priority, alone=alone)
        now = asyncio.get_running_loop().time
        asked_s = now()
        try:
            station = self._site.requests.station(drive.name)
            value = await self._site.requests.read(station, code, priority, timeout_s=60.0)
        except LecombusError as exc:
            self._seen.answered(type(exc).__name__)
        else:
            self._seen.answered("done")
            self._seen.told_address(drive.name, drive.address, value.raw)
        finally:
            self._seen.turns.answered(priority, number, at_once=now() == asked_s)

    async def _look(self) -> None:
        """Look at what is shown, again and again."""
        while not self._over.is_set():
            self._seen.shown.look()
            if self._seen.leases is not None:
                self._seen.leases.look()
            with anyio.move_on_after(LOOK_EVERY_S):
                await self._over.wait()

    async def _write(self) -> None:
        """Write a setpoint; where trouble is, sometimes one that is soon of no use."""
        hurried = self._line.kind in TROUBLED and self._random.random() < 0.2
        expires_s = self._random.uniform(0.0, LOST_TIME_S) if hurried else EXPIRY_S
        await self._write_setpoint(self._random.choice(self._drives), expires_s)

    async def _write_setpoint(self, drive: DriveEntry, expires_s: float = EXPIRY_S) -> None:
        """Write a setpoint that this drive has not had for long: it tells whose it is."""
        await self._write_one(drive, _setpoint_of(drive), self.next_value(drive), expires_s)

    async def _write_group(self) -> None:
        """Write a setpoint to drives that have it at the same code, by one telegram if it fits."""
        named = {drive.name: drive for drive in self._drives}
        groups = {
            name: [named[member] for member in entry.members]
            for name, entry in sorted(self._line.roster.groups.items())
        }
        alike = [name for name, of in groups.items() if len({*map(_setpoint_of, of)}) == 1]
        if not alike:
            return
        group = self._random.choice(alike)
        members = groups[group]
        self._seen.asked()
        try:
            report = await self._site.operations.write_group(
                group, _setpoint_of(members[0]), self.next_value(members[0]), expires_s=EXPIRY_S,
                verify=self._random.random() < 0.3,
            )  # fmt: skip
        except LecombusError as exc:
            self._seen.answered(type(exc).__name__)
        else:
            self._seen.answered(report.outcome)

    def next_value(self, drive: DriveEntry) -> Decimal:
        """Give a value that the drive has not had for long."""
        self._values[drive.name] = (self._values[drive.name] + 1) % VALUES
        return Decimal(self._values[drive.name] + 1).scaleb(-1)

    async def _write_one(
        self, drive: DriveEntry, code: Code, value: Decimal, expires_s: float = EXPIRY_S
    ) -> None:
        verify = self._random.random() < 0.3
        self._seen.asked()
        try:
            report = await self._site.operations.write(
                drive.name, code, value, expires_s=expires_s, verify=verify
            )
        except LecombusError as exc:
            self._seen.answered(type(exc).__name__)
        else:
            self._seen.answered(report.outcome)

    async def _reset(self) -> None:
        """Say an edge, which must not be said twice."""
        drive = self._random.choice(self._drives)
        if drive.family != "820x":
            await self._write_one(drive, EDGE, _edge_of(drive))

    async def _write_twice(self) -> None:
        """Change one's mind about a setpoint."""
        drive = self._random.choice(self._drives)
        async with anyio.create_task_group() as tasks:
            for _ in range(self._random.choice((2, 3))):
                tasks.start_soon(self._write_setpoint, drive)
                await anyio.sleep(self._random.choice((0.0, 0.02, 0.2)))

    async def _write_and_stop(self) -> None:
        """Stop a drive for which writes wait, or are under way."""
        if not self._may_stop():
            return
        drive = self._random.choice(self._drives)
        async with anyio.create_task_group() as tasks:
            for _ in range(self._random.choice((1, 2))):
                tasks.start_soon(self._write_setpoint, drive)
            if drive.family != "820x":
                tasks.start_soon(self._write_one, drive, EDGE, _edge_of(drive))
            if drive.family != "smvector":
                tasks.start_soon(self._write_one, drive, SETTING, self.next_value(drive))
            await anyio.sleep(self._random.choice((0.0, 0.01, 0.1, LOST_TIME_S)))
            await self._stop([drive])

    async def _write_then_stop(self) -> None:
        """Stop a drive, the same or another, up to a watchdog time after a write."""
        await self._write()
        if await self._pause(0.0, self._stops_apart_s / STOPS_APART):
            await self._stop_some()

    async def _write_group_then_stop(self) -> None:
        """Stop a drive up to a watchdog time after a group's write, or while that waits."""
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._write_group)
            if await self._pause(0.0, self._stops_apart_s):
                await self._stop_some()

    async def _read_slow_then_stop(self) -> None:
        """Read what takes a module half a second, if there is room for that, and stop a drive."""
        drive = self._random.choice(self._drives)
        traits = family(drive.family).watchdog
        if traits is not None:
            self._seen.asked()
            try:
                station = self._site.requests.station(drive.name)
                await self._site.requests.read(
                    station, traits.action_code, Priority.INTERACTIVE, timeout_s=60.0
                )
            except LecombusError as exc:
                self._seen.answered(type(exc).__name__)
            else:
                self._seen.answered("done")
        if await self._pause(0.0, self._stops_apart_s / STOPS_APART):
            await self._stop_some()

    async def _enable(self) -> None:
        """Let a drive run."""
        drive = self._random.choice(self._drives)
        self._seen.asked()
        self._seen.shown.enable_asked(drive.name)
        try:
            report = await self._site.operations.verb(drive.name, Verb.ENABLE, expires_s=EXPIRY_S)
        except LecombusError as exc:
            self._seen.answered(type(exc).__name__)
        else:
            self._seen.answered(report.outcome)
        finally:
            self._seen.shown.enable_ended(drive.name)

    def _may_stop(self) -> bool:
        """Tell whether the watchdogs outlast a stop now, by what they are planned for."""
        now_s = asyncio.get_running_loop().time()
        if now_s < self._stopped_s + self._stops_apart_s:
            return False
        self._stopped_s = now_s
        return True

    async def _stop_some(self) -> None:
        """Stop a drive, there or not, or one that is there and some that are not."""
        if not self._may_stop():
            return
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
        asked_s = self._seen.stop_asked(drive)
        outcome = ""
        try:
            report = await self._site.operations.stop(action, drive)
        except LecombusError as exc:
            outcome = type(exc).__name__
        else:
            outcome = report.members[0].outcome
        finally:
            self._seen.answered(outcome)
            self._seen.stop_ended(drive, outcome, asked_s)

    async def _stop_group(self) -> None:
        """Stop all drives of a decade by one telegram."""
        name = self._random.choice(sorted(self._line.roster.groups))
        members = self._line.roster.groups[name].members
        action = self._random.choice(list(StopAction))
        self._seen.asked()
        asked_s = min(self._seen.stop_asked(drive) for drive in members)
        outcomes = dict.fromkeys(members, "")
        try:
            report = await self._site.operations.stop(action, name)
        except LecombusError as exc:
            self._seen.answered(type(exc).__name__)
        else:
            outcomes |= {one.drive: one.outcome for one in report.members}
            self._seen.answered(report.outcome)
        finally:
            for drive in members:
                self._seen.stop_ended(drive, outcomes[drive], asked_s)

    async def _weather(self) -> None:
        """Let faults come and go."""
        faults = self._sim.faults
        for storm in self._line.storms:
            if not await self._pause(storm.after_s, storm.after_s):
                return
            usual = getattr(faults, storm.fault)
            setattr(faults, storm.fault, storm.chance)
            await self._pause(storm.for_s, storm.for_s)
            setattr(faults, storm.fault, usual)

    async def _come_and_go(self) -> None:
        """Switch drives off and on, one after the other has been given up or found again."""
        times = [drive.watchdog.time_s for drive in self._drives if drive.watchdog]
        rest_s = 2.0 * max(times, default=1.0)
        while await self._pause(rest_s, rest_s + 15.0):
            drive = self._random.choice(self._drives)
            absent = self._sim.faults.absent
            if drive.address in absent:
                self._come_back(drive)
            else:
                absent.add(drive.address)
                self._seen.left(drive.name)
                if self._random.random() < 0.5:  # somebody sees it and wants it stopped
                    await self._stop([drive])

    def _come_back(self, drive: DriveEntry) -> None:
        """Let a drive answer again; mostly it has been without its supply."""
        if self._random.random() < 0.7:
            now_s = asyncio.get_running_loop().time()
            self._sim[drive.name].power_cycle(now_s, 0.0)
            self._seen.lost_power(drive.name)
        self._sim.faults.absent.discard(drive.address)


def _setpoint_of(drive: DriveEntry) -> Code:
    return Code({"smvector": 140, "93xx": 141}.get(drive.family, 46))


def _edge_of(drive: DriveEntry) -> Decimal:
    """Give what resets a fault: an SMVector takes 1, and reads 0 afterwards."""
    return Decimal(1 if drive.family == "smvector" else 0)
