"""`make faults`: puts every class of faults into a running daemon, and shows what was seen.

    python -m faults.run [PART OF A NAME ..] [--table]

One daemon on three simulated drives, with clients that read, write and stop all the time; after
each class all must be good again. `--table` prints Markdown, as docs/reliability.md has it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable

from faults.bench import Bench, Seen
from faults.classes import CLASSES, FaultClass
from support.children import take_priority

__all__ = ["chosen", "main", "put_in"]


def put_in(classes: Iterable[FaultClass]) -> Iterable[tuple[FaultClass, str, Seen]]:
    """Put classes of faults in, one after the other; give each with what was put in and seen."""
    wanted = list(classes)
    while wanted:
        with Bench() as bench:
            while wanted:
                one = wanted.pop(0)
                what = ""
                with bench.watched(
                    may_fire=one.may_fire, may_cut=one.may_cut, clients=one.clients
                ) as seen:
                    what = one.inject(bench, seen)
                yield one, what, seen
                if seen.broken:
                    break  # with a new daemon


def chosen(parts: list[str]) -> list[FaultClass]:
    """Return the classes whose names or areas have one of these in them; all if there is none."""
    return [
        one
        for one in CLASSES.values()
        if not parts or any(part in f"{one.area} {one.name}" for part in parts)
    ]


def main() -> int:
    """Run; exit status 1 where something that was promised did not hold."""
    parser = argparse.ArgumentParser(prog="make faults", description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", help="parts of names or areas; none: all")
    parser.add_argument("--table", action="store_true", help="print Markdown")
    given = parser.parse_args()
    take_priority()
    broken = 0
    if given.table:
        print("| area | fault | put in | promised | seen |\n|---|---|---|---|---|")
    for one, what, seen in put_in(chosen(given.parts)):
        broken += bool(seen.broken)
        bad = f" **BROKEN: {'; '.join(seen.broken)}**" if seen.broken else ""
        if given.table:
            print(f"| {one.area} | {one.name} | {what} | {one.promised} | {seen.text}{bad} |")
        else:
            print(f"{one.area}: {one.name}\n  put in: {what}\n  seen: {seen.text}{bad}")
        sys.stdout.flush()
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
