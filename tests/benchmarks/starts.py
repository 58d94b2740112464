"""How long `lecombus run` takes to its first telegram, and what memory it holds.

Both with 31 drives at 19200 baud. Memory is looked at after a minute in which `/metrics` is scraped
every second and the API is asked for drives and values twenty times a second.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from support.children import MASTER_CORE, OTHER_CORE, Child, child, die_with_parent, environment

from .cycles import scraped
from .machine import free_port
from .rosters import write_roster
from .table import Row, percentile, spread

__all__ = ["measure"]

MEMORY_AFTER_S = 60.0
PATHS = ("/v1/line", "/v1/drives", "/v1/drives/d07", "/v1/drives/d07/codes/C0150", "/readyz")


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure starts, then one long run."""
    link, port = folder / "line", free_port()
    roster = write_roster(folder, link, baud=19200, turnaround_ms=2, http=port)
    with child("support.paced_line", link, "--baud", "19200", core=OTHER_CORE) as line:
        starts_s = [one_start(line, roster) for _ in range(rounds)]
        with running(roster) as daemon:
            first_telegram(line)
            with scraped(port), scraped(port, PATHS, per_s=20.0):
                time.sleep(MEMORY_AFTER_S)
                held_mb = [resident_mb(daemon) for _ in range(5)]
    return [
        Row(
            "start of `lecombus run` to its first telegram",
            f"{spread(starts_s, 2)} s", "", percentile(starts_s, 0.5), 1.0, note="s",
        ),
        Row(
            "resident memory after 60 s, 31 drives, scrape and API load",
            f"{spread(held_mb)} MB", "", percentile(held_mb, 0.5), 80.0, digits=1,
            note="MB; aim 60",
        ),
    ]  # fmt: skip


@contextlib.contextmanager
def running(roster: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run the command as a user does, and end it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "lecombus", "run", "-c", roster],
        stderr=subprocess.DEVNULL, env=environment(), preexec_fn=die_with_parent,
    )  # fmt: skip
    os.sched_setaffinity(process.pid, {MASTER_CORE})
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20.0)


def one_start(line: Child, roster: Path) -> float:
    """Start it once; seconds to the first telegram."""
    line.ask("first")
    began_s = time.monotonic()
    with running(roster):
        return first_telegram(line) - began_s


def first_telegram(line: Child) -> float:
    """Wait for the first telegram since the last asking; gives the moment."""
    while not (first_s := line.ask("first")):
        time.sleep(0.02)
    return float(first_s)


def resident_mb(process: subprocess.Popen[bytes]) -> float:
    """What a process holds in memory, megabytes."""
    for row in Path(f"/proc/{process.pid}/status").read_text().splitlines():
        if row.startswith("VmRSS"):
            return int(row.split()[1]) * 1024 / 1e6
    raise RuntimeError("the daemon has ended")
