"""A clean Debian system in a directory, started with its own systemd, without a network.

mmdebstrap makes it from the mirror that this machine's apt uses; systemd-nspawn starts it. It takes
root and a Debian machine, and some twenty seconds. Nothing is kept from one run to the next.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from support.real_parts import missing, require

__all__ = ["DebianRoot", "make_root", "mirror_lines"]

PACKAGES = ("systemd", "udev", "python3")
"""What a Debian machine has before lecombus is installed; there is no network to get it later."""

MADE_WITHIN_S = 600.0
STARTED_WITHIN_S = 90.0
DONE_WITHIN_S = 180.0
LOOK_AGAIN_S = 0.2

ENVIRONMENT = (
    "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    "HOME=/root", "LC_ALL=C.UTF-8", "SYSTEMD_COLORS=0", "DEBIAN_FRONTEND=noninteractive",
)  # fmt: skip

CHANGING = ("proc", "sys", "dev", "run", "tmp", "srv", "var/log", "var/cache", "var/lib/apt")
"""Where files come and go without a package."""


def mirror_lines(release: str) -> list[str]:
    """Return the lines of sources.list for a release, from the mirror that this machine uses."""
    here = ""
    for line in Path("/etc/os-release").read_text().splitlines():
        if line.startswith("VERSION_CODENAME="):
            here = line.partition("=")[2].strip('"')
    done = subprocess.run(
        [require("apt-get"), "indextargets", "--format", "$(RELEASE)/$(COMPONENT) $(SITE)",
         "Created-By: Packages"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    pairs = (line.split(" ", 1) for line in done.stdout.splitlines())
    sites = {site for name, site in pairs if name == f"{here}/main"}
    if not sites:
        missing("this machine's apt has no mirror of Debian")
    return [f"deb {site} {release} main" for site in sorted(sites)]


def make_root(release: str, place: Path, *more: str) -> None:
    """Make a clean system of a release in a directory that does not exist yet.

    Args:
        release: Its code name.
        place: The directory.
        more: Packages that it shall have too.
    """
    if os.getuid():
        missing("only root can make a Debian system in a directory")
    words = [
        str(require("mmdebstrap")), "--quiet", "--mode=root", "--variant=minbase",
        f"--include={','.join(PACKAGES + more)}", "--dpkgopt=force-unsafe-io",
        release, str(place), "-",
    ]  # fmt: skip
    sources = "\n".join(mirror_lines(release))
    subprocess.run(words, input=sources, text=True, check=True, timeout=MADE_WITHIN_S)


class DebianRoot:
    """A system that runs as long as the block.

    Args:
        clean: What it is a copy of, made by `make_root`.
        place: Its directory, which does not exist yet and is deleted at the end.
    """

    def __init__(self, clean: Path, place: Path) -> None:
        self.clean = clean
        self.place = place
        self._nspawn: subprocess.Popen[bytes] | None = None
        self._leader = 0
        self._beside: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Self:
        copy = [str(require("cp")), "-a", "--reflink=auto", str(self.clean), str(self.place)]
        subprocess.run(copy, check=True)
        words = [
            str(require("systemd-nspawn")), "--quiet", f"--directory={self.place}", "--boot",
            "--private-network", "--register=no", "--console=pipe",
        ]  # fmt: skip
        if not Path("/run/systemd/system").exists():
            words.append("--keep-unit")  # there is no manager to ask for one
        self._nspawn = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT
        )
        try:
            self._wait_for_systemd()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def _wait_for_systemd(self) -> None:
        assert self._nspawn is not None
        until_s = time.monotonic() + STARTED_WITHIN_S
        children = Path(f"/proc/{self._nspawn.pid}/task/{self._nspawn.pid}/children")
        state = ""
        while state not in ("running", "degraded"):
            assert self._nspawn.poll() is None, "the system did not start"
            assert time.monotonic() < until_s, f"the system is {state or 'not started'}"
            time.sleep(LOOK_AGAIN_S)
            found = children.read_text().split()
            if found:
                self._leader = int(found[0])
                state = self.run("systemctl", "is-system-running", status=None).strip()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        exc: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in self._beside:
            process.send_signal(signal.SIGKILL)
            process.wait(DONE_WITHIN_S)
        if self._nspawn is not None:
            self._nspawn.terminate()
            try:
                self._nspawn.wait(STARTED_WITHIN_S)
            except subprocess.TimeoutExpired:
                self._nspawn.kill()
                self._nspawn.wait(DONE_WITHIN_S)
        shutil.rmtree(self.place, ignore_errors=True)

    def _words(self, words: Sequence[str], user: str) -> list[str]:
        enter = [
            str(require("nsenter")),
            "-t",
            str(self._leader),
            "-m",
            "-u",
            "-i",
            "-n",
            "-p",
            "--",
        ]
        become = [] if user == "root" else ["setpriv", f"--reuid={user}", f"--regid={user}"]
        if become:
            become += ["--init-groups", "--"]
        return [*enter, "env", "-i", *ENVIRONMENT, *become, *words]

    def run(self, *words: str, user: str = "root", status: int | None = 0) -> str:
        """Run a program in the system.

        Args:
            words: The program and its arguments.
            user: As whom.
            status: The exit status that is expected; None: any.

        Returns:
            What it said, errors included.
        """
        done = subprocess.run(
            self._words(words, user),
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, timeout=DONE_WITHIN_S, check=False,
        )  # fmt: skip
        failed = f"{words}: {done.returncode}\n{done.stdout}"
        assert status is None or done.returncode == status, failed
        return done.stdout

    def start(self, *words: str, user: str = "root") -> subprocess.Popen[bytes]:
        """Start a program in the system that runs beside the test; it is killed at the end."""
        process = subprocess.Popen(
            self._words(words, user),
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._beside.append(process)
        return process

    def start_ours(self, *words: str | Path) -> subprocess.Popen[bytes]:
        """Start a program of this machine in the system's network; it is killed at the end."""
        process = subprocess.Popen(
            [str(word) for word in self._in_network(words)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._beside.append(process)
        return process

    def run_ours(self, *words: str | Path, status: int | None = 0) -> str:
        """Run a program of this machine in the system's network, and return what it says.

        Args:
            words: The program and its arguments.
            status: The exit status that is expected; None: any.
        """
        done = subprocess.run(
            [str(word) for word in self._in_network(words)],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, timeout=DONE_WITHIN_S, check=False,
        )  # fmt: skip
        failed = f"{words}: {done.returncode}\n{done.stdout}"
        assert status is None or done.returncode == status, failed
        return done.stdout

    def _in_network(self, words: Sequence[str | Path]) -> list[str | Path]:
        return [require("nsenter"), "-t", str(self._leader), "-n", "--", *words]

    def path(self, name: str) -> Path:
        """Return where a file of the system is for us."""
        return self.place / name.lstrip("/")

    def files(self) -> set[str]:
        """Return all files and directories that only packages and people change."""
        found: set[str] = set()
        for folder, folders, names in os.walk(self.place):
            where = os.path.relpath(folder, self.place).removeprefix(".").lstrip("/")
            if where in CHANGING:
                folders.clear()
                continue
            found.update(f"/{where}/{name}".replace("//", "/") for name in (*folders, *names))
        return found
