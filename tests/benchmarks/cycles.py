"""How much of the line is used: cycles of 31 drives against a raw `select` loop.

Strategy: one simulated line, paced byte by byte in a process of its own, for each baud rate and
turnaround; daemon and raw loop take turns on it. While the raw loop speaks, the daemon has been
told to leave all drives alone and is then stopped, so that it takes neither bytes nor processor
time. Both are counted by the line itself: requests heard, and when. The daemon is scraped over
HTTP every second and a thousand background reads wait; those are the same exchanges as the cyclic
ones, so a cycle is 31 exchanges, and how many of them were background's share is shown.
"""

from __future__ import annotations

import contextlib
import http.client
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from lecombus.drives import family
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.telegram_costs import read_cost
from lecombus.parameters import Code
from support.children import MASTER_CORE, OTHER_CORE, Child, child
from support.paced_line import ADDRESSES, FAMILY

from .machine import free_port
from .rosters import write_roster
from .table import Row, ratios, spread

__all__ = ["measure", "scraped"]

TURN_S = 3.0
SETTLE_S = 0.5
HOLD_S = TURN_S + 4 * SETTLE_S
CASES = [(baud, turnaround_ms) for baud in (9600, 19200) for turnaround_ms in (0, 2)]
PROMISES = {0: 0.995, 2: 0.985}


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure all combinations of baud rate and turnaround."""
    return [one_case(folder, baud, turnaround_ms, rounds) for baud, turnaround_ms in CASES]


def one_case(folder: Path, baud: int, turnaround_ms: int, rounds: int) -> Row:
    """Let daemon and raw loop take turns on one line."""
    link, port = folder / f"line-{baud}-{turnaround_ms}", free_port()
    roster = write_roster(folder, link, baud=baud, turnaround_ms=turnaround_ms, http=port)
    ours: list[float] = []
    raw: list[float] = []
    with (
        child("support.paced_line", link, "--baud", str(baud), core=OTHER_CORE) as line,
        child("benchmarks.daemon_child", roster, core=MASTER_CORE) as daemon,
        child("benchmarks.raw_loop", link, str(turnaround_ms), core=MASTER_CORE) as loop,
        scraped(port),
    ):
        daemon.ask("online")
        daemon.ask("background", count=1000)
        began = daemon.ask("used")
        for _ in range(rounds):
            time.sleep(SETTLE_S)
            ours.append(cycles_per_s(line))
            until_s = daemon.ask("hold", for_s=HOLD_S)
            daemon.pause()
            loop.tell("run", for_s=TURN_S + 2 * SETTLE_S)
            time.sleep(SETTLE_S)
            raw.append(cycles_per_s(line))
            loop.hear()
            daemon.resume()
            time.sleep(max(0.0, until_s - time.monotonic()))
        ended = daemon.ask("used")
    return row(baud, turnaround_ms, ours, raw, background_share(began, ended))


def row(
    baud: int, turnaround_ms: int, ours: list[float], raw: list[float], background: float
) -> Row:
    """Make the row of one case."""
    timing = LineTiming(baud)
    cost = read_cost(timing, family(FAMILY), Code(150), Form.STANDARD)
    ideal = 1.0 / (len(ADDRESSES) * (cost.expected_s + turnaround_ms / 1000.0))
    return Row(
        f"31 drives, {baud} bit/s, turnaround {turnaround_ms} ms",
        f"{spread(ours, 4)} cycles/s",
        f"select loop {spread(raw, 4)}",
        ratios(ours, raw),
        PROMISES[turnaround_ms],
        at_least=True,
        digits=4,
        note=f"{median(ours) / ideal:.4f} of the ideal {ideal:.4f} (the select loop "
        f"{median(raw) / ideal:.4f}); {100 * background:.0f} % of it background reads",
    )


def background_share(began: dict[str, float], ended: dict[str, float]) -> float:
    """How many of all exchanges were background reads."""
    exchanges = ended["exchanges"] - began["exchanges"]
    return (ended["background"] - began["background"]) / exchanges


def cycles_per_s(line: Child) -> float:
    """Count what the line hears during one turn, from request to request."""
    first, first_s = line.ask("mark")
    time.sleep(TURN_S)
    last, last_s = line.ask("mark")
    return float((last - first) / (last_s - first_s) / len(ADDRESSES))


# ---- scraping -----------------------------------------------------------------------------------


@contextlib.contextmanager
def scraped(
    port: int, paths: tuple[str, ...] = ("/metrics",), per_s: float = 1.0
) -> Iterator[None]:
    """Ask a daemon for pages over HTTP, so many a second, as long as this is entered."""
    end = threading.Event()

    def scrape() -> None:
        number = 0
        due_s = time.monotonic()
        while not end.wait(max(0.0, due_s - time.monotonic())):
            due_s = max(due_s + 1.0 / per_s, time.monotonic())
            with contextlib.suppress(OSError, http.client.HTTPException):
                client = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
                client.request("GET", paths[number % len(paths)])
                client.getresponse().read()
                client.close()
            number += 1

    thread = threading.Thread(target=scrape, daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join(12.0)
