"""One random line in virtual time: the real runtime over simulated drives, watched at every step.

Schedule, worker, supervisor, recorder and store are those of the daemon; only the event loop's
time jumps and the port is in memory. What comes in is handed over in pieces as an adapter does,
which also makes it fast. `run_line` gives what was seen to break; an empty list is what is wanted.
"""

from __future__ import annotations

import asyncio
import gc
import time
from dataclasses import asdict, dataclass, field

import anyio

from lecombus.config import DriveEntry
from lecombus.drive_state.readings import DriveState
from lecombus.fieldbus.lecom.simulator.line import SimLine, build
from lecombus.schedule import Priority
from proof.clients import Clients
from proof.controllers import Controllers
from proof.invariants import Invariants
from proof.lines import RandomLine
from support.drives import presets
from support.site_host import Plant
from support.virtual_loop import Paused, VirtualLoop

START_S = 600.0
"""Longest time granted for all drives to come online, seconds of line time."""
FELL = "the daemon fell over"
LOG_SIZE = 40
"""Each drive remembers what was said to it for longer than a write and its proof take."""
SELDOM = 50_000
"""A line leaves little that only the garbage collector finds: it looks after so many objects."""
PATIENCE_S = 300.0
"""So long after the last was asked for everything must have its outcome."""


@dataclass(frozen=True)
class Finding:
    """What one line came to.

    Args:
        line: The line.
        broken: What did not hold, in words; empty: everything did.
        exchanges: How many there were.
        line_s: How long it ran, seconds of line time.
        took_s: Processor time it took.
        digest: Of every byte that was said and heard, and when.
        most: By what was promised: how near the longest came to it, 1 is as promised.
        leases: What it has shown of leases; empty: it has none.
    """

    line: RandomLine
    broken: tuple[str, ...]
    exchanges: int
    line_s: float
    took_s: float
    digest: str
    most: dict[str, float]
    leases: dict[str, float] = field(default_factory=dict)


class World:
    """A line under watch.

    Args:
        line: What to run.
    """

    def __init__(self, line: RandomLine) -> None:
        self.line = line
        self.plant = Plant(line.roster, line=_simulated(line), latency_s=line.adapter_s)
        self.site, self.sim = self.plant.site, self.plant.line
        self.invariants = Invariants(line, self.sim, self.site)
        self.plant.watched_by(self.invariants)

    async def run(self) -> None:
        """Wait until the drives are there, then let clients and trouble loose on them."""
        async with self.plant:
            await self._settle()
            self.invariants.begin(settled=self._is_settled())
            self._let_pause()
            with anyio.CancelScope() as patience:
                async with anyio.create_task_group() as tasks:
                    clients = Clients(self.site, self.line, self.invariants, self.sim)
                    tasks.start_soon(clients.run)
                    controllers = self._controllers(clients)
                    if controllers is not None:
                        tasks.start_soon(controllers.run)
                    await anyio.sleep(self.line.length_s)
                    clients.stop()
                    if controllers is not None:
                        controllers.stop()
                    patience.deadline = anyio.current_time() + PATIENCE_S
            self.invariants.end()

    def _controllers(self, clients: Clients) -> Controllers | None:
        checks = self.invariants.leases
        if checks is None:
            return None
        return Controllers(self.site, self.line, self.invariants, checks, clients.next_value)

    def _let_pause(self) -> None:
        """Have the daemon not run now and then, from here on."""
        loop, at_s, spans = asyncio.get_running_loop(), asyncio.get_running_loop().time(), []
        for after_s, for_s in self.line.pauses:
            spans.append((at_s + after_s, at_s + after_s + for_s))
            at_s += after_s + for_s
        if spans and isinstance(loop, VirtualLoop):
            loop.machine = Paused(spans)
            self.invariants.let_pause(loop.machine.paused_s)

    async def _settle(self) -> None:
        with anyio.move_on_after(START_S):
            while not self._is_settled():  # noqa: ASYNC110 - any state of the site
                await anyio.sleep(1.0)
        await anyio.sleep(2.0)

    def _is_settled(self) -> bool:
        """Whether all drives are there and what the daemon wants to know of them is known."""
        if not all(map(self._is_there, self.line.roster.drives)):
            return False
        waiting = self.site.schedule.stats(asyncio.get_running_loop().time()).depth
        return not waiting[Priority.BACKGROUND]

    def _is_there(self, drive: DriveEntry) -> bool:
        """Whether a drive is online; one that ran without its lease may be silenced."""
        silenced = self.line.leased and drive.lease.required and drive.lease.on_lapse == "silence"
        return silenced or self.site.store.state(drive.name) is DriveState.ONLINE


def _simulated(line: RandomLine) -> SimLine:
    """Make the drives, with the watchdogs set as the roster wants them."""
    overrides = {drive.name: presets(drive) for drive in line.roster.drives}
    for drive in line.roster.drives:
        if drive.name in line.early and drive.family != "smvector":
            overrides[drive.name][1921] = "1"
    sim = build(
        [(drive.name, drive.address, drive.family) for drive in line.roster.drives],
        baud=line.roster.line.baud, faults=line.faults, seed=line.seed, spread=0.5,
        overrides=overrides, log_size=LOG_SIZE, word_as_written=line.as_written,
    )  # fmt: skip
    for name in line.running:
        sim[name].model.write_control_word("H0000")
    return sim


def _errors(exc: BaseException) -> list[BaseException]:
    """Take errors out of their groups."""
    if isinstance(exc, BaseExceptionGroup):
        return [one for part in exc.exceptions for one in _errors(part)]
    return [exc]


def run_line(line: RandomLine) -> Finding:
    """Run a line to its end and say what did not hold.

    Args:
        line: The line.
    """
    started_s = time.process_time()
    world: World | None = None

    async def main() -> None:
        nonlocal world
        world = World(line)
        loop, say = asyncio.get_running_loop(), world.invariants.say
        loop.set_exception_handler(lambda _, found: say(f"{FELL}: {found.get('exception')!r}"))
        try:
            await world.run()
        except Exception as exc:  # noqa: BLE001 - whatever it is, it is what this line has shown
            say(f"{FELL}: {', '.join(map(repr, _errors(exc)))}")

    usual = gc.get_threshold()
    gc.set_threshold(SELDOM, *usual[1:])
    try:
        with asyncio.Runner(loop_factory=lambda: VirtualLoop(1e6)) as runner:
            runner.run(main())
            line_s = runner.get_loop().time() - 1000.0
    finally:
        gc.set_threshold(*usual)
    assert world is not None
    found = world.invariants
    return Finding(
        line, tuple(found.broken), found.exchanges, line_s, time.process_time() - started_s,
        found.wire.digest, found.promises.most | found.turns.most,
        {} if found.leases is None else asdict(found.leases.counts),
    )  # fmt: skip
