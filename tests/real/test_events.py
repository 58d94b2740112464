"""`lecombus events` beside a real daemon: what it prints, and what it says after a restart."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from lecombus.fieldbus.lecom.simulator import PtyEnd
from support.daemon_host import Daemon, command, running, short_dir, sim_line, started, until
from support.rosters import Wanted, roster_text

pytestmark = [pytest.mark.real, pytest.mark.timeout(60)]

DRIVES: tuple[Wanted, ...] = (("feeder", 11, "8200vector"), ("belt", 12, "smvector"))


class Printed:
    """What a running `lecombus events --json` has printed."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def all(self) -> list[dict[str, Any]]:
        """Every event so far, in order."""
        rows = self._path.read_text().splitlines(keepends=True)
        return [json.loads(row) for row in rows if row.startswith("{") and row.endswith("\n")]

    def has(self, kind: str, **data: Any) -> bool:
        """Whether an event of a kind came with some data."""
        return any(
            one["event"] == kind and data.items() <= one["data"].items() for one in self.all()
        )


def kinds(events: Printed) -> list[str]:
    """The kinds of the events so far."""
    return [one["event"] for one in events.all()]


@contextmanager
def printed(daemon: Daemon) -> Iterator[Printed]:
    """Run the command beside a daemon; it reads when this is entered."""
    path = daemon.folder / "events"
    before = daemon.metric("lecombus_event_readers")
    with started(command("events", "--socket", daemon.socket, "--json"), path):
        until(
            lambda: sum(daemon.metric("lecombus_event_readers{").values()) > sum(before.values()),
            "it reads",
        )
        yield Printed(path)


@contextmanager
def line_on_a_pty(folder: Path) -> Iterator[tuple[PtyEnd, str]]:
    """Simulated drives on a pseudo terminal, and the roster of a daemon for them."""
    with PtyEnd(sim_line(DRIVES), folder / "port") as end:
        yield end, roster_text(DRIVES, port=folder / "port", folder=folder)


def test_values_writes_stops_faults_and_losses_are_printed() -> None:
    with (
        short_dir() as folder,
        line_on_a_pty(folder) as (end, text),
        running(text, folder) as daemon,
    ):
        daemon.until_online()
        with printed(daemon) as events:
            answer = daemon.client.put("/v1/drives/feeder/codes/C0046", json={"value": 12.5})
            assert answer.status_code == 200, answer.text
            until(
                lambda: events.has("write", drive="feeder", code="C0046", outcome="done"), "write"
            )
            assert daemon.cli("read", "feeder", "C0046").status == 0
            until(lambda: events.has("value", drive="feeder", code="C0046", value=12.5), "value")
            with end.lock:
                end.line.advance(time.monotonic())
                end.line["belt"].trip(3)
            until(lambda: events.has("trip", drive="belt", active=True), "trip")
            assert daemon.cli("stop").status == 0
            until(lambda: events.has("write", drive="all", what="stop"), "stop")
            end.unplug()
            until(lambda: events.has("line", state="lost"), "the line is lost")
            until(lambda: events.has("state", drive="feeder", state="offline"), "offline")
            assert daemon.end() == 0
        numbers = [int(one["id"].rpartition("-")[2]) for one in events.all()]
        assert numbers == sorted(set(numbers))
        assert "Traceback" not in daemon.log()


def test_after_a_restart_it_goes_on_and_says_that_events_are_missing() -> None:
    with (
        short_dir() as folder,
        line_on_a_pty(folder) as (_, text),
        running(text, folder) as daemon,
    ):
        daemon.until_online()
        with printed(daemon) as events:
            daemon.tell(signal.SIGKILL)
            daemon.process.wait(5)
            with running(text, folder) as again:
                until(lambda: events.has("gap", missed=None), "a gap")
                again.until_online()
                since = kinds(events).index("gap")
                until(lambda: "value" in kinds(events)[since:], "values after it")
                assert kinds(events).count("gap") == 1
