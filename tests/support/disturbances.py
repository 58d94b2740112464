"""What disturbs a line for a while, and what must be as before a minute after it has ended.

A disturbance is something to do while it lasts (`Pattern.during`), and how well the process runs
meanwhile (`Pattern.machine`): paused, or late by chance. Before and after it the same things are
looked at (`Picture`): which drives are online, how long a setpoint takes on each, whether each can
be read, how often each cyclic code is read, and what was learnt about drives.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

import anyio

from lecombus.drive_state.readings import DriveState
from lecombus.errors import LecombusError
from lecombus.fieldbus.lecom.simulator.faults import Faults, parse_faults
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.parameters import Code
from support.rosters import roster_text
from support.site_host import Plant
from support.virtual_loop import Machine, Paused, Starved

__all__ = ["LINES", "PATTERNS", "Pattern", "Picture", "look", "mixed_roster"]

LASTS_S = 60.0
AFTER_S = 60.0
WATCH_S = 20.0
FAMILIES = ("smvector", "8200vector", "93xx", "820x", "821x")
SETPOINTS = {"smvector": 1061, "8200vector": 46, "93xx": 141, "820x": 46, "821x": 46}
WATCHDOG = "{time: 2s, action: %s, configure: true}"


def mixed_roster(count: int, baud: int) -> str:
    """Write a roster of so many drives; with 31 most are SMVectors, which start quickly."""
    drives, own = [], {}
    every = max(2 * count // 10, 1)
    for number in range(count):
        kind = FAMILIES[number % len(FAMILIES)] if count < 31 or number % 4 == 0 else "smvector"
        action = "trip" if kind == "smvector" else "quick-stop"
        drives.append((f"d{number}", number + 1 + number // 9, kind))
        own[f"d{number}"] = f"watchdog: {WATCHDOG % action}, writable: [C{SETPOINTS[kind]:04}]"
    cyclic = f"cyclic: [{{code: C0150, every: {every}s}}, {{code: C0046, every: {4 * every}s}}]"
    return roster_text(drives, baud=baud, own=own, drive=cyclic)


LINES = {8: (8, 9600), 12: (12, 9600), 31: (31, 19200)}
"""By name: drives and baud rate."""


@dataclass(frozen=True)
class Pattern:
    """One disturbance.

    Args:
        faults: Of the line while it lasts, as `parse_faults` reads them.
        machine: How the process runs while it lasts, from a time to a time.
        during: What else happens while it lasts.
    """

    faults: str = ""
    machine: Callable[[float, float], Machine] | None = None
    during: Callable[[Plant], Awaitable[None]] | None = None
    lasts_s: float = LASTS_S

    async def happen(self, plant: Plant) -> None:
        """Let it happen, and end."""
        loop, faults = asyncio.get_running_loop(), plant.line.faults
        began_s = plant.now_s
        if self.faults:
            plant.line.faults = parse_faults(self.faults)
        if self.machine is not None:
            loop.machine = self.machine(began_s, began_s + self.lasts_s)  # type: ignore[attr-defined]
        try:
            if self.during is not None:
                with anyio.move_on_after(self.lasts_s):
                    await self.during(plant)
            while plant.now_s < began_s + self.lasts_s:
                plant.site.supervision.watch.look()
                await anyio.sleep(1.0)
        finally:
            plant.line.faults = faults
            loop.machine = None  # type: ignore[attr-defined]


@dataclass
class Picture:
    """How a line is.

    Attributes:
        offline: Drives that are not online.
        wrote_s: How long each drive's setpoint took, seconds.
        failed: Writes and reads that failed, in words.
        gaps: How often each cyclic code was read, by drive and code.
        due: How often at least it should be, by the roster; reads that feed come besides.
        stretch: The cadence's.
        slow: Remarks on slow drives.
        lapses: Watchdogs whose time ran out.
    """

    offline: list[str] = field(default_factory=list)
    wrote_s: dict[str, float] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    gaps: Counter[tuple[str, Code]] = field(default_factory=Counter)
    due: Counter[tuple[str, Code]] = field(default_factory=Counter)
    stretch: float = 1.0
    slow: list[str] = field(default_factory=list)
    lapses: int = 0

    def worse_than(self, before: Picture) -> list[str]:
        """Say in what it is worse than before."""
        found = [f"{name} is not online" for name in self.offline]
        found += self.failed
        longest_s = max(before.wrote_s.values(), default=0.0)
        found += [
            f"{name}: written in {took_s:.3f} s, {longest_s:.3f} s was the longest before"
            for name, took_s in self.wrote_s.items()
            if took_s > 1.5 * longest_s + 0.1
        ]
        found += [
            f"{drive} {code}: read {self.gaps[drive, code]} times, {times} before"
            for (drive, code), times in before.gaps.items()
            if self.gaps[drive, code] < min(times, self.due[drive, code]) - 1
        ]
        if self.stretch > 1.05:
            found.append(f"the cadence is stretched {self.stretch:.2f} times")
        if self.lapses:
            found.append(f"{self.lapses} watchdogs ran out")
        return found + self.slow


async def look(plant: Plant, setpoint: int) -> Picture:
    """Look at a line for some seconds while every drive is written and read once."""
    site, names = plant.site, [one.name for one in plant.roster.drives]
    began, lapses = len(plant.reports), _lapses(plant)
    picture = Picture([one for one in names if plant.state(one) is not DriveState.ONLINE])
    began_s = plant.now_s
    for entry in plant.roster.drives:
        code = Code(SETPOINTS[entry.family])
        at_s = plant.now_s
        try:
            report = await site.operations.write(
                entry.name, code, setpoint, expires_s=None, verify=False
            )
            if report.outcome not in ("done", "verified"):
                picture.failed.append(f"{entry.name}: {report.outcome}: {report.reason}")
            picture.wrote_s[entry.name] = plant.now_s - at_s
            reading = await site.operations.read(entry.name, Code(46))
            if reading.value is None:
                picture.failed.append(f"{entry.name}: C0046 reads nothing")
        except LecombusError as exc:
            picture.failed.append(f"{entry.name}: {exc}")
        await anyio.sleep(0.3)
    await anyio.sleep(max(began_s + WATCH_S - plant.now_s, 0.0))
    site.supervision.watch.look()
    for one in plant.reports[began:]:
        if one.result.kind is ResultKind.ANSWERED:
            picture.gaps[one.drive, one.step.code] += 1
    for entry in plant.roster.drives:
        for one_of in entry.cyclic:
            picture.due[entry.name, one_of.code] = int(WATCH_S / one_of.every_s)
    picture.stretch = site.schedule.stats(plant.now_s).stretch
    picture.lapses = _lapses(plant) - lapses
    for name in names:
        said = site.store.drive(name).remarks.values()
        picture.slow += [f"{name}: {text}" for text in said if "answers later" in text]
    return picture


def _lapses(plant: Plant) -> int:
    return sum(one.lapses for one in plant.site.schedule.stats(plant.now_s).feeds.values())


# ---- the patterns -------------------------------------------------------------------------------


def _paused(on_s: float, off_s: float) -> Callable[[float, float], Machine]:
    def make(from_s: float, until_s: float) -> Machine:
        spans, at_s = [], from_s
        while at_s < until_s:
            spans.append((at_s, min(at_s + off_s, until_s)))
            at_s += off_s + on_s
        return Paused(spans)

    return make


def _starved(chance: float, most_s: float) -> Callable[[float, float], Machine]:
    return lambda from_s, until_s: Starved(random.Random(7), chance, most_s, until_s)


async def _replug(plant: Plant) -> None:
    for _ in range(3):
        plant.end.unplug()
        await anyio.sleep(1.0)
        plant.end.replug()
        await anyio.sleep(4.0)


async def _power_cycle(plant: Plant) -> None:
    for entry in plant.roster.drives[1:4]:
        plant.power_cycle(entry.name, 1.5)
        await anyio.sleep(3.0)


async def _adapter_stalls(plant: Plant) -> None:
    for _ in range(4):
        plant.line.faults = Faults(unplugged=True)
        await anyio.sleep(3.0)
        plant.line.faults = Faults()
        await anyio.sleep(2.0)


async def _one_drive_away(plant: Plant) -> None:
    plant.line[plant.roster.drives[2].name].present = False
    try:
        await anyio.sleep(40.0)
    finally:
        plant.line[plant.roster.drives[2].name].present = True


PATTERNS: dict[str, Pattern] = {
    "paused a quarter of a second, run as long": Pattern(machine=_paused(0.25, 0.25), lasts_s=30),
    "paused 80 ms in each 200 ms": Pattern(machine=_paused(0.12, 0.08)),
    "one pause of 5 s": Pattern(machine=_paused(60.0, 5.0), lasts_s=10),
    "starved: one step in five up to 60 ms late": Pattern(machine=_starved(0.2, 0.06)),
    "starved: one step in fifty up to 1 s late": Pattern(machine=_starved(0.02, 1.0)),
    "10 % of answers 0.2 s late": Pattern("late=0.1:0.2s-0.2s"),
    "5 % late": Pattern("late=0.05"),
    "30 % late, the drives themselves": Pattern("late=0.3:300ms:drive"),
    "all answers 0.2 s late": Pattern("late=1:0.2s-0.2s"),
    "10 % lost": Pattern("lost=0.1"),
    "60 % lost": Pattern("lost=0.6"),
    "noise in 20 % of answers": Pattern("noise=0.2,bad-bcc=0.05,half=0.05"),
    "requests unheard or damaged": Pattern("unheard=0.1,request-noise=0.1"),
    "an adapter that stalls": Pattern(during=_adapter_stalls, lasts_s=25),
    "unplugged and plugged in thrice": Pattern(during=_replug, lasts_s=16),
    "three drives power-cycled": Pattern(during=_power_cycle, lasts_s=15),
    "one drive away": Pattern(during=_one_drive_away, lasts_s=45),
    "stalled for half a minute": Pattern("unplugged", lasts_s=35),
    "5 min of an adapter that adds 0.1 s": Pattern("late=1:0.1s-0.1s", lasts_s=300),
    "drives that think 0.3 s longer": Pattern("late=1:300ms-300ms:drive", lasts_s=120),
    "answers that an EOT does not end": Pattern("late=0.2:0.3s:stubborn"),
    "refusals and wrong parity": Pattern("nak=0.2,parity=0.2"),
    "drives that lose their power": Pattern("power-cycle=0.01:1s"),
    "answers without end": Pattern("endless=0.05"),
    "late, lost, noisy and paused": Pattern(
        "late=0.1:0.3s,lost=0.1,noise=0.1", machine=_paused(0.8, 0.2)
    ),
}
