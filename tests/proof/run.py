"""`make proof`: many hours of many lines, resumable, and one seed again.

    python -m proof.run --hours 1000        goes on where it stopped
    python -m proof.run --first 500         seeds that CI does not run
    python -m proof.run --seed 1234         one line again, with what broke
    python -m proof.run --mutants           every mutant on the lines that show it

Every line that was run stands in `.proof/done.jsonl`, with the digest of the program it was of, as
soon as it has ended: it may be stopped at any time, and goes on with the lines that are missing.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import count, islice
from pathlib import Path

import lecombus
from proof.lines import line_of
from proof.mutants import MUTANTS, mutated
from proof.world import Finding, run_line

RECORD = Path(".proof/done.jsonl")
LENGTH_S = 120.0
AHEAD = 3
"""Lines handed out for each process: none waits for the slowest."""
LINES_EACH = 200
"""After so many a process is replaced: what it has kept by then is of no more use."""
SAY_EVERY_S = 3600.0
MUTANT_LENGTH_S = 60.0


def program() -> str:
    """The digest of everything that is proven here, and of what proves it."""
    digest = hashlib.sha256()
    proof = Path(__file__).parent
    for home in (Path(lecombus.__file__).parent, proof, proof.parent / "support"):
        for file in sorted([*home.rglob("*.py"), *home.rglob("*.yaml")]):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def prove(seed: int, length_s: float = LENGTH_S) -> Finding:
    """Run the line of a seed; what the daemon logs of it is of no use here."""
    logging.getLogger("lecombus").addHandler(logging.NullHandler())
    return run_line(line_of(seed, length_s))


def _from(least: int) -> Callable[[str], int]:
    """Make what reads a whole number that is not too small."""

    def number(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r}: a whole number from {least} on")
        return int(text)

    return number


def _hours() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m proof.run", description=__doc__)
    parser.add_argument("--hours", type=float, default=10.0, help="hours of line time in all")
    parser.add_argument("--seed", type=int, help="run this line alone")
    parser.add_argument("--length", type=float, default=LENGTH_S, help="seconds a line is run")
    parser.add_argument("--first", type=_from(0), default=0, help="seeds from this one on")
    parser.add_argument(
        "--jobs", type=_from(1), default=os.cpu_count() or 1, help="processes, one a core"
    )
    parser.add_argument("--mutants", action="store_true", help="run the mutants instead")
    return parser


def _done(of: str) -> dict[int, float]:
    """Read which seeds this very program has run, and for how long; a torn last row is none."""
    if not RECORD.exists():
        return {}
    found = {}
    for text in RECORD.read_text().splitlines():
        try:
            row = json.loads(text)
        except ValueError:
            continue
        if row["program"] == of:
            found[row["seed"]] = row["line_s"]
    return found


def _note(found: Finding, of: str) -> None:
    RECORD.parent.mkdir(exist_ok=True)
    row = {
        "program": of, "seed": found.line.seed, "kind": found.line.kind,
        "line_s": round(found.line_s, 1), "exchanges": found.exchanges,
        "took_s": round(found.took_s, 2), "broken": list(found.broken),
    }  # fmt: skip
    with RECORD.open("a") as file:
        file.write(json.dumps(row) + "\n")


def main() -> int:
    """Prove as asked; the exit status is 1 if anything broke."""
    asked = _hours().parse_args()
    if asked.mutants:
        return _mutants()
    if asked.seed is not None:
        found = prove(asked.seed, asked.length)
        print(f"{found.line}: {found.exchanges} exchanges in {found.line_s:.0f} s of line time")
        print(f"  digest of all that was said and heard: {found.digest}")
        near = ", ".join(f"{row} {part:.0%}" for row, part in sorted(found.most.items()))
        print(f"  nearest to what was promised: {near or 'nothing is judged on such a line'}")
        for text in found.broken:
            print(f"  {text}")
        return 1 if found.broken else 0
    return _many(asked.hours * 3600.0, asked.length, asked.jobs, asked.first)


def _mutants() -> int:
    """Run every mutant on the lines that show it; the exit status is 1 if one was not found out."""
    missed = 0
    for name, mutant in MUTANTS.items():
        noticed = 0
        for seed in mutant.seeds:
            with mutated(name):
                broken = prove(seed, MUTANT_LENGTH_S).broken
            noticed += bool(broken)
            print(f"{name}, seed {seed}: {broken[0] if broken else 'not noticed'}", flush=True)
        missed += not noticed
    return 1 if missed else 0


def _many(wanted_s: float, length_s: float, jobs: int, first: int) -> int:
    of = program()
    done = _done(of)
    line_s, broken, said_s = sum(done.values()), 0, 0.0
    print(f"{line_s / 3600:.2f} h of this program so far", file=sys.stderr, flush=True)
    seeds = (seed for seed in count(first) if seed not in done)
    with ProcessPoolExecutor(
        jobs, max_tasks_per_child=LINES_EACH, initializer=_check_program, initargs=(of,)
    ) as pool:
        under_way: set[Future[Finding]] = set()
        while line_s < wanted_s:
            more = islice(seeds, AHEAD * jobs - len(under_way))
            under_way |= {pool.submit(prove, seed, length_s) for seed in more}
            for found in _ended(under_way):
                _note(found, of)
                line_s += found.line_s
                broken += bool(found.broken)
                for text in found.broken:
                    print(f"{found.line}: {text}", flush=True)
            if line_s >= said_s + SAY_EVERY_S or line_s >= wanted_s:
                said_s = line_s
                print(f"{line_s / 3600:.2f} h, {broken} lines broken", file=sys.stderr, flush=True)
        pool.shutdown(cancel_futures=True)
    return 1 if broken else 0


def _check_program(of: str) -> None:
    """Begin a process only for the program that is being proven: somebody may have changed it."""
    if program() != of:
        raise SystemExit(f"the program is no longer {of}: begin again")


def _ended(under_way: set[Future[Finding]]) -> Iterator[Finding]:
    """Wait for one line at least; take those that have ended out, the first seeds first."""
    ended, _ = wait(under_way, return_when=FIRST_COMPLETED)
    under_way -= ended
    yield from sorted((one.result() for one in ended), key=lambda found: found.line.seed)


if __name__ == "__main__":
    sys.exit(main())
