"""`make proof`: many hours of many lines, resumable, and one seed again.

    python -m proof.run --hours 1000        goes on where it stopped
    python -m proof.run --first 500         seeds that CI does not run
    python -m proof.run --seed 1234         one line again, with what broke
    python -m proof.run --seed 18 --tolerate 2 [--losses 3]    one line of lost answers again
    python -m proof.run --leases            10,000 lines whose drives have leases, resumable too
    python -m proof.run --leases --seed 7   one of them again
    python -m proof.run --mutants           every mutant on the lines that show it

Besides the random lines it runs lines whose watchdogs just outlast 0 to 3 lost answers, with as
many answers lost at the worst moments, and with one more (`losses`). Upon one more a watchdog may
act: that is counted, and no finding.

Every line that was run stands in `.proof/done.jsonl`, with the digest of the program it was of, as
soon as it has ended: it may be stopped at any time, and goes on with the lines that are missing.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import math
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import count, islice
from pathlib import Path
from typing import Any, NamedTuple

import lecombus
from proof.lease_lines import leased_line
from proof.lease_mutants import LEASE_MUTANTS
from proof.lines import RandomLine, line_of
from proof.losses import MOST_TOLERATED, tolerant_line
from proof.mutants import MUTANTS, applied
from proof.world import Finding, run_line

RECORD = Path(".proof/done.jsonl")
LENGTH_S = 120.0
LEASED_LINES = 10_000
AHEAD = 3
"""Lines handed out for each process: none waits for the slowest."""
LINES_EACH = 200
"""After so many a process is replaced: what it has kept by then is of no more use."""
SAY_EVERY_S = 3600.0
MUTANT_LENGTH_S = 60.0
DECIDES_NOTHING = frozenset({
    "api", "backups", "bridges", "cli", "client", "config", "daemon.py", "demo.py", "fleet",
    "journal", "metrics", "saved_state", "tokens",
})  # fmt: skip
"""Rooms that no line of the proof runs, or that only read rosters, count, show and keep."""
LOST_EVERY = 4
"""Behind so many random lines goes one with lost answers, and one with one more."""
STOPPED, CHANGED = 130, 2
ACTED = "the watchdog of "


class Asked(NamedTuple):
    """A line to be run: a random one, with leases or not, or one that outlasts lost answers."""

    seed: int
    tolerate: int | None = None
    losses: int = 0
    leased: bool = False

    def line(self, length_s: float) -> RandomLine:
        """Draw it."""
        if self.leased:
            return leased_line(self.seed, length_s)
        if self.tolerate is None:
            return line_of(self.seed, length_s)
        return tolerant_line(
            self.seed, tolerate=self.tolerate, losses=self.losses, length_s=length_s
        )

    @property
    def is_beyond(self) -> bool:
        """Whether more answers are lost than are tolerated."""
        return self.tolerate is not None and self.losses > self.tolerate

    def __str__(self) -> str:
        """Say how it is run again."""
        if self.leased:
            return f"--leases --seed {self.seed}"
        if self.tolerate is None:
            return f"--seed {self.seed}"
        return f"--seed {self.seed} --tolerate {self.tolerate} --losses {self.losses}"


def asked_from(first: int, *, leased: bool = False) -> Iterator[Asked]:
    """Give the lines to be run, without end."""
    for seed in count(first):
        yield Asked(seed, leased=leased)
        if leased:
            continue
        if seed % LOST_EVERY == LOST_EVERY - 1:
            tolerate = seed // LOST_EVERY % (MOST_TOLERATED + 1)
            yield Asked(seed, tolerate, tolerate)
            yield Asked(seed, tolerate, tolerate + 1)


def program() -> str:
    """The digest of everything that is proven here, and of what proves it.

    What decides neither a telegram nor its time is left out: hours count on when only that changes.
    """
    digest = hashlib.sha256()
    proof = Path(__file__).parent
    daemon = Path(lecombus.__file__).parent
    for home in (daemon, proof, proof.parent / "support"):
        for file in sorted([*home.rglob("*.py"), *home.rglob("*.yaml")]):
            part = file.relative_to(home).parts[0]
            tries = part.startswith("test_") or part.endswith("mutants.py")
            if part not in DECIDES_NOTHING if home is daemon else not tries:
                digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def prove(seed: int, length_s: float = LENGTH_S) -> Finding:
    """Run the random line of a seed."""
    return prove_asked(Asked(seed), length_s)


def prove_asked(asked: Asked, length_s: float) -> Finding:
    """Run a line; what the daemon logs of it is of no use here."""
    logging.getLogger("lecombus").addHandler(logging.NullHandler())
    return run_line(asked.line(length_s))


def _from(least: int) -> Callable[[str], int]:
    """Make what reads a whole number that is not too small."""

    def number(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r}: a whole number from {least} on")
        return int(text)

    return number


def _arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m proof.run", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--hours", type=float, default=10.0, help="hours of line time in all")
    parser.add_argument("--seed", type=int, help="run this line alone")
    parser.add_argument(
        "--tolerate", type=int, choices=range(MOST_TOLERATED + 1),
        help="with --seed: the line whose watchdogs outlast so many lost answers",
    )  # fmt: skip
    parser.add_argument("--losses", type=_from(0), help="lost answers; else as many as tolerated")
    parser.add_argument("--length", type=float, default=LENGTH_S, help="seconds a line is run")
    parser.add_argument("--first", type=_from(0), default=0, help="seeds from this one on")
    parser.add_argument(
        "--jobs", type=_from(1), default=os.cpu_count() or 1, help="processes, one a core"
    )
    parser.add_argument("--mutants", action="store_true", help="run the mutants instead")
    parser.add_argument("--leases", action="store_true", help="lines whose drives have leases")
    parser.add_argument(
        "--lines", type=_from(1), default=LEASED_LINES, help="with --leases: so many in all"
    )
    return parser


class Record:
    """What this very program has run, in this sitting and before.

    Args:
        of: The digest of the program.
        leased: Only lines with leases count, else only those without.
    """

    def __init__(self, of: str, *, leased: bool = False) -> None:
        self.of = of
        self.leased = leased
        self.done: dict[Asked, dict[str, Any]] = {}
        for text in RECORD.read_text().splitlines() if RECORD.exists() else ():
            try:
                row = json.loads(text)
            except ValueError:  # torn: it was being written when the computer stopped
                continue
            if row["program"] == of and bool(row.get("leases")) is leased:
                asked = Asked(row["seed"], row.get("tolerate"), row.get("losses", 0), leased)
                self.done[asked] = row

    @property
    def line_s(self) -> float:
        """Line time of all of them, seconds."""
        return float(sum(row["line_s"] for row in self.done.values()))

    def note(self, asked: Asked, found: Finding) -> tuple[str, ...]:
        """Note a line that has ended; give what broke."""
        broken = found.broken
        acted = sum(ACTED in text for text in broken) if asked.is_beyond else 0
        if asked.is_beyond:
            broken = tuple(text for text in broken if ACTED not in text)
        row: dict[str, Any] = {
            "program": self.of, "seed": asked.seed, "kind": found.line.kind,
            "line_s": round(found.line_s, 1), "exchanges": found.exchanges,
            "took_s": round(found.took_s, 2), "broken": list(broken),
        }  # fmt: skip
        if asked.tolerate is not None:
            row |= {"tolerate": asked.tolerate, "losses": asked.losses, "acted": acted}
        if found.leases:
            row["leases"] = found.leases
        self.done[asked] = row
        RECORD.parent.mkdir(exist_ok=True)
        with RECORD.open("a") as file:
            file.write(json.dumps(row) + "\n")
        return broken

    def say(self, wanted_s: float) -> bool:
        """Say in plain words how far the proof is, and what it found; whether nothing broke."""
        rows, hours = self.done.values(), self.line_s / 3600.0
        of = "" if math.isinf(wanted_s) else f"of {wanted_s / 3600.0:g} "
        kinds = ", ".join(f"{n} {kind}" for kind, n in Counter(r["kind"] for r in rows).items())
        print(
            f"program {self.of}: {hours:.2f} {of}hours of line time, "
            f"{len(rows)} lines ({kinds or 'none'}), {sum(r['exchanges'] for r in rows)} exchanges"
        )
        for tolerate in range(MOST_TOLERATED + 1):
            self._say_lost(tolerate)
        if self.leased:
            self._say_leases()
        broken = {asked: row["broken"] for asked, row in self.done.items() if row["broken"]}
        for asked, texts in broken.items():
            print(f"broken: {asked}: {texts[0]}")
        if not broken:
            print("nothing was found broken")
        else:
            print(f"{len(broken)} lines broken; one again: make proof ARGS='{next(iter(broken))}'")
        return not broken

    def _say_leases(self) -> None:
        """Say what the lines have shown of leases."""
        total: Counter[str] = Counter()
        for row in self.done.values():
            total.update({name: n for name, n in row["leases"].items() if name != "latest"})
        latest = max((row["leases"]["latest"] for row in self.done.values()), default=0.0)
        print(", ".join(f"{n} {name}" for name, n in total.items()))
        print(f"the latest stop of a lapse began after {latest:.0%} of its bound")

    def _say_lost(self, tolerate: int) -> None:
        of = [(asked, row) for asked, row in self.done.items() if asked.tolerate == tolerate]
        held = [row for asked, row in of if not asked.is_beyond]
        beyond = [row for asked, row in of if asked.is_beyond]
        if of:
            acted = sum(any(ACTED in text for text in row["broken"]) for row in held)
            more = sum(bool(row["acted"]) for row in beyond)
            print(
                f"line.tolerate {tolerate}: with so many lost answers a watchdog acted on "
                f"{acted} of {len(held)} lines, with one more on {more} of {len(beyond)}"
            )


def main() -> int:
    """Prove as asked; the exit status is 1 if anything broke."""
    parser = _arguments()
    args = parser.parse_args()
    if args.mutants:
        return _mutants()
    if args.seed is not None:
        losses = args.tolerate or 0 if args.losses is None else args.losses
        return _again(Asked(args.seed, args.tolerate, losses, args.leases), args.length)
    if args.tolerate is not None or args.losses is not None:
        parser.error("--tolerate and --losses need --seed")
    if args.leases:
        return _many_leased(args.lines, args.length, args.jobs, args.first)
    return _many(args.hours * 3600.0, args.length, args.jobs, args.first)


def _again(asked: Asked, length_s: float) -> int:
    found = prove_asked(asked, length_s)
    print(f"{found.line}: {found.exchanges} exchanges in {found.line_s:.0f} s of line time")
    print(f"  digest of all that was said and heard: {found.digest}")
    near = ", ".join(f"{row} {part:.0%}" for row, part in sorted(found.most.items()))
    print(f"  nearest to what was promised: {near or 'nothing is judged on such a line'}")
    for text in found.broken:
        print(f"  {text}")
    return 1 if found.broken else 0


def _mutants() -> int:
    """Run every mutant on the lines that show it; the exit status is 1 if one was not found out."""
    missed = 0
    for name, mutant in (MUTANTS | LEASE_MUTANTS).items():
        noticed = 0
        for seed in mutant.seeds:
            with applied(mutant):
                broken = run_line(mutant.line(seed, MUTANT_LENGTH_S)).broken
            noticed += bool(broken)
            print(f"{name}, seed {seed}: {broken[0] if broken else 'not noticed'}", flush=True)
        missed += not noticed
    return 1 if missed else 0


def _many(wanted_s: float, length_s: float, jobs: int, first: int) -> int:
    record = Record(program())
    return _run_to(record, lambda: record.line_s >= wanted_s, wanted_s, length_s, jobs, first)


def _many_leased(lines: int, length_s: float, jobs: int, first: int) -> int:
    record = Record(program(), leased=True)
    wanted_s = math.inf  # lines are counted, not hours
    return _run_to(record, lambda: len(record.done) >= lines, wanted_s, length_s, jobs, first)


def _run_to(
    record: Record,
    is_enough: Callable[[], bool],
    wanted_s: float,
    length_s: float,
    jobs: int,
    first: int,
) -> int:
    print(f"{record.line_s / 3600:.2f} h of this program so far", file=sys.stderr, flush=True)
    try:
        status = _run_many(record, is_enough, length_s, jobs, first)
    except BrokenProcessPool:
        text = f"the program is no longer {record.of}, or a process was killed: begin again"
        print(text, flush=True)
        status = CHANGED
    sound = record.say(wanted_s)
    return status or (0 if sound else 1)


def _run_many(
    record: Record, is_enough: Callable[[], bool], length_s: float, jobs: int, first: int
) -> int:
    said_s, of = record.line_s, record.of
    asked_for = asked_from(first, leased=record.leased)
    missing = (asked for asked in asked_for if asked not in record.done)
    with ProcessPoolExecutor(
        jobs, max_tasks_per_child=LINES_EACH, initializer=_begin_process, initargs=(of,)
    ) as pool:
        under_way: dict[Future[Finding], Asked] = {}
        try:
            while not is_enough():
                for asked in islice(missing, AHEAD * jobs - len(under_way)):
                    under_way[pool.submit(prove_asked, asked, length_s)] = asked
                wait(under_way, return_when=FIRST_COMPLETED)
                _take_ended(record, under_way)
                if record.line_s >= said_s + SAY_EVERY_S:
                    said_s = record.line_s
                    print(f"{said_s / 3600:.2f} h", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            print("ends with the lines that are under way", file=sys.stderr, flush=True)
            pool.shutdown(cancel_futures=True)
            _take_ended(record, under_way)
            return STOPPED
        pool.shutdown(cancel_futures=True)
        _take_ended(record, under_way)
    return 0


def _begin_process(of: str) -> None:
    """Begin a process only for the program that is being proven: somebody may have changed it.

    Ctrl-C goes to all processes of a terminal; only the first one acts upon it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if program() != of:
        raise SystemExit(f"the program is no longer {of}: begin again")


def _take_ended(record: Record, under_way: dict[Future[Finding], Asked]) -> None:
    """Note the lines that have ended, the first seeds first."""
    ended = [(asked, one) for one, asked in under_way.items() if one.done()]
    for asked, one in sorted(ended, key=lambda pair: pair[0].seed):
        del under_way[one]
        if one.cancelled():
            continue
        found = one.result()
        for text in record.note(asked, found):
            print(f"{found.line} ({asked}): {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
