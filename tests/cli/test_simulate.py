"""Simulated drives served by one command and read by another, with no daemon between."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cli.conftest import Run
from support.rosters import roster_text

pytestmark = pytest.mark.clock

ROSTER = roster_text([("feeder", 11, "8200vector")], name="hall-3")


@pytest.fixture
def roster(tmp_path: Path) -> Path:
    path = tmp_path / "hall-3.yaml"
    path.write_text(ROSTER)
    return path


@contextmanager
def simulated(*words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run `lecombus simulate` and give it with the first line it prints."""
    with subprocess.Popen(
        [sys.executable, "-m", "lecombus", "simulate", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().strip()
        finally:
            process.kill()


def test_a_simulated_drive_is_read_through_a_port_of_its_own(
    run: Run, roster: Path, tmp_path: Path
) -> None:
    link = tmp_path / "line"
    with simulated("-c", str(roster), "--pty", str(link)) as (_, port):
        assert port == str(link)
        words = ("--port", port, "--baud", "19200", "--family", "8200vector", "--json")
        ran = run("read", *words, "--address", "11", "C0050")
        assert (ran.status, ran.err) == (0, "")
        reading = json.loads(ran.out)
        assert (reading["code"], reading["format"], reading["unit"]) == ("C0050", "VD", "Hz")
        absent = run("read", *words[:-1], "--address", "12", "C0050")
        assert absent.status == 1
        assert "no drive answers at address 12: not one byte came back" in absent.err
        assert "check the baud rate (19200 here" in absent.err
        assert "A and B" in absent.err


def test_another_program_that_takes_the_bytes_is_named(
    run: Run, roster: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who else has a port open is found out in tests/line/test_devices.py."""
    monkeypatch.setattr("lecombus.line.devices.holders", lambda path: {12: "cat (pid 12)"})
    with simulated("-c", str(roster), "--pty", str(tmp_path / "line")) as (_, port):
        ran = run("read", "--port", port, "--baud", "19200", "--address", "12", "C0050")
        assert ran.status == 1
        assert f"cat (pid 12) has {port} open too and takes bytes from the drives" in ran.err
        assert "end it" in ran.err


def test_the_same_over_tcp(run: Run, roster: Path) -> None:
    with simulated("-c", str(roster), "--tcp", "127.0.0.1:0", "--json") as (_, line):
        served = json.loads(line)
        assert served["drives"] == [{"drive": "feeder", "address": 11, "family": "8200vector"}]
        ran = run("read", "--port", served["port"], "--baud", "19200", "--address", "11", "C0050")
        assert ran.status == 0


def test_the_link_of_a_simulator_that_runs_is_left_alone(
    run: Run, roster: Path, tmp_path: Path
) -> None:
    link = tmp_path / "line"
    with simulated("-c", str(roster), "--pty", str(link)):
        leads_to = link.readlink()
        ran = run("simulate", "-c", str(roster), "--pty", str(link))
        assert (ran.status, ran.out) == (2, "")
        assert "a simulator still serves it" in ran.err
        assert "end that one first" in ran.err
        assert link.readlink() == leads_to


def test_a_link_left_behind_is_replaced(run: Run, roster: Path, tmp_path: Path) -> None:
    link = tmp_path / "line"
    link.symlink_to("/dev/pts/no-such-terminal")
    with simulated("-c", str(roster), "--pty", str(link)):
        assert link.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_cleanly_and_leaves_no_link(
    roster: Path, tmp_path: Path, number: signal.Signals
) -> None:
    link = tmp_path / "line"
    with simulated("-c", str(roster), "--pty", str(link)) as (process, _):
        assert link.is_symlink()
        process.send_signal(number)
        assert process.wait(timeout=10) == 0
    assert not link.is_symlink()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--tcp", "0.0.0.0:4001"], "127.0.0.1"),
        (["--tcp", "x"], "127.0.0.1:PORT"),
        (["--tcp", "0", "--faults", "gremlins=1"], "gremlins"),
        (["--tcp", "0", "--faults", "absent=11+99"], "has the address 99; absent takes"),
        (["--tcp", "0", "--pty", "/tmp/x"], "--pty and --tcp are both given; leave one"),
        (["--pty", "/etc/passwd"], "is not a link"),
    ],
)
def test_what_cannot_be_served_is_said(run: Run, roster: Path, words: list[str], said: str) -> None:
    ran = run("simulate", "-c", str(roster), *words)
    assert ran.status == 2
    assert said in ran.err


@pytest.mark.parametrize("address", ["0", "20", "90", "100", "-1"])
def test_an_address_that_no_drive_has_is_refused_at_once(run: Run, address: str) -> None:
    ran = run("read", "--port", "/dev/none", "--address", address, "C0050")
    assert (ran.status, ran.out) == (2, "")
    assert f"no drive has the address {address}; it is 1 to 99, and not 10, 20 .. 90" in ran.err


def test_a_port_that_is_not_there_is_a_failure_of_the_line(run: Run, tmp_path: Path) -> None:
    ran = run("read", "--port", str(tmp_path / "none"), "--address", "11", "C0050")
    assert ran.status == 1
    assert ran.err.count("\n") == 1
    assert "no such device" in ran.err


def test_a_running_simulator_is_told_from_another_terminal(
    run: Run, roster: Path, tmp_path: Path
) -> None:
    link = tmp_path / "line"
    words = ("simulate", "--pty", str(link), "--tell")
    with simulated("-c", str(roster), "--pty", str(link)):
        told = run(*words, "trip feeder 50")
        assert (told.status, told.out) == (0, "feeder: address 11, 8200vector, TRIP 50\n")
        ran = run(
            "read", "--port", str(link), "--baud", "19200", "--address", "11", "--json", "C0161"
        )
        assert json.loads(ran.out)["value"] == 50
        wrong = run(*words, "trip feedr 50")
        assert (wrong.status, wrong.out) == (1, "")
        assert "did you mean feeder?" in wrong.err
        two = run(*words, "trip feeder 50", "--tell", "reset feeder", "--json")
        assert json.loads(two.out)[0]["told"] == "trip feeder 50"
        none = run(*words, "trip feedr 50", "--json")
        assert (none.status, none.out, json.loads(none.err)["status"]) == (1, "", 1)
        some = run(*words, "trip feeder 50", "--tell", "trip feedr 50", "--json")
        assert (some.status, len(json.loads(some.out))) == (1, 1)
    gone = run("simulate", "--control", str(tmp_path / "nothing"), "--tell", "drives")
    assert gone.status == 3
    assert "no simulator answers at" in gone.err
    gone = run("simulate", "--control", str(tmp_path / "nothing"), "--tell", "drives", "--json")
    assert (gone.status, gone.out) == (3, "")
    assert "no simulator answers at" in json.loads(gone.err)["problem"]
    nobody = run("simulate", "--tell", "drives")
    assert (nobody.status, "needs the simulator" in nobody.err) == (2, True)


def test_lines_typed_into_its_terminal_are_done(roster: Path, tmp_path: Path) -> None:
    keyboard, terminal = os.openpty()
    words = [sys.executable, "-m", "lecombus", "simulate", "-c", str(roster), "--tcp", "0"]
    # A shell that opens it as the leader of a session makes it the terminal of what it becomes.
    opening = f"exec {shlex.join(words)} <{os.ttyname(terminal)}"
    with subprocess.Popen(
        ["sh", "-c", opening],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        try:
            while "Type help" not in process.stderr.readline():
                assert process.poll() is None
            os.write(keyboard, b"jump\ntrip feeder 50\n")
            assert "there is no `jump`" in process.stderr.readline()
            assert "TRIP 50" in process.stderr.readline()
        finally:
            process.kill()
    os.close(keyboard)
    os.close(terminal)


def test_a_roster_is_still_wanted(run: Run) -> None:
    ran = run("simulate", "--tcp", "0")
    assert ran.status == 2
    assert "-c ROSTER is missing" in ran.err
