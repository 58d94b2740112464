"""No watchdog of a drive that is there acts, but for one cause that nobody can help.

Only the drives know when theirs acts; it is looked at with every exchange. Not counted are drives
that went away, and what follows from the first telegram of a stop that is not answered: it waits
for nothing, because its drive is supposed to be there, and nothing keeps room for it. That excuse
lasts until the feeds have had one round; what comes later is held against the line. There is no
excuse where no more answers are lost than the roster's hypothesis allows (`losses`).
"""

from __future__ import annotations

from collections.abc import Callable

from lecombus.capacity.exchange_costs import watched_s
from lecombus.capacity.plan import Promises
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.schedule import Priority
from proof.lines import RandomLine

__all__ = ["Watchdogs"]


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
        self.look(report.result.started_s)

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
            if now_s <= self._excused_until_s:
                self.excused += 1
            else:
                self._say(f"the watchdog of {drive.name} acted")
        self._fired = found
