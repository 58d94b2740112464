"""Records what commands print, and their exit statuses, for rosters right and wrong.

Nothing of lecombus is imported here: each command is a process of a tree's source (`warm`).
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from compare.normal import normal
from compare.rosters import RIGHT, WRONG, written
from compare.trees import ROOT, Side

FAMILIES = ("820x", "821x", "822x", "824x", "8200vector", "93xx", "smvector", "generic")
COMMANDS = ("demo", "run", "check", "plan", "reload", "simulate", "read", "write", "group",
            "enable", "set-speed", "reset-fault", "quick-stop", "inhibit", "stop", "readdress",
            "rebaud", "wear", "accept", "forget-times", "describe", "backup", "diff", "restore",
            "status", "lease", "leases", "events", "journal", "token", "support-bundle", "scan",
            "bridge", "fleet", "notify", "why")  # fmt: skip
LINES = """\

--version
--help
nonsense
chek -c config/small.yaml
check
check -c
check -c nowhere.yaml
check -c config
check -c config/small.yaml more
check -c config/small.yaml --frob
check -c nowhere.yaml --json
run -c nowhere.yaml
run -c config/small.yaml --log-format xml
run
plan
plan -c nowhere.yaml --json
plan --live
plan --live --socket /nowhere.sock --json
events --kind nonsense
events --socket /nowhere.sock
reload more
lease
lease service
lease service --on feeder
lease service --on feeder --socket /nowhere.sock -- true
leases more
leases --socket /nowhere.sock
journal more
journal --last 0
journal --since nonsense
journal --socket /nowhere.sock
journal --socket /nowhere.sock --json
journal verify --help
journal verify --socket /nowhere.sock
token
token new
token new --help
token new PLC --scope write --file /nowhere/tokens
token new plc --scope nonsense
token new plc --scope write --file /nowhere/tokens
token list --help
token list --file /nowhere/tokens
token list -c config/small.yaml
token revoke --help
token revoke plc --file /nowhere/tokens
support-bundle more
support-bundle -c nowhere.yaml -o /nowhere/bundle.tar.gz
bridge
bridge opcua
bridge mqtt
bridge mqtt --help
bridge mqtt -c nowhere.yaml
bridge mqtt -c config/small.yaml
bridge modbus --help
bridge modbus -c nowhere.yaml
bridge modbus -c config/small.yaml
bridge modbus -c config/small.yaml --map
bridge modbus -c config/small.yaml --map --markdown
bridge notify --help
fleet more
fleet --frob
bridge notify -c config/small.yaml
notify
notify test --help
notify test -c nowhere.yaml
notify test -c config/small.yaml
reload --socket /nowhere.sock
simulate
simulate -c config/small.yaml
simulate -c config/small.yaml --pty x --tcp 0
simulate -c config/small.yaml --tcp nowhere
simulate -c config/small.yaml --tcp 99999
simulate -c config/small.yaml --tcp 0 --faults nonsense
simulate -c config/small.yaml --tcp 0 --faults late=2
simulate -c config/small.yaml --tcp 0 --faults absent=x
simulate -c config/small.yaml --tcp 0 --control-word no
simulate --pty nowhere --tell help
describe
describe siemens
describe smvector C9999
describe 8200vector C0043
describe 820x C0043
describe smvector P425
describe smvector P425 --json
describe 8200vector C0135
describe 8200vector C0135 --lang de
describe 93xx C0150 --configuration 1011 --json
describe 93xx C0135 --configuration 4711
describe 820x --configuration 1
describe 93xx --lang fr
describe 93xx x
read
read feeder
read feeder C0150
read feeder C0150 more
read feeder C99999
read feeder C0150 --socket /nowhere.sock
read feeder C0150 --socket /nowhere.sock --json
read feeder C0150 --url ftp://x
read feeder C0150 --url http://127.0.0.1:1
read C0150 --port /dev/nowhere
read C0150 --port /dev/nowhere --address 11
read C0150 --port /dev/nowhere --address 100
read C0150 --port /dev/nowhere --address 11 --baud 115200
read C0150 --port /dev/nowhere --address 11 --family x
write feeder C0046
write feeder C0046 1,5
write feeder C0046 1e3
write feeder C0046 x
write feeder C0046 -5 --socket /nowhere.sock
write feeder C0046 20 --expires 2
write feeder C0046 20 --expires 2h
write feeder C0046 20 --wait x
group
group all C0046
group all C0046 20 --socket /nowhere.sock
set-speed feeder
set-speed feeder fast
set-speed feeder 20 --unit rpm
enable
enable feeder --socket /nowhere.sock --json
inhibit --socket /nowhere.sock
quick-stop a b c
stop --action halt
stop feeder --all --socket /nowhere.sock
stop --socket /nowhere.sock --json
readdress feeder
readdress feeder 20 --socket /nowhere.sock
readdress feeder x
rebaud
rebaud 115200 -c config/small.yaml
rebaud 9600 -c nowhere.yaml
rebaud 19200 -c config/small.yaml --dry-run
wear
accept
forget-times
backup
backup feeder
diff
diff a
diff nowhere.yaml nothing.yaml
diff config/small.yaml config/small.yaml
restore
restore nowhere.yaml feeder
restore config/small.yaml feeder --socket /nowhere.sock
status --socket /nowhere.sock
status --socket /nowhere.sock --json
why
why feeder --lang fr
scan --addresses 0
scan --addresses 5-1
scan --addresses x
scan --bauds 1
scan --port /dev/nowhere --bauds 9600
scan --port /dev/nowhere --all-bauds --bauds 9600"""


def corpus(rosters: Path) -> Iterator[list[str]]:
    """Give all command lines; the rosters lie in a folder."""
    for file in sorted(rosters.glob("config/*.yaml")):
        yield from _of_a_right_one(f"config/{file.name}")
    for file in sorted(rosters.glob("former/*.yaml")):
        yield from _of_a_right_one(f"former/{file.name}")
    for name in RIGHT:
        yield from _of_a_right_one(f"right/{name}.yaml")
    for name in WRONG:
        yield ["check", "-c", f"wrong/{name}.yaml", "--json"]
    for name in list(WRONG)[::8]:
        for words in (["check"], ["plan"], ["plan", "--json"], ["run"], ["simulate", "--tcp", "0"]):
            yield [*words, "-c", f"wrong/{name}.yaml"]
    for family in FAMILIES:
        yield ["describe", family, "--json"]
        yield ["describe", family, "--lang", "de"]
    yield ["describe", "93xx", "--configuration", "1011", "--json"]
    for command in COMMANDS:
        yield [command, "--help"]
    for line in LINES.splitlines():
        yield line.split()


def _of_a_right_one(path: str) -> Iterator[list[str]]:
    for words in (["check"], ["check", "--json"], ["plan"], ["plan", "--json"]):
        yield [*words, "-c", path]


def record(
    side: Side,
    lines: Iterable[list[str]] | None = None,
    *,
    former: Path | None = None,
    jobs: int | None = None,
) -> str:
    """Return the record of the command part of one side.

    Args:
        side: The side.
        lines: What is run; None: all.
        former: The folder `config` of the base: what differs there is asked of both sides too, as
            rosters of users that stay as they are.
        jobs: How many processes run at a time; None: one for each core.
    """
    with tempfile.TemporaryDirectory(prefix="lc-") as name:
        folder = Path(name)
        _write_rosters(folder, former)
        asked = list(corpus(folder) if lines is None else lines)
        count = jobs or os.cpu_count() or 1
        shares = [asked[number::count] for number in range(count)]
        with ThreadPoolExecutor(count) as pool:
            ran = list(pool.map(lambda share: _run(side, folder, share), shares))
        results = [ran[number % count][number // count] for number in range(len(asked))]
        return "".join(map(section, asked, results))


def _run(side: Side, folder: Path, lines: list[list[str]]) -> list[tuple[int, str, str]]:
    """Run commands of a side one after the other, in forks of one interpreter."""
    env = {**side.environment(), "HOME": str(folder), "XDG_RUNTIME_DIR": str(folder)}
    done = subprocess.run(
        [side.python, Path(__file__).parent / "warm.py"], cwd=folder, env=env,
        input=json.dumps(lines), stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    found: list[tuple[int, str, str]] = json.loads(done.stdout)
    return found


def _write_rosters(folder: Path, former: Path | None) -> None:
    (folder / "config").mkdir()
    (folder / "former").mkdir()
    for file in (ROOT / "config").glob("*.yaml"):
        (folder / "config" / file.name).write_bytes(file.read_bytes())
    for file in former.glob("*.yaml") if former is not None else ():
        now = folder / "config" / file.name
        if not now.exists() or now.read_bytes() != file.read_bytes():
            (folder / "former" / file.name).write_bytes(file.read_bytes())
    for kind, rosters in (("right", RIGHT), ("wrong", WRONG)):
        (folder / kind).mkdir()
        for name, edit in rosters.items():
            (folder / kind / f"{name}.yaml").write_bytes(written(edit))


def section(words: list[str], ran: tuple[int, str, str]) -> str:
    """Return the section of one command: exit status, standard output, standard error."""
    rows = [f"=== lecombus {' '.join(words)}", f"exit status {ran[0]}"]
    rows += [f"out: {row}" for row in _rows(ran[1])]
    rows += [f"err: {row}" for row in _rows(ran[2])]
    return normal("\n".join([*rows, ""]))


def _rows(output: str) -> list[str]:
    """Return lines; those of a long document one part a row."""
    return output.replace(', "', ',\n "').split("\n")
