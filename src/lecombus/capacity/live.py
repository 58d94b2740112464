"""A plan compared with the last minutes of the running line.

The plan is that of the running roster; what was measured is the document of
`metrics.rolling_window`. Compared are waits and line time by class, margins by watched drive, and
gaps by cyclic code; everything beyond its promise is listed. Promises hold while drives answer and
at most the exchange under way is lost, so the lost exchanges are shown beside them.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from lecombus.capacity.exchange_costs import line_timing, read_times, watched_s
from lecombus.capacity.plan import LinePlan, make_plan
from lecombus.capacity.waits import ClassWait
from lecombus.roster import Roster
from lecombus.schedule.watchdog_deadline import HARD_PART

__all__ = ["LiveClass", "LiveCode", "LiveDrive", "LivePlan", "compare"]

LOAD_ROOM: Final = 0.02
"""Share of the line by which a measured load may exceed the promised one."""
ROUNDING_S: Final = 1e-6
OPEN: Final = "open"
READS: Final = "cyclic"


@dataclass(frozen=True, slots=True)
class LiveClass:
    """One class: promised and measured.

    Args:
        name: The class.
        quiet_s: Its wait is promised to be no longer while there are no other requests.
        loaded_s: The same with every lower class full.
        median_s: Half of its waits were no longer; None: there were none.
        most_s: The longest wait.
        waits: How many were measured.
        exchanges: How many exchanges it had.
        failed: How many of them were not answered.
        load: The share of the line that is asked for all the time; None: it is up to clients. That
            of the feeds is what must be: a line that has time feeds early.
        load_slow: The same if the adapter adds to every answer all that it may.
        used: The share of the line that it took.
    """

    name: str
    quiet_s: float
    loaded_s: float
    median_s: float | None
    most_s: float | None
    waits: int
    exchanges: int
    failed: int
    load: float | None
    load_slow: float | None
    used: float

    @property
    def verdict(self) -> str:
        """The longest wait and the load, compared with what was promised."""
        if self.name == READS and self.load is not None and self.used > self.load + LOAD_ROOM:
            text = f"takes more of the line than promised ({self.used:.0%} of {self.load:.0%})"
            slow = self.load_slow is not None and self.used <= self.load_slow + LOAD_ROOM
            return f"{text}, as with an adapter that adds to every answer" if slow else text
        if self.most_s is None:
            return "nothing measured"
        if self.most_s <= self.quiet_s + ROUNDING_S:
            return "within" if math.isfinite(self.quiet_s) else "nothing was promised"
        if self.most_s <= self.loaded_s + ROUNDING_S:
            return "within, under load" if math.isfinite(self.loaded_s) else "nothing was promised"
        return "waited longer than promised"


@dataclass(frozen=True, slots=True)
class LiveDrive:
    """One watched drive: promised and measured.

    Args:
        drive: The drive.
        time_s: Its watchdog time.
        promised_s: So much of that is promised to be left at every feed.
        least_s: The least that was left; None: it was not fed.
    """

    drive: str
    time_s: float
    promised_s: float
    least_s: float | None

    @property
    def verdict(self) -> str:
        """The least margin, compared with what was promised."""
        if self.least_s is None:
            return "not fed"
        if self.least_s < 0.0:
            return "fed too late: the drive may have acted"
        return "within" if self.least_s >= self.promised_s - ROUNDING_S else "less than promised"


@dataclass(frozen=True, slots=True)
class LiveCode:
    """One cyclic code: promised and measured.

    Args:
        drive: The drive.
        code: The code.
        asked_s: How often the roster asks for it.
        promised_s: Its good values are promised to be no further apart, clients being quiet.
        loaded_s: The same with every lower class full, as while drives are audited.
        longest_s: The longest they were, the time since the last one included; None: never read.
        away: The drive does not answer now; promises are for drives that do.
    """

    drive: str
    code: str
    asked_s: float
    promised_s: float
    loaded_s: float
    longest_s: float | None
    away: bool = False

    @property
    def verdict(self) -> str:
        """The longest gap, compared with what was promised."""
        if self.away:
            return "the drive is away"
        if self.longest_s is None:
            return "not read yet"
        if not math.isfinite(self.promised_s):
            return "nothing was promised"
        if self.longest_s <= self.promised_s + ROUNDING_S:
            return "within"
        if self.longest_s <= self.loaded_s + ROUNDING_S:
            return "within, under load"
        return "seldomer than promised"


@dataclass(frozen=True, slots=True)
class LivePlan:
    """A line: promised and measured.

    Args:
        line: Its name.
        baud: Its baud rate.
        window_s: How long was measured.
        load: The share of the line that is asked for all the time.
        used: The share that was taken.
        slack_s: The least time that was left until the line had to be free for feeding, as seen
            once a second; None: nothing is fed.
        woken_late_s: How late the line's task was woken at most; None: not measured.
        classes: By class, the highest first.
        drives: The watched drives.
        codes: The cyclic codes.
        away: The drives that do not answer now.
        state: `open`, or how else the line is now.
    """

    line: str
    baud: int
    window_s: float
    load: float
    used: float
    slack_s: float | None
    woken_late_s: float | None
    classes: tuple[LiveClass, ...]
    drives: tuple[LiveDrive, ...]
    codes: tuple[LiveCode, ...]
    away: tuple[str, ...] = ()
    state: str = OPEN

    @property
    def failed(self) -> int:
        """Exchanges that were not answered."""
        return sum(one.failed for one in self.classes)

    @property
    def beyond(self) -> tuple[str, ...]:
        """What is beyond what was promised, in words."""
        fine = {
            *("within", "within, under load", "nothing was promised", "nothing measured"),
            *("not fed", "not read yet", "the drive is away"),
        }
        rows = [
            *((f"class {one.name}", one.verdict) for one in self.classes),
            *((f"watchdog of {one.drive}", one.verdict) for one in self.drives),
            *((f"{one.code} of {one.drive}", one.verdict) for one in self.codes),
        ]
        away = tuple(f"drive {name}: does not answer" for name in self.away)
        if self.state != OPEN:
            away = (f"line {self.line}: is {self.state}, no drive can be asked",)
        return away + tuple(f"{what}: {verdict}" for what, verdict in rows if verdict not in fine)

    def as_json(self) -> dict[str, Any]:
        """Give it for `--json`; a promise that cannot be given is null."""
        found = asdict(self)
        for name in ("classes", "drives", "codes"):
            found[name] = [
                {key: _finite(value) for key, value in asdict(one).items()}
                | {"verdict": one.verdict}
                for one in getattr(self, name)
            ]
        return found | {"failed": self.failed, "beyond": list(self.beyond)}


def compare(
    roster: Roster,
    measured: Mapping[str, Any],
    away: Collection[str] = (),
    state: str = OPEN,
) -> LivePlan:
    """Compare what was promised with what was measured.

    Args:
        roster: The running line.
        measured: What its last minutes showed, as `RollingWindow.as_json` gives it.
        away: The drives that do not answer now.
        state: `open`, or how else the line is now.
    """
    plan = make_plan(roster)
    pause_s = roster.line.turnaround_s
    classes = tuple(_class(one, plan, measured, pause_s) for one in plan.waits)
    return LivePlan(
        line=plan.line,
        baud=plan.baud,
        window_s=measured["window_s"],
        load=plan.load.total,
        used=sum(one.used for one in classes),
        slack_s=measured["slack_s"],
        woken_late_s=measured["scheduler_lateness_s"],
        classes=classes,
        drives=tuple(_drives(roster, measured["margins_s"])),
        codes=tuple(_codes(roster, plan, measured["gaps_s"], away)),
        away=tuple(drive.name for drive in roster.drives if drive.name in away),
        state=state,
    )


def _class(
    wait: ClassWait, plan: LinePlan, measured: Mapping[str, Any], pause_s: float
) -> LiveClass:
    found = measured["classes"][wait.name]
    window_s = measured["window_s"]
    pauses = found["exchanges"] * pause_s / window_s if window_s > 0.0 else 0.0
    asked = {READS: plan.load.cyclic, "watchdog": plan.load.feeding}
    slow = {READS: plan.adapter.load.cyclic, "watchdog": plan.adapter.load.feeding}
    return LiveClass(
        name=wait.name,
        quiet_s=wait.quiet_s,
        loaded_s=wait.loaded_s,
        median_s=found["wait_median_s"],
        most_s=found["wait_most_s"],
        waits=found["waits"],
        exchanges=found["exchanges"],
        failed=found["failed"],
        load=asked.get(wait.name),
        load_slow=slow.get(wait.name),
        used=found["utilisation"] + pauses,
    )


def _drives(roster: Roster, margins: Mapping[str, float | None]) -> list[LiveDrive]:
    return [
        LiveDrive(drive.name, time_s, (1.0 - HARD_PART) * time_s, margins.get(drive.name))
        for drive in roster.drives
        if (time_s := watched_s(drive))
    ]


def _codes(
    roster: Roster,
    plan: LinePlan,
    gaps: Mapping[str, Mapping[str, float | None]],
    away: Collection[str],
) -> list[LiveCode]:
    """A slot may be late; that of a watched drive may also be run early, to feed it.

    Values differ by their times, and of two answers the first may come without delay.
    """
    late = plan.wait("cyclic")
    timing = line_timing(roster.line)
    found = []
    for drive in roster.drives:
        early = 2.0 if watched_s(drive) else 1.0
        for entry in drive.cyclic:
            period_s = entry.every_s * plan.stretch
            longest_s = gaps.get(drive.name, {}).get(str(entry.code))
            read_s = read_times(drive, entry.code, timing).usual_s + timing.adapter_latency_s
            own_s = early * period_s + read_s
            found.append(
                LiveCode(drive.name, str(entry.code), entry.every_s, own_s + late.quiet_s,
                         own_s + late.loaded_s, longest_s, drive.name in away)
            )  # fmt: skip
    return found


def _finite(value: object) -> object:
    return None if isinstance(value, float) and math.isinf(value) else value
