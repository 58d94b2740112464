"""What is got out of a line when drives are away: lecombus beside masters as people write them.

The same paced line for all, 31 drives at 19200 baud, of which none, 3 or 10 do not answer. What
counts is how often the others are asked. lecombus is given time to find out who is away; while a
naive master has its turn, the daemon leaves the drives alone and is stopped.
"""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

from support.children import MASTER_CORE, OTHER_CORE, Child, child
from support.paced_line import ADDRESSES

from .machine import free_port
from .naive import KINDS
from .rosters import write_roster
from .table import Row, ratios, spread

__all__ = ["measure"]

BAUD = 19200
ABSENT = (0, 3, 10)
TURN_S = 4.0
FOUND_OUT_S = 20.0
LONGEST_ROUND_S = 60.0
MOST_ROUNDS = 2
KEPT = 0.85
"""Of the cycles with none absent, what is kept with ten of 31 absent."""


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure everybody with 0, 3 and 10 drives absent."""
    rows: list[Row] = []
    whole: list[float] = []
    link, port = folder / "line-absent", free_port()
    roster = write_roster(folder, link, baud=BAUD, turnaround_ms=0, http=port)
    with contextlib.ExitStack() as stack:
        line = stack.enter_context(
            child("support.paced_line", link, "--baud", str(BAUD), core=OTHER_CORE)
        )
        daemon = stack.enter_context(child("benchmarks.daemon_child", roster, core=MASTER_CORE))
        naive = {
            kind: stack.enter_context(child("benchmarks.naive", link, kind, core=MASTER_CORE))
            for kind in KINDS
        }
        daemon.ask("online")
        for absent in ABSENT:
            line.ask("absent", count=absent)
            time.sleep(FOUND_OUT_S if absent else 1.0)
            ours, theirs = turns(line, daemon, naive, absent, min(rounds, MOST_ROUNDS))
            whole = whole or ours
            rows += rows_of(absent, ours, theirs, whole)
    return rows


def turns(
    line: Child, daemon: Child, naive: dict[str, Child], absent: int, rounds: int
) -> tuple[list[float], dict[str, list[float]]]:
    """Let everybody have their turns; cycles of the drives that are there, per second."""
    ours: list[float] = []
    theirs: dict[str, list[float]] = {kind: [] for kind in naive}
    for _ in range(rounds):
        first, first_s = line.ask("useful")
        time.sleep(TURN_S)
        last, last_s = line.ask("useful")
        ours.append((last - first) / (last_s - first_s) / (len(ADDRESSES) - absent))
        for kind, master in naive.items():
            until_s = daemon.ask("hold", for_s=LONGEST_ROUND_S)
            daemon.pause()
            made, took_s = master.ask("run", for_s=TURN_S)
            theirs[kind].append(made / took_s)
            daemon.resume()
            daemon.ask("release", until_s=until_s)
            time.sleep(1.0)
    return ours, theirs


def rows_of(
    absent: int, ours: list[float], theirs: dict[str, list[float]], whole: list[float]
) -> list[Row]:
    """Make the rows of one number of absent drives."""
    words = {"loop": "plain asyncio loop", "client": "pymodbus' way", "pauses": "50 ms pauses"}
    rows = [
        Row(
            f"{absent} of 31 absent",
            f"{spread(ours, 3)} cycles/s",
            f"{words[kind]} {spread(cycles, 3)}",
            ratios(ours, cycles),
            digits=1,
            note="times the cycles of the drives that are there",
        )
        for kind, cycles in theirs.items()
    ]
    if absent == ABSENT[-1]:
        rows.append(
            Row(
                f"cycles kept with {absent} of 31 absent",
                f"{spread(ours, 3)} cycles/s",
                f"none absent {spread(whole, 3)}",
                sorted(ours)[len(ours) // 2] / sorted(whole)[len(whole) // 2],
                KEPT,
                at_least=True,
            )
        )
    return rows
