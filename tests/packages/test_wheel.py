"""A wheel of this source tree, installed in an environment of its own."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from support.package_build import ROOT

pytestmark = [pytest.mark.real, pytest.mark.timeout(600)]


def run(*words: str | Path) -> str:
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def wheel(tmp_path: Path) -> Path:
    """Built as by `make wheel`, from a copy: building leaves files in the source tree."""
    source = tmp_path / "source"
    shutil.copytree(ROOT / "src", source / "src", ignore=shutil.ignore_patterns("*.egg-info"))
    shutil.copytree(ROOT / "bin", source / "bin")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    only = ("--no-deps", "--no-index", "--no-build-isolation")
    run(*pip, "wheel", *only, "--wheel-dir", tmp_path, source)
    (made,) = tmp_path.glob("lecombus-*.whl")
    return made


def test_a_wheel_holds_every_file_of_the_program_and_runs(wheel: Path, tmp_path: Path) -> None:
    sources = {
        str(path.relative_to(ROOT / "src"))
        for path in (ROOT / "src" / "lecombus").rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    assert sources <= set(ZipFile(wheel).namelist())
    environment = tmp_path / "environment"
    run(sys.executable, "-m", "venv", environment)
    python = environment / "bin" / "python"
    run(python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel)
    # The libraries are those of the tests; only the program itself is from the wheel.
    libraries = Path(pytest.__file__).parents[1]
    (site,) = (environment / "lib").glob("python*/site-packages")
    (site / "libraries.pth").write_text(f"{libraries}\n")
    where = run(python, "-P", "-c", "import lecombus; print(lecombus.__file__)")
    assert Path(where.strip()).is_relative_to(environment)
    command = environment / "bin" / "lecombus"
    assert run(command, "--version").startswith("lecombus ")
    assert "bench" in run(command, "check", "-c", ROOT / "config" / "small.yaml")
