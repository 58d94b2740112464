"""`make proof`: many hours of many lines, resumable, and one seed again.

    python -m proof.run --hours 1000        goes on where it stopped
    python -m proof.run --first 500         seeds that CI does not run
    python -m proof.run --seed 1234         one line again, with what broke

Every line that was run stands in `.proof/done.jsonl`, with the digest of the program it was of.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import count, islice
from pathlib import Path

import lecombus
from proof.lines import line_of
from proof.world import Finding, run_line

RECORD = Path(".proof/done.jsonl")
LENGTH_S = 120.0


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
    parser.add_argument("--jobs", type=_from(1), default=1, help="processes")
    return parser


def _done(of: str) -> dict[int, float]:
    """Read which seeds this very program has run, and for how long."""
    if not RECORD.exists():
        return {}
    rows = [json.loads(row) for row in RECORD.read_text().splitlines() if row.strip()]
    return {row["seed"]: row["line_s"] for row in rows if row["program"] == of}


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


def _many(wanted_s: float, length_s: float, jobs: int, first: int) -> int:
    of = program()
    done = _done(of)
    line_s, broken = sum(done.values()), 0
    print(f"{line_s / 3600:.2f} h of this program so far", file=sys.stderr, flush=True)
    seeds = (seed for seed in count(first) if seed not in done)
    with ProcessPoolExecutor(jobs) as pool:
        while line_s < wanted_s:
            batch = list(islice(seeds, 8 * jobs))
            for found in pool.map(prove, batch, [length_s] * len(batch)):
                _note(found, of)
                line_s += found.line_s
                broken += bool(found.broken)
                for text in found.broken:
                    print(f"{found.line}: {text}", flush=True)
            print(f"{line_s / 3600:.2f} h, {broken} lines broken", file=sys.stderr, flush=True)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
