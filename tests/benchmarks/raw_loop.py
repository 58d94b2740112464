"""A child: the fastest master there can be, nothing but write, `select` and read.

`python -m benchmarks.raw_loop LINK TURNAROUND_MS`. Asked to `run`, it asks all drives for their
status word in turn, for as long as the question says. It knows no time-outs, no priorities and no
values; it keeps the turnaround exactly, by looking at the clock for its last stretch.
"""

from __future__ import annotations

import json
import os
import select
import sys
import time

from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.protocol.controls import with_parity
from lecombus.fieldbus.lecom.protocol.telegrams import read_telegram
from lecombus.parameters import Code
from support.paced_line import ADDRESSES

__all__ = ["main"]

SPIN_S = 0.0005
"""How long before its end a wait is no longer slept."""


def run(descriptor: int, turnaround_s: float, for_s: float) -> None:
    """Ask all drives in turn."""
    telegrams = [
        with_parity(read_telegram(address, Code(150), Form.STANDARD)) for address in ADDRESSES
    ]
    end_s = time.monotonic() + for_s
    while time.monotonic() < end_s:
        for telegram in telegrams:
            os.write(descriptor, telegram)
            ended_s = read_answer(descriptor)
            if turnaround_s:
                wait_until(ended_s + turnaround_s)


def read_answer(descriptor: int) -> float:
    """Read until an answer is complete; gives the moment."""
    answer = b""
    while len(answer) < 4 or answer[-2] & 0x7F != 0x03:
        if not select.select([descriptor], [], [], 1.0)[0]:
            raise RuntimeError("the simulated line does not answer")
        answer += os.read(descriptor, 4096)
    return time.monotonic()


def wait_until(at_s: float) -> None:
    """Wait, exactly."""
    left_s = at_s - time.monotonic()
    if left_s > SPIN_S:
        time.sleep(left_s - SPIN_S)
    while time.monotonic() < at_s:
        pass


def main(link: str, turnaround_ms: str) -> None:
    """Serve until the input ends."""
    for row in sys.stdin:
        descriptor = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        run(descriptor, int(turnaround_ms) / 1000.0, json.loads(row)["for_s"])
        os.close(descriptor)
        sys.stdout.write("true\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
