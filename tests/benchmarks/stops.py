"""How soon a stop is on the wire when it is asked for at a random moment under full load.

What the machine itself adds shows in the same time of a bare `select` loop, taken before.

Strategy: the line notes when the first byte of a write came and when the last byte before it went
to the host; both clocks are the same. What is measured is the time beyond the exchange under way:
from the request, or from the end of that exchange if it ended later, to the stop's first byte. The
stop is asked for inside the daemon (`Operations.stop`) and over HTTP on the Unix socket, in turn.
"""

from __future__ import annotations

import http.client
import json
import random
import socket
import time
from pathlib import Path

from support.children import MASTER_CORE, OTHER_CORE, Child, child
from support.paced_line import drives

from .cycles import scraped
from .machine import free_port
from .rosters import write_roster
from .table import Row, percentile

__all__ = ["measure"]

STOPS = 80
"""Stops of each kind and round; percentiles are taken over those of all rounds together."""

BETWEEN_S = (0.08, 0.16)
"""Long enough for the stop before to have been proven."""


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure both ways in, without turnaround."""
    link, port = folder / "line", free_port()
    roster = write_roster(folder, link, baud=19200, turnaround_ms=0, http=port)
    inside: list[float] = []
    outside: list[float] = []
    chance = random.Random(1)
    with (
        child("support.paced_line", link, "--baud", "19200", core=OTHER_CORE) as line,
        child("benchmarks.raw_loop", link, "0", core=MASTER_CORE) as loop,
    ):
        line.ask("mark")  # it is there
        loop.ask("run", for_s=6.0)
        gaps_ms = [1000.0 * gap_s for gap_s in line.ask("gaps")[1:]]
    link.unlink(missing_ok=True)
    with (
        child("support.paced_line", link, "--baud", "19200", core=OTHER_CORE) as line,
        child("benchmarks.daemon_child", roster, core=MASTER_CORE) as daemon,
        scraped(port),
    ):
        daemon.ask("online")
        daemon.ask("background", count=1000)
        client = UnixClient("lecombus", timeout=10.0)
        client.path = str(folder / "api.sock")
        for _ in range(rounds * STOPS):
            drive = chance.choice(drives(31))[0]
            asked_s = daemon.ask("stop", drive=drive, after_s=chance.uniform(*BETWEEN_S))
            inside.append(beyond_s(line, asked_s))
            time.sleep(chance.uniform(*BETWEEN_S))
            outside.append(beyond_s(line, stop_over_http(client, drive)))
    return [
        row("inside the daemon", inside, gaps_ms),
        row("over HTTP, Unix socket", outside, gaps_ms),
    ]


class UnixClient(http.client.HTTPConnection):
    """HTTP over a Unix socket."""

    path = ""

    def connect(self) -> None:
        """Connect to the path."""
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(self.path)


def stop_over_http(client: http.client.HTTPConnection, drive: str) -> float:
    """Stop a drive and wait for the outcome; gives the moment at which that was asked."""
    body = json.dumps({"action": "inhibit", "target": drive})
    asked_s = time.monotonic()
    client.request("POST", "/v1/stop", body, {"Content-Type": "application/json"})
    answer = client.getresponse()
    text = answer.read()
    if answer.status != 200:
        raise RuntimeError(f"the stop ended with {answer.status}: {text!r}")
    return asked_s


def beyond_s(line: Child, asked_s: float) -> float:
    """The time beyond the exchange under way."""
    ((came_s, before_s), *_) = line.ask("stops")
    return float(came_s - max(asked_s, before_s))


def row(where: str, found_s: list[float], gaps_ms: list[float]) -> Row:
    """Make a row of the table."""
    ms = [1000.0 * seconds for seconds in found_s]
    p50, p99 = percentile(ms, 0.50), percentile(ms, 0.99)
    return Row(
        f"stop asked {where}, beyond the exchange under way",
        f"p50 {p50:.2f} ms, p99 {p99:.2f} ms",
        f"select loop's next telegram p50 {percentile(gaps_ms, 0.5):.2f} ms, "
        f"p99 {percentile(gaps_ms, 0.99):.2f} ms",
        p99,
        2.0,
        note=f"p99 in ms of {len(ms)} stops in all rounds, worst {max(ms):.2f} ms",
    )
