"""Adapters with habits: they echo, hold bytes back, or stall without saying so."""

from __future__ import annotations

import time

import pytest

from lecombus.fieldbus.lecom.simulator import PtyEnd
from support.daemon_host import (
    Daemon,
    on_a_pty,
    running,
    short_dir,
    sim_line,
    until,
)
from support.rosters import Wanted, roster_text

pytestmark = [pytest.mark.real, pytest.mark.timeout(40)]

DRIVES: tuple[Wanted, ...] = (("belt", 12, "smvector"), ("winder", 21, "93xx"))


def works(daemon: Daemon) -> None:
    """Read and write once, with the right result."""
    path = "/v1/drives/belt/codes/C1061"
    answer = daemon.client.put(path, json={"value": 12.5, "verify": True})
    assert (answer.status_code, answer.json()["outcome"]) == (200, "verified"), answer.text
    assert daemon.get(f"{path}?fresh=true")["value"] == 12.5


@pytest.mark.parametrize("echo", ["auto", "yes"])
def test_an_adapter_that_echoes_is_worked_with(echo: str) -> None:
    with (
        short_dir() as folder,
        on_a_pty(folder, DRIVES, faults="echo", line=f"echo: {echo}") as (daemon, end),
    ):
        daemon.until_online()
        works(daemon)
        end.unplug()
        until(lambda: daemon.line_state() == "lost", "the loss is seen")
        end.line.faults.echo = False
        if echo == "auto":  # found out anew after every reopening: another adapter may be there
            end.replug()
            until(lambda: daemon.line_state() == "open", "the line is open")
            daemon.until_online()
            works(daemon)


def test_an_adapter_that_holds_bytes_back_for_16_ms_is_worked_with() -> None:
    """What an FTDI does without its low latency mode: bytes come in batches."""
    line = sim_line(DRIVES, faults="late=1:1ms-16ms")
    with short_dir() as folder, PtyEnd(line, folder / "port") as end:
        text = roster_text(DRIVES, port=end.path, folder=folder, line="adapter_latency: 16ms")
        with running(text, folder) as daemon:
            daemon.until_online()
            works(daemon)
            outcomes = daemon.metric("lecombus_telegrams_total")
            failed = [one for one, count in outcomes.items() if count and "answered" not in one]
            assert failed == []


def test_an_adapter_that_stalls_without_an_error_is_reopened() -> None:
    with short_dir() as folder, on_a_pty(folder, DRIVES, line="stall: 2s") as (daemon, end):
        daemon.until_online()
        opened = daemon.log().count("event=port-open")
        with end.lock:
            end.line.faults.unplugged = True
        began_s = time.monotonic()
        until(lambda: daemon.log().count("event=port-open") > opened, "the port is reopened")
        assert time.monotonic() - began_s > 1.5
        assert "no byte from any drive" in daemon.log()
        with end.lock:
            end.line.faults.unplugged = False
        daemon.until_online()
        works(daemon)
