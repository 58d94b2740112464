"""No watchdog of a drive that is there acts, but for one cause that nobody can help.

Only the drives know when theirs acts; it is looked at with every exchange. Not counted are drives
that went away, and what follows from the first telegram of a stop that is not answered: it waits
for nothing, because its drive is supposed to be there, and nothing keeps room for it. That excuse
lasts until the feeds have had one round; what comes later is held against the line. There is no
excuse where no more answers are lost than the roster's hypothesis allows (`losses`), but one that
`check` names beforehand: the watchdog of a drive that is being stopped may act when two or more
answers of its own stop are lost. It is the own one alone, and only of a drive that is named.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from lecombus.capacity.exchange_costs import watched_s
from lecombus.capacity.plan import Promises
from lecombus.config import line_timing
from lecombus.config.warnings import lost_stops
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.schedule import Priority
from proof.lines import RandomLine

__all__ = ["Watchdogs"]

STOPS_LOST = 2
"""From so many lost answers of one stop on its drive's own watchdog may act, if `check` says so."""


class Watchdogs:
    """Watches the watchdogs of one line.

    Args:
        line: The line; with noise on it nothing is judged.
        plan: What was printed for it.
        sim: Its drives.
        say: Told what did not hold.
    """

    def __init__(
        self, line: RandomLine, plan: Promises, sim: SimLine, say: Callable[[str], None]
    ) -> None:
        self._judged = line.kind != "faulty"
        self._excuses = line.kind != "tolerant"
        self._round_s = plan.silent_stop.quiet_s
        self._say = say
        guarded = {drive.name for drive in line.roster.drives if watched_s(drive) is not None}
        self._drives = [drive for drive in sim.drives if drive.name in guarded]
        self._models = [drive.model for drive in self._drives]
        self._fired = self._now_fired()
        self._gone: set[str] = set()
        self._silent: set[str] = set()
        self._excused_until_s = 0.0
        timing = line_timing(line.roster.line)
        self._named = {name for name, _ in lost_stops(line.roster, timing)}
        self._stops_lost: Counter[str] = Counter()  # by drive: since it answered last
        self.excused = 0

    def begin(self) -> None:
        """Count from here."""
        self._fired = self._now_fired()

    def _now_fired(self) -> list[int]:
        return [model.watchdog_fired for model in self._models]

    def left(self, drive: str) -> None:
        """A drive goes away: its own may act."""
        self._gone.add(drive)

    def excuse(self, until_s: float) -> None:
        """More stops at once than watchdogs need outlast: judge none until then."""
        self._excused_until_s = max(self._excused_until_s, until_s)

    def ended(self, report: ExchangeReport) -> None:
        """Look whether one acted during or since the last exchange."""
        answered = report.result.kind is ResultKind.ANSWERED
        stop = report.priority is Priority.STOP and not report.members
        if self._excuses and stop and not answered and report.drive not in self._silent:
            self._silent.add(report.drive)
            over_s = report.result.ended_s + report.quarantined_s + self._round_s
            self._excused_until_s = max(self._excused_until_s, over_s)
        elif answered:
            self._silent.discard(report.drive)
        if stop and not answered:
            self._stops_lost[report.drive] += 1
        self.look(report.result.started_s)
        if answered:
            self._stops_lost.pop(report.drive, None)

    def _is_named(self, drive: str) -> bool:
        """Whether it lost so many answers of its own stop that its watchdog may act."""
        return drive in self._named and self._stops_lost[drive] >= STOPS_LOST

    def look(self, now_s: float) -> None:
        """Judge what acted since the last look.

        Args:
            now_s: When the exchange began, or the line ended.
        """
        found = self._now_fired()
        if found == self._fired or not self._judged:
            return
        for drive, before, now in zip(self._drives, self._fired, found, strict=True):
            if now == before or drive.name in self._gone:
                continue
            if now_s <= self._excused_until_s or self._is_named(drive.name):
                self.excused += 1
            else:
                self._say(f"the watchdog of {drive.name} acted")
        self._fired = found
