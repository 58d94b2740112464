"""The process that sends messages, beside a real daemon: what happens reaches a command."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from lecombus.cli import main
from lecombus.fieldbus.lecom.simulator import PtyEnd
from lecombus.fieldbus.lecom.simulator.control import Control
from support.daemon_host import (
    Daemon,
    command,
    environment,
    on_a_pty,
    running,
    short_dir,
    started,
    until,
)
from support.rosters import roster_text

pytestmark = [pytest.mark.real, pytest.mark.slow, pytest.mark.timeout(150)]

DRIVES = (("feeder", 11, "8200vector"), ("belt", 12, "smvector"))
LEASE = "lease: {required: true}"
NOTIFY = """\
notify:
  command: [{folder}/page]
  gather: 300ms
  limit: {{burst: 100, every: 1s}}
  daemon_gone: 2s
"""


@dataclass(frozen=True)
class Messages:
    """The messages that the command got.

    Args:
        folder: Where it writes them.
    """

    folder: Path

    def events(self) -> list[dict[str, Any]]:
        """What all messages said, in order."""
        path = self.folder / "messages"
        rows = path.read_text().splitlines() if path.exists() else []
        return [event for row in rows for event in json.loads(row)["events"]]

    def has(self, event: str, drive: str | None, *, active: bool) -> bool:
        wanted = (event, drive, active)
        return wanted in [(one["event"], one["drive"], one["active"]) for one in self.events()]

    def until(self, event: str, drive: str | None = None, *, active: bool = True) -> None:
        until(lambda: self.has(event, drive, active=active), f"{event} {drive} {active}",
              within_s=30)  # fmt: skip


def notify_section(folder: Path) -> str:
    """Write a command that keeps what it gets; returns the roster's `notify:`."""
    page = folder / "page"
    page.write_text(f"#!/bin/sh\n{{ cat; echo; }} >> {folder}/messages\n")
    page.chmod(0o755)
    return NOTIFY.format(folder=folder)


@contextmanager
def notified(folder: Path, **roster: Any) -> Iterator[tuple[Daemon, PtyEnd, Messages]]:
    """A daemon and the process that sends messages of it."""
    watchdog = "{time: 2s, action: inhibit, configure: true}"
    section = notify_section(folder)
    settings = {"watchdog": watchdog, "sections": section, **roster}
    with on_a_pty(folder, DRIVES, **settings) as (daemon, end):
        words = command("bridge", "notify", "-c", daemon.roster)
        with started(words, folder / "bridge.log", env=environment()) as bridge:
            log = folder / "bridge.log"
            until(lambda: "event=daemon-connected" in log.read_text(), "the bridge is connected")
            daemon.until_online()
            yield daemon, end, Messages(folder)
            assert "Traceback" not in log.read_text()
            bridge.send_signal(signal.SIGTERM)
            assert bridge.wait(10) == 0


def say(end: PtyEnd, what: str) -> None:
    """Have something happen to the simulated drives."""
    Control(end.line, end.lock, end).do(what)


def test_all_that_can_happen_is_told_and_its_end() -> None:
    with short_dir() as folder, notified(folder, own={"belt": LEASE}) as (daemon, end, messages):
        say(end, "trip feeder 50")
        messages.until("trip", "feeder")
        assert daemon.cli("reset-fault", "feeder").status == 0
        messages.until("trip", "feeder", active=False)

        lease = {"targets": ["belt"], "time": "300ms", "counter": 1}
        assert daemon.client.put("/v1/leases/plc", json=lease).status_code == 200
        messages.until("lease-lapse", "belt")
        lease = {"targets": ["belt"], "time": "2s", "counter": 1}
        assert daemon.client.put("/v1/leases/plc", json=lease).status_code == 200
        messages.until("lease-lapse", "belt", active=False)

        say(end, "absent feeder")
        messages.until("drive-lost", "feeder")
        messages.until("watchdog-missed", "feeder")
        say(end, "present feeder")
        messages.until("drive-lost", "feeder", active=False)

        end.unplug()
        messages.until("line-lost")
        end.replug()
        messages.until("line-lost", active=False)
        daemon.until_online("feeder")
        lost = [one["drive"] for one in messages.events() if one["event"] == "drive-lost"]
        assert "belt" not in lost, "a drive on a line that is lost is not named"

        daemon.process.send_signal(signal.SIGKILL)
        daemon.process.wait(5)
        messages.until("daemon-lost")
        with running(daemon.roster.read_text(), folder):
            messages.until("daemon-lost", active=False)


def test_a_test_message_says_whether_it_was_sent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    roster = tmp_path / "roster.yaml"
    roster.write_text(roster_text(DRIVES, sections=notify_section(tmp_path)))
    assert main(["notify", "test", "-c", str(roster)]) == 0
    assert capsys.readouterr().out == "command\tsent\t\n"
    assert json.loads((tmp_path / "messages").read_text())["test"] is True
    (tmp_path / "page").unlink()
    assert main(["notify", "test", "-c", str(roster), "--json"]) == 1
    (found,) = json.loads(capsys.readouterr().out)["channels"]
    assert (found["channel"], found["sent"]) == ("command", False)
    assert "No such file" in found["reason"]


@pytest.mark.parametrize("words", [["notify", "test"], ["bridge", "notify"]])
def test_a_roster_without_messages_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    roster = tmp_path / "roster.yaml"
    roster.write_text(roster_text(DRIVES))
    assert main([*words, "-c", str(roster)]) == 2
    assert "has no key `notify`" in capsys.readouterr().err
