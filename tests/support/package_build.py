"""Builds the Debian package for tests, as `make deb` does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from support.real_parts import require

__all__ = ["ROOT", "architecture", "build", "with_version"]

ROOT = Path(__file__).parents[2]
BUILT_WITHIN_S = 900.0


def architecture() -> str:
    """Return Debian's name of this machine's kind."""
    done = subprocess.run(
        [require("dpkg"), "--print-architecture"], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def build(to: Path, *architectures: str) -> list[Path]:
    """Build packages into a directory."""
    subprocess.run(
        [sys.executable, "scripts/deb", "--to", to, *architectures],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": "src"}, check=True, timeout=BUILT_WITHIN_S,
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    return sorted(to.glob("*.deb"))


def with_version(package: Path, version: str, place: Path) -> Path:
    """Return the same package under another version, so that it is an upgrade for dpkg."""
    unpacked = place / "unpacked"
    dpkg = str(require("dpkg-deb"))
    subprocess.run([dpkg, "-R", str(package), str(unpacked)], check=True)
    control = unpacked / "DEBIAN" / "control"
    lines = control.read_text().splitlines()
    lines = [f"Version: {version}" if one.startswith("Version:") else one for one in lines]
    control.write_text("\n".join(lines) + "\n")
    made = place / f"lecombus_{version}_{architecture()}.deb"
    words = [dpkg, "-Zgzip", "-z1", "--root-owner-group", "-b", str(unpacked), str(made)]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    return made
