"""Unpacked Debian for arm64 with our package in it, whose Python runs under qemu's user emulation.

Nothing of it is installed: no program of another kind must run for that, so neither binfmt_misc nor
a chroot is needed, and it takes seconds. qemu finds the files of the program below the root (-L).
Only a program that starts another one would leave it: so Python is started, not /usr/bin/lecombus.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

from support.debian_root import mirror_lines
from support.package_build import ROOT
from support.real_parts import missing, require

__all__ = ["HOME", "Arm64Root"]

HOME = "usr/lib/lecombus"
PROCESSOR = "cortex-a53"
"""That of a Raspberry Pi 3, the oldest that docs/install.md names: nothing newer may be needed.

qemu's own default also signs pointers, in software: Debian 13 then takes four times as long.
"""

MADE_WITHIN_S = 600.0
DONE_WITHIN_S = 600.0
STARTS = re.compile(r"^run='(.+)'$", re.MULTILINE)
"""How /usr/bin/lecombus starts Python."""

IMPORTS_ALL = """
from importlib import import_module
from pkgutil import walk_packages
import lecombus
names = [one.name for one in walk_packages(lecombus.__path__, "lecombus.")]
for name in names:
    import_module(name)
assert len(names) > 200, names
"""


def emulator() -> str:
    """Return where qemu is."""
    found = shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")
    if found is None:
        missing("qemu-aarch64-static is missing: apt-get install qemu-user-static")
    return found


class Arm64Root:
    """A release of Debian for arm64 with the package, in a directory.

    Every module of the program has been imported, and with them all libraries.

    Args:
        release: Its code name.
        python: The version of its Python.
        package: Our package for arm64.
        place: The directory, which does not exist yet.
    """

    def __init__(self, release: str, python: str, package: Path, place: Path) -> None:
        self.place = place
        (starts,) = STARTS.findall((ROOT / "packaging" / "lecombus").read_text())
        words = [emulator(), "-cpu", PROCESSOR, "-L", str(place)]
        words.append(str(place / "usr/bin" / f"python{python}"))
        # Compiled once, with the import of all: compiling takes most of the time of a start.
        self._python = [*words, "-I", "-S", "-X", f"pycache_prefix={place / 'compiled'}", "-c"]
        self._starts = starts
        made = [
            str(require("mmdebstrap")), "--quiet", "--mode=root", "--variant=extract",
            "--architectures=arm64", "--skip=check/qemu", "--include=python3", release, str(place),
            "-",
        ]  # fmt: skip
        sources = "\n".join(mirror_lines(release))
        subprocess.run(made, input=sources, text=True, check=True, timeout=MADE_WITHIN_S)
        if not (place / "lib").exists():  # Debian 13: the link is made when it is installed
            (place / "lib").symlink_to("usr/lib")
        unpack = [str(require("dpkg-deb")), "-x", str(package), str(place)]
        subprocess.run(unpack, check=True)
        self.python(IMPORTS_ALL)

    def _run(self, code: str, *words: str | Path) -> str:
        done = subprocess.run(
            [*self._python, code, *(str(word) for word in words)],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, timeout=DONE_WITHIN_S, check=False, env={"LC_ALL": "C.UTF-8"},
        )  # fmt: skip
        assert done.returncode == 0, f"{words}: {done.returncode}\n{done.stdout}"
        return done.stdout

    def python(self, code: str, *words: str | Path) -> str:
        """Run a program in Python that finds what lecombus finds, and return what it says."""
        return self._run(f"import sys; sys.path.insert(0, '/{HOME}')\n{code}", *words)

    def lecombus(self, *words: str | Path) -> str:
        """Run a command, which must end with 0, and return what it says."""
        return self._run(self._starts, *words)

    def start(self, log: Path, *words: str | Path) -> subprocess.Popen[bytes]:
        """Start a command that runs beside the test, and writes what it says into a file."""
        with log.open("wb") as said:
            return subprocess.Popen(
                [*self._python, self._starts, *(str(word) for word in words)],
                stdin=subprocess.DEVNULL, stdout=said, stderr=said, env={"LC_ALL": "C.UTF-8"},
            )  # fmt: skip
