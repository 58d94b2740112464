"""What must hold on every line, looked at with every telegram and every end.

* No two telegrams overlap: nothing is said while a drive speaks (the simulated line knows).
* At most one exchange is open: before a telegram the last exchange has ended.
* Nothing overtakes a stop: from its submission on only the exchange under way, and stops, go
  before it; and it begins within what the plan promises, as `plan --from-daemon` reckons it.
* Before a stop of a drive that is known to be silent nothing goes but stops and feeds, and every
  telegram of it begins within what the plan promises for that.
* Every request ends in exactly one outcome.
* No answer is taken for another exchange's: every drive is asked for its own address.
* On a line whose drives all answer or are away, no watchdog acts.
* No class waits longer than the plan promised.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import dataclass

from lecombus.line.observer import ExchangeReport
from lecombus.planning import Plan, make_plan
from lecombus.planning.silent_stops import PAUSE_S
from lecombus.protocol.exchange import ResultKind
from lecombus.schedule import Priority
from lecombus.simulator.line import SimLine
from lecombus.site import Site
from proof.lines import RandomLine

_STRIPPED = bytes(range(128)) * 2
MOST_SAID = 5
"""So many broken promises of one line are enough to look at."""
GOES_BEFORE = {Priority.STOP, Priority.WATCHDOG}
CLASSES = {Priority.CONTROL: "control", Priority.INTERACTIVE: "interactive"}


@dataclass
class _Waiting:
    """A stop of a silent drive: since when it waits, and what others had had by then."""

    since_s: float
    others_s: float
    others: int


class Invariants:
    """Watches one line.

    Args:
        line: The line.
        sim: Its simulated drives.
    """

    def __init__(self, line: RandomLine, sim: SimLine) -> None:
        self.line = line
        self.sim = sim
        self.plan: Plan = make_plan(line.roster)
        self.broken: list[str] = []
        self.exchanges = 0
        self.outcomes: Counter[str] = Counter()
        self._stopping: Counter[str] = Counter()  # stops of a drive that have not ended
        self._addresses = {drive.address: drive.name for drive in line.roster.drives}
        self._stops: dict[str, float] = {}  # drives whose stop waits unsaid: since when
        self._silent: dict[str, _Waiting] = {}  # drives whose stop waits though nobody is there
        self._before: dict[float, str] = {}  # telegrams that went before a silent drive's stop
        self._others_s = 0.0  # line time of stops and of exchanges that failed
        self._others = 0
        self._asked = 0
        self._answered = 0
        self._fired: dict[str, int] = {}
        self._begun = False
        self._site: Site | None = None
        self._gone: set[str] = set()

    # -- what the world tells ----------------------------------------------------------------

    def begin(self, site: Site) -> None:
        """Count from here: all drives that will come are there."""
        self.sim.advance(asyncio.get_running_loop().time())
        self._fired = {drive.name: drive.watchdog_fired for drive in self.sim.drives}
        self._site = site
        self._begun = True

    def end(self, site: Site) -> None:
        """Look at what can only be judged at the end."""
        self.sim.advance(asyncio.get_running_loop().time())
        if self.line.kind != "faulty":
            self._judge_watchdogs(site)
            if self.sim.collisions or self.sim.clashes:
                self.say(f"{self.sim.collisions} telegrams were said while a drive spoke")
        if self._asked != self._answered:
            self.say(f"{self._asked} requests had {self._answered} outcomes")

    def _judge_watchdogs(self, site: Site) -> None:
        for drive in self.sim.drives:
            fired = drive.watchdog_fired - self._fired[drive.name]
            fed = drive.name in site.schedule.stats(asyncio.get_running_loop().time()).feeds
            if fired and fed and drive.name not in self._gone:
                self.say(f"the watchdog of {drive.name} acted {fired} times")

    def left(self, drive: str) -> None:
        """A drive goes away: its watchdog may act, and nobody can help it."""
        self._gone.add(drive)

    def said(self, data: bytes, now_s: float) -> None:
        """A telegram goes out."""
        if not self._begun:
            return
        text = data.translate(_STRIPPED)
        name = self._addresses.get(int(text[1:3]), "")
        waiting_silent = self._waiting_silent()
        if waiting_silent and name not in self._silent:
            self._before[now_s] = waiting_silent
        if self._stops and name not in self._stops:
            waiting = min(self._stops.values())
            if now_s > waiting:  # the exchange under way was said before
                self.say(
                    f"{name} was spoken to while {', '.join(self._stops)} waited to be stopped"
                )
        since_s = self._stops.pop(name, None)
        if since_s is not None:
            self._judge_stop(name, now_s - since_s)

    def _judge_stop(self, name: str, waited_s: float) -> None:
        promised_s = self.plan.wait("stop").loaded_s
        if waited_s > promised_s:
            promised_s = self._plan_as_measured().wait("stop").loaded_s
        if waited_s > promised_s:
            self.say(f"the stop of {name} waited {waited_s:.3f} s, promised {promised_s:.3f} s")

    def _waiting_silent(self) -> str:
        """Name a silent drive whose stop could go out now, if there is one."""
        assert self._site is not None
        waiting = self._site.schedule._waiting
        stops = waiting.queues[Priority.STOP].waiting()
        return next((one.drive for one in stops if one.drive in waiting.silent), "")

    def _watch_silent(self, report: ExchangeReport) -> None:
        """Judge what went before stops of silent drives, and how long these waited."""
        result = report.result
        behind = self._before.pop(result.started_s, "")
        if behind and report.priority not in GOES_BEFORE:
            self.say(f"{report.priority.name} to {report.drive} before the stop of {behind}")
        stop = report.priority is Priority.STOP
        waiting = self._silent.pop(report.drive, None) if stop else None
        if waiting is not None:
            self._judge_silent(report.drive, waiting, result.started_s)
        ended_s = result.ended_s + report.quarantined_s
        answered = result.kind is ResultKind.ANSWERED
        if stop or not answered:
            self._others_s += ended_s - result.started_s
            self._others += 1
        if stop and not answered and not report.members and report.drive in self._stopping:
            self._silent[report.drive] = _Waiting(ended_s + PAUSE_S, self._others_s, self._others)
        elif answered:
            self._silent.pop(report.drive, None)

    def _judge_silent(self, name: str, waiting: _Waiting, now_s: float) -> None:
        """Each of the others' stops may let a round of feeds go first, as this one does."""
        waited_s, rounds = now_s - waiting.since_s, 1 + self._others - waiting.others
        more_s = self._others_s - waiting.others_s
        promised_s = self.plan.silent_stop.loaded_s * rounds + more_s
        if waited_s > promised_s:
            promised_s = self._plan_as_measured().silent_stop.loaded_s * rounds + more_s
        if waited_s > promised_s:
            self.say(
                f"a stop of the silent {name} waited {waited_s:.3f} s, promised {promised_s:.3f} s"
            )

    def _plan_as_measured(self) -> Plan:
        """Plan as `plan --from-daemon`: drives whose answers came late are waited for longer."""
        assert self._site is not None
        requests, roster = self._site.requests, self.line.roster
        drives = tuple(
            drive.model_copy(update={"slow": requests.station(drive.name).measured.slow})
            for drive in roster.drives
        )
        return make_plan(roster.model_copy(update={"drives": drives}))

    def ended(self, report: ExchangeReport) -> None:
        """An exchange ended."""
        self.exchanges += 1
        if self._begun:
            self._watch_silent(report)
        name = CLASSES.get(report.priority)
        if not self._begun or name is None or self.line.kind not in {"quiet", "loaded"}:
            return
        if report.result.kind is ResultKind.LOST:
            return
        wait = self.plan.wait(name)
        promised_s = wait.quiet_s if self.line.kind == "quiet" else wait.loaded_s
        if name != "control" and self.line.kind == "loaded":
            return  # many ask at once: how long is up to them
        if report.waited_s > promised_s:
            self.say(
                f"{name} to {report.drive} waited {report.waited_s:.3f} s, "
                f"promised {promised_s:.3f} s"
            )

    # -- what the clients tell ---------------------------------------------------------------

    def stop_asked(self, drive: str) -> None:
        """A drive is to be stopped."""
        assert self._site is not None
        now_s = asyncio.get_running_loop().time()
        self._stopping[drive] += 1
        if drive in self._site.schedule._waiting.silent:
            self._silent.setdefault(drive, _Waiting(now_s, self._others_s, self._others))
        else:
            self._stops.setdefault(drive, now_s)

    def stop_ended(self, drive: str) -> None:
        """The stop has its outcome; if it was never said, nobody waits for that any more."""
        self._stopping[drive] -= 1
        if not self._stopping[drive]:
            del self._stopping[drive]
            self._stops.pop(drive, None)
            self._silent.pop(drive, None)

    def asked(self) -> None:
        """A request was made."""
        self._asked += 1

    def answered(self, outcome: str) -> None:
        """A request ended."""
        self._answered += 1
        self.outcomes[outcome] += 1

    def told_address(self, drive: str, wanted: int, told: str) -> None:
        """A drive was asked for its own address."""
        if told != str(wanted):
            self.say(f"{drive} was asked for its address {wanted} and the answer was {told}")

    def say(self, text: str) -> None:
        """Note what did not hold."""
        if len(self.broken) < MOST_SAID:
            self.broken.append(f"at {asyncio.get_running_loop().time() - 1000.0:.3f} s: {text}")
