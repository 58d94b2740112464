"""Promises about the project as a whole that no single room can keep."""

from __future__ import annotations

import ast
import re
import runpy
import subprocess
import sys
import tomllib
from importlib.metadata import metadata
from pathlib import Path

import pytest

from support.golden import NAME, read_golden

ROOT = Path(__file__).parents[1]
REQUIREMENTS = ROOT / "requirements"
LOCKS = sorted(path for path in REQUIREMENTS.glob("*.txt") if path.name != "debian.txt")
PIN = re.compile(r"^([a-z0-9][a-z0-9._-]*)==(\S+)", re.MULTILINE)

PRIVATE = re.compile(r"\b_?(exchange_loop|worker|schedule|site)\._[a-z]\w*$")
"""How a test would reach into a line that it runs."""

MODULE_LINES = 500
LONGER = {
    "src/lecombus/bridges/mqtt/broker.py",
    "src/lecombus/daemon.py",
    "src/lecombus/fieldbus/lecom/exchanges/exchange_loop.py",
    "src/lecombus/fieldbus/lecom/exchanges/stop_job.py",
    "src/lecombus/fieldbus/lecom/simulator/line.py",
    "src/lecombus/journal/journal.py",
    "src/lecombus/roster.py",
    "src/lecombus/schedule/watchdog_set.py",
}
"""Modules that are one thing, and longer: the length is a guide."""
FUNCTION_LINES = 45


def pins(lock: str) -> dict[str, str]:
    return dict(PIN.findall((REQUIREMENTS / lock).read_text()))


def wanted(source: str) -> dict[str, str]:
    """The packages an .in file names itself, with their conditions."""
    lines = [line.strip() for line in (REQUIREMENTS / source).read_text().splitlines()]
    named = [line for line in lines if line and not line.startswith(("#", "-"))]
    return {normal(re.split(r"[<>=!~]", line)[0]): line for line in named}


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def tracked() -> list[Path]:
    done = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    paths = [ROOT / name for name in done.stdout.split("\0") if name]
    return [path for path in paths if path.is_file()]


def test_rooms_import_only_what_they_may() -> None:
    linter = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [linter, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_package_asks_for_what_the_runtime_lock_is_made_from() -> None:
    """The locks hold what each bridge needs too: they are what packages are made from."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    asked = list(project["project"]["dependencies"])
    for of_a_bridge in project["project"]["optional-dependencies"].values():
        asked += of_a_bridge
    assert sorted(asked) == sorted(wanted("runtime.in").values())
    assert project["build-system"]["requires"] == list(wanted("build.in").values())


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.name)
def test_a_lock_holds_every_package_its_source_names(lock: Path) -> None:
    assert set(wanted(f"{lock.stem}.in")) <= {normal(name) for name in pins(lock.name)}


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.name)
def test_a_lock_pins_by_hash_and_names_no_index(lock: Path) -> None:
    text = lock.read_text()
    assert "://" not in text
    assert "--index-url" not in text
    assert "--find-links" not in text
    for block in re.split(r"\n(?=\S)", text):
        if block.startswith("#"):
            continue
        assert PIN.match(block), block
        assert "--hash=sha256:" in block, block


def test_the_locks_agree_with_each_other() -> None:
    dev = pins("dev.txt")
    for lock in ("runtime.txt", "build.txt"):
        for name, version in pins(lock).items():
            assert dev.get(name) == version, name
    for lock in ("bench.txt", "package.txt"):
        for name, version in pins(lock).items():
            assert dev.get(name, version) == version, name


def test_compiled_packages_are_locked_for_other_machines_too() -> None:
    """A lock made from one machine's own wheels would hold one hash of each."""
    text = (REQUIREMENTS / "runtime.txt").read_text()
    for name in ("httptools", "msgspec", "pydantic-core", "pyyaml"):
        block = re.search(rf"^{name}==.*?(?=^\S)", text, re.MULTILINE | re.DOTALL)
        assert block is not None
        assert block.group().count("--hash=") > 20


def test_no_package_we_ship_with_is_under_the_gpl() -> None:
    for name in pins("runtime.txt"):
        about = metadata(name).json
        said = [str(about.get("license_expression") or about.get("license") or "")]
        said += [line for line in about.get("classifier", []) if line.startswith("License")]
        assert any(said), name
        assert not re.search(r"\bA?GPL|GNU (?:Affero )?General Public", " ".join(said)), name


def test_no_file_names_a_place_that_only_one_machine_has() -> None:
    place = re.compile(r"/(?:root|work|home/[a-z]+|Users/[a-z]+)/[a-z.]")
    found = []
    for path in tracked():
        try:
            text = path.read_text()
        except UnicodeDecodeError:
            continue
        for number, line in enumerate(text.splitlines(), 1):
            if place.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert found == []


def test_what_must_not_live_in_a_room_stands_in_the_header_of_its_package() -> None:
    packages = [path for path in (ROOT / "src").rglob("*.py") if path.name == "__init__.py"]
    others = {*(ROOT / "src").rglob("*.py"), *(ROOT / "tests").rglob("*.py")} - {*packages}
    words = " ".join(("must not", "live here"))
    assert any(words in path.read_text() for path in packages)
    assert [str(path) for path in others if words in path.read_text()] == []


def test_modules_stay_readable() -> None:
    long = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "src").rglob("*.py")
        if len(path.read_text().splitlines()) > MODULE_LINES
    }
    assert long == LONGER


def body_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """How long a function is without its docstring, which may say as much as is needed."""
    lines = (function.end_lineno or 0) - function.lineno + 1
    first = function.body[0]
    if ast.get_docstring(function) is not None:
        lines -= (first.end_lineno or 0) - first.lineno + 1
    return lines


def test_functions_stay_readable() -> None:
    long = {
        f"{path.relative_to(ROOT)}:{node.name}": body_lines(node)
        for path in (ROOT / "src").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and body_lines(node) > FUNCTION_LINES
    }
    assert long == {}


def test_no_test_reaches_into_what_is_private_to_the_exchange_loop() -> None:
    reached = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}"
        for path in (ROOT / "tests").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and PRIVATE.search(ast.unparse(node))
    ]
    assert reached == []


def test_golden_files_hold_nothing_that_no_test_asks_for() -> None:
    for path in (ROOT / "tests").rglob(NAME):
        for key in read_golden(path):
            module, _, test = re.split(r"[\[ ]", key)[0].partition("::")
            source = path.with_name(f"{module}.py").read_text()
            assert f"def {test}(" in source, key
            assert "golden" in source, key


def test_every_test_runs_in_just_one_lane() -> None:
    lanes: dict[str, list[str]] = runpy.run_path(str(ROOT / "scripts" / "test"))["lanes"]()
    paths = [ROOT / path for paths in lanes.values() for path in paths]
    assert sorted(paths) == sorted((ROOT / "tests").glob("**/test_*.py"))


def test_what_needs_real_time_runs_apart_and_is_what_conftest_repeats() -> None:
    lanes: dict[str, list[str]] = runpy.run_path(str(ROOT / "scripts" / "test"))["lanes"]()
    marks = runpy.run_path(str(ROOT / "tests" / "conftest.py"))["ON_THE_CLOCK"]
    apart = {path for lane in ("load", "real", "cli", "clock", "packages") for path in lanes[lane]}
    marked = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "tests").glob("**/test_*.py")
        if any(re.search(rf"pytest\.mark\.{mark}\b", path.read_text()) for mark in marks)
    }
    assert apart == marked


def test_every_license_text_is_there() -> None:
    text = (ROOT / "LICENSE").read_text()
    assert "Apache License" in text
    assert "END OF TERMS AND CONDITIONS" in text
