"""Random lines: everything about a line and its trouble, drawn from one seed.

A line has 1 to 90 drives of all families at any baud rate. Its watchdog times are drawn above what
the plan says outlasts lost answers: one more than it must, and where drives go away, all of those
that such a drive costs. Four
kinds of line show four sides of it: `quiet` (one client, one request at a time), `loaded` (clients
that ask for more than the line can do), `absent` (drives go away and return) and `faulty` (noise,
lost and late answers).
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from random import Random

from lecombus.capacity.demand_bound import Stream, find_overload, load_of
from lecombus.capacity.exchange_costs import own_longest_s, stop_s
from lecombus.capacity.watchdog_demand import demand_of, smallest, under_way_s
from lecombus.capacity.watchdog_feasibility import AWAY_ATTEMPTS
from lecombus.config import DriveEntry, Roster, RosterError, line_timing
from lecombus.drives import family
from lecombus.schedule.watchdog_deadline import HARD_PART
from support.rosters import make_roster

FAMILIES = ("820x", "821x", "822x", "824x", "8200vector", "93xx", "smvector")
BAUDS = (1200, 2400, 4800, 9600, 19200, 19200, 19200)
FAULTS = (
    "double", "unheard", "request_noise", "damaged", "bad_bcc", "parity", "half", "endless",
    "nak",
)  # fmt: skip
KINDS = ("quiet", "loaded", "absent", "faulty")
ADDRESSES = tuple(address for address in range(1, 100) if address % 10)
ADAPTER_S = 0.008
QUICK_ADAPTER_S = 0.001
"""Bytes are handed to the host in pieces of so much time, as by an adapter's latency timer."""
LONGEST_WATCHDOG_S = 60.0
SHORTEST_WATCHDOG_S = 0.05
TROUBLED = ("absent", "faulty")
"""On these lines clients ask for several things at once: no wait of theirs is promised."""
MORE = 1_000_003
"""What was added to lines later is drawn by itself: a seed's roster stays what it was."""


@dataclass(frozen=True)
class Storm:
    """One fault that is there for a while, much more often than by its chance.

    Args:
        after_s: When it begins, from the last one's end, seconds.
        for_s: How long it lasts, seconds.
        fault: Which, as `Faults` calls it.
        chance: Of each telegram, 0..1.
    """

    after_s: float
    for_s: float
    fault: str
    chance: float


@dataclass(frozen=True)
class RandomLine:
    """One line and its trouble.

    Args:
        seed: What it was drawn from.
        kind: One of `KINDS`.
        roster: The line.
        faults: Of the simulated line, as `parse_faults` reads them.
        length_s: How long it is run after all drives are there, seconds of line time.
        running: Drives whose motors may turn at the beginning; the others are stopped.
        early: Drives that acknowledge a write before they have passed it on (C1921 = 1).
        as_written: C0135 of the drives reads what was written to it last.
        storms: What goes wrong besides, one after the other.
        pauses: When the daemon does not run, from the beginning on: after how long, for how long.
        leased: Its drives have leases, and controllers take them.
    """

    seed: int
    kind: str
    roster: Roster
    faults: str
    length_s: float
    running: frozenset[str] = frozenset()
    early: frozenset[str] = frozenset()
    as_written: bool = False
    storms: tuple[Storm, ...] = ()
    pauses: tuple[tuple[float, float], ...] = ()
    leased: bool = False

    @property
    def adapter_s(self) -> float:
        """How long the adapter gathers what comes in: every fourth line has a quick one."""
        return QUICK_ADAPTER_S if self.seed // len(KINDS) % 4 == 1 else ADAPTER_S

    @property
    def is_crowded(self) -> bool:
        """Whether many clients ask for reads at once, and not only for idle time; of `loaded`."""
        return self.kind == "loaded" and self.seed % 12 != 9

    @property
    def is_loaded(self) -> bool:
        """Whether clients ask for more than the line can do."""
        return self.kind == "loaded"

    @property
    def is_idle(self) -> bool:
        """Whether one client asks for one thing after the other, and mostly feeds go."""
        return False

    @property
    def is_saturated(self) -> bool:
        """Whether clients also write setpoints as fast as they are done; of those crowded."""
        return self.seed % 12 == 5

    @property
    def writes_groups(self) -> bool:
        """Whether clients also write to groups."""
        return False

    @property
    def is_told_apart(self) -> bool:
        """Whether no answer comes twice, or later than the roster's `late_answer` says.

        An answer carries no address. A copy that comes when the same code is asked of another drive
        passes for that one's, and nothing on the wire shows it: what is read then may be wrong. So
        does an answer that is later than `late_answer`: an adapter that holds back an answer
        without end holds back all behind it for as long as that takes.
        """
        endless = "endless" in self.faults or any(one.fault == "endless" for one in self.storms)
        return "double" not in self.faults and not (endless and ":adapter" in self.faults)

    @property
    def may_cancel(self) -> bool:
        """Whether noise and a wrong BCC may strike one answer: the BCC may be right again then."""
        return "bad_bcc" in self.faults or any(one.fault == "bad_bcc" for one in self.storms)

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
        f"baud: {baud}, repeaters: true, turnaround: {random.choice(('0ms', '2ms', '5ms'))}, "
        f"retries: {random.randrange(4)}"
    )
    period_ms = random.choice((200, 500, 1000, 3000, 10000))
    cyclic = random.choice(("", "cyclic: []", f"cyclic: [{{code: C0150, every: {period_ms}ms}}]"))
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
    roster = _accepted(head, drives, watched, times, cyclic)
    more = Random(seed + MORE)
    troubled, faulty = kind in TROUBLED, kind == "faulty"
    return RandomLine(
        seed, kind, roster, _faults(random, more) if faulty else "", length_s,
        running=_some(more, roster.drives, 0.7),
        early=_some(more, roster.drives, 0.3) if troubled else frozenset(),
        as_written=more.random() < 0.3,
        storms=_storms(more, length_s) if faulty else (),
        pauses=_pauses(more) if faulty else (),
    )  # fmt: skip


def _some(random: Random, drives: tuple[DriveEntry, ...], share: float) -> frozenset[str]:
    return frozenset(drive.name for drive in drives if random.random() < share)


def _least_s(roster: Roster, short: set[str], lost: int) -> float | None:
    """Give the least time for some of the watchdogs, the others being four times as long."""
    timing = line_timing(roster.line)
    feeding = demand_of(roster, timing)
    longest_stop_s = max(stop_s(drive, timing) for drive in roster.drives)
    shortest = min(feeding.streams, key=lambda one: one.every_s, default=None)
    under_way = under_way_s(feeding.before(shortest.name if shortest else ""))
    blocking_s = max(under_way, feeding.lost_s) + longest_stop_s + lost * feeding.lost_s

    def holds(time_s: float) -> bool:
        streams = [
            Stream(one.name, one.cost_s, HARD_PART * time_s * (1.0 if one.name in short else 4.0))
            for one in feeding.streams
        ]
        return find_overload(streams, blocking_s) is None and load_of(streams) <= 1.0

    return smallest(holds, SHORTEST_WATCHDOG_S, LONGEST_WATCHDOG_S)


def _accepted(
    head: str,
    drives: list[tuple[int, str]],
    watched: list[bool],
    times: list[float],
    cyclic: str,
) -> Roster:
    """Read a roster; with longer watchdogs while `check` refuses these by some milliseconds."""
    for more in range(40):
        longer = [min(LONGEST_WATCHDOG_S, time_s * 1.02**more) for time_s in times]
        with contextlib.suppress(RosterError):
            return _read(head, drives, watched, longer, cyclic)
    return _read(head, drives, watched, times, cyclic)


def _read(
    head: str,
    drives: list[tuple[int, str]],
    watched: list[bool],
    times: list[float],
    cyclic: str,
) -> Roster:
    own = {}
    for number, (address, kind) in enumerate(drives):
        keys = [] if kind == "smvector" else ["also_writable: [C0012]"]
        if watched[number]:
            time = f"{math.ceil(times[number] * 1000) + 1}ms"
            keys.append(f"watchdog: {{time: {time}, action: quick-stop, configure: true}}")
        own[f"d{address}"] = ", ".join(keys)
    named = [(f"d{address}", address, kind) for address, kind in drives]
    return make_roster(
        named, baud=None, line=head, drive=cyclic, own=own, sections=groups_of(drives)
    )


def groups_of(drives: list[tuple[int, str]], *, multicast: bool = False) -> str:
    """Make a group of each decade of addresses: one telegram reaches its members.

    Args:
        drives: Address and family of each.
        multicast: Writes to them, and to all drives, are one telegram as well.
    """
    decades: dict[int, list[str]] = {}
    for address, _ in drives:
        decades.setdefault(address // 10, []).append(f"d{address}")
    more = ", multicast: yes" if multicast else ""
    rows = [f"  g{at}: {{members: [{', '.join(names)}]{more}}}" for at, names in decades.items()]
    if multicast:
        rows.append("  all: {multicast: yes}")
    return "\n".join(["groups:", *rows, ""])


def _shortest_s(drive: DriveEntry, roster: Roster) -> float:
    """Give the shortest watchdog time that a drive's own exchanges allow."""
    traits = family(drive.family).watchdog
    own_s = own_longest_s(drive, line_timing(roster.line)) / HARD_PART
    return max(traits.low_s if traits else 0.0, own_s, SHORTEST_WATCHDOG_S)


def _faults(random: Random, more: Random) -> str:
    """Draw what may go wrong at any time: loss, noise and lateness, and up to three things more."""
    late = random.choice(("drive", "adapter"))
    if more.random() < 0.25:
        late = "stubborn"
    found = [
        f"lost={random.uniform(0, 0.03):.3f},noise={random.uniform(0, 0.05):.3f}",
        f"late={random.uniform(0, 0.05):.3f}:0.5s:{late}",
    ]
    for name in more.sample(FAULTS, more.randrange(4)):
        delay = more.choice((":0ms-5ms", ":20ms-500ms", ":3s")) if name == "double" else ""
        found.append(f"{name}={more.uniform(0, 0.05):.3f}{delay}")
    if more.random() < 0.3:
        found.append("nak_reads")
    if len(found) % 2:  # half of the lines, and no draw changes what else they are
        found.append("eot_drops_writes")
    return ",".join(found)


def _storms(random: Random, length_s: float) -> tuple[Storm, ...]:
    """Draw faults that come for a few seconds and strike most telegrams."""
    return tuple(
        Storm(
            random.uniform(0.0, length_s / 2), random.uniform(0.2, 8.0),
            random.choice((*FAULTS[1:], "lost", "noise", "late")), random.uniform(0.2, 1.0),
        )
        for _ in range(random.randrange(4))
    )  # fmt: skip


def _pauses(random: Random) -> tuple[tuple[float, float], ...]:
    """Draw when the daemon does not run, on every third line: mostly for less than a second."""
    if random.random() > 0.3:
        return ()
    longest_s = random.choice((0.05, 0.3, 3.0))
    return tuple(
        (random.uniform(0.0, 20.0), random.uniform(0.0, longest_s))
        for _ in range(random.randrange(1, 8))
    )
