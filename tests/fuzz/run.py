"""`make fuzz`: feeds every entry point with inputs that coverage guides, and shows what escaped.

    python -m fuzz.run [TARGET ..] [--seconds 60] [--runs N] [--keep]

Each target runs in a process of its own at idle priority, on atheris (libFuzzer). An input that
raises what is not documented, takes longer than `HANG_S`, or takes more than `MOST_MB` ends the
target's run and is an escape; its input is kept in `.fuzz/` and is run again by `--replay FILE`.
`--keep` adds what found new code to `tests/fuzz/corpus/`, the shortest inputs first.
"""

from __future__ import annotations

import argparse
import json
import logging
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fuzz import corpus

ROOT: Final = Path(__file__).resolve().parents[2]
RECORD: Final = ROOT / ".fuzz"
HANG_S: Final = 5
MOST_MB: Final = 1024
_RUNS = re.compile(r"stat::number_of_executed_units:\s*(\d+)")
_COVERED = re.compile(r"cov: (\d+)")
ESCAPES = ("Uncaught Python exception", "ERROR: libFuzzer", "==ERROR")


@dataclass
class Ran:
    """What came of one target."""

    name: str
    inputs: int
    seconds: float
    covered: int
    escaped: str


def main() -> int:
    """Run what was asked for; exit status 1 where something escaped."""
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", help="all, if none is named")
    parser.add_argument("--seconds", type=float, default=60.0, help="for each target")
    parser.add_argument("--runs", type=int, default=0, help="inputs for each target; 0: no limit")
    parser.add_argument("--keep", action="store_true", help="add to the inputs in the tree")
    parser.add_argument("--replay", type=Path, help="run one input again, of the target named")
    parser.add_argument("--child", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        return fuzz(given.child[0], given.child[1:])
    from fuzz.targets import TARGETS

    names = given.targets or list(TARGETS)
    unknown = [name for name in names if name not in TARGETS]
    if unknown:
        parser.error(f"no such target: {', '.join(unknown)}; there are {', '.join(TARGETS)}")
    if given.replay is not None:
        TARGETS[names[0]].check(given.replay.read_bytes())
        print("nothing escaped")
        return 0
    RECORD.mkdir(exist_ok=True)
    print(f"{'target':<11}{'inputs':>12}{'seconds':>9}{'branches':>10}  escaped", flush=True)
    escaped = False
    for name in names:
        ran = run(name, given.seconds, given.runs, keep=given.keep)
        escaped = escaped or bool(ran.escaped)
        print(
            f"{name:<11}{ran.inputs:>12,}{ran.seconds:>9.0f}{ran.covered:>10}"
            f"  {ran.escaped or 'nothing'}",
            flush=True,
        )
        with (RECORD / "runs.jsonl").open("a") as file:
            file.write(json.dumps(vars(ran) | {"at": int(time.time())}) + "\n")
    lines = (RECORD / "runs.jsonl").read_text().splitlines()
    total = sum(json.loads(line)["inputs"] for line in lines)
    print(f"{total:,} inputs since .fuzz/ was begun")
    return 1 if escaped else 0


def run(name: str, seconds: float, runs: int, *, keep: bool) -> Ran:
    """Run one target in a process of its own."""
    from fuzz.targets import LONGEST, TARGETS

    with tempfile.TemporaryDirectory(prefix=f"lecombus-fuzz-{name}-") as place:
        folder = Path(place)
        found, seeds, words = folder / "found", folder / "seeds", folder / "words"
        found.mkdir()
        seeds.mkdir()
        for number, data in enumerate(corpus.kept(name)):
            (seeds / str(number)).write_bytes(data)
        words.write_text("".join(f"{_quoted(word)}\n" for word in TARGETS[name].words))
        began_s = time.monotonic()
        options = [
            str(found), str(seeds), f"-dict={words}", f"-max_len={LONGEST}", f"-timeout={HANG_S}",
            f"-rss_limit_mb={MOST_MB}", f"-artifact_prefix={RECORD}/{name}-", f"-runs={runs or -1}",
            f"-max_total_time={max(1, round(seconds))}", "-print_final_stats=1",
        ]  # fmt: skip
        ended = subprocess.run(
            ["chrt", "-i", "0", sys.executable, "-m", "fuzz.run", "--child", name, *options],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
            check=False,
        )  # fmt: skip
        said = ended.stdout
        (RECORD / f"{name}.log").write_text(said)
        if keep:
            _keep(name, found)
    inputs, covered = _RUNS.search(said), _COVERED.findall(said)
    escaped = ""
    if ended.returncode or any(sign in said for sign in ESCAPES):
        lines = [line for line in said.splitlines() if line.strip()]
        why = next((line for line in lines if "Error" in line or "EscapeError" in line), "")
        at = re.search(r"Test unit written to (\S+)", said)
        escaped = f"{why or f'exit status {ended.returncode}'} ({at[1] if at else 'see the log'})"
    return Ran(
        name, int(inputs[1]) if inputs else 0, time.monotonic() - began_s,
        int(covered[-1]) if covered else 0, escaped,
    )  # fmt: skip


def _keep(name: str, found: Path) -> None:
    """Add the short inputs that reached new code, as many as are kept."""
    before = corpus.kept(name)
    new = sorted((one.read_bytes() for one in found.iterdir()), key=len)
    short = [one for one in new if len(one) <= corpus.MOST_KEPT_BYTES]
    room = max(0, corpus.MOST_KEPT - len(before))
    step = max(1, len(short) // room) if room else 1
    corpus.write(name, before + short[::step][:room])


def _quoted(word: bytes) -> str:
    return '"' + "".join(f"\\x{byte:02X}" for byte in word) + '"'


def fuzz(name: str, options: list[str]) -> int:
    """Run in the child: atheris looks at every branch of lecombus while it feeds it."""
    logging.disable(logging.CRITICAL)
    import atheris

    with atheris.instrument_imports(include=["lecombus"], enable_loader_override=False):
        from fuzz.targets import TARGETS
    atheris.Setup([sys.argv[0], *options], TARGETS[name].check)
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
