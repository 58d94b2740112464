"""A simulated line in a process of its own, for tests that need this process for something else.

`python paced_line.py ROSTER LINK FAULTS` serves the roster's drives on a pseudo terminal that LINK
points at. Their watchdogs are already set as the roster says. For each line on standard input it
prints what the drives went through so far, as one JSON document; when the input ends, it ends.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from lecombus.config import DriveEntry, load_roster
from lecombus.drives import family
from lecombus.simulator import PtyEnd, SimLine, build

__all__ = ["main"]


def presets(entry: DriveEntry) -> dict[int, str]:
    """A drive's own watchdog as the roster wants it."""
    traits = family(entry.family).watchdog
    if entry.watchdog is None or traits is None:
        return {}
    return {
        traits.time_code.number: str(round(entry.watchdog.time_s * 1000)),
        traits.action_code.number: str(traits.actions[entry.watchdog.action]),
    }


def so_far(line: SimLine) -> str:
    """What the drives went through up to now."""
    line.advance(time.monotonic())
    fired = {drive.name: drive.watchdog_fired for drive in line.drives}
    return json.dumps({"fired": fired, "requests": line.requests, "collisions": line.collisions})


def main(roster: str, link: str, faults: str) -> None:
    """Serve a roster's drives until the input ends."""
    wanted = load_roster(Path(roster))
    drives = [(entry.name, entry.address, entry.family) for entry in wanted.drives]
    overrides = {entry.name: presets(entry) for entry in wanted.drives}
    line = build(drives, baud=wanted.line.baud, faults=faults, overrides=overrides)
    with PtyEnd(line, Path(link)) as end:
        for _ in sys.stdin:
            with end.lock:
                said = so_far(line)
            sys.stdout.write(said + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
