"""What readers of events take from the line: cycles with 200 of them, of which 50 read nothing.

A full paced line, 31 drives at 19200 baud, of which every value read is published, changed or not;
turns without and with readers follow each other, with the same daemon. The readers' process gives
way to the simulated line on their core: in the field they are on other machines.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

from support.children import MASTER_CORE, OTHER_CORE, Child, child

from .machine import free_port
from .rosters import write_roster
from .table import Row, ratios, spread

__all__ = ["measure"]

BAUD = 19200
READERS, SILENT = 200, 50
TURN_S = 15.0
"""Longer than until a reader that takes nothing is cut."""
WARM_S = 2.0
KEPT = 0.99
MOST_MB = 30.0
"""The buffer has 2 MB; each reader at most 16 kB here, and its connection and task."""


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure the line without and with readers."""
    link = folder / "line-readers"
    roster = write_roster(folder, link, baud=BAUD, turnaround_ms=0, http=free_port())
    without: list[float] = []
    read: list[float] = []
    taken: list[float] = []
    grown: list[float] = []
    with contextlib.ExitStack() as stack:
        line = stack.enter_context(
            child("support.paced_line", link, "--baud", str(BAUD), core=OTHER_CORE)
        )
        daemon = stack.enter_context(child("benchmarks.daemon_child", roster, core=MASTER_CORE))
        daemon.ask("online")
        daemon.ask("publish_all")
        readers = stack.enter_context(
            child("benchmarks.readers_child", folder / "api.sock", core=OTHER_CORE)
        )
        os.setpriority(os.PRIO_PROCESS, readers.process.pid, 10)
        rate_of(line)
        for _ in range(rounds):
            without.append(rate_of(line))
            before_mb = resident_mb(daemon)
            readers.ask("open", count=READERS, silent=SILENT)
            time.sleep(WARM_S)
            readers.ask("taken")
            began_s = time.monotonic()
            read.append(rate_of(line))
            taken.append(readers.ask("taken") / (time.monotonic() - began_s) / 1000.0)
            grown.append(resident_mb(daemon) - before_mb)
            readers.ask("close")
            time.sleep(WARM_S)
    return [
        Row(
            f"cycles with {READERS} readers of events, {SILENT} of them silent",
            f"{spread(read, 3)} cycles/s",
            f"without {spread(without, 3)}",
            ratios(read, without),
            KEPT,
            at_least=True,
            digits=3,
            note=f"{spread(taken, 0)} kB/s to those that read",
        ),
        Row(
            "memory for them",
            f"{spread(grown)} MB",
            "the daemon before",
            max(grown),
            MOST_MB,
            digits=1,
            note="resident, the most of all rounds",
        ),
    ]


def rate_of(line: Child) -> float:
    """Measure how often all drives are asked, a second."""
    first, first_s = line.ask("mark")
    time.sleep(TURN_S)
    last, last_s = line.ask("mark")
    return float((last - first) / (last_s - first_s) / 31)


def resident_mb(daemon: Child) -> float:
    """Return the memory that the daemon holds."""
    status = Path(f"/proc/{daemon.process.pid}/status").read_text()
    row = next(one for one in status.splitlines() if one.startswith("VmRSS"))
    return int(row.split()[1]) / 1000.0
