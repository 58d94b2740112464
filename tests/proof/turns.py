"""Nothing starves: the first request of each class below control begins within the plan's bound.

Seen from the clients' side: a class waits from when a client has asked for something in it, or from
the end of the last exchange of that class, until the next one begins. A cyclic slot waits from when
it is due; one that is run early, to feed a drive, is not a turn of the others. Stops come on top.
And no request is left behind many later ones of its class.

Judged on lines whose drives all answer, whatever load is on them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from lecombus.capacity.plan import Promises
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.schedule import Priority
from proof.lines import RandomLine

__all__ = ["Turns"]

_ROWS = {priority: f"{priority.name.lower()}, its turn" for priority in Priority}
OVERTAKEN_MOST = 60
"""Requests of a class go first come, first served, but for drives that are left alone or fed, and
for what is repeated: at most 19 later ones were answered before one, and hundreds or thousands
where the last that came goes first."""


class Turns:
    """Judges how long each class had to wait for its turn.

    Args:
        line: The line.
        plan: What was printed for it.
        now: The time.
        say: Told what did not hold.
    """

    def __init__(
        self, line: RandomLine, plan: Promises, now: Callable[[], float], say: Callable[[str], None]
    ) -> None:
        self._say = say
        self._now = now
        judged = line.kind in ("quiet", "loaded")
        self._within_s = {
            Priority[one.name.upper()]: one.crowded_s
            for one in plan.waits
            if judged and one.crowded_s is not None
        }
        self._asked: Counter[Priority] = Counter()
        self._tickets: dict[Priority, dict[int, int]] = {one: {} for one in Priority}
        self._count = 0
        self._in_order = line.kind in ("quiet", "loaded", "tolerant")
        self._since_s: dict[Priority, float] = {}
        self._stops_s = 0.0
        self._stops_before_s: dict[Priority, float] = {}
        self._begun = False
        self.most: dict[str, float] = {}

    def begin(self) -> None:
        """Judge from here on."""
        self._begun = True
        for priority in self._since_s:
            self._wait(priority, self._now())

    def asked(self, priority: Priority, *, alone: bool = False) -> int:
        """A client asks for something; give its number.

        Args:
            priority: Its class.
            alone: Its drive is written to all the time and left alone after each write: later ones
                may be answered before it.
        """
        self._asked[priority] += 1
        if priority not in self._since_s:
            self._wait(priority, self._now())
        self._count += 1
        if not alone:
            self._tickets[priority][self._count] = 0
        return self._count

    def answered(self, priority: Priority, number: int, *, at_once: bool = False) -> None:
        """It has its outcome.

        Args:
            priority: Its class.
            number: What `asked` gave.
            at_once: It was refused when it was asked, as for a silenced drive: nothing was sent,
                so that it went ahead of none.
        """
        tickets = self._tickets[priority]
        tickets.pop(number, None)
        for other in () if at_once else tickets:
            if other < number:
                tickets[other] += 1
                if tickets[other] == OVERTAKEN_MOST and self._in_order and self._begun:
                    self._say(
                        f"{OVERTAKEN_MOST} later requests of class {priority.name.lower()} were "
                        "answered before one"
                    )
        self._asked[priority] -= 1
        if not self._asked[priority]:
            del self._since_s[priority]

    def ended(self, report: ExchangeReport) -> None:
        """An exchange ended."""
        started_s, ended_s = report.result.started_s, report.result.ended_s
        if report.priority is Priority.STOP:
            self._stops_s += ended_s + report.quarantined_s - started_s
        if report.result.kind is ResultKind.LOST:
            return
        priority = report.priority
        if priority is Priority.CYCLIC:
            if report.waited_s <= 0.0:
                return
            since_s = max(self._since_s.get(priority, started_s), started_s - report.waited_s)
            self._since_s[priority] = since_s
        if priority in self._since_s:
            self._judge(priority, started_s)
            self._wait(priority, ended_s)

    def end(self) -> None:
        """Judge what still waits."""
        for priority, asked in self._asked.items():
            if asked:
                self._judge(priority, self._now())

    def _wait(self, priority: Priority, since_s: float) -> None:
        self._since_s[priority] = since_s
        self._stops_before_s[priority] = self._stops_s

    def _judge(self, priority: Priority, begun_s: float) -> None:
        promised_s = self._within_s.get(priority)
        if promised_s is None or not self._begun:
            return
        stops_s = self._stops_s - self._stops_before_s.get(priority, self._stops_s)
        waited_s = begun_s - self._since_s[priority] - stops_s
        row = _ROWS[priority]
        if waited_s / promised_s > self.most.setdefault(row, 0.0):
            self.most[row] = waited_s / promised_s
        if waited_s > promised_s:
            self._say(
                f"{priority.name.lower()} had no turn for {waited_s:.3f} s, promised "
                f"{promised_s:.3f} s"
            )
