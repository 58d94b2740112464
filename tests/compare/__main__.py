"""`make compare BASE=COMMIT`: proves that the checkout does what a commit did.

    python -m compare --base fab6b02                 all parts
    python -m compare --base fab6b02 --parts http    one part
    python -m compare --base A --to B                two commits

Five parts are recorded on both sides and compared (ADR 60): `proof` (random lines on the virtual
clock: digests of all bytes, times and outcomes), `wire` (31 drives of each family, every byte),
`http` (whole answers over both sockets), `commands` (output and exit statuses) and `families`
(every field). A record is kept in `.compare/records/` as long as nothing that decides it changes.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable

from compare import commands, daemon
from compare.differences import Meant, beginnings, differences, read_meant, shown
from compare.trees import HOME, Side, side_of

PARTS = ("families", "commands", "http", "wire", "proof")
SEEDS = 300
LENGTH_S = 10.0


def inside(side: Side, module: str, *words: str) -> str:
    """Run a recorder on a side's own source and return its record."""
    output = HOME / "records" / f"{os.getpid()}.part"
    command = [str(side.python), "-m", f"compare.inside.{module}"]
    where = [words[0], str(output), *words[1:]] if module == "proof" else [str(output), *words]
    subprocess.run([*command, *where], env=side.environment(), cwd=side.tree, check=True)
    found = output.read_text()
    output.unlink()
    return found


def recorders(asked: argparse.Namespace, base: Side) -> dict[str, Callable[[Side], str]]:
    """Return what records each part of a side, for a comparison with a base."""
    jobs = ("--jobs", str(asked.jobs))
    seeds = f"--first {asked.first} --count {asked.seeds} --length {asked.length}".split()
    return {
        "families": lambda side: inside(side, "families"),
        "commands": lambda side: commands.record(
            side, former=base.tree / "config", jobs=asked.jobs
        ),
        "http": daemon.record,
        "wire": lambda side: inside(side, "proof", "wire", *jobs),
        "proof": lambda side: inside(side, "proof", "seeds", *seeds, *jobs),
    }


def recorded(side: Side, part: str, asked: argparse.Namespace, base: Side) -> str:
    """Return the record of a part of a side: the one kept, or a new one."""
    more = f"-{asked.first}-{asked.seeds}-{asked.length:g}" if part == "proof" else ""
    if part == "commands":
        more = f"-{base.tree.name}"
    kept = HOME / "records" / f"{side.key}-{part}{more}"
    kept.parent.mkdir(parents=True, exist_ok=True)
    if not kept.exists() or asked.fresh:
        begun_s, used_s = time.monotonic(), _processor_s()
        text = recorders(asked, base)[part](side)
        kept.write_text(text)
        took = f"{time.monotonic() - begun_s:.0f} s, processor {_processor_s() - used_s:.0f} s"
        print(f"{part} of {side.name} recorded in {took}", file=sys.stderr, flush=True)
    return kept.read_text()


def _processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def compare(
    base: Side, now: Side, part: str, meant: list[Meant], asked: argparse.Namespace
) -> bool:
    """Compare one part and say how it went; True where nothing differs but what is meant."""
    before, after = (recorded(side, part, asked, base) for side in (base, now))
    found = differences(part, before, after, meant)
    said = f", {found.meant} rows differ as meant" if found.meant else ""
    sections = before.count("\n=== ") + before.startswith("=== ")
    if not found.rows:
        print(f"{part}: equal ({sections} sections{said})", flush=True)
        return True
    file = HOME / f"{part}.diff"
    file.write_text("\n".join(found.rows) + "\n")
    where = f"{len(found.sections)} of {sections} sections"
    print(f"{part}: {len(found.rows)} rows in {where} differ{said}; all of them: {file}")
    if part == "wire":
        print(beginnings(before, after, found.sections), flush=True)
        return False
    print(shown(found), flush=True)
    if part == "proof":  # only digests so far: the first line that differs is run again
        seed = found.sections[0].split()[-1]
        words = ("seed", "--first", seed, "--length", str(asked.length), "--jobs", "1")
        whole = [inside(side, "proof", *words) for side in (base, now)]
        print(beginnings(whole[0], whole[1], [f"seed {seed}"]), flush=True)
    return False


def main() -> int:
    """Compare; the exit status is 1 if anything differs that is not meant."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("make compare", description=__doc__, formatter_class=raw)
    parser.add_argument("--base", required=True, help="the commit that is right")
    parser.add_argument("--to", help="compare this commit, and not the checkout")
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--first", type=int, default=0, help="the first seed of the proof")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="how many")
    parser.add_argument("--length", type=float, default=LENGTH_S, help="seconds a line is run")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--fresh", action="store_true", help="use no record that is kept")
    asked = parser.parse_args()
    parts = asked.parts.split(",")
    if unknown := set(parts) - set(PARTS):
        parser.error(f"there is no part {', '.join(sorted(unknown))}: {', '.join(PARTS)}")
    base, now = side_of(asked.base), side_of(asked.to)
    meant = read_meant()
    print(f"{base.name} and {now.name}", flush=True)
    equal = [compare(base, now, part, meant, asked) for part in parts]
    unused = [one for one in meant if not one.used and one.part in parts]
    for one in unused:
        print(f"meant.yaml: nothing of {one.part} fits `{one.pattern}` any more: remove it")
    return 0 if all(equal) and not unused else 1


if __name__ == "__main__":
    sys.exit(main())
