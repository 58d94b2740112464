"""The command line against the real daemon: `lecombus run` on simulated drives, all commands."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cli.conftest import Run
from support.rosters import roster_text

pytestmark = pytest.mark.clock


@contextmanager
def running(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a daemon on simulated drives in a folder with a short path; all of them are online."""
    roster, socket = folder / "hall-3.yaml", folder / "hall-3.sock"
    text = roster_text(
        [("feeder", 11, "8200vector"), ("belt", 12, "93xx")],
        name="hall-3", own={"belt": "restore: true"},
        sections=f"groups: {{conveyors: {{members: [feeder, belt]}}}}\napi: {{socket: {socket}}}",
    )  # fmt: skip
    roster.write_text(text)
    with subprocess.Popen(
        [sys.executable, "-m", "lecombus", "run", "-c", str(roster), "--log-format", "json"],
        stderr=subprocess.PIPE,
        text=True,
    ) as daemon:
        assert daemon.stderr is not None
        try:
            missing = {"feeder", "belt"}
            for line in daemon.stderr:
                event = json.loads(line)
                if event.get("event") == "state" and event.get("to") == "online":
                    missing.discard(event["drive"])
                if not missing:
                    break
            yield daemon
        finally:
            daemon.kill()


@pytest.fixture(scope="module")
def shared() -> Iterator[Path]:
    """The folder of a daemon for all tests that leave it as it was, or do not mind."""
    with tempfile.TemporaryDirectory(prefix="lb-") as name, running(Path(name)):
        yield Path(name)


@pytest.fixture
def daemon_of_all(shared: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """LECOMBUS_SOCKET points at the daemon that these tests share; gives its folder."""
    monkeypatch.setenv("LECOMBUS_SOCKET", str(shared / "hall-3.sock"))
    return shared


@pytest.fixture
def process(short_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[subprocess.Popen[str]]:
    """A daemon of one test's own; LECOMBUS_SOCKET points at it."""
    monkeypatch.setenv("LECOMBUS_SOCKET", str(short_dir / "hall-3.sock"))
    with running(short_dir) as daemon:
        yield daemon


@pytest.mark.usefixtures("daemon_of_all")
def test_every_command_speaks_with_the_daemon(run: Run) -> None:
    reading = json.loads(run("read", "feeder", "C0050", "--json").out)
    assert (reading["drive"], reading["code"], reading["quality"]) == ("feeder", "C0050", "good")
    assert run("read", "feeder", "C0050", "--stored").status == 0

    written = run("write", "feeder", "C0046", "12.5", "--verify", "--json")
    assert (written.status, written.err) == (0, "")
    report = json.loads(written.out)
    assert (report["outcome"], report["reading"]["value"]) == ("verified", 12.5)
    assert run("read", "feeder", "C0046").out.split("\t")[2] == "12.5"

    grouped = run("group", "conveyors", "C0040", "0", "--verify")
    assert grouped.status == 0
    assert [line.split("\t")[0] for line in grouped.out.splitlines()] == ["feeder", "belt"]

    stopped = run("stop")
    assert stopped.status == 0
    assert {line.split("\t")[2] for line in stopped.out.splitlines()} == {"verified"}

    line, *listed = run("status").out.splitlines()
    assert line.split("\t")[:3] == ["line", "hall-3", "open"]
    assert [line.split("\t")[:4] for line in listed] == [
        ["feeder", "11", "8200vector", "online"],
        ["belt", "12", "93xx", "online"],
    ]
    values = [line.split("\t") for line in run("status", "feeder").out.splitlines()]
    assert ["C0046", "12.5"] in [[cells[0], cells[2]] for cells in values]
    both = json.loads(run("status", "--json").out)
    assert {"line", "drives"} == set(both)


@pytest.mark.usefixtures("daemon_of_all")
def test_a_command_runs_with_a_lease_that_ends_with_it(run: Run) -> None:
    lecombus = [sys.executable, "-m", "lecombus"]
    words = ("lease", "service", "--on", "feeder", "--time", "2s", "--")
    inside = run(*words, *lecombus, "write", "feeder", "C0046", "7.5")
    assert inside.err == ""
    assert (inside.status, inside.out.split("\t")[:3]) == (0, ["feeder", "C0046", "done"])
    rows = run(*words, *lecombus, "leases")
    [row] = [line.split("\t") for line in rows.out.splitlines()]
    assert row[:3] == ["feeder", "free", "service"]
    refused = f"import os, subprocess; del os.environ['LECOMBUS_LEASE']; raise SystemExit(" \
        f"subprocess.call({[*lecombus, 'write', 'feeder', 'C0046', '7.5']!r}))"  # fmt: skip
    other = run(*words, sys.executable, "-c", refused)
    assert (other.status, "under the lease service" in other.err) == (4, True), other.err
    assert run(*words, sys.executable, "-c", "raise SystemExit(7)").status == 7
    assert run(*words, "/nowhere").status == 2
    assert run("lease", "service", "--on", "feder", "--", "true").status == 2
    assert run("leases").out == ""


@pytest.mark.usefixtures("daemon_of_all")
def test_what_the_daemon_refuses_has_the_status_that_fits(run: Run) -> None:
    assert run("read", "feedr", "C0050").status == 2
    assert "feeder" in run("read", "feedr", "C0050").err
    assert run("read", "feeder", "C6000").status == 1
    assert run("write", "feeder", "C0011", "50").status == 4
    assert run("write", "feeder", "C0046", "H00").status == 2
    assert run("group", "nobody", "C0040", "0").status == 2
    ran = run("stop", "fedeer")
    assert (ran.status, "feeder" in ran.err.splitlines()[1]) == (2, True)
    assert ran.err.startswith("there is no drive and no group fedeer, no quick stop was sent: ")


def test_a_second_daemon_names_the_first_and_never_opens_the_port(daemon_of_all: Path) -> None:
    roster = daemon_of_all / "hall-3.yaml"
    second = subprocess.run(
        [sys.executable, "-m", "lecombus", "run", "-c", str(roster), "--log-level", "debug"],
        capture_output=True,
        text=True,
        timeout=15,
        check=False,
    )
    assert second.returncode == 1
    assert f"{daemon_of_all}/hall-3.sock is served by " in second.stderr
    assert "event=port-open" not in second.stderr


def test_a_daemon_that_was_ended_is_not_reachable(run: Run, process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=20)
    assert process.returncode == 0
    assert run("status").status == 3


@pytest.mark.timeout(60)  # some 170 reads over a line that takes its time
@pytest.mark.usefixtures("process")
def test_a_drive_is_backed_up_changed_and_restored(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    backup, other = tmp_path / "belt.yaml", tmp_path / "other.yaml"
    assert run("backup", "belt", "-o", str(backup)).status == 0
    changed = backup.read_text().replace("C0039/2: 10 ", "C0039/2: 20.5 ")
    assert changed != backup.read_text()
    other.write_text(changed)

    assert run("write", "belt", "C0040", "1").status == 0
    ran = run("restore", str(other), "belt", "--yes")
    assert (ran.status, "1 code written and read back and saved" in ran.out) == (0, True), ran.err
    assert "belt is inhibited" in ran.out
    assert run("read", "belt", "C0040").out.split("\t")[2] == "0"
    ran = run("diff", str(backup), "belt")
    assert [line.split("\t")[0] for line in ran.out.splitlines()] == ["C0039/2"]
