"""The Modbus bridge as a process, a daemon with simulated drives, and clients of another make."""

from __future__ import annotations

import contextlib
import re
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from lecombus.bridges.line_follower import AWAY_AFTER_S
from support.daemon_host import (
    Daemon,
    command,
    environment,
    free_port,
    lecombus,
    running,
    short_dir,
    started,
    until,
)
from support.modbus_plc import ModbusClient, ModbusRefusedError, Outputs, cycling, halves
from support.rosters import roster_text

pytestmark = [pytest.mark.real]

FEEDER = 1100
BELT = 1200
DONE, VERIFIED, REFUSED = 2, 3, 4
HELD = 3
BUSY, AWAY, NOT_FRESH = 0x06, 0x0A, 0x0B
LEASE_S = 1.0


@dataclass
class Site:
    """A daemon, its bridge, and a client."""

    daemon: Daemon
    bridge: subprocess.Popen[bytes]
    port: int
    client: ModbusClient

    def shown(self) -> list[int]:
        """The last command and its outcome, the last setpoint and its outcome."""
        return self.client.read(FEEDER + 10, 7)

    def command(self) -> list[int]:
        return self.client.read(FEEDER + 11, 2)

    def controls(self) -> bool:
        return self.client.read(FEEDER + 7) == [HELD]

    def turns(self) -> bool:
        return self.client.refused(FEEDER + 26, 2) == 0 and self.client.signed(FEEDER + 26) > 0


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    """One daemon for all; what is done to it is undone by each test, but for the last."""
    lease = f"lease: {{required: true, time: {LEASE_S}s, on_lapse: quick-stop}}"
    cyclic = "cyclic: [{code: C0150, every: 200ms}, {code: C0050, every: 200ms}]"
    drives = (("feeder", 11, "8200vector"), ("belt", 12, "93xx"))
    with short_dir() as folder:
        text = roster_text(drives, folder=folder, own={"feeder": f"{lease}, {cyclic}"})
        with running(text, folder) as found:
            found.until_online("feeder", within_s=40.0)
            yield found


@contextlib.contextmanager
def bridge(daemon: Daemon, *, control: bool = True) -> Iterator[Site]:
    port = free_port()
    roster, log = daemon.folder / f"{port}.yaml", daemon.folder / f"{port}.log"
    modbus = f"modbus: {{port: {port}, control: {control}, units: [1]}}\n"
    roster.write_text(daemon.roster.read_text() + modbus)
    words = command("bridge", "modbus", "-c", roster)
    with started(words, log, env=environment()) as process:
        until(lambda: "event=daemon-connected" in log.read_text(), "it serves", within_s=30.0)
        client = ModbusClient(port)
        try:
            until(lambda: client.refused(FEEDER + 20, 8) == 0, "values are fresh")
            yield Site(daemon, process, port, client)
        finally:
            client.close()


def mbpoll(port: int, first: int, *words: str, kind: str = "4") -> subprocess.CompletedProcess[str]:
    found = shutil.which("mbpoll")
    assert found, "mbpoll is missing: apt-get install mbpoll"
    return subprocess.run(
        [found, "-m", "tcp", "-p", str(port), "-a", "1", "-0", "-1", "-q", "-t", kind,
         "-r", str(first), "127.0.0.1", *words],
        capture_output=True, text=True, timeout=20.0, check=False,
    )  # fmt: skip


def polled(port: int, first: int, count: int, kind: str = "4") -> tuple[list[int], str]:
    """Read with mbpoll: the registers, and what it says otherwise."""
    done = mbpoll(port, first, "-c", str(count), kind=kind)
    rows = re.findall(r"^\[\d+\]:\s+(-?\d+)", done.stdout, re.MULTILINE)
    return [int(one) for one in rows], done.stdout + done.stderr


def test_another_makes_client_reads_and_is_refused_what_is_old_and_what_it_may_not(
    daemon: Daemon,
) -> None:
    with bridge(daemon, control=False) as one:
        registers, _ = polled(one.port, FEEDER, 17)
        assert (len(registers), registers[0], registers[5], registers[7]) == (17, 2, 1, 0)
        inputs, _ = polled(one.port, FEEDER + 20, 8, kind="3")
        assert len(inputs) == 8
        _, said = polled(one.port, 1226, 2)  # a 93XX shows no speed
        assert "Target device failed to respond" in said
        _, said = polled(one.port, 1300, 1)
        assert "Illegal data address" in said
        done = mbpoll(one.port, FEEDER + 41, "1")
        assert "Illegal function" in done.stdout + done.stderr
        for _ in range(1000):
            assert len(one.client.read(FEEDER, 17)) == 17
        assert daemon.states()["feeder"] == "online"


def enable(one: Site, plc: Outputs) -> None:
    plc.command = 1
    until(lambda: one.command() == [1, VERIFIED], "stopped")
    plc.command = 0
    time.sleep(0.5)
    plc.command = 3
    until(lambda: one.command() == [3, VERIFIED], "enabled")


def test_a_plc_enables_sets_stops_and_loses_its_lease_when_it_hangs(daemon: Daemon) -> None:
    with bridge(daemon) as one, cycling(one.port, FEEDER + 40, command=3) as plc:
        plc.setpoint = 354000
        until(one.controls, "the lease is held")
        time.sleep(0.5)
        assert one.shown()[2:4] == [REFUSED, 1]  # set before the lease: it starts nothing
        assert not one.turns()
        enable(one, plc)
        assert one.shown()[5] == DONE  # before the enable
        until(one.turns, "it turns")
        time.sleep(1.0)
        assert daemon.log().count("written=C0046:35.4") == 1
        plc.setpoint = 200000
        until(lambda: "C0046:20" in daemon.log(), "the new setpoint")
        plc.is_counting = False
        until(lambda: not one.controls(), "the lease ends")
        until(lambda: "event=lapse-stopped" in daemon.log(), "the drive is stopped")
        until(lambda: not one.turns(), "it stands", within_s=30.0)
        plc.is_counting = True
        until(one.controls, "the lease is held again")
        time.sleep(1.0)
        assert not one.turns()
        enable(one, plc)
        plc.command = 1
        until(lambda: one.command() == [1, VERIFIED], "the quick stop")
        assert "process=lecombus-modbus" in daemon.log()
    # The lease was not given up when the PLC ended.
    until(lambda: daemon.log().count("end=lapsed") == 2, "the lease lapses")
    assert "end=released" not in daemon.log()


def test_stops_need_no_lease_and_come_from_every_address_that_may_connect(daemon: Daemon) -> None:
    with bridge(daemon) as one:
        assert "Written 1 references" in mbpoll(one.port, FEEDER + 41, "2").stdout
        until(lambda: one.command() == [2, VERIFIED], "the inhibit")
        one.client.write_one(40, 1)
        until(lambda: one.client.read(5, 2) == [1, VERIFIED], "the stop of all")
        with cycling(one.port, FEEDER + 40):
            until(one.controls, "the lease is held")
            with contextlib.closing(ModbusClient(one.port, source="127.0.0.2")) as other:
                with pytest.raises(ModbusRefusedError) as refused:
                    other.write(FEEDER + 40, 1, 0, *halves(5))
                assert refused.value.code == BUSY
                other.write_one(FEEDER + 41, 1)
            until(lambda: one.command() == [1, VERIFIED], "the stop of another")
        for first, values, code in (
            (FEEDER + 41, (5,), 3), (40, (3,), 3), (FEEDER + 42, (1,), 2), (FEEDER + 43, (1,), 2),
            (FEEDER + 20, (1,), 2), (FEEDER + 40, (1, 0, 0), 2), (1341, (1,), 2),
        ):  # fmt: skip
            with pytest.raises(ModbusRefusedError) as refused:
                one.client.write(first, *values)
            assert refused.value.code == code


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_bridge_that_dies_or_hangs_leaves_no_motor_running(daemon: Daemon, number: int) -> None:
    stops = daemon.log().count("event=lapse-stopped")
    with bridge(daemon) as one, cycling(one.port, FEEDER + 40) as plc:
        plc.setpoint = 100000
        until(one.controls, "the lease is held")
        enable(one, plc)
        one.bridge.send_signal(number)
        until(lambda: daemon.log().count("event=lapse-stopped") > stops, "the drive is stopped")


def test_it_ends_by_sigterm_and_says_what_is_wrong_with_its_roster(daemon: Daemon) -> None:
    with bridge(daemon) as one:
        one.bridge.send_signal(signal.SIGTERM)
        assert one.bridge.wait(10.0) == 0
        with socket.create_server(("127.0.0.1", one.port)):
            done = lecombus("bridge", "modbus", "-c", daemon.folder / f"{one.port}.yaml")
        assert done.status == 1
        assert f"127.0.0.1:{one.port} cannot be listened on" in done.err
    done = lecombus("bridge", "modbus", "-c", daemon.roster)
    assert done.status == 2
    assert "has no key `modbus`" in done.err
    found = lecombus("bridge", "modbus", "-c", daemon.roster, "--map", "--json").json()
    commands = [one["register"] for one in found["registers"] if one["name"] == "command"]
    assert commands == [FEEDER + 41, 1241]


def test_values_of_a_daemon_that_hangs_or_dies_become_exceptions_in_their_time(
    daemon: Daemon,
) -> None:
    with bridge(daemon) as one:
        stopped_s = time.monotonic()
        daemon.tell(signal.SIGSTOP)
        try:
            until(lambda: one.client.refused(FEEDER + 20) in (NOT_FRESH, AWAY), "stale",
                  within_s=8.0)  # fmt: skip
            until(lambda: one.client.refused(FEEDER + 26, 2) in (NOT_FRESH, AWAY), "stale")
            until(lambda: one.client.refused(20) == AWAY, "away", within_s=2 * AWAY_AFTER_S + 5)
            assert one.client.read(FEEDER, 2) == [0, 0]
            ages = one.client.read(FEEDER + 2, 2)
            assert all(age >= 10 * (time.monotonic() - stopped_s) - 30 for age in ages)
            with pytest.raises(ModbusRefusedError) as refused:
                one.client.write_one(FEEDER + 41, 1)
            assert refused.value.code == AWAY
        finally:
            daemon.tell(signal.SIGCONT)
        until(lambda: one.client.refused(FEEDER + 20, 8) == 0, "fresh again", within_s=20.0)
        daemon.process.kill()
        until(lambda: one.client.refused(FEEDER + 20) == AWAY, "away")
        assert len(one.client.read(FEEDER, 17)) == 17
