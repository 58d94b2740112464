"""A controlling program dies, hangs or loses its network while the motor runs: real processes on a
pseudo terminal. The network is a relay that forwards nothing more and closes nothing, so that the
daemon is told nothing: as with a cable that is pulled.

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
from enum import Enum

import pytest

from support.children import Child, child, environment
from support.daemon_host import Daemon, free_port, lecombus, running, short_dir, until
from support.relay import Relay, relay_to
from support.rosters import Wanted, roster_text

pytestmark = [pytest.mark.real]


class End(Enum):
    """What becomes of a controller."""

    DIES = signal.SIGKILL
    HANGS = signal.SIGSTOP
    IS_CUT_OFF = None


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
    network: Relay

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
        drives, port = FULL[:count], free_port()
        lease = f"lease: {{required: true, time: {LEASE_S}s, on_lapse: {policy}}}"
        text = roster_text(
            drives, port=folder / "port", folder=folder, own={DRIVE: lease}, http=port,
            drive="cyclic: [{code: C0150, every: 100ms}, {code: C0135, every: 100ms}]",
            watchdog=f"{{time: {1 if count < 9 else 4}s, action: quick-stop}}",
        )  # fmt: skip
        text = text.replace("http:", f"tokens: {folder / 'tokens'}, http:")
        (folder / "line.yaml").write_text(text)
        made = lecombus(
            "token", "new", "plc", "--scope", "write", "--scope", "control", "-o", folder / "token",
            "-c", folder / "line.yaml", within_s=60.0,
        )  # fmt: skip
        assert made.status == 0, made.err
        words = ("--roster", folder / "line.yaml")
        plan = lecombus("plan", "-c", folder / "line.yaml", "--json", within_s=60.0).json()
        stop_s = next(one["loaded_s"] for one in plan["waits"] if one["name"] == "stop")
        with child("support.paced_line", folder / "port", *words) as line:
            line.ask("so_far")
            with running(text, folder) as daemon, relay_to(port) as network:
                # With `silence` nothing is sent to a drive that is enabled without a lease.
                daemon.until_online(*(name for name, _, _ in drives[1:]), within_s=120.0)
                yield Site(daemon, line, stop_s, network)


@contextlib.contextmanager
def controller(here: Site, *, over_network: bool) -> Iterator[subprocess.Popen[str]]:
    """Run the controlling program, at the socket or over the network."""
    folder = here.daemon.folder
    words: list[object] = [folder / "api.sock", DRIVE, "30", LEASE_S]
    if over_network:
        words = [f"http://127.0.0.1:{here.network.port}", DRIVE, "30", LEASE_S, folder / "token"]
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


def end_once(here: Site, end: End, *, silent: bool, rng: random.Random) -> float:
    """Have a controller end in some way while the motor runs; gives how late the stop was, s."""
    with controller(here, over_network=end is End.IS_CUT_OFF) as program:
        assert line_of(program) == "running"
        until(lambda: here.turns() > 0.5, "the motor turns", within_s=30.0)
        fired = here.fired()
        time.sleep(rng.uniform(0.0, LEASE_S))
        assert not here.is_latched()
        here.line.ask("stops")
        if end.value is None:
            here.network.cut()
        else:
            program.send_signal(end.value)
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
        if end is End.DIES:
            assert program.wait(10.0) == -signal.SIGKILL
        else:  # it goes on as if no time had passed
            here.network.mend() if end is End.IS_CUT_OFF else program.send_signal(signal.SIGCONT)
            assert line_of(program) in ("lease-lost", "offline")
    time.sleep(0.5)
    assert here.turns() == 0.0
    assert here.is_latched()
    return late_s


def end_often(policy: str, times: int, count: int) -> list[float]:
    """Have controllers die, hang and lose their network in turn."""
    rng = random.Random(policy)
    with site(policy, count) as here:
        silent = policy == "silence"
        ends = list(End) * times
        return [end_once(here, end, silent=silent, rng=rng) for end in ends]


@pytest.mark.slow
@pytest.mark.timeout(240)
@pytest.mark.parametrize("policy", ["quick-stop", "silence"])
def test_a_drive_stops_when_its_controller_dies_hangs_or_is_cut_off(policy: str) -> None:
    end_often(policy, 2, 5)


@pytest.mark.long
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("policy", ["quick-stop", "silence"])
def test_a_drive_of_a_full_line_stops_in_100_of_100_ends_of_each_kind(
    policy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    late_s = sorted(end_often(policy, 100, 31))
    with capsys.disabled():
        print(f"\n{policy}: {late_s[150]:.3f} s, at most {late_s[-1]:.3f} s late")  # noqa: T201
