"""A child: simulated drives on a pseudo terminal, and the times at which what came and went.

`python -m support.paced_line LINK --roster FILE`, or `LINK --baud RATE --drives COUNT`. The
watchdogs of a roster's drives are already set as the roster says. The times are the system's
monotonic clock, the same in every process: when the host's bytes were read here, and when an
answer's bytes were given to the host. Questions:

* `mark`: requests heard so far, and the time of the last one;
* `useful`: the same of those to drives that answer; `absent`: let the last so many not answer;
* `first`: when the first byte since the last asking came;
* `gaps`: from the last byte of each answer to the first of the next telegram;
* `so_far`: which watchdogs fired, and how many requests and collisions there were;
* `turns`: the output of a drive's motor;
* `stops`: for every write heard, when its first byte came, and when the answer before it ended.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

from lecombus.config import load_roster
from lecombus.fieldbus.lecom.simulator import PtyEnd, SimLine
from lecombus.fieldbus.lecom.simulator.drive import SimDrive
from lecombus.fieldbus.lecom.simulator.faults import parse_faults
from lecombus.fieldbus.lecom.simulator.receiver import ReceivedRequest
from support.drives import presets

__all__ = ["ADDRESSES", "FAMILY", "WatchedLine", "drives", "main"]

FAMILY = "smvector"
ADDRESSES = [address for address in range(1, 99) if address % 10][:31]

_STX = 0x02


def drives(count: int) -> list[tuple[str, int, str]]:
    """Name, address and family of each drive of a line."""
    return [(f"d{address:02}", address, FAMILY) for address in ADDRESSES[:count]]


class WatchedLine(SimLine):
    """A line that remembers when what came and went."""

    def watch(self) -> None:
        """Begin."""
        self.mark = self.useful = (0, 0.0)
        self.first_s = 0.0
        self.stops: list[tuple[float, float]] = []
        self.gaps: deque[float] = deque(maxlen=1000)
        self._spoke_s = 0.0
        self.on_request = self._heard

    def _heard(self, at_s: float, heard: ReceivedRequest) -> None:
        self.mark = (self.mark[0] + 1, at_s)
        if heard.address not in self.faults.absent:
            self.useful = (self.useful[0] + 1, at_s)

    def receive(self, data: bytes, now_s: float) -> None:
        """Note when a telegram began, and keep that of writes."""
        self.first_s = self.first_s or now_s
        self.gaps.append(now_s - self._spoke_s)
        if len(data) > 3 and data[3] & 0x7F == _STX:
            self.stops.append((now_s, self._spoke_s))
        super().receive(data, now_s)

    def poll(self, now_s: float) -> bytes:
        """Note when bytes went to the host."""
        out = super().poll(now_s)
        if out:
            self._spoke_s = time.monotonic()
        return out


def answer(line: WatchedLine, what: str, count: int = 0, drive: str = "") -> Any:
    """Answer one question."""
    if what == "mark":
        return line.mark
    if what == "useful":
        return line.useful
    if what == "absent":
        line.faults.absent = set(ADDRESSES[len(ADDRESSES) - count :])
        return True
    if what == "first":
        first_s, line.first_s = line.first_s, 0.0
        return first_s
    if what == "so_far":
        line.advance(time.monotonic())
        fired = {drive.name: drive.watchdog_fired for drive in line.drives}
        return {"fired": fired, "requests": line.requests, "collisions": line.collisions}
    if what == "turns":
        line.advance(time.monotonic())
        return abs(line[drive].model.motor.output)
    if what == "gaps":
        gaps = list(line.gaps)
        line.gaps.clear()
        return gaps
    stops, line.stops = line.stops, []
    return stops


def rostered(path: Path, faults: str) -> WatchedLine:
    """Make the drives of a roster, with their watchdogs set."""
    roster = load_roster(path)
    found = [
        SimDrive(entry.address, entry.family, entry.name, presets(entry), log_size=1)
        for entry in roster.drives
    ]
    return WatchedLine(found, baud=roster.line.baud, faults=parse_faults(faults))


def plain(baud: int, count: int) -> WatchedLine:
    """Make drives of one family."""
    found = [
        SimDrive(address, family, name, None, log_size=1) for name, address, family in drives(count)
    ]
    return WatchedLine(found, baud=baud)


def main() -> None:
    """Serve until the input ends."""
    parser = argparse.ArgumentParser()
    parser.add_argument("link", type=Path)
    parser.add_argument("--roster", type=Path)
    parser.add_argument("--faults", default="")
    parser.add_argument("--baud", type=int, default=19200)
    parser.add_argument("--drives", type=int, default=31)
    asked = parser.parse_args()
    line = rostered(asked.roster, asked.faults) if asked.roster else plain(asked.baud, asked.drives)
    line.watch()
    with PtyEnd(line, asked.link) as end:
        for row in sys.stdin:
            with end.lock:
                said = answer(line, **json.loads(row))
            sys.stdout.write(json.dumps(said) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
