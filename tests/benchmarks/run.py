"""`make bench`: every figure that lecombus promises, measured beside its peers in one run.

Takes about half an hour. Nothing is promised of a machine that is busy with something else: the
table says how busy it was. `--write` puts the table into docs/figures.md; `--only` measures some
of the figures (cycles, stops, worlds ..), `--quick` all with two rounds, for a look.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
from collections.abc import Callable
from datetime import date
from pathlib import Path

from support.children import OTHER_CORE, ROOT, pin

from .cycles import measure as cycles
from .efficiency import measure as efficiency
from .exchanges import measure as exchanges
from .fleet import measure as fleet
from .journal import measure as journal
from .machine import Noise, describe
from .promises import measure as promises
from .queues import measure as queues
from .readers import measure as readers
from .starts import measure as starts
from .stops import measure as stops
from .table import Row, render
from .worlds import measure as worlds

__all__ = ["main"]

ROUNDS = 5
PARTS: dict[str, Callable[[Path, int], list[Row]]] = {
    "exchanges": exchanges,
    "cycles": cycles,
    "journal": journal,
    "stops": stops,
    "starts": starts,
    "queues": queues,
    "worlds": worlds,
    "efficiency": efficiency,
    "readers": readers,
    "promises": promises,
    "fleet": fleet,
}
FIGURES = ROOT / "docs" / "figures.md"

PREFACE = """\
# Figures

Measured by `make bench`: medians of {rounds} rounds (least and most in brackets), lecombus and the
peers in turn in the same run, ratios taken round by round. {date}, {machine}.
During the run {noise}.

`CPU per exchange` is without pauses: one exchange after the other, each answer in one piece. On a
paced line the process sleeps between bytes and telegrams, and an exchange takes some 13 times as
much, 2 to 3 % of a busy computer's core for a full line: why, says
[ADR 29](adr/0029-processor-time.md#on-a-line-that-takes-its-time).

"""


def main() -> int:
    """Measure, and print one table; 1 when a promise was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"also write {FIGURES.name}")
    parser.add_argument("--quick", action="store_true", help="two rounds of each")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    wanted = parser.parse_args()
    rounds = 2 if wanted.quick else ROUNDS
    pin(OTHER_CORE)
    noise = Noise()
    rows: list[Row] = []
    for part in wanted.only:
        print(f"measuring {part} ..", file=sys.stderr)
        with tempfile.TemporaryDirectory(prefix="lb-") as folder:
            rows += PARTS[part](Path(folder), rounds)
    used = resource.getrusage(resource.RUSAGE_CHILDREN), resource.getrusage(resource.RUSAGE_SELF)
    children_s = sum(one.ru_utime + one.ru_stime for one in used)
    text = PREFACE.format(
        rounds=rounds, date=date.today(), machine=describe(), noise=noise.report(children_s)
    )
    text += render(rows) + "\n"
    print(text)
    if wanted.write:
        FIGURES.write_text(text)
    return 0 if all(row.met for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
