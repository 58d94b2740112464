"""The Modbus bridge as a process, a daemon with simulated drives, and clients of another make."""

from __future__ import annotations

import contextlib
import re
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from lecombus.bridges.line_follower import AWAY_AFTER_S
from support.daemon_host import (
    Daemon,
    command,
    environment,
    free_port,
    lecombus,
    on_a_pty,
    short_dir,
    started,
    until,
)
from support.modbus_plc import ModbusClient, ModbusRefusedError, Outputs, cycling, halves

pytestmark = [pytest.mark.real]

FEEDER = 1100
BELT = 1200
PENDING, DONE, VERIFIED, REFUSED = 1, 2, 3, 4
HELD = 3
AWAY, NOT_FRESH = 0x0A, 0x0B
LEASE_S = 1.0

DRIVES = (("feeder", 11, "8200vector"), ("belt", 12, "smvector"))


@dataclass
class Site:
    """A daemon, its bridge, and a client."""

    daemon: Daemon
    bridge: subprocess.Popen[bytes]
    port: int
    client: ModbusClient
    folder: Path

    def log(self) -> str:
        return (self.folder / "bridge.log").read_text()

    def shown(self) -> list[int]:
        """The last command and its outcome, the last setpoint and its outcome."""
        return self.client.read(FEEDER + 10, 7)

    def command(self) -> list[int]:
        return self.client.read(FEEDER + 11, 2)


@contextlib.contextmanager
def site(control: bool, **roster: str) -> Iterator[Site]:
    with short_dir() as folder:
        port = free_port()
        sections = f"modbus: {{port: {port}, control: {control}, units: [1]}}"
        lease = f"lease: {{required: true, time: {LEASE_S}s, on_lapse: quick-stop}}"
        cyclic = "cyclic: [{code: C0150, every: 200ms}, {code: C0050, every: 200ms}]"
        own = {"feeder": f"{lease}, {cyclic}"}
        with on_a_pty(folder, DRIVES, sections=sections, own=own, **roster) as (daemon, _):
            words = command("bridge", "modbus", "-c", folder / "roster.yaml")
            with started(words, folder / "bridge.log", env=environment()) as bridge:
                until(lambda: "event=daemon-connected" in (folder / "bridge.log").read_text(),
                      "the bridge serves", within_s=30.0)  # fmt: skip
                daemon.until_online(within_s=40.0)
                client = ModbusClient(port)
                try:
                    yield Site(daemon, bridge, port, client, folder)
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


def test_another_makes_client_reads_and_writes_and_is_refused_what_is_old() -> None:
    with site(control=False) as one:
        assert until(lambda: one.client.read(FEEDER, 2) == [2, 7], "fresh values")
        registers, _ = polled(one.port, FEEDER, 17)
        assert (len(registers), registers[0], registers[5]) == (17, 2, 1)
        inputs, _ = polled(one.port, FEEDER + 20, 8, kind="3")
        assert len(inputs) == 8
        _, said = polled(one.port, FEEDER + 28, 2)
        assert "Target device failed to respond" in said
        _, said = polled(one.port, 1300, 1)
        assert "Illegal data address" in said
        done = mbpoll(one.port, FEEDER + 41, "1")
        assert "Illegal function" in done.stdout + done.stderr
        for _ in range(1000):
            assert len(one.client.read(FEEDER, 17)) == 17
        assert one.daemon.get("/v1/drives/feeder")["state"] == "online"


def test_a_plc_enables_sets_stops_and_loses_its_lease_when_it_hangs() -> None:
    with site(control=True) as one, cycling(one.port, FEEDER + 40, command=3) as plc:
        plc.setpoint = 354000
        until(lambda: one.client.read(FEEDER + 7, 1) == [HELD], "the lease is held")
        time.sleep(0.5)
        assert one.shown()[2:4] == [REFUSED, 1]  # set before the lease: it starts nothing
        assert one.daemon.get("/v1/drives/feeder")["motion"]["doing"] == "stopped"
        enable(one, plc)
        until(lambda: one.shown()[5] == DONE, "the setpoint is given")
        until(lambda: turns(one), "it turns")
        rows = one.daemon.log().count("verb=set-speed")
        time.sleep(1.0)
        assert one.daemon.log().count("verb=set-speed") == rows == 1
        plc.setpoint = 200000
        until(lambda: "C0046:20" in one.daemon.log(), "the new setpoint")
        plc.is_counting = False
        until(lambda: one.client.read(FEEDER + 7, 1)[0] != HELD, "the lease ends")
        until(lambda: "event=lapse-stopped" in one.daemon.log(), "the drive is stopped")
        plc.is_counting = True
        until(lambda: one.client.read(FEEDER + 7, 1) == [HELD], "the lease is held again")
        time.sleep(0.5)
        assert not turns(one)
        enable(one, plc)
        plc.command = 1
        until(lambda: one.command() == [1, VERIFIED], "the quick stop")
        assert "process=lecombus-modbus" in one.daemon.log()


def enable(one: Site, plc: Outputs) -> None:
    plc.command = 0
    time.sleep(0.5)
    plc.command = 3
    until(lambda: one.command() == [3, VERIFIED], "enabled")


def turns(one: Site) -> bool:
    return one.client.refused(FEEDER + 26, 2) == 0 and one.client.signed(FEEDER + 26) > 0


def test_stops_need_no_lease_and_come_from_anyone_who_may_connect() -> None:
    with site(control=True) as one:
        assert "Written 1 references" in mbpoll(one.port, FEEDER + 41, "2").stdout
        until(lambda: one.command() == [2, VERIFIED], "the inhibit")
        one.client.write_one(40, 1)
        until(lambda: one.client.read(5, 2) == [1, VERIFIED], "the stop of all")
        with cycling(one.port, FEEDER + 40) as plc:
            until(lambda: one.client.read(FEEDER + 7, 1) == [HELD], "the lease is held")
            other = ModbusClient(one.port, source="127.0.0.2")
            with contextlib.closing(other):
                with pytest.raises(ModbusRefusedError) as refused:
                    other.write(FEEDER + 40, 1, 0, *halves(5))
                assert refused.value.code == 0x06
                other.write_one(FEEDER + 41, 1)
            until(lambda: one.command() == [1, VERIFIED], "the stop of another")
            assert plc.count > 0


@pytest.mark.parametrize(("values", "code"), [((5,), 3), ((0xFFFF,), 3)])
def test_what_is_no_command_is_refused(values: Sequence[int], code: int) -> None:
    with site(control=True) as one:
        for first in (FEEDER + 41, 40):
            with pytest.raises(ModbusRefusedError) as refused:
                one.client.write(first, *values)
            assert refused.value.code == code
        for first, words in ((FEEDER + 42, (1,)), (FEEDER + 43, (1,)), (FEEDER + 20, (1,)),
                             (FEEDER + 40, (1, 0, 0)), (1341, (1,)), (FEEDER + 43, (0, 0))):  # fmt: skip
            with pytest.raises(ModbusRefusedError) as refused:
                one.client.write(first, *words)
            assert refused.value.code == 2
        assert one.client.read(FEEDER + 40, 4) == [0, 0, 0, 0]


def test_values_of_a_daemon_that_hangs_or_dies_become_exceptions_in_their_time() -> None:
    with site(control=True) as one:
        until(lambda: one.client.refused(FEEDER + 20, 8) == 0, "fresh values")
        one.daemon.tell(signal.SIGSTOP)
        stopped_s = time.monotonic()
        try:
            # C0150 and C0050 are read every 200 ms: they are good for a second at most.
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
            one.daemon.tell(signal.SIGCONT)
        until(lambda: one.client.refused(FEEDER + 20, 8) == 0, "fresh again", within_s=20.0)
        one.daemon.process.kill()
        until(lambda: one.client.refused(FEEDER + 20) == AWAY, "away")
        assert len(one.client.read(FEEDER, 17)) == 17


def test_a_bridge_that_is_killed_or_stopped_leaves_no_motor_running() -> None:
    with site(control=True) as one, cycling(one.port, FEEDER + 40) as plc:
        plc.setpoint = 100000
        until(lambda: one.client.read(FEEDER + 7, 1) == [HELD], "the lease is held")
        enable(one, plc)
        one.bridge.send_signal(signal.SIGKILL)
        until(lambda: "event=lapse-stopped" in one.daemon.log(), "the drive is stopped")
        assert "end=lapsed" in one.daemon.log()


def test_it_ends_by_sigterm_and_says_what_is_wrong_with_its_roster(tmp_path: Path) -> None:
    with site(control=True) as one:
        one.bridge.send_signal(signal.SIGTERM)
        assert one.bridge.wait(10.0) == 0
        with socket.create_server(("127.0.0.1", one.port)):
            done = lecombus("bridge", "modbus", "-c", one.daemon.roster)
            assert done.status == 1
            assert f"127.0.0.1:{one.port} cannot be listened on" in done.err
    roster = tmp_path / "r.yaml"
    roster.write_text(
        "line: {name: a, port: 'sim:'}\ndrives: [{name: b, address: 1, family: generic}]\n"
    )
    done = lecombus("bridge", "modbus", "-c", roster)
    assert done.status == 2
    assert "has no key `modbus`" in done.err
    found = lecombus("bridge", "modbus", "-c", roster, "--map", "--json").json()
    assert [one["register"] for one in found["registers"] if one["name"] == "command"] == [141]
