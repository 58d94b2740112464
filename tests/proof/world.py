"""One random line in virtual time: the real site over simulated drives, watched at every step.

Schedule, worker, keeper, books and store are those of the daemon; only the event loop's time jumps
and the port is in memory. What comes in is handed over in pieces as an adapter does, which also
makes it fast. `run_line` gives what was seen to break; an empty list is what is wanted.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass

import anyio

from lecombus.line.observer import ExchangeReport, Observer
from lecombus.line.port import Port, PortSettings, Receiver
from lecombus.readings import DriveState
from lecombus.simulator.line import SimLine
from lecombus.simulator.memory import MemoryEnd
from lecombus.simulator.world import build
from lecombus.site import Site
from proof.clients import Clients
from proof.invariants import Invariants
from proof.lines import RandomLine
from support.virtual_loop import VirtualLoop

ADAPTER_S = 0.008
"""Bytes are handed over in pieces of so much time, as by an adapter's latency timer."""
START_S = 1500.0
"""Longest time granted for all drives to come online, seconds of line time."""
WALL_S = 1_795_000_000.0


@dataclass(frozen=True)
class Finding:
    """What one line came to.

    Args:
        line: The line.
        broken: What did not hold, in words; empty: everything did.
        exchanges: How many there were.
        line_s: How long it ran, seconds of line time.
        took_s: Processor time it took.
    """

    line: RandomLine
    broken: tuple[str, ...]
    exchanges: int
    line_s: float
    took_s: float


class World:
    """A line under watch.

    Args:
        line: What to run.
        change: Called with the site before it starts; for mutants.
    """

    def __init__(self, line: RandomLine, change: Callable[[Site], None] | None = None) -> None:
        self.line = line
        self.sim = _simulated(line)
        self.invariants = Invariants(line, self.sim)
        self._memory = MemoryEnd(self.sim, latency_s=ADAPTER_S)
        clock = asyncio.get_running_loop().time
        self.site = Site(line.roster, self._open, clock, lambda: WALL_S + clock())
        self.site.worker._observer = _Watched(self.site.worker._observer, self.invariants)
        if change is not None:
            change(self.site)
        self.exchanges = 0

    async def _open(self, settings: PortSettings, receiver: Receiver) -> Port:
        return _WatchedPort(await self._memory.open(settings, receiver), self.invariants)

    async def run(self) -> None:
        """Wait until the drives are there, then let clients and trouble loose on them."""
        async with _running(self.site):
            await self._settle()
            self.invariants.begin(self.site)
            async with anyio.create_task_group() as tasks:
                clients = Clients(self.site, self.line, self.invariants, self.sim)
                tasks.start_soon(clients.run)
                await anyio.sleep(self.line.length_s)
                clients.stop()
            self.invariants.end(self.site)

    async def _settle(self) -> None:
        names = [drive.name for drive in self.line.roster.drives]
        started_s = asyncio.get_running_loop().time()
        while any(self.site.store.drive(name).state is not DriveState.ONLINE for name in names):
            await anyio.sleep(1.0)
            if asyncio.get_running_loop().time() - started_s > START_S:
                break
        await anyio.sleep(2.0)


class _Watched:
    """Stands before the books."""

    def __init__(self, inner: Observer, invariants: Invariants) -> None:
        self._inner = inner
        self._invariants = invariants

    def exchange_ended(self, report: ExchangeReport) -> None:
        self._invariants.ended(report)
        self._inner.exchange_ended(report)

    def line_changed(self, up: bool, reason: str) -> None:
        self._inner.line_changed(up, reason)

    def thinking(self, for_s: float) -> None:
        self._inner.thinking(for_s)

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        self._inner.stray_bytes(data, late_answer)


class _WatchedPort:
    """Shows every telegram to the invariants."""

    def __init__(self, inner: Port, invariants: Invariants) -> None:
        self._inner = inner
        self._invariants = invariants
        self.carries_parity = inner.carries_parity
        self.discard_input = inner.discard_input
        self.abort = inner.abort
        self.describe = inner.describe

    def write(self, data: bytes) -> None:
        self._invariants.said(data, asyncio.get_running_loop().time())
        self._inner.write(data)


def _simulated(line: RandomLine) -> SimLine:
    """Make the drives, with the watchdogs set as the roster wants them."""
    actions = {"none": 0, "inhibit": 1, "quick-stop": 2}
    overrides: dict[str, dict[int | tuple[int, int], str]] = {}
    for drive in line.roster.drives:
        if drive.watchdog is not None:
            codes = (1425, 1426) if drive.family == "smvector" else (1923, 1922)
            action = actions[drive.watchdog.action]
            overrides[drive.name] = {
                codes[0]: str(round(drive.watchdog.time_s * 1000)),
                codes[1]: str(action),
            }
    return build(
        [(drive.name, drive.address, drive.family) for drive in line.roster.drives],
        baud=line.roster.line.baud, faults=line.faults, seed=line.seed, spread=0.5,
        overrides=overrides, log_size=1,
    )  # fmt: skip


@contextlib.asynccontextmanager
async def _running(site: Site) -> AsyncIterator[None]:
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(site.keeper.run)
        tasks.start_soon(site.worker.run)
        yield
        tasks.cancel_scope.cancel()


def run_line(line: RandomLine, change: Callable[[Site], None] | None = None) -> Finding:
    """Run a line to its end and say what did not hold.

    Args:
        line: The line.
        change: Changes the site before it starts; for mutants.
    """
    started_s = time.process_time()
    world: World | None = None

    async def main() -> None:
        nonlocal world
        world = World(line, change)
        await world.run()

    with asyncio.Runner(loop_factory=lambda: VirtualLoop(1e6)) as runner:
        runner.run(main())
        line_s = runner.get_loop().time() - 1000.0
    assert world is not None
    found = world.invariants
    return Finding(
        line, tuple(found.broken), found.exchanges, line_s, time.process_time() - started_s
    )
