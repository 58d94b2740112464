"""Processor time of one exchange when neither line nor drive takes any time.

Strategy: every contender is a process of its own with a pseudo terminal of its own, and one
process answers all of them at once. They take turns, one short turn each, so that whatever else
the machine does befalls all of them alike; the others are stopped meanwhile.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

from .children import MASTER_CORE, Child, child
from .machine import free_port
from .rosters import write_roster
from .table import Row, ratios, spread

__all__ = ["measure"]

KINDS = ("protocol", "worker", "scheduled", "pymodbus")
COUNT = 3000
TURN_S = 0.5


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure all contenders."""
    roster = write_roster(
        folder, folder / "daemon", baud=19200, turnaround_ms=0, http=free_port(), every_ms=10
    )
    with contextlib.ExitStack() as stack:
        responder = stack.enter_context(child("responder", folder, *KINDS, "daemon"))
        responder.ask("go")
        masters = {
            kind: stack.enter_context(child("masters", kind, folder / kind, core=MASTER_CORE))
            for kind in KINDS
        }
        daemon = stack.enter_context(child("daemon_child", roster, "unpaced", core=MASTER_CORE))
        daemon.ask("online")
        found = take_turns(masters, daemon, rounds)
    return rows(found)


def take_turns(masters: dict[str, Child], daemon: Child, rounds: int) -> dict[str, list[float]]:
    """Let each do its exchanges in turn; gives microseconds. The first round warms up."""
    found: dict[str, list[float]] = {kind: [] for kind in (*masters, "daemon")}
    daemon.pause()
    for number in range(rounds + 1):
        turn = {kind: master.ask("spend", count=COUNT) for kind, master in masters.items()}
        daemon.resume()
        turn["daemon"] = daemon.ask("spend", for_s=TURN_S)
        daemon.pause()
        for kind, seconds in turn.items():
            if number:
                found[kind].append(seconds * 1e6)
    daemon.resume()
    return found


def rows(found: dict[str, list[float]]) -> list[Row]:
    """Make the rows of the table."""

    def row(name: str, kind: str, peer: str, limit: float | None, note: str = "") -> Row:
        mine, theirs = found[kind], found[peer]
        return Row(name, us(mine), f"{peer} {us(theirs)}", ratios(mine, theirs), limit, note=note)

    return [
        row("worker, CPU per exchange", "worker", "protocol", 1.25),
        row("worker with schedule", "scheduled", "protocol", None, "shown only"),
        row("whole daemon, CPU per exchange", "daemon", "pymodbus", 1.5, "aim 1.0"),
    ]


def us(numbers: Sequence[float]) -> str:
    """Show microseconds."""
    return f"{spread(numbers)} µs"
