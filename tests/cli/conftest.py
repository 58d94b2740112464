"""Every test of the command line runs `main` itself and looks at its status and its output."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from cli.daemon_stub import DaemonStub, serve_stub
from lecombus.cli import main
from lecombus.client import finding


@dataclass(frozen=True)
class Ran:
    """A command that was run."""

    status: int
    out: str
    err: str


Run = Callable[..., Ran]

SetZone = Callable[[str], None]


@pytest.fixture(autouse=True)
def _no_daemon_of_this_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("LECOMBUS_SOCKET", raising=False)
    monkeypatch.delenv("LECOMBUS_URL", raising=False)
    monkeypatch.delenv("LECOMBUS_TOKEN_FILE", raising=False)
    monkeypatch.delenv("LECOMBUS_CA", raising=False)
    monkeypatch.setattr(finding, "RUNTIME_DIR", tmp_path / "run")


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    def run_command(*words: str) -> Ran:
        capfd.readouterr()
        status = main(words)
        out, err = capfd.readouterr()
        return Ran(int(status), out, err)

    return run_command


@pytest.fixture
def set_zone() -> Iterator[SetZone]:
    """Sets the local time zone, for this test only."""
    with pytest.MonkeyPatch.context() as changed:

        def change(zone: str) -> None:
            changed.setenv("TZ", zone)
            time.tzset()

        yield change
    time.tzset()  # reads the variable that stands there again


@pytest.fixture
def short_dir() -> Iterator[Path]:
    """A directory whose path is short enough for a Unix socket."""
    with tempfile.TemporaryDirectory(prefix="lb-") as name:
        yield Path(name)


@pytest.fixture
def daemon(short_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[DaemonStub]:
    """A daemon that `LECOMBUS_SOCKET` points at."""
    with serve_stub(short_dir / "hall-3.sock") as stub:
        monkeypatch.setenv("LECOMBUS_SOCKET", str(stub.path))
        yield stub
