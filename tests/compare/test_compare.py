"""A changed byte, time, header, message or field of a family is found, in a copy of the source."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from compare import commands, daemon
from compare.differences import Differences, Meant, beginnings, differences
from compare.normal import NORMAL, normal
from compare.requests import corpus, get
from compare.rosters import RIGHT, WRONG, written
from compare.trees import ROOT, Side
from lecombus.cli.entry import COMMANDS
from lecombus.drives import FAMILY_NAMES

pytestmark = pytest.mark.clock

CHANGES = (
    ("cycle", "{code: C0150, every_ms: 1000}", "{code: C0150, every_ms: 900}"),
    ("header", '"no-store"', '"no-cache"'),
    ("message", '"is unknown"', '"is not known"'),
    ("field", "name: acceleration time", "name: time of acceleration"),
)
"""What is changed in the copy: each text stands in the source; another one is chosen if not."""


@pytest.fixture(scope="module")
def sides(tmp_path_factory: pytest.TempPathFactory) -> tuple[Side, Side]:
    """Return this source and a changed copy of it."""
    copy = tmp_path_factory.mktemp("copy")
    for name in ("src", "tests/proof", "tests/support", "tests/compare"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for what, old, new in CHANGES:
        files = [f for f in (copy / "src").rglob("*") if f.suffix in (".py", ".yaml")]
        found = [file for file in files if old in file.read_text()]
        assert found, f"{what}: choose another text than {old!r}, which stands nowhere now"
        for file in found:
            file.write_text(file.read_text().replace(old, new))
    here = Side("here", ROOT, Path(sys.executable), "")
    return here, dataclasses.replace(here, name="copy", tree=copy)


def inside(side: Side, output: Path, module: str, *words: str) -> str:
    command = [str(side.python), "-m", f"compare.inside.{module}"]
    where = [words[0], str(output), *words[1:]] if module == "proof" else [str(output), *words]
    subprocess.run([*command, *where], env=side.environment(), cwd=side.tree, check=True)
    return output.read_text()


def compared(part: str, records: list[str]) -> Differences:
    assert "=== " in records[0]
    assert not differences(part, records[0], records[0], []).rows
    return differences(part, records[0], records[1], [])


@pytest.mark.timeout(120)
def test_a_changed_time_on_the_wire_is_found(sides: tuple[Side, Side], tmp_path: Path) -> None:
    words = ("seeds", "--first", "1", "--length", "5", "--jobs", "1")
    found = compared("proof", [inside(one, tmp_path / "r", "proof", *words) for one in sides])
    assert found.sections == ["seed 1"]


@pytest.mark.timeout(120)
def test_every_byte_of_a_full_line_is_in_its_record(
    sides: tuple[Side, Side], tmp_path: Path
) -> None:
    words = ("wire", "--families", "smvector", "--length", "2", "--jobs", "1")
    record = inside(sides[0], tmp_path / "r", "proof", *words)
    row = next(row for row in record.splitlines() if " > " in row)
    changed = f"{row[:-1]}{int(row[-1], 16) ^ 1:x}"
    found = compared("wire", [record, record.replace(row, changed, 1)])
    assert found.rows == [f"smvector\t-{row}", f"smvector\t+{changed}"]
    again = inside(sides[0], tmp_path / "r", "proof", *words)
    assert again == record


def test_a_changed_field_of_a_family_is_found(sides: tuple[Side, Side], tmp_path: Path) -> None:
    words = ("--families", "8200vector")
    found = compared("families", [inside(one, tmp_path / "r", "families", *words) for one in sides])
    assert "8200vector\t+family.codes.C0012.name = time of acceleration" in found.rows
    assert "8200vector\t+family.status.0.1 = 0.9" in found.rows
    assert len(found.rows) < 30


def test_a_changed_message_is_found(sides: tuple[Side, Side]) -> None:
    name = next(name for name, edit in WRONG.items() if edit == "line baud: 9601")
    lines = [["check", "-c", f"wrong/{name}.yaml"], ["describe", "generic"]]
    found = compared("commands", [commands.record(one, lines, jobs=2) for one in sides])
    assert found.sections == [f"lecombus check -c wrong/{name}.yaml"]


def test_a_command_in_a_fork_does_what_it_does_in_a_process_of_its_own(
    sides: tuple[Side, Side],
) -> None:
    lines = [["check", "-c", "wrong/013.yaml"], ["nonsense"], [], ["describe", "generic"]]
    record = commands.record(sides[0], lines, jobs=1)
    for words in (["nonsense"], ["describe", "generic"], []):
        done = subprocess.run(
            sides[0].command(*words), env=sides[0].environment(), capture_output=True, text=True,
            stdin=subprocess.DEVNULL, check=False,
        )  # fmt: skip
        section = commands.section(words, (done.returncode, done.stdout, done.stderr))
        assert section in record


@pytest.mark.real
@pytest.mark.timeout(300)
def test_a_changed_header_is_found(sides: tuple[Side, Side]) -> None:
    asked = [get("/v1/groups"), get("/v1/drives/nobody")]
    found = compared("http", [daemon.answers(one, "sim:", asked) for one in sides])
    assert "unix: GET /v1/groups  1.1\t+cache-control: no-cache" in found.rows


def test_a_difference_that_is_meant_passes_and_one_that_is_not_there_is_told() -> None:
    meant = [Meant("http", "Cache", "why"), Meant("http", "nothing", ""), Meant("wire", "a", "")]
    found = differences("http", "=== one\nCache: a\nb\n", "=== one\nCache: b\nc\n", meant)
    assert found.rows == ["one\t-b", "one\t+c"]
    assert found.meant == 2
    assert [one.used for one in meant] == [True, False, False]


def test_a_section_that_is_gone_or_new_differs() -> None:
    found = differences("http", "=== a\n1\n=== a\n2\n", "=== a\n1\n=== b\n2\n", [])
    assert found.rows == ["a #2\t-(the whole section)", "b\t+(the whole section)"]


def test_where_two_runs_part_is_shown() -> None:
    base, now = ("=== a\n1\n2\n3\n", "=== a\n1\n2\n4\n5\n")
    assert beginnings(base, now, ["a"]).splitlines() == [
        "  a", "  begins to differ in row 3:", "      1", "      2", "    - 3", "    + 4", "    + 5"
    ]  # fmt: skip


def test_what_varies_is_replaced_and_nothing_else() -> None:
    assert normal('"age_s": 1.25, "value": 1.25') == '"age_s": AGE, "value": 1.25'
    assert normal("read 12.2 s ago") == "read AGE ago"
    assert normal('lecombus_x_total{a="b"} 5.0') == 'lecombus_x_total{a="b"} N'
    assert normal('lecombus_drive_state{a="b"} 5.0') == 'lecombus_drive_state{a="b"} 5.0'
    assert len({what for what, _, _ in NORMAL}) == len(NORMAL)


def test_the_corpora_are_large_and_each_entry_stands_once() -> None:
    asked = [one.data for one in corpus()]
    assert len(asked) >= 300
    assert len(WRONG) >= 60
    files = [written(edit) for edit in (*RIGHT.values(), *WRONG.values())]
    assert len(set(files)) == len(files)


def test_every_command_is_asked() -> None:
    """A command that is new and not listed would never be compared."""
    assert set(commands.COMMANDS) >= set(COMMANDS)
    assert commands.FAMILIES == FAMILY_NAMES
