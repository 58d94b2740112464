"""Records random lines and lines of 31 drives in virtual time; runs on its own commit's source.

    python -m compare.inside.proof seeds OUTPUT --first 0 --count 300 --length 10
    python -m compare.inside.proof seed OUTPUT --first 17 --length 10
    python -m compare.inside.proof wire OUTPUT --families smvector,93xx

Every telegram, all bytes received and every outcome is one row with its virtual time. An outcome is
written as a user sees it: the outcome's word, or the error's `kind`. No row holds a name of a class
or of a module. Keep this file in step with `proof` when names there change; the rows stay as they
are, because the base commit writes them too.
"""

from __future__ import annotations

import argparse
import asyncio
import hashlib
import logging
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

from lecombus.config import parse_roster
from proof.invariants import Invariants
from proof.lines import ADDRESSES, RandomLine, line_of
from proof.world import run_line

FAMILIES = ("820x", "821x", "822x", "824x", "8200vector", "93xx", "smvector")
DRIVES = 31
FAULTS = "lost=0.01,late=0.01:0.5s:drive,noise=0.01"
WIRE_SEED = 3
WIRE_LENGTH_S = 60.0


def record(line: RandomLine) -> list[str]:
    """Run a line and return its rows."""
    logging.getLogger("lecombus").addHandler(logging.NullHandler())
    rows: list[str] = []
    with _recording(rows):
        found = run_line(line)
    rows += [f"broken {text}" for text in found.broken]
    return rows


@contextmanager
def _recording(rows: list[str]) -> Iterator[None]:
    """Record what the lines that run meanwhile send, receive and answer to their clients."""

    def row(kind: str, what: str) -> None:
        rows.append(f"{asyncio.get_running_loop().time():.9f} {kind} {what}")

    def before(name: str, note: Callable[..., None]) -> Any:
        usual = getattr(Invariants, name)

        def noted(self: Invariants, *args: Any) -> Any:
            note(*args)
            return usual(self, *args)

        return mock.patch.object(Invariants, name, noted)

    with (
        before("said", lambda data: row(">", data.hex())),
        before("heard", lambda data: row("<", data.hex())),
        before("answered", lambda outcome: row("outcome", _word(outcome))),
        before("told_address", lambda drive, wanted, told: row("read", f"{drive} {told}")),
        before("stop_ended", lambda drive, outcome, asked_s: row("stop", _word(outcome))),
    ):
        yield


def _word(outcome: str) -> str:
    """Return an outcome as the API writes it; an error by its kind."""
    error = sys.exc_info()[1]
    return str(outcome) if error is None else f"error {getattr(error, 'kind', '')}"


def full_line(family: str) -> RandomLine:
    """Return the paced line of 31 drives of one family, with writes, stops and lost answers."""
    drives = [f"d{address}" for address in ADDRESSES[:DRIVES]]
    entries = "".join(
        f"  - {{name: {name}, address: {name[1:]}, family: {family}, "
        f"watchdog: {{time: 30s, action: quick-stop, configure: true}}"
        f"{'' if family == 'smvector' else ', also_writable: [C0012]'}}}\n"
        for name in drives
    )
    groups = f"groups:\n  g1: {{members: [{', '.join(drives[:9])}]}}\n"
    head = "line: {name: l, port: 'sim:', baud: 19200, turnaround: 2ms, retries: 2}\n"
    roster = parse_roster(f"{head}drives:\n{entries}{groups}", "r.yaml")
    return RandomLine(WIRE_SEED, "faulty", roster, FAULTS, WIRE_LENGTH_S)


def digest(seed: int, length_s: float) -> str:
    """Return the section of a random line: how many rows it has, and their digest."""
    rows = record(line_of(seed, length_s))
    found = hashlib.sha256("\n".join(rows).encode()).hexdigest()[:32]
    broken = sum(row.startswith("broken") for row in rows)
    return f"=== seed {seed}\n{len(rows)} rows, {found}, {broken} broken\n"


def whole_seed(seed: int, length_s: float) -> str:
    """Return the section of a random line with all its rows."""
    return "\n".join([f"=== seed {seed}", *record(line_of(seed, length_s)), ""])


def whole_family(family: str, length_s: float) -> str:
    """Return the section of a full line with all its rows."""
    line = full_line(family)
    line = RandomLine(line.seed, line.kind, line.roster, line.faults, length_s)
    return "\n".join([f"=== {family}", *record(line), ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("seeds", "seed", "wire"))
    parser.add_argument("output", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--length", type=float, default=WIRE_LENGTH_S)
    parser.add_argument("--families", default=",".join(FAMILIES))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    seeds = range(asked.first, asked.first + asked.count)
    with ProcessPoolExecutor(asked.jobs) as pool:
        sections: Iterator[str]
        if asked.what == "wire":
            one = partial(whole_family, length_s=asked.length)
            sections = pool.map(one, asked.families.split(","))
        else:
            made = digest if asked.what == "seeds" else whole_seed
            sections = pool.map(partial(made, length_s=asked.length), seeds)
        asked.output.write_text("".join(sections))
    return 0


if __name__ == "__main__":
    sys.exit(main())
