"""Processor time of one exchange when neither line nor drive takes any time.

Strategy: every contender is a process of its own with a pseudo terminal of its own, and one
process answers all of them at once. They take turns, one short turn each, so that whatever else
the machine does befalls all of them alike; the others are stopped meanwhile.

Unpaced means back to back: the daemon is given more to ask for than any line could hold, and says
so if its line falls idle all the same. What an exchange costs that finds the line idle is shown
beside it, with the peer asked as often: both then pay for a sleep, a timer and cold caches, some
three times as much, so an exchange of one kind must never be held against one of the other.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

from support.children import MASTER_CORE, OTHER_CORE, Child, child

from .machine import free_port
from .rosters import DRIVES, write_roster
from .table import Row, ratios, spread

__all__ = ["measure"]

KINDS = ("protocol", "worker", "scheduled", "pymodbus")
COUNT = 3000
TURN_S = 0.5
EVERY_MS = 10
CODES = (
    "C0010", "C0011", "C0012", "C0013", "C0046", "C0050",
    "C0052", "C0053", "C0054", "C0061", "C0068", "C0135", "C0150",
)  # fmt: skip
"""Thirteen codes of 31 drives every 10 ms are 40300 exchanges a second: nobody has those."""
SELDOM_MS = 62
"""One code of 31 drives so often is an exchange every 2 ms, and an idle line between."""


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure all contenders."""
    with contextlib.ExitStack() as stack:
        responder = stack.enter_context(
            child("benchmarks.responder", folder, *KINDS, "daemon", "seldom", core=OTHER_CORE)
        )
        responder.ask("go")
        masters = {
            kind: stack.enter_context(
                child("benchmarks.masters", kind, folder / kind, core=MASTER_CORE)
            )
            for kind in KINDS
        }
        busy = unpaced_roster(folder, "daemon", EVERY_MS, CODES)
        seldom = unpaced_roster(folder, "seldom", SELDOM_MS, ("C0150",))
        daemons = {
            name: stack.enter_context(
                child("benchmarks.daemon_child", roster, "unpaced", core=MASTER_CORE)
            )
            for name, roster in (("daemon", busy), ("seldom", seldom))
        }
        for daemon in daemons.values():
            daemon.ask("online")
            daemon.pause()
        found = take_turns(masters, daemons, rounds)
    return rows(found)


def unpaced_roster(folder: Path, name: str, every_ms: int, codes: Sequence[str]) -> Path:
    """Write the roster of one of the daemons, in a folder of its own."""
    own = folder / f"of-{name}"
    own.mkdir()
    return write_roster(
        own, folder / name, baud=19200, turnaround_ms=0, http=free_port(), every_ms=every_ms,
        codes=codes,
    )  # fmt: skip


def take_turns(
    masters: dict[str, Child], daemons: dict[str, Child], rounds: int
) -> dict[str, list[float]]:
    """Let each do its exchanges in turn; gives microseconds. The first round warms up."""
    found: dict[str, list[float]] = {kind: [] for kind in (*masters, *daemons, "seldom peer")}
    for number in range(rounds + 1):
        turn = {kind: master.ask("spend", count=COUNT) for kind, master in masters.items()}
        for name, daemon in daemons.items():
            daemon.resume()
            turn[name] = daemon.ask("spend", for_s=TURN_S, busy=name == "daemon")
            daemon.pause()
        every_s = SELDOM_MS / 1000 / DRIVES
        count = int(TURN_S / every_s)
        turn["seldom peer"] = masters["pymodbus"].ask("spend", count=count, every_s=every_s)
        for kind, seconds in turn.items():
            if number:
                found[kind].append(seconds * 1e6)
    for daemon in daemons.values():
        daemon.resume()
    return found


def rows(found: dict[str, list[float]]) -> list[Row]:
    """Make the rows of the table."""

    def row(
        name: str, kind: str, peer: str, limit: float | None, note: str, peer_name: str = ""
    ) -> Row:
        mine, theirs = found[kind], found[peer]
        told = f"{peer_name or peer} {us(theirs)}"
        return Row(name, us(mine), told, ratios(mine, theirs), limit, note=note)

    shown = "shown only"
    return [
        row("worker, CPU per exchange", "worker", "protocol", 1.25, ""),
        row("worker with schedule", "scheduled", "protocol", None, shown),
        row("whole daemon, CPU per exchange", "daemon", "pymodbus", 1.5, "aim 1.0"),
        row("the same, line idle between", "seldom", "seldom peer", None, shown, "pymodbus"),
    ]


def us(numbers: Sequence[float]) -> str:
    """Show microseconds."""
    return f"{spread(numbers)} µs"
