"""What the plan printed, held against what was measured: no wait, gap or margin is beyond it.

What is promised to whom depends on who else asks. On a `quiet` line one client asks for one thing
at a time: every class is held to `begins within`. On a `loaded` line the lower classes are full:
control is held to `under load`, and where no crowd asks in its own class, interactive and cyclic
are, too; what clients ask meanwhile comes on top of a slot's lateness, and what the line has not
yet made up for of what they asked before: slots that were due then go first. It makes up for that
with the share of its time that reads and feeds leave. The good values of a cyclic code are no
further apart than its period, reached and kept early for a feed, the lateness of its slot and the
time of an answer.

A plan counts the millisecond that an adapter adds in its low latency mode. Waits behind reads and
feeds of many drives, of cyclic slots and of background, grow with each exchange, so where the
adapter of a line adds more they are held to the plan of a line that counts it.

Watched drives are fed within nine tenths of their times wherever all drives answer and the adapter
adds no more than a millisecond; what others add comes off the last tenth, which is there for that.

The promises hold while all drives answer: lines with trouble are not judged here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from lecombus.capacity.exchange_costs import read_times, watched_s
from lecombus.capacity.plan import Promises as LinePromises
from lecombus.capacity.plan import make_promises
from lecombus.capacity.work_ahead import LOW_LATENCY_S
from lecombus.config import line_timing
from lecombus.drives import family
from lecombus.fieldbus.lecom.protocol.telegrams import ValueAnswer
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.fieldbus.requests import StepKind
from lecombus.parameters import Code
from lecombus.schedule import Priority
from lecombus.schedule.watchdog_deadline import HARD_PART
from proof.lines import QUICK_ADAPTER_S, RandomLine

__all__ = ["Promises"]

ROUNDING_S = 1e-6
QUIET = {
    Priority.CONTROL: "control",
    Priority.INTERACTIVE: "interactive",
    Priority.CYCLIC: "cyclic",
    Priority.BACKGROUND: "background",
}
OWN_WORK = {Priority.CYCLIC, Priority.WATCHDOG}
LOADED = {Priority.CONTROL: "control"}
OWN = {name: f"{name} itself" for name in QUIET.values()}
SAID = {"gap": "was not read for", "feed": "was not fed for"} | {
    row: f"was spoken to, {name}, and it took" for name, row in OWN.items()
}
SUMS = (Priority.CYCLIC, Priority.BACKGROUND)
UNCROWDED = LOADED | {Priority.INTERACTIVE: "interactive", Priority.CYCLIC: "cyclic"}


class Promises:
    """Judges what is promised by class, cyclic code and watchdog.

    Args:
        line: The line.
        plan: What was printed for it.
        sim: The drives: they know when they were spoken to.
        say: Told what did not hold.
    """

    def __init__(
        self, line: RandomLine, plan: LinePromises, sim: SimLine, say: Callable[[str], None]
    ) -> None:
        self._say = say
        self._sim = sim
        self._begun = False
        quiet = line.kind == "quiet"
        self._judged = quiet or line.kind == "loaded"
        classes = QUIET if quiet else LOADED if line.is_crowded else UNCROWDED
        if line.is_saturated:
            classes = {}
        slowed = _slowed(line, plan) if self._judged else plan
        waits = {which: plan.wait(name) for which, name in classes.items()}
        self._waits = {
            which: (wait.name, wait.quiet_s if quiet else wait.loaded_s)
            for which, wait in waits.items()
        }
        for which in self._waits.keys() & set(SUMS):
            name, promised_s = self._waits[which]
            wait = slowed.wait(name)
            slowed_s = wait.quiet_s if quiet else wait.loaded_s
            self._waits[which] = name, max(promised_s, slowed_s)
        self._own_s = {wait.name: wait.own_s for wait in waits.values()}
        self._promised_for = OWN_WORK if quiet else OWN_WORK | {Priority.BACKGROUND}
        self._asked: list[tuple[float, float]] = []
        self._spare = max(1.0 - slowed.load.total, 0.0)
        self._pause_s = line.roster.line.turnaround_s
        self._slots = {
            (drive.name, entry.code) for drive in line.roster.drives for entry in drive.cyclic
        }
        self._gaps: dict[tuple[str, Code], float] = {}
        if Priority.CYCLIC in self._waits:
            self._promise_gaps(line, slowed, self._waits[Priority.CYCLIC][1])
        self._good: dict[tuple[str, Code], float] = {}
        part = HARD_PART if line.adapter_s <= QUICK_ADAPTER_S else 1.0
        self._guards = {
            drive.address: (drive.name, part * time_s)
            for drive in line.roster.drives
            if (time_s := watched_s(drive))
        }
        self._fed: dict[int, float] = {}
        self._stopped: dict[str, float] = {}
        self._holds_s = {
            drive.name: family(drive.family).hold_after_write_s for drive in line.roster.drives
        }
        self.most: dict[str, float] = {}

    def _promise_gaps(self, line: RandomLine, plan: LinePromises, late_s: float) -> None:
        timing = line_timing(line.roster.line)
        for drive in line.roster.drives:
            periods = 2.0 if watched_s(drive) else 1.0
            for entry in drive.cyclic:
                period_s = periods * entry.every_s * plan.stretch
                read_s = read_times(drive, entry.code, timing).usual_s + line.adapter_s
                self._gaps[drive.name, entry.code] = period_s + late_s + read_s

    def begin(self, now_s: float, *, settled: bool) -> None:
        """Judge from here on; what the daemon itself asks in idle time goes before clients'."""
        if not settled:
            self._waits.pop(Priority.BACKGROUND, None)
        self._begun = True
        if self._judged:
            self._good = dict.fromkeys(self._gaps, now_s)
            self._fed = {self._sim[name].address: now_s for name, _ in self._guards.values()}

    def ended(self, report: ExchangeReport) -> None:
        """Judge how long an exchange had waited, and what it brought."""
        if not self._judged or report.result.kind is ResultKind.LOST:
            return
        if report.priority is Priority.STOP:
            self._stopped[report.drive] = report.result.ended_s
        name, promised_s = self._waits.get(report.priority, ("", 0.0))
        is_promised = report.priority in self._promised_for
        if report.priority is Priority.CYCLIC and not self._is_slot(report):
            name, is_promised = "", False
        if not is_promised:
            # After a write its drive may be left alone; its slots wait for that.
            is_write = report.step.kind is StepKind.WRITE
            hold_s = self._holds_s.get(report.drive, 0.0) if is_write else 0.0
            self._asked.append((report.result.ended_s + hold_s, report.result.started_s))
        if not self._begun:
            return
        if name:
            # On a quiet line only status words after a command go before background.
            if name in ("cyclic", "background") and report.waited_s > promised_s:
                promised_s += self._asked_s(report.result.started_s - report.waited_s)
            # What a proof waits is not a wait of the request; nor is a stop of the drive that is
            # under way, behind which its status words are read.
            behind_stop = self._stopped.get(report.drive, -math.inf) > (
                report.result.started_s - report.waited_s
            )
            if report.attempt == 1 and not (behind_stop and name == "interactive"):
                self._judge(name, report.drive, report.waited_s, promised_s)
            took_s, own_s = report.result.ended_s - report.result.started_s, self._own_s[name]
            self._judge(OWN[name], report.drive, took_s, own_s)
        if isinstance(report.result.answer, ValueAnswer):
            self._value(report.drive, report.step.code, report.result.ended_s)

    def _is_slot(self, report: ExchangeReport) -> bool:
        """Whether it is a cyclic read; why a drive refused a write is asked for in that class."""
        return (report.drive, report.step.code) in self._slots

    def _value(self, drive: str, code: Code, at_s: float) -> None:
        since_s = self._good.get((drive, code))
        if since_s is not None:
            self._good[drive, code] = at_s
            self._judge_gap(drive, code, since_s, at_s)

    def _judge_gap(self, drive: str, code: Code, since_s: float, at_s: float) -> None:
        promised_s = self._gaps[drive, code]
        if at_s - since_s > promised_s:
            promised_s += self._asked_s(since_s)
        self._judge("gap", drive, at_s - since_s, promised_s)

    def _asked_s(self, since_s: float) -> float:
        """Tell how much of the line went to what clients asked for since a time.

        What they asked before counts as far as the line has not made up for it until then.
        """
        behind_s, since_then_s, last_s = 0.0, 0.0, -math.inf
        for ended_s, started_s in self._asked:
            took_s = ended_s - started_s + self._pause_s
            if ended_s > since_s:
                since_then_s += took_s
            else:
                behind_s = self._made_up_s(behind_s, started_s - last_s) + took_s
                last_s = started_s
        return self._made_up_s(behind_s, since_s - last_s) + since_then_s

    def _made_up_s(self, behind_s: float, time_s: float) -> float:
        """Tell how much of what clients asked still keeps slots waiting after a time.

        A line that reads and feeds fill makes up for nothing: it stretches its periods instead.
        """
        if not behind_s or not self._spare:
            return 0.0
        return max(behind_s - self._spare * time_s, 0.0)

    def drives_heard(self, at_s: float, address: int) -> None:
        """A drive has heard a telegram: it is fed."""
        since_s = self._fed.get(address)
        if since_s is not None:
            self._fed[address] = at_s
            name, within_s = self._guards[address]
            self._judge("feed", name, at_s - since_s, within_s)

    def _judge(self, row: str, drive: str, measured_s: float, promised_s: float) -> None:
        part = measured_s / promised_s if promised_s else measured_s and math.inf
        if part > self.most.get(row, 0.0):
            self.most[row] = part
        if measured_s > promised_s + ROUNDING_S:
            what = f"{drive} {SAID[row]}" if row in SAID else f"{row} to {drive} waited"
            self._say(f"{what} {measured_s:.3f} s, promised {promised_s:.3f} s")

    def end(self, now_s: float) -> None:
        """Judge what has not come again."""
        for (drive, code), since_s in self._good.items():
            self._judge_gap(drive, code, since_s, now_s)
        for address, since_s in self._fed.items():
            name, within_s = self._guards[address]
            self._judge("feed", name, now_s - since_s, within_s)


def _slowed(line: RandomLine, plan: LinePromises) -> LinePromises:
    """Give the plan of a line whose adapter adds to each answer what this line's does."""
    more_s = line.adapter_s - LOW_LATENCY_S
    if more_s <= 0.0:
        return plan
    timing = line_timing(line.roster.line)
    timing = replace(timing, turnaround_s=timing.turnaround_s + more_s)
    return make_promises(line.roster, timing)
