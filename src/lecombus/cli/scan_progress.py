"""How far a scan is: a bar on a terminal, and a line for each drive that is found."""

from __future__ import annotations

import sys
import time
from contextlib import AbstractContextManager
from typing import Final

from lecombus.cli.screen import Bar, progress
from lecombus.config import LineEntry, line_timing
from lecombus.drives import family
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.scanning import FoundDrive, Scan
from lecombus.fieldbus.lecom.telegram_costs import read_cost
from lecombus.parameters import Code

__all__ = ["ScanProgress", "look_s", "scan_bar"]

MEASURED: Final = 5
"""From this number of addresses on, the measured time of an address replaces the computed one."""


def scan_bar() -> AbstractContextManager[Bar]:
    """Show a bar on a terminal; a pipe gets nothing on standard error."""
    return progress("listening", quiet=not sys.stderr.isatty(), counts=False)


class ScanProgress:
    """Shows how far a scan is, how long it may take, and each drive when it is found.

    Args:
        scan: The scan.
        look_s: Computed time of an address without a drive, seconds.
        bar: Where it is shown.
    """

    def __init__(self, scan: Scan, look_s: float, bar: Bar) -> None:
        self._scan = scan
        self._look_s = look_s
        self._bar = bar
        self._shown = 0
        self._looks, self._spent_s, self._looked = 0, 0.0, 0
        self._watched_s = time.monotonic()

    def watch(self) -> None:
        """Show the state of the scan."""
        scan, now_s = self._scan, time.monotonic()
        if scan.looks > self._looks:
            self._looks, self._looked = scan.looks, self._looked + 1
            self._spent_s += now_s - self._watched_s
        self._watched_s = now_s
        for one in scan.found[self._shown :]:
            self._bar.say(_found_line(one))
        self._shown = len(scan.found)
        title = f"address {scan.address} at {scan.baud} baud, {self._found()}, {self._left()}"
        self._bar.advance(scan.looks, scan.looks + scan.looks_left, title)

    def _found(self) -> str:
        count = len(self._scan.found)
        return "1 drive found" if count == 1 else f"{count or 'no'} drives found"

    def _left(self) -> str:
        """Say how long it may still take, from the measured time of an address."""
        per_look_s = self._look_s if self._looked < MEASURED else self._spent_s / self._looked
        return f"about {self._scan.looks_left * per_look_s:.0f} s left"


def _found_line(one: FoundDrive) -> str:
    sure = "" if one.certain or one.family == "generic" else " (probably)"
    labels = f" ({', '.join(text for _, text in one.labels)})" if one.labels else ""
    return f"{one.address} at {one.baud} baud: {one.family}{sure}{labels}"


def look_s(line: LineEntry, baud: int) -> float:
    """Return how long an address takes at which nothing answers, seconds."""
    timing = line_timing(line.model_copy(update={"baud": baud}))
    cost = read_cost(timing, family("generic"), Code(46), Form.STANDARD)
    return cost.first_byte_s + timing.quarantine_s + timing.turnaround_s
