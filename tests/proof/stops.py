"""Nothing overtakes a stop, and every stop begins within what the plan promises.

* From its submission on only the exchange under way, and stops, go before a stop; and its first
  telegram begins within the plan's wait, as `plan --from-daemon` reckons it. Stops of other drives
  that came before add their line time, and a daemon that is not run the time for which it is not.
* Before a stop of a drive that is known to be silent nothing goes but stops and feeds, and every
  telegram of it begins within what the plan promises for that; a reading counts from when it may be
  sent: in each form of which an answer is missing, when that can no longer come (`late_answer`).

Judged by the reports of the exchanges: they tell in which class each was, and when it began.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from lecombus.capacity.plan import Promises, make_promises
from lecombus.drives.stops import STOP_PAUSE_S
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.fieldbus.requests import StepKind
from lecombus.line_runtime import LineRuntime
from lecombus.parameters import Code
from lecombus.schedule import Priority
from proof.lines import RandomLine

__all__ = ["Stops"]

GOES_BEFORE = {Priority.STOP, Priority.WATCHDOG}
MOST_FORMS = 2
"""In so many addressing forms a code is read at most."""


@dataclass(frozen=True)
class _Waiting:
    """A stop that waits: since when, and what others had had of the line by then."""

    since_s: float
    others_s: float
    others: int


class Stops:
    """Watches the stops of one line.

    Args:
        line: The line.
        plan: What was printed for it.
        site: What runs it.
        say: Told what did not hold.
    """

    def __init__(
        self, line: RandomLine, plan: Promises, site: LineRuntime, say: Callable[[str], None]
    ) -> None:
        self._line = line
        self._plan = plan
        self._site = site
        self._say = say
        self._asked: Counter[str] = Counter()  # stops of a drive that have not ended
        self._unsaid: dict[str, _Waiting] = {}  # drives whose stop has not begun
        self._silent: dict[str, _Waiting] = {}  # drives whose stop waits though nobody is there
        self._lost_reads: dict[Code, deque[float]] = defaultdict(lambda: deque(maxlen=MOST_FORMS))
        self._before: dict[float, str] = {}  # telegrams that went before a silent drive's stop
        self._stopped_s = 0.0  # line time of stops
        self._others_s = 0.0  # line time of stops and of exchanges that failed
        self._others = 0
        self.paused_s: Callable[[float, float], float] = _never_paused
        self.begun: Collection[str] = ()  # drives that the daemon is stopping by itself

    def asked(self, drive: str, now_s: float) -> None:
        """A drive is to be stopped."""
        self._asked[drive] += 1
        if drive in self.begun:
            return  # it joins a stop that was said before
        if drive in self._site.schedule.silent:
            self._silent.setdefault(drive, _Waiting(now_s, self._others_s, self._others))
        else:
            self._unsaid.setdefault(drive, _Waiting(now_s, self._stopped_s, 0))

    def ended(self, drive: str) -> None:
        """The stop has its outcome; if it was never said, nobody waits for that any more."""
        self._asked[drive] -= 1
        if not self._asked[drive]:
            del self._asked[drive]
            self._unsaid.pop(drive, None)
            self._silent.pop(drive, None)

    def said(self, drive: str, now_s: float) -> None:
        """A telegram goes out."""
        self._sort_out_silent(now_s)
        waiting = self._waiting_silent()
        if waiting and drive not in self._silent:
            self._before[now_s] = waiting

    def _sort_out_silent(self, now_s: float) -> None:
        """A drive may turn out to be silent before its stop could be said at all."""
        for name in self._site.schedule.silent & self._unsaid.keys():
            del self._unsaid[name]
            self._silent[name] = _Waiting(now_s, self._others_s, self._others)

    def _waiting_silent(self) -> str:
        """Name a silent drive whose stop could go out now, if there is one."""
        schedule = self._site.schedule
        silent = schedule.silent
        if not silent:
            return ""
        return next((one.drive for one in schedule.stops() if one.drive in silent), "")

    def reported(self, report: ExchangeReport) -> None:
        """An exchange has ended: judge whether it was its turn."""
        if self._unsaid:
            self._judge_order(report)
        self._watch_silent(report)
        if report.priority is Priority.STOP:
            ended_s = report.result.ended_s + report.quarantined_s
            self._stopped_s += ended_s - report.result.started_s

    def _judge_order(self, report: ExchangeReport) -> None:
        began_s = report.result.started_s
        waiting = [drive for drive, one in self._unsaid.items() if one.since_s < began_s]
        if report.priority is not Priority.STOP:
            if waiting:  # what was said before they were asked for is the exchange under way
                text = f"{report.priority.name} to {report.drive} went before the stop of"
                self._say(f"{text} {', '.join(waiting)}")
            return
        for name in (report.drive, *report.members):  # a multicast says it to all of them
            one = self._unsaid.pop(name, None)
            if one is not None:
                self._judge_wait(name, one, began_s)

    def _judge_wait(self, name: str, one: _Waiting, began_s: float) -> None:
        waited_s = began_s - one.since_s
        more_s = self._stopped_s - one.others_s + self.paused_s(one.since_s, began_s)
        promised_s = self.promised_s(waited_s - more_s)
        if waited_s > promised_s + more_s:
            self._say_late(f"the stop of {name}", waited_s, promised_s + more_s)

    def promised_s(self, needed_s: float) -> float:
        """Give within what a stop begins; `needed_s`: how long this one took, others' apart."""
        promised_s = self._promise(lambda plan: plan.wait("stop").loaded_s, needed_s)
        if needed_s > promised_s:  # watchdogs of drives that are away hold nothing back
            promised_s = self._plan_as_measured(watched=False).wait("stop").loaded_s
        return promised_s

    def _watch_silent(self, report: ExchangeReport) -> None:
        """Judge what went before stops of silent drives, and how long these waited."""
        result = report.result
        behind = self._before.pop(result.started_s, "")
        if behind and report.priority not in GOES_BEFORE:
            self._say(f"{report.priority.name} to {report.drive} before the stop of {behind}")
        stop = report.priority is Priority.STOP
        waiting = self._silent.pop(report.drive, None) if stop else None
        if waiting is not None:
            since_s = max(waiting.since_s, self._readable_from_s(report))
            self._judge_silent(report.drive, replace(waiting, since_s=since_s), result.started_s)
        ended_s = result.ended_s + report.quarantined_s
        answered = result.kind is ResultKind.ANSWERED
        if not answered and report.step.kind is StepKind.READ:
            self._lost_reads[report.step.code].append(result.ended_s)
        if stop or not answered:
            self._others_s += ended_s - result.started_s
            self._others += 1
        if stop and not answered and not report.members and report.drive in self._asked:
            self._silent[report.drive] = _Waiting(
                ended_s + STOP_PAUSE_S, self._others_s, self._others
            )
        elif answered:
            self._silent.pop(report.drive, None)

    def _readable_from_s(self, report: ExchangeReport) -> float:
        """Give from when on a reading may be sent: an answer in its form may still be missing.

        It carries no address, so that of another drive counts too. While it is missing in one form,
        none is asked for in that form: of each there is one at most.
        """
        step = report.step
        drive = next((one for one in self._line.roster.drives if one.name == report.drive), None)
        if step.kind is not StepKind.READ or drive is None:
            return -math.inf
        forms = sum(form.carries(step.code) for form in drive.forms)
        lost = self._lost_reads[step.code]
        if len(lost) < forms:
            return -math.inf
        return lost[-forms] + self._line.roster.line.late_answer_s

    def _judge_silent(self, name: str, waiting: _Waiting, now_s: float) -> None:
        """Each of the others' stops may let a round of feeds go first, as this one does."""
        waited_s, rounds = now_s - waiting.since_s, 1 + self._others - waiting.others
        more_s = self._others_s - waiting.others_s + self.paused_s(waiting.since_s, now_s)
        own_s = (waited_s - more_s) / rounds
        promised_s = self._promise(lambda plan: plan.silent_stop.loaded_s, own_s) * rounds + more_s
        if waited_s > promised_s:
            self._say_late(f"a stop of the silent {name}", waited_s, promised_s)

    def _promise(self, promise: Callable[[Promises], float], needed_s: float) -> float:
        """Give what was promised; where that is not enough, what is promised as measured."""
        promised_s = promise(self._plan)
        return promised_s if needed_s <= promised_s else promise(self._plan_as_measured())

    def _plan_as_measured(self, *, watched: bool = True) -> Promises:
        """Plan as `plan --from-daemon`: drives whose answers came late are waited for longer."""
        without = {} if watched else {"watchdog": None}
        requests, roster = self._site.requests, self._line.roster
        drives = tuple(
            drive.model_copy(update={"slow": requests.station(drive.name).measured.slow} | without)
            for drive in roster.drives
        )
        return make_promises(roster.model_copy(update={"drives": drives}))

    def _say_late(self, what: str, waited_s: float, promised_s: float) -> None:
        self._say(f"{what} waited {waited_s:.3f} s, promised {promised_s:.3f} s")


def _never_paused(_from_s: float, _to_s: float) -> float:
    return 0.0
