"""How much faster than real time the virtual world of the proof runs: 31 drives at 19200 baud."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path

from proof.lines import RandomLine
from proof.world import run_line
from support.paced_line import drives
from support.rosters import make_roster

from .table import Row, spread

__all__ = ["measure"]

LENGTH_S = 300.0
PROMISE = 200.0
SAME_ADAPTER = 16
"""Seeds so far apart have the same adapter, which gathers what comes for 8 ms."""


def measure(folder: Path, rounds: int) -> list[Row]:
    """Run the same busy line again and again."""
    logging.getLogger("lecombus").addHandler(logging.NullHandler())
    line = busy_line()
    speeds = []
    exchanges = 0
    for number in range(rounds):
        found = run_line(dataclasses.replace(line, seed=number * SAME_ADAPTER))
        assert not found.broken, found.broken
        speeds.append(found.line_s / found.took_s)
        exchanges = found.exchanges
    row = Row(
        "virtual world, 31 drives, 19200 bit/s, one core",
        f"{spread(speeds, 0)} x real time",
        "real time",
        sorted(speeds)[len(speeds) // 2],
        PROMISE,
        at_least=True,
        digits=0,
        note=f"{exchanges} exchanges in {LENGTH_S:.0f} s of line time, and the start before it",
    )
    return [row]


def busy_line() -> RandomLine:
    """A full line whose cyclic reads keep it about half busy."""
    roster = make_roster(drives(31), watchdog="{time: 4s, action: quick-stop}")
    return RandomLine(0, "quiet", roster, "", LENGTH_S)
