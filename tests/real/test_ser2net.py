"""The same roster over a pty and over TCP through a real ser2net: the same results.

Both lines are served by `lecombus simulate`, as a user would start it.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from support.daemon_host import (
    Daemon,
    command,
    free_port,
    running,
    short_dir,
    started,
    until,
)
from support.real_parts import require
from support.rosters import Wanted, roster_text

pytestmark = [pytest.mark.real, pytest.mark.timeout(60)]

DRIVES: tuple[Wanted, ...] = (
    ("feeder", 11, "8200vector"),
    ("belt", 12, "smvector"),
    ("winder", 21, "93xx"),
)
WATCHDOG = "{time: 2s, action: inhibit, configure: true}"

SER2NET = """\
%YAML 1.1
---
connection: &line
  accepter: tcp,127.0.0.1,{port}
  connector: serialdev(nouucplock=true),{device},19200n81,local
  options:
    chardelay: false
    kickolduser: true
"""
"""Raw bytes both ways, 8N1, every byte passed on as it comes; no lock files of the machine's."""


@contextmanager
def simulated(folder: Path, roster: str) -> Iterator[Path]:
    """Serve a roster's drives by `lecombus simulate`."""
    link = folder / "device"
    (folder / "line.yaml").write_text(roster)
    words = command("simulate", "-c", folder / "line.yaml", "--pty", link)
    with started(words, folder / "simulate.log") as process:
        until(link.exists, "the simulated line is there")
        yield link
        process.terminate()
        assert process.wait(5) == 0, (folder / "simulate.log").read_text()


@contextmanager
def ser2net(folder: Path, device: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    """Serve a device by a real ser2net."""
    (folder / "ser2net.yaml").write_text(SER2NET.format(port=port, device=device))
    words = [str(require("ser2net")), "-n", "-d", "-c", str(folder / "ser2net.yaml")]
    words += ["-P", str(folder / "ser2net.pid")]
    with started(words, folder / "ser2net.log", env=dict(os.environ)) as process:
        yield process


@pytest.fixture
def both() -> Iterator[tuple[Daemon, Daemon]]:
    """A daemon on a pty, and one on TCP to a ser2net in front of a pty, with the same roster."""
    with ExitStack() as stack:
        direct, served = stack.enter_context(short_dir()), stack.enter_context(short_dir())
        port = free_port()
        rosters = [
            roster_text(DRIVES, port=where, folder=folder, watchdog=WATCHDOG)
            for where, folder in (
                (direct / "device", direct),
                (f"socket://127.0.0.1:{port}", served),
            )
        ]
        stack.enter_context(simulated(direct, rosters[0]))
        stack.enter_context(
            ser2net(served, stack.enter_context(simulated(served, rosters[1])), port)
        )
        on_pty = stack.enter_context(running(rosters[0], direct))
        on_tcp = stack.enter_context(running(rosters[1], served))
        for daemon in (on_pty, on_tcp):
            daemon.until_online(within_s=25.0)
        yield on_pty, on_tcp


def test_a_pty_and_tcp_through_ser2net_give_the_same_results(both: tuple[Daemon, Daemon]) -> None:
    on_pty, on_tcp = both
    assert results(on_pty) == results(on_tcp)
    for daemon in both:
        # On a busy computer an answer may be late: not more than a few in some 400.
        assert sum(faults(daemon).values()) <= 3, daemon.log()
        assert daemon.end(signal.SIGTERM) == 0


def results(daemon: Daemon) -> list[Any]:
    """What a user gets on a line: statuses, readings, writes, refusals, a group, a stop."""
    asked: list[tuple[str, str, dict[str, Any] | None]] = [
        ("GET", "/v1/groups", None),
        ("GET", "/v1/drives/feeder/codes/C0046?fresh=true", None),
        ("GET", "/v1/drives/winder/codes/C0039/1?fresh=true", None),
        ("GET", "/v1/drives/belt/codes/C9999?fresh=true", None),
        ("PUT", "/v1/drives/feeder/codes/C0046", {"value": 35.4, "verify": True}),
        ("PUT", "/v1/drives/belt/codes/C1061", {"value": 12.5, "verify": True}),
        ("PUT", "/v1/drives/winder/codes/C0141", {"value": -10, "verify": True}),
        ("PUT", "/v1/drives/winder/codes/C0141", {"value": 30000}),
        ("PUT", "/v1/drives/feeder/codes/C0001", {"value": 1}),
        ("PUT", "/v1/groups/all/codes/C0135", {"value": "H0008", "verify": True}),
        ("POST", "/v1/stop", {"action": "quick-stop", "target": "all"}),
        ("POST", "/v1/stop", {"action": "inhibit", "target": "winder"}),
        ("GET", "/v1/drives/winder/codes/C0040?fresh=true", None),
    ]
    found: list[Any] = [daemon.states()]
    for method, path, document in asked:
        answer = daemon.client.request(method, path, json=document)
        found.append((method, path, answer.status_code, plain(answer.json())))
    words = ("status", "winder"), ("read", "feeder", "C0046"), ("stop",)
    found += [(one, daemon.cli(*one).status) for one in words]
    assert [one[2] for one in found[1:] if len(one) == 4] == [
        200, 200, 200, 404, 200, 200, 200, 409, 403, 200, 200, 200, 200
    ]  # fmt: skip
    return found


def plain(document: Any) -> Any:
    """A document without its times."""
    if isinstance(document, dict):
        timed = ("time", "age_s", "since")
        return {key: plain(one) for key, one in document.items() if key not in timed}
    return [plain(one) for one in document] if isinstance(document, list) else document


def faults(daemon: Daemon) -> dict[str, float]:
    """Telegrams that ended in anything but an answer, and late answers."""
    samples = {
        **daemon.metric("lecombus_telegrams_total"),
        **daemon.metric("lecombus_late_answers_total"),
    }
    fine = ('outcome="answered"', 'outcome="refused"', 'outcome="sent"')
    return {
        name: count for name, count in samples.items() if count and not any(o in name for o in fine)
    }
