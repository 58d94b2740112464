"""A child: the whole daemon, with what a benchmark wants of it besides.

`python -m benchmarks.daemon_child ROSTER [unpaced]`. The daemon is the one `lecombus run` runs;
HTTP answers on the roster's socket and port. Asked from outside, it can keep a thousand background
reads waiting, leave all drives alone for a while, stop a drive at a moment, and say what processor
time it has used for how many exchanges.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import logging
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import anyio
from anyio.abc import TaskGroup

import lecombus.daemon
from lecombus.config import line_timing, load_roster
from lecombus.daemon import SWITCH_INTERVAL_S, Daemon
from lecombus.drive_state.readings import DriveState
from lecombus.drives import StopAction
from lecombus.errors import LecombusError
from lecombus.line.event_loop import run as run_loop
from lecombus.line_runtime import LineRuntime
from lecombus.parameters import Code
from lecombus.schedule import Outcome, Priority
from lecombus.supervision import drive_supervisor, event_sources
from lecombus.supervision.journal_record import JournalRecord
from support.children import answer_lines

__all__ = ["main"]

STATUS = Code(150)
SETPOINT = Code(140)
MOST_TRIES = 5
MOST_RESTS = 0.02
"""Of the exchanges of a busy line: a few are left to whoever starts."""
LEAST_RATE = 1000.0
"""Exchanges a second of a line that is not silent because of a late answer."""


class Bench:
    """What is asked of a daemon during a benchmark."""

    def __init__(self, daemon: Daemon, tasks: TaskGroup) -> None:
        self._daemon = daemon
        self._tasks = tasks
        self._record: JournalRecord | None = None
        self._written = 0
        self._closed = False
        self._background = 0

    @property
    def site(self) -> LineRuntime:
        """The daemon's line."""
        assert self._daemon.runtime is not None
        return self._daemon.runtime

    async def answer(self, question: dict[str, Any]) -> Any:
        """Answer one question."""
        what = question.pop("what")
        return await getattr(self, what)(**question)

    async def online(self) -> bool:
        """Wait until every drive has been audited."""
        store = self.site.store
        changed = anyio.Event()

        def look(_: object) -> None:
            if all(info.state is DriveState.ONLINE for info in store.drives()):
                changed.set()

        store.subscribe(look)
        look(None)
        await changed.wait()
        store.unsubscribe(look)
        return True

    async def background(self, count: int) -> int:
        """Keep so many background reads waiting from now on."""
        names = self.site.store.names()
        for number in range(count):
            self._read_again(names[number % len(names)])
        return count

    def _read_again(self, name: str) -> None:
        def again(outcome: Outcome, reason: str) -> None:
            self._background += 1
            self._read_again(name)

        requests = self.site.requests
        request = requests.maker.read(
            requests.station(name), STATUS, Priority.BACKGROUND, settle=again
        )
        requests.worker.submit(request)

    async def publish_all(self) -> bool:
        """Publish every value that is read, changed or not, while events are read."""
        vars(event_sources)["HEARTBEAT_S"] = 0.0
        return True

    async def hold(self, for_s: float) -> float:
        """Leave all drives alone for a while; answers when nothing is under way any more."""
        now = anyio.current_time()
        for name in self.site.store.names():
            self.site.schedule.hold(name, now + for_s, now)
        await anyio.sleep(0.2)
        return now + for_s

    async def release(self, until_s: float) -> bool:
        """End a hold before its time."""
        self.site.schedule.fail_all(anyio.current_time(), "the hold is over")
        self.site.worker.nudge()
        return True

    async def used(self) -> dict[str, float]:
        """Processor time, exchanges and background reads so far."""
        worker = self.site.worker
        return {
            "cpu_s": time.process_time(),
            "exchanges": worker.exchanges,
            "background": self._background,
        }

    async def spend(self, for_s: float, busy: bool) -> float:
        """Processor time per exchange over a while, seconds; `busy`: the line must not fall idle.

        One answer that a busy machine gave too late is half a second of silence: that is no
        measure, and another is taken.

        Raises:
            RuntimeError: The line fell idle each time: other exchanges would be measured than
                were asked for.
        """
        for _ in range(MOST_TRIES):
            worker = self.site.worker
            cpu_s, exchanges, rests = time.process_time(), worker.exchanges, worker.rests
            await anyio.sleep(for_s)
            cpu_s, exchanges = time.process_time() - cpu_s, worker.exchanges - exchanges
            rests = worker.rests - rests
            at_work = exchanges > LEAST_RATE * for_s and rests <= MOST_RESTS * exchanges
            if exchanges and (at_work or not busy):
                return cpu_s / exchanges
        raise RuntimeError(f"{rests} rests in {exchanges} exchanges: not back to back")

    async def writes(self, per_s: float) -> int:
        """Write setpoints from now on, so many a second, each drive in turn."""
        self._tasks.start_soon(self._write, per_s)
        return 0

    async def _write(self, per_s: float) -> None:
        names, due_s = self.site.store.names(), anyio.current_time()
        for number in itertools.count():
            due_s += 1.0 / per_s
            await anyio.sleep_until(due_s)
            self._tasks.start_soon(self._write_one, names[number % len(names)], number % 50)

    async def _write_one(self, name: str, value: int) -> None:
        with contextlib.suppress(LecombusError):  # the drives are left alone at present
            report = await self.site.operations.write(name, SETPOINT, value)
            self._written += report.outcome.is_good

    async def written(self) -> int:
        """Return how many of them were done so far."""
        return self._written

    async def journal(self, on: bool) -> int:
        """Record in the journal what is done from now on, or do not; give its newest row."""
        actions = self.site.operations.actions
        records = [one for one in actions.followers if isinstance(one, JournalRecord)]
        self._record = self._record or records[0]
        others = tuple(one for one in actions.followers if one is not self._record)
        actions.followers = (self._record, *others) if on else others
        figures = self.site.supervision.watch.journal
        assert figures is not None
        return figures().rows

    async def stop(self, drive: str, after_s: float) -> float:
        """Stop a drive some time from now; gives the moment at which that was asked."""
        await anyio.sleep(after_s)
        asked_s = time.monotonic()
        await self.site.operations.stop(StopAction.INHIBIT, drive)
        return asked_s


async def learn_nothing(self: object, drive: object) -> None:
    """Instead of what a drive is asked once, in the background, after it has come online.

    It waits ahead of the thousand reads, and its answers are shorter than theirs.
    """


async def serve(path: Path, unpaced: bool) -> None:
    """Run daemon and questions side by side."""
    roster = load_roster(path)
    vars(drive_supervisor)["DriveSupervisor"]._learn_the_rest = learn_nothing
    if unpaced:  # a responder answers before a telegram of this baud rate could have left
        timing = dataclasses.replace(line_timing(roster.line), paced=False)
        vars(lecombus.daemon)["LineRuntime"] = partial(LineRuntime, timing=timing)
    daemon = Daemon(roster, None)
    async with anyio.create_task_group() as tasks:
        bench = Bench(daemon, tasks)
        tasks.start_soon(daemon.main)
        while daemon.runtime is None:  # noqa: ASYNC110 - the state file is opened in a thread first
            await asyncio.sleep(0.001)
        await answer_lines(bench.answer)
        daemon.end()


def main(roster: str, pace: str = "paced") -> None:
    """Serve until the input ends."""
    logging.disable(logging.WARNING)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    run_loop(serve, Path(roster), pace == "unpaced")


if __name__ == "__main__":
    main(*sys.argv[1:])
