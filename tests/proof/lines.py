"""Random lines: everything about a line and its trouble, drawn from one seed.

A line has 1 to 90 drives of all families at any baud rate. Its watchdog times are drawn above what
the plan says outlasts lost answers: one more than it must, and where drives go away, all of those
that such a drive costs. Four
kinds of line show four sides of it: `quiet` (one client, one request at a time), `loaded` (clients
that ask for more than the line can do), `absent` (drives go away and return) and `faulty` (noise,
lost and late answers).

Must not live here: what has to hold (`invariants`), running (`world`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random

from lecombus.config import DriveEntry, Roster, line_timing, parse_roster
from lecombus.config.exchanges import own_longest_s, stop_s
from lecombus.config.feeding import feeding_of, smallest
from lecombus.drives import family
from lecombus.planning.watchdogs import AWAY_ATTEMPTS
from lecombus.schedule.demand import Stream, find_overload, load_of
from lecombus.schedule.feeds import HARD_PART

FAMILIES = ("820x", "821x", "822x", "824x", "8200vector", "93xx", "smvector")
BAUDS = (1200, 2400, 4800, 9600, 19200, 19200, 19200)
KINDS = ("quiet", "loaded", "absent", "faulty")
ADDRESSES = tuple(address for address in range(1, 100) if address % 10)
ADAPTER_S = 0.008
QUICK_ADAPTER_S = 0.001
"""Bytes are handed to the host in pieces of so much time, as by an adapter's latency timer."""
LONGEST_WATCHDOG_S = 60.0
SHORTEST_WATCHDOG_S = 0.05


@dataclass(frozen=True)
class RandomLine:
    """One line and its trouble.

    Args:
        seed: What it was drawn from.
        kind: One of `KINDS`.
        roster: The line.
        faults: Of the simulated line, as `parse_faults` reads them.
        length_s: How long it is run after all drives are there, seconds of line time.
    """

    seed: int
    kind: str
    roster: Roster
    faults: str
    length_s: float

    @property
    def adapter_s(self) -> float:
        """How long the adapter gathers what comes in: every fourth line has a quick one."""
        return QUICK_ADAPTER_S if self.seed // len(KINDS) % 4 == 1 else ADAPTER_S

    @property
    def is_crowded(self) -> bool:
        """Whether many clients ask for reads at once, and not only for idle time; of `loaded`."""
        return self.kind == "loaded" and self.seed % 12 != 9

    @property
    def is_saturated(self) -> bool:
        """Whether clients also write setpoints as fast as they are done; of those crowded."""
        return self.seed % 12 == 5

    def __str__(self) -> str:
        line = self.roster.line
        return (
            f"seed {self.seed}: {self.kind}, {len(self.roster.drives)} drives at {line.baud} baud"
        )


def line_of(seed: int, length_s: float) -> RandomLine:
    """Draw the line of a seed."""
    random = Random(seed)
    kind = KINDS[seed % len(KINDS)]
    count = random.choice((1, 2, 3, 5, 8, 12, 16, 24, 31, 31, 45, 60, 90))
    drives = [(random.choice(ADDRESSES), random.choice(FAMILIES)) for _ in range(count)]
    drives = sorted(dict(drives).items())
    baud = random.choice(BAUDS)
    head = (
        f"line: {{name: l, port: 'sim:', baud: {baud}, repeaters: true, "
        f"turnaround: {random.choice(('0ms', '2ms', '5ms'))}, "
        f"retries: {random.randrange(4)}}}\n"
    )
    period_ms = random.choice((200, 500, 1000, 3000, 10000))
    cyclic = random.choice(
        ("", ", cyclic: []", f", cyclic: [{{code: C0150, every: {period_ms}ms}}]")
    )
    watched = [random.random() < 0.85 for _ in drives]
    roster = _read(head, drives, watched, [LONGEST_WATCHDOG_S] * len(drives), cyclic)
    short = [random.random() < share for share in [random.choice((1.0, 1.0, 0.4))] for _ in drives]
    tight = {f"d{address}" for at, (address, _) in enumerate(drives) if short[at]}
    least_s = _least_s(roster, tight, AWAY_ATTEMPTS if kind == "absent" else 1)
    if least_s is None or least_s > LONGEST_WATCHDOG_S:
        watched = [False] * len(drives)
        least_s = 1.0
    spread = random.choice((1.0, 1.2, 3.0))
    shortest_s = [_shortest_s(drive, roster) for drive in roster.drives]
    times = [
        min(
            LONGEST_WATCHDOG_S,
            max(
                shortest_s[at],
                least_s * random.uniform(1.0, spread) * (1.0 if short[at] else 4.0),
            ),
        )
        for at in range(len(drives))
    ]
    roster = _read(head, drives, watched, times, cyclic)
    return RandomLine(seed, kind, roster, _faults(random, kind), length_s)


def _least_s(roster: Roster, short: set[str], lost: int) -> float | None:
    """Give the least time for some of the watchdogs, the others being four times as long."""
    timing = line_timing(roster.line)
    feeding = feeding_of(roster, timing)
    longest_stop_s = max(stop_s(drive, timing) for drive in roster.drives)
    under_way_s = max(feeding.under_way_s, feeding.lost_s)
    blocking_s = under_way_s + longest_stop_s + lost * feeding.lost_s

    def holds(time_s: float) -> bool:
        streams = [
            Stream(one.name, one.cost_s, HARD_PART * time_s * (1.0 if one.name in short else 4.0))
            for one in feeding.streams
        ]
        return find_overload(streams, blocking_s) is None and load_of(streams) <= 1.0

    return smallest(holds, SHORTEST_WATCHDOG_S, LONGEST_WATCHDOG_S)


def _read(
    head: str,
    drives: list[tuple[int, str]],
    watched: list[bool],
    times: list[float],
    cyclic: str,
) -> Roster:
    entries = []
    for number, (address, kind) in enumerate(drives):
        guard = ""
        if watched[number]:
            milliseconds = math.ceil(times[number] * 1000) + 1
            guard = f", watchdog: {{time: {milliseconds}ms, action: quick-stop, configure: true}}"
        entries.append(
            f"  - {{name: d{address}, address: {address}, family: {kind}{guard}{cyclic}}}\n"
        )
    return parse_roster(f"{head}drives:\n{''.join(entries)}", "r.yaml")


def _shortest_s(drive: DriveEntry, roster: Roster) -> float:
    """Give the shortest watchdog time that a drive's own exchanges allow."""
    traits = family(drive.family).watchdog
    own_s = own_longest_s(drive, line_timing(roster.line)) / HARD_PART
    return max(traits.low_s if traits else 0.0, own_s, SHORTEST_WATCHDOG_S)


def _faults(random: Random, kind: str) -> str:
    if kind != "faulty":
        return ""
    late = random.choice(("drive", "adapter"))
    return (
        f"lost={random.uniform(0, 0.03):.3f},noise={random.uniform(0, 0.05):.3f},"
        f"late={random.uniform(0, 0.05):.3f}:0.5s:{late}"
    )
