"""What the journal costs the line: cycles of 31 drives with it against cycles without, in one run.

Strategy: one daemon on one paced line, fully used, with setpoints written all the time. Round by
round the journal records them or does not: with it, each waits for the disk before it is sent, and
the line must not. The line itself counts the requests that it hears.
"""

from __future__ import annotations

import time
from pathlib import Path

from support.children import MASTER_CORE, OTHER_CORE, child

from .cycles import cycles_per_s
from .machine import free_port
from .rosters import write_roster
from .table import Row, ratios, spread

__all__ = ["measure"]

SETTLE_S = 0.5
CASES = (9600, 19200)
PROMISE = 0.995
WRITES_PER_S = 10.0
TURNS = 4
"""Turns of each in a round: what is compared differs by less than one turn from the next."""


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure at both baud rates."""
    return [one_case(folder, baud, rounds) for baud in CASES]


def one_case(folder: Path, baud: int, rounds: int) -> Row:
    """Let the journal record every other turn."""
    link, port = folder / f"line-{baud}", free_port()
    roster = write_roster(folder, link, baud=baud, turnaround_ms=2, http=port, journal=True)
    recorded: list[float] = []
    unrecorded: list[float] = []
    with (
        child("support.paced_line", link, "--baud", str(baud), core=OTHER_CORE) as line,
        child("benchmarks.daemon_child", roster, core=MASTER_CORE) as daemon,
    ):
        daemon.ask("online")
        daemon.ask("background", count=1000)
        daemon.ask("writes", per_s=WRITES_PER_S)
        first = daemon.ask("journal", on=True)
        for _ in range(rounds):
            counted: dict[bool, list[float]] = {True: [], False: []}
            for turn in range(2 * TURNS):
                is_on = turn % 4 in (0, 3)
                daemon.ask("journal", on=is_on)
                time.sleep(SETTLE_S)
                counted[is_on].append(cycles_per_s(line))
            recorded.append(sum(counted[True]) / TURNS)
            unrecorded.append(sum(counted[False]) / TURNS)
        last, written = daemon.ask("journal", on=False), daemon.ask("written")
    return Row(
        f"31 drives, {baud} bit/s, with a journal, {WRITES_PER_S:g} writes a second",
        f"{spread(recorded, 4)} cycles/s",
        f"without a journal {spread(unrecorded, 4)}",
        ratios(recorded, unrecorded),
        PROMISE,
        at_least=True,
        digits=4,
        note=f"{last - first} rows, {written} writes done",
    )
