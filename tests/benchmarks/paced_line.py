"""A child: simulated drives on a pseudo terminal, and the times at which what came and went.

`python -m benchmarks.paced_line LINK BAUD COUNT`. The times are the system's monotonic clock, the
same in every process: when the host's bytes were read here, and when an answer's bytes were given
to the host. Questions:

* `mark`: requests heard so far, and the time of the last one;
* `useful`: the same of those to drives that answer; `absent`: let the last so many not answer;
* `first`: when the first byte since the last asking came;
* `gaps`: from the last byte of each answer to the first of the next telegram;
* `stops`: for every write heard, when its first byte came, and when the answer before it ended.
"""

from __future__ import annotations

import json
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

from lecombus.simulator import PtyEnd, SimLine
from lecombus.simulator.drive import SimDrive
from lecombus.simulator.receiver import Heard

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

    def _heard(self, at_s: float, heard: Heard) -> None:
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


def answer(line: WatchedLine, what: str, count: int = 0) -> Any:
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
    if what == "gaps":
        gaps = list(line.gaps)
        line.gaps.clear()
        return gaps
    stops, line.stops = line.stops, []
    return stops


def main(link: str, baud: str, count: str) -> None:
    """Serve until the input ends."""
    found = [
        SimDrive(address, family, name, None, log_size=1)
        for name, address, family in drives(int(count))
    ]
    line = WatchedLine(found, baud=int(baud))
    line.watch()
    with PtyEnd(line, Path(link)) as end:
        for row in sys.stdin:
            with end.lock:
                said = answer(line, **json.loads(row))
            sys.stdout.write(json.dumps(said) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
