"""A real daemon for tests: `lecombus run` as its own process, on a simulated line.

What is talked to here is what a user has: a process with signals and an exit status, its socket,
its log, and the command line. Nothing of the daemon is imported. The line is a pseudo terminal or
whatever the roster names; helpers here write rosters, start processes, and end exactly those.

Waiting is done by `until`, which looks again and again and fails after a time that is far longer
than needed, because the machine may be busy with something else.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import httpx2
import pytest

from lecombus.fieldbus.lecom.simulator import PtyEnd, SimLine, build
from support.rosters import Wanted, roster_text

__all__ = [
    "FIVE",
    "Daemon",
    "Ran",
    "command",
    "free_port",
    "lecombus",
    "on_a_pty",
    "running",
    "short_dir",
    "sim_line",
    "started",
    "until",
]

SRC = Path(__file__).parents[2] / "src"
LOOK_AGAIN_S = 0.02
T = TypeVar("T")

FIVE: tuple[Wanted, ...] = (
    ("feeder", 11, "8200vector"),
    ("belt", 12, "smvector"),
    ("winder", 21, "93xx"),
    ("pump", 22, "820x"),
    ("fan", 23, "821x"),
)


def until(condition: Callable[[], T], what: str, *, within_s: float = 15.0) -> T:
    """Look until a condition holds, and give what it gave.

    Args:
        condition: Looked at again and again; what httpx2 raises meanwhile counts as no.
        what: Said when it never holds.
        within_s: How long to look, seconds.
    """
    end_s = time.monotonic() + within_s
    while True:
        with contextlib.suppress(httpx2.TransportError):
            found = condition()
            if found:
                return found
        if time.monotonic() > end_s:
            pytest.fail(f"not within {within_s:g} s: {what}")
        time.sleep(LOOK_AGAIN_S)


@contextlib.contextmanager
def short_dir() -> Iterator[Path]:
    """A directory whose path is short enough for a Unix socket."""
    with tempfile.TemporaryDirectory(prefix="lb-") as name:
        yield Path(name)


def free_port() -> int:
    """A TCP port of this machine that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def sim_line(drives: Sequence[Wanted] = FIVE, *, baud: int = 19200, **more: Any) -> SimLine:
    """Build simulated drives."""
    return build(drives, baud=baud, **more)


def command(*words: str | Path) -> list[str]:
    """The words that run lecombus from this source tree."""
    return [sys.executable, "-m", "lecombus", *map(str, words)]


def environment(**more: str) -> dict[str, str]:
    """The environment in which lecombus finds its source and nothing of this machine's."""
    kept = {key: text for key, text in os.environ.items() if not key.startswith("LECOMBUS_")}
    kept.pop("NOTIFY_SOCKET", None)
    return {**kept, "PYTHONPATH": str(SRC), "PYTHONWARNINGS": "default", "COLUMNS": "200", **more}


@dataclass(frozen=True)
class Ran:
    """A command that was run to its end."""

    status: int
    out: str
    err: str

    def json(self) -> Any:
        """What it printed, read as one JSON document."""
        return json.loads(self.out)


def lecombus(*words: str | Path, within_s: float = 15.0) -> Ran:
    """Run a command of lecombus to its end."""
    done = subprocess.run(
        command(*words),
        capture_output=True, text=True, timeout=within_s, env=environment(), check=False,
    )  # fmt: skip
    return Ran(done.returncode, done.stdout, done.stderr)


@contextlib.contextmanager
def started(
    words: Sequence[str], log: Path, *, env: dict[str, str] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Start a program and end it, whatever happens; all it says goes into `log`."""
    with log.open("ab") as out:
        program = subprocess.Popen(words, stdout=out, stderr=out, env=env or environment())
        try:
            yield program
        finally:
            program.kill()
            program.wait()


@dataclass
class Daemon:
    """A running daemon and how to talk to it.

    Args:
        process: The process.
        folder: Where its roster, its socket and its log are.
        client: Speaks HTTP over its Unix socket.
    """

    process: subprocess.Popen[bytes]
    folder: Path
    client: httpx2.Client
    socket: Path = field(init=False)
    roster: Path = field(init=False)

    def __post_init__(self) -> None:
        self.socket = self.folder / "api.sock"
        self.roster = self.folder / "roster.yaml"

    def get(self, path: str) -> Any:
        """Read a document that must be there."""
        answer = self.client.get(path)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def cli(self, name: str, *words: str | Path, within_s: float = 15.0) -> Ran:
        """Run a command that talks to this daemon."""
        return lecombus(name, "--socket", self.socket, *words, within_s=within_s)

    def states(self) -> dict[str, str]:
        """The state of every drive."""
        return {drive["drive"]: drive["state"] for drive in self.get("/v1/drives")["drives"]}

    def line_state(self) -> str:
        """The state of the line."""
        return str(self.get("/v1/line")["state"])

    def until_online(self, *names: str, within_s: float = 18.0) -> None:
        """Wait until drives (none named: all) are online."""

        def online() -> bool:
            states = self.states()
            return all(states[name] == "online" for name in names or states)

        try:
            until(online, "drives online", within_s=within_s)
        except pytest.fail.Exception as exc:
            pytest.fail(f"{exc}: {self.states()}\n{self.log()[-3000:]}")

    def log(self) -> str:
        """All it has logged so far."""
        return (self.folder / "log").read_text()

    def tell(self, number: int) -> None:
        """Send it a signal."""
        self.process.send_signal(number)

    def end(self, number: int = signal.SIGTERM, *, within_s: float = 10.0) -> int:
        """End it by a signal and give its exit status."""
        self.tell(number)
        return self.process.wait(within_s)

    def metric(self, wanted: str) -> dict[str, float]:
        """The samples whose names and labels begin with a text."""
        page = self.client.get("/metrics").text
        rows = (row.rpartition(" ") for row in page.splitlines() if row.startswith(wanted))
        return {name: float(number) for name, _, number in rows}


@contextlib.contextmanager
def running(roster: str, folder: Path, *, env: dict[str, str] | None = None) -> Iterator[Daemon]:
    """Run a daemon with a roster; its API answers when this is entered.

    Args:
        roster: The roster's text.
        folder: Where to put roster, log and socket; the roster's socket is `api.sock` there.
        env: Further variables of its environment.
    """
    (folder / "roster.yaml").write_text(roster)
    words = command("run", "-c", folder / "roster.yaml")
    transport = httpx2.HTTPTransport(uds=str(folder / "api.sock"))
    with (
        started(words, folder / "log", env=environment(**(env or {}))) as process,
        httpx2.Client(transport=transport, base_url="http://lecombus", timeout=12.0) as client,
    ):
        daemon = Daemon(process, folder, client)

        def answers() -> bool:
            assert process.poll() is None, daemon.log()
            return listens(folder / "api.sock") and client.get("/v1/line").status_code == 200

        until(answers, "the API answers")
        yield daemon


def listens(path: Path) -> bool:
    """Whether somebody takes connections; httpx2 leaks a socket when it finds out by itself."""
    with socket.socket(socket.AF_UNIX) as probe:
        return probe.connect_ex(str(path)) == 0


@contextlib.contextmanager
def on_a_pty(
    folder: Path, drives: Sequence[Wanted] = FIVE, *, faults: str = "", **roster: Any
) -> Iterator[tuple[Daemon, PtyEnd]]:
    """Run a daemon on a pseudo terminal of simulated drives, served by this process."""
    line = sim_line(drives, faults=faults)
    with PtyEnd(line, folder / "port") as end:
        text = roster_text(drives, port=folder / "port", folder=folder, **roster)
        with running(text, folder) as daemon:
            yield daemon, end
