"""A controlling program dies or hangs while the motor runs: real processes on a pseudo terminal.

Some drives of the line are read all the time, so that the line is full. From the signal to the
stop may pass the lease time, the wait that `lecombus plan` prints for a stop, and what the computer
adds: the daemon says itself how late it was woken, and this test may be woken as late.
"""

from __future__ import annotations

import contextlib
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from support.children import Child, child, environment
from support.daemon_host import Daemon, lecombus, running, short_dir, until
from support.rosters import Wanted, roster_text

pytestmark = [pytest.mark.real]

LEASE_S = 0.6
WATCHDOG_S = 1.0
OWN_LATENESS_S = 0.3
"""How late the processes of this test may be on a busy computer."""

FULL: tuple[Wanted, ...] = tuple(
    (f"drive-{address}", address, "8200vector") for address in range(11, 45) if address % 10
)[:31]
DRIVE = FULL[0][0]


@dataclass
class Site:
    """A daemon on a full line, and what it promises."""

    daemon: Daemon
    line: Child
    stop_s: float

    def turns(self) -> float:
        return float(self.line.ask("turns", drive=DRIVE))

    def fired(self) -> int:
        return int(self.line.ask("so_far")["fired"][DRIVE])

    def lateness_s(self) -> float:
        return max(self.daemon.metric("lecombus_scheduler_lateness_seconds").values())

    def is_latched(self) -> bool:
        return 1.0 in self.daemon.metric(f'lecombus_drive_latched{{line="test",drive="{DRIVE}"}}'
                                         ).values()  # fmt: skip


@contextlib.contextmanager
def site(policy: str, count: int) -> Iterator[Site]:
    """Run a daemon with drives that are read as often as the line can."""
    with short_dir() as folder:
        drives = FULL[:count]
        lease = f"lease: {{required: true, time: {LEASE_S}s, on_lapse: {policy}}}"
        text = roster_text(
            drives, port=folder / "port", folder=folder, own={DRIVE: lease},
            drive="cyclic: [{code: C0150, every: 100ms}, {code: C0135, every: 100ms}]",
            watchdog=f"{{time: {1 if count < 9 else 4}s, action: quick-stop}}",
        )  # fmt: skip
        (folder / "line.yaml").write_text(text)
        words = ("--roster", folder / "line.yaml")
        plan = lecombus("plan", "-c", folder / "line.yaml", "--json", within_s=60.0).json()
        stop_s = next(one["loaded_s"] for one in plan["waits"] if one["name"] == "stop")
        with child("support.paced_line", folder / "port", *words) as line:
            line.ask("so_far")
            with running(text, folder) as daemon:
                # With `silence` nothing is sent to a drive that is enabled without a lease.
                daemon.until_online(*(name for name, _, _ in drives[1:]), within_s=120.0)
                yield Site(daemon, line, stop_s)


@contextlib.contextmanager
def controller(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run the controlling program until it says that the drive runs."""
    words = [folder / "api.sock", DRIVE, "30", LEASE_S]
    program = subprocess.Popen(
        [sys.executable, "-m", "support.lease_client", *map(str, words)],
        stdout=subprocess.PIPE, text=True, env=environment(),
    )  # fmt: skip
    try:
        yield program
    finally:
        program.kill()
        program.communicate()


def line_of(program: subprocess.Popen[str]) -> str:
    """Wait for the next line that a program says."""
    assert program.stdout is not None
    return program.stdout.readline().strip()


def die_once(here: Site, number: signal.Signals, *, silent: bool, rng: random.Random) -> float:
    """Have a controller die or hang while the motor runs; gives how late the stop was, seconds."""
    with controller(here.daemon.folder) as program:
        assert line_of(program) == "running"
        until(lambda: here.turns() > 0.5, "the motor turns", within_s=30.0)
        fired = here.fired()
        time.sleep(rng.uniform(0.0, LEASE_S))
        assert not here.is_latched()
        here.line.ask("stops")
        program.send_signal(number)
        at_s = time.monotonic()
        until(here.is_latched, "the lease has lapsed", within_s=30.0)
        if silent:
            until(lambda: here.fired() > fired, "the watchdog acts", within_s=30.0)
            late_s = 0.0
            assert here.line.ask("stops") == []
        else:
            stops = until(lambda: here.line.ask("stops"), "a stop", within_s=30.0)
            late_s = stops[0][0] - at_s - LEASE_S
            assert here.fired() == fired
        until(lambda: here.turns() == 0.0, "the motor stands", within_s=60.0)
        allowed_s = here.stop_s + here.lateness_s() + OWN_LATENESS_S
        assert late_s <= allowed_s, (late_s, allowed_s)
        if number is signal.SIGSTOP:
            program.send_signal(signal.SIGCONT)
            assert line_of(program) in ("lease-lost", "offline")
        else:
            assert program.wait(10.0) == -number
    time.sleep(0.5)
    assert here.turns() == 0.0
    assert here.is_latched()
    return late_s


def die(policy: str, times: int, count: int) -> list[float]:
    """Have controllers die and hang in turn."""
    rng = random.Random(policy)
    with site(policy, count) as here:
        silent = policy == "silence"
        return [
            die_once(here, (signal.SIGKILL, signal.SIGSTOP)[one % 2], silent=silent, rng=rng)
            for one in range(times)
        ]


@pytest.mark.slow
@pytest.mark.timeout(240)
@pytest.mark.parametrize("policy", ["quick-stop", "silence"])
def test_a_drive_stops_when_its_controller_dies_or_hangs(policy: str) -> None:
    die(policy, 5, 5)


@pytest.mark.long
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("policy", ["quick-stop", "silence"])
def test_a_drive_of_a_full_line_stops_in_100_of_100_deaths_and_hangs(
    policy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    late_s = sorted(die(policy, 200, 31))
    with capsys.disabled():
        print(f"\n{policy}: {late_s[100]:.3f} s, at most {late_s[-1]:.3f} s late")  # noqa: T201
