"""`make mutants`: slips planted in the protocol and the schedule, and how many the tests find.

    python -m mutation.run [--sample 200] [--seed 1] [--jobs 2] [MODULE ..]

mutmut makes the mutants, in a copy of the tree in `.mutants/`; each is run here in a process of its
own, with the tests of its room, those of its module first and then the quick files, until one of
them fails. A mutant that makes a test hang counts as found. There are some 5,000, so a sample is
drawn by the seed; `--sample 0` takes all, in a night. What was run is noted in
`.mutants/results.jsonl`.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
PLACE: Final = ROOT / ".mutants"
TREE: Final = PLACE / "mutants"
PROTOCOL: Final = "lecombus.fieldbus.lecom.protocol"
QUICK: Final = ("request", "rare_ways", "drive_table", "classes", "health", "stops", "polling")
SLOW: Final = ("watchdog_set", "simulation", "starvation", "any_line")
TESTED_BY: Final = {
    "addressing": "codes",
    "arbiter": "lookahead",
    "schedule": "rare_ways",
    "stats": "polling",
    "waiting": "stops",
    "watchdog_deadline": "watchdog_set",
}
"""Modules without a file of tests that has their name."""
SLOWEST_S: Final = 900
GENERATE: Final = """
from mutmut import __main__ as mutmut
mutmut.copy_src_dir()
mutmut.copy_also_copy_files()
mutmut.setup_source_paths()
mutmut.create_mutants(1)
"""
COUNTS_CALLS: Final = "tests/schedule/test_health.py::test_held_lanes_cost_the_same_however_long"
"""Counts calls of functions, of which a mutant has more."""


def generate() -> list[str]:
    """Make all mutants of the present tree; return their names."""
    shutil.rmtree(PLACE, ignore_errors=True)
    PLACE.mkdir()
    for name in ("src", "tests", "pyproject.toml", "README.md"):
        what = ROOT / name
        (shutil.copytree if what.is_dir() else shutil.copy)(what, PLACE / name)
    subprocess.run([sys.executable, "-c", GENERATE], cwd=PLACE, check=True, capture_output=True)
    names: list[str] = []
    for meta in sorted(TREE.rglob("*.meta")):
        names += json.loads(meta.read_text())["exit_code_by_key"]
    return names


def files_for(name: str) -> list[str]:
    """Return the files of tests for a mutant: those of its module first, then the quick ones."""
    room = "tests/protocol" if name.startswith(PROTOCOL) else "tests/schedule"
    module = name.rpartition(".")[0].rpartition(".")[2]
    own = f"test_{TESTED_BY.get(module, module)}"

    def late(file: Path) -> tuple[bool, bool, bool]:
        subject = file.stem.removeprefix("test_")
        return file.stem != own, subject not in QUICK, subject in SLOW

    files = sorted((TREE / room).glob("test_*.py"))
    files.sort(key=late)
    return [str(file.relative_to(TREE)) for file in files]


def is_found(name: str) -> bool:
    """Run the tests on one mutant (an empty name: on none of them) until one fails."""
    words = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider"]
    words += ["--deselect", COUNTS_CALLS, *files_for(name)]
    env = os.environ | {"MUTANT_UNDER_TEST": name, "PYTHONPATH": "src:tests"}
    env["PYTHONDONTWRITEBYTECODE"] = ""  # the mutants make modules long: they are compiled once
    try:
        ended = subprocess.run(
            words, cwd=TREE, env=env, timeout=SLOWEST_S, capture_output=True, check=False
        )
    except subprocess.TimeoutExpired:
        return True
    if ended.returncode not in (0, 1):
        raise RuntimeError(f"{name}: {ended.stdout.decode()[-2000:]}")
    return ended.returncode == 1


def drawn(names: Sequence[str], sample: int, seed: int, modules: Sequence[str]) -> list[str]:
    """Return the mutants of these modules (none named: of all), or a sample of them."""
    wanted = [one for one in names if not modules or any(part in one for part in modules)]
    if not sample or sample >= len(wanted):
        return wanted
    return random.Random(seed).sample(wanted, sample)


def main() -> int:
    """Run; exit status 1 where fewer are found than is wanted."""
    parser = argparse.ArgumentParser(prog="make mutants", description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", help="parts of names; none: all")
    parser.add_argument("--sample", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--wanted", type=float, default=85.0, help="per cent")
    given = parser.parse_args()
    names = generate()
    chosen = drawn(names, given.sample, given.seed, given.modules)
    print(f"{len(names)} mutants, {len(chosen)} of them are run", flush=True)
    found, ran = Counter[str](), Counter[str]()
    with (PLACE / "results.jsonl").open("a") as file, ThreadPoolExecutor(given.jobs) as pool:
        runs = {pool.submit(is_found, name): name for name in chosen}
        for run in as_completed(runs):
            name, is_out = runs[run], run.result()
            module = name.rpartition(".")[0]
            ran[module] += 1
            found[module] += is_out
            file.write(json.dumps({"name": name, "found": is_out}) + "\n")
            file.flush()
            if not is_out:
                print(f"not found: {name}", flush=True)
    for module in sorted(ran):
        print(f"{module:<48}{found[module]:>5} of {ran[module]}")
    part = 100.0 * found.total() / ran.total()
    print(f"{found.total()} of {ran.total()} found: {part:.1f} %")
    return 0 if part >= given.wanted else 1


if __name__ == "__main__":
    sys.exit(main())
