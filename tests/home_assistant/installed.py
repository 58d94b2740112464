"""Home Assistant in an environment of its own, as it needs another Python and other packages."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from support.real_parts import missing

__all__ = ["install"]

PACKAGES = Path(__file__).parent / "packages.txt"
PYTHON = "python3.12"
"""The packages are those of Home Assistant 2025.1, the last one that takes it."""


def install(folder: Path) -> Path:
    """Install Home Assistant, and return its interpreter.

    Args:
        folder: Where to; made if it is not there.
    """
    newer = shutil.which(PYTHON)
    if newer is None or subprocess.run([newer, "--version"], check=False).returncode:  # a shim
        missing(f"Home Assistant needs {PYTHON} in PATH")
    subprocess.run([newer, "-m", "venv", folder], check=True)
    python = folder / "bin" / "python"
    words = ("-m", "pip", "install", "-qq", "--no-deps", "--prefer-binary", "-r", str(PACKAGES))
    subprocess.run([python, *words], check=True)
    return python
