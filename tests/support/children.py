"""Processes beside a test or a benchmark, and how they are spoken to.

Every party (simulated line, daemon, peer) is a process of its own, so that none takes another's
interpreter; in a benchmark pinned to a core: masters to one, everything else to the other. A child
reads one JSON document a line from its standard input and answers each with one; it ends when its
input ends. Between its turns in a benchmark it is stopped by signal, so that it takes nothing from
the one that is measured.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import json
import os
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

__all__ = [
    "MASTER_CORE",
    "OTHER_CORE",
    "ROOT",
    "Child",
    "answer_lines",
    "child",
    "pin",
    "take_priority",
]

ROOT = Path(__file__).parents[2]
PR_SET_PDEATHSIG = 1
UNIT_NICE = -10
CORES = sorted(os.sched_getaffinity(0))
MASTER_CORE, OTHER_CORE = CORES[-1], CORES[0]


def pin(core: int) -> None:
    """Keep the calling thread on one core."""
    os.sched_setaffinity(0, {core})


def take_priority() -> None:
    """Run from now on with the priority that the unit gives the daemon, where that is allowed."""
    with contextlib.suppress(PermissionError):
        os.nice(UNIT_NICE - os.nice(0))


class Child:
    """A process that answers one JSON document with one."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def ask(self, what: str, **more: Any) -> Any:
        """Ask and wait for the answer."""
        self.tell(what, **more)
        return self.hear()

    def tell(self, what: str, **more: Any) -> None:
        """Ask; the answer is waited for by `hear`."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"what": what, **more}) + "\n")
        self.process.stdin.flush()

    def hear(self) -> Any:
        """Wait for the answer to what was asked."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"a child ended: {self.process.args!r}")
        return json.loads(line)

    def pause(self) -> None:
        """Stop it until `resume`; it takes no processor time meanwhile."""
        self.process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on."""
        self.process.send_signal(signal.SIGCONT)


def environment() -> dict[str, str]:
    """The environment in which children find lecombus and the benchmarks.

    Their modules are compiled once, as those of an installed lecombus are: otherwise that is a
    third of the time that a start takes.
    """
    kept = {key: text for key, text in os.environ.items() if not key.startswith("LECOMBUS_")}
    kept.pop("NOTIFY_SOCKET", None)
    kept.pop("PYTHONDONTWRITEBYTECODE", None)
    return {**kept, "PYTHONPATH": f"{ROOT / 'src'}:{ROOT / 'tests'}"}


def die_with_parent() -> None:
    """Leave no child behind, stopped or not, when the run is killed."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


@contextlib.contextmanager
def child(module: str, *words: str | Path, core: int | None = None) -> Iterator[Child]:
    """Run a module of the tests as a child, on one core if one is given, and end it."""
    command = [sys.executable, "-m", module, *map(str, words)]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment(),
        preexec_fn=die_with_parent,
    )  # fmt: skip
    if core is not None:
        os.sched_setaffinity(process.pid, {core})
    try:
        yield Child(process)
    finally:
        process.kill()
        process.communicate()


async def answer_lines(answer: Callable[[dict[str, Any]], Awaitable[Any]]) -> None:
    """In a child with an event loop: answer what is asked until the input ends."""
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        document = await answer(json.loads(line))
        sys.stdout.write(json.dumps(document) + "\n")
        sys.stdout.flush()
