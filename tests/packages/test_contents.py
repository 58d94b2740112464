"""What is in the package, and what Debian's own checker says of it."""

from __future__ import annotations

import gzip
import json
import re
import subprocess
from pathlib import Path

import click
import pytest

from lecombus.cli.entry import COMMANDS, lecombus
from support.package_build import ROOT, build
from support.real_parts import require

pytestmark = [pytest.mark.real, pytest.mark.timeout(900)]

DEPLOY = ROOT / "deploy"
PINS = re.compile(r"^([a-z0-9][a-z0-9._-]*)==(\S+)", re.MULTILINE)


@pytest.fixture(scope="session")
def unpacked(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("unpacked")
    subprocess.run([str(require("dpkg-deb")), "-x", str(package), str(place)], check=True)
    return place


def locked() -> dict[str, str]:
    found = PINS.findall((ROOT / "requirements" / "runtime.txt").read_text())
    return {normal(name): version for name, version in found}


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def lintian(package: Path) -> str:
    """What lintian says of a package, warnings too."""
    words = [str(require("lintian")), "--allow-root", "--fail-on=none", str(package)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return "\n".join(line for line in done.stdout.splitlines() if line.startswith(("E:", "W:")))


def test_every_file_of_deploy_is_in_the_package(unpacked: Path) -> None:
    shipped = [path.name for path in (unpacked / "usr").rglob("*") if path.is_file()]
    wanted = [path.name for path in DEPLOY.rglob("*") if path.is_file()]
    assert len(wanted) > 8
    assert [name for name in wanted if name not in shipped] == []


def test_units_start_a_program_of_the_package(unpacked: Path) -> None:
    folder = unpacked / "usr/lib/systemd/system"
    ours = {*DEPLOY.glob("*.service"), *DEPLOY.glob("*.timer")}
    assert {unit.name for unit in folder.iterdir()} == {one.name for one in ours}
    units = sorted(folder.glob("*.service"))
    for unit in units:
        (program,) = re.findall(r"^ExecStart=(\S+)", unit.read_text(), re.MULTILINE)
        assert program == "/usr/bin/lecombus"
        by_hand = (DEPLOY / unit.name).read_text()
        assert "\nExecStart=/opt/lecombus/bin/lecombus " in by_hand
    assert (unpacked / "usr/bin/lecombus").stat().st_mode & 0o111


def test_nothing_of_it_names_the_place_of_an_installation_by_hand(unpacked: Path) -> None:
    for folder in ("usr/lib/systemd", "usr/share/lecombus", "usr/bin"):
        for path in (unpacked / folder).rglob("*"):
            assert path.is_dir() or "/opt/" not in path.read_text(), path


def test_the_bill_of_materials_is_the_lock(unpacked: Path) -> None:
    bill = json.loads((unpacked / "usr/share/doc/lecombus/sbom.cdx.json").read_text())
    assert (bill["bomFormat"], bill["metadata"]["component"]["name"]) == ("CycloneDX", "lecombus")
    assert {normal(one["name"]): one["version"] for one in bill["components"]} == locked()
    assert all(one.get("licenses") for one in bill["components"])


def test_every_library_has_its_licence_in_the_copyright_file(unpacked: Path) -> None:
    text = (unpacked / "usr/share/doc/lecombus/copyright").read_text()
    parts = re.split(r"^-{72}\n(\S+) (\S+)\n-{72}\n", text, flags=re.MULTILINE)
    each = zip(*[iter(parts[1:])] * 3, strict=True)
    found = {normal(name): (version, body) for name, version, body in each}
    assert {name: version for name, (version, _) in found.items()} == locked()
    for name, (_, body) in found.items():
        assert "common-licenses" in body or re.search(r"copyright", body, re.IGNORECASE), name


def test_each_python_has_its_compiled_modules(unpacked: Path) -> None:
    home = unpacked / "usr/lib/lecombus"
    by_python = {
        python: {path.name.split(".")[0] for path in home.rglob(f"*.cpython-{python}-*.so")}
        for python in ("311", "313")
    }
    assert by_python["311"] == by_python["313"] >= {"_pydantic_core", "_yaml", "parser", "_core"}


def test_every_command_has_a_man_page(unpacked: Path) -> None:
    pages = {path.name for path in (unpacked / "usr/share/man/man1").iterdir()}
    context = click.Context(lecombus)
    commands = {name: lecombus.get_command(context, name) for name in COMMANDS}
    parts = {
        f"{name}-{part}"
        for name, command in commands.items()
        if isinstance(command, click.Group)
        for part in command.commands
    }
    assert "fleet-stop" in parts
    assert pages == {"lecombus.1.gz", *(f"lecombus-{name}.1.gz" for name in {*COMMANDS, *parts})}
    for page in (unpacked / "usr/share/man/man1").iterdir():
        said = gzip.decompress(page.read_bytes()).decode()
        (what,) = re.findall(r"^\.SH NAME\n(.+)$", said, re.MULTILINE)
        assert not what.endswith("..."), what


def control_of(package: Path, place: Path) -> dict[str, str]:
    """Return the control files of a package; what must differ by kind is left out."""
    subprocess.run([str(require("dpkg-deb")), "-e", str(package), str(place)], check=True)
    found = {path.name: path.read_text() for path in place.iterdir() if path.name != "md5sums"}
    lines = found["control"].splitlines()
    kept = [line for line in lines if not line.startswith(("Architecture:", "Installed-Size:"))]
    return {**found, "control": "\n".join(kept)}


@pytest.mark.long
def test_two_builds_are_identical_and_lintian_finds_nothing(tmp_path: Path) -> None:
    first, second = (build(tmp_path / each) for each in ("first", "second"))
    assert [path.name.rpartition("_")[2] for path in first] == ["amd64.deb", "arm64.deb"]
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes(), one.name
        assert lintian(one) == ""
    ours, arm64 = (control_of(one, tmp_path / one.stem) for one in first)
    assert arm64 == ours, "it is installed and removed in the same way"
