"""What must hold on every line, looked at with every telegram and every end.

* No two telegrams overlap, at most one exchange is open, and no answer is taken for another
  exchange's (`wire`); nor by a client, every drive being asked for its own address.
* Nothing overtakes a stop, and it begins in time (`stops`).
* Every request ends in exactly one outcome (`outcomes`).
* On a line whose drives all answer or are away, no watchdog acts (`watchdogs`).
* No class below control starves, whatever clients ask for (`turns`).
* No wait, gap or margin is beyond what the plan promised (`promises`).
* Line and drives are left alone for as long as they must be (`pauses`), and nothing is said for a
  request that it did not ask for, or once too often (`sayings`).
* Where drives have leases, only their holders move them (`lease_checks`).
* What is shown of drives and motors is true of the drives themselves (`shown`).

Here is who hands on to these what the world and the clients tell, and what is said to be broken.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable

from lecombus.capacity.plan import make_promises
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.fieldbus.lecom.simulator.receiver import ReceivedRequest
from lecombus.fieldbus.loop_interface import ExchangeReport
from lecombus.line_runtime import LineRuntime
from lecombus.schedule import Outcome, Request
from proof.lease_checks import LeaseChecks
from proof.lines import RandomLine
from proof.losses import Losses, TolerantLine
from proof.outcomes import Outcomes
from proof.pauses import Pauses
from proof.promises import Promises
from proof.sayings import Sayings
from proof.shown import Shown
from proof.stops import Stops
from proof.telegrams import Telegrams
from proof.turns import Turns
from proof.watchdogs import Watchdogs
from proof.wire import Wire
from support.lecom_loop import lecom_loop

MOST_SAID = 5
"""So many broken promises of one line are enough to look at."""


class Invariants:
    """Watches one line.

    Args:
        line: The line.
        sim: Its simulated drives.
        site: What runs it; not begun yet.
    """

    def __init__(self, line: RandomLine, sim: SimLine, site: LineRuntime) -> None:
        self.line = line
        self.sim = sim
        self.broken: list[str] = []
        self.exchanges = 0
        self.outcomes: Counter[str] = Counter()
        self._site = site
        self._told_apart = line.is_told_apart
        plan = make_promises(line.roster)
        self.wire = Wire(
            sim, line.kind != "faulty", self.say,
            told_apart=line.is_told_apart, may_cancel=line.may_cancel,
        )  # fmt: skip
        self.promises = Promises(line, plan, sim, _not_judged if line.leased else self.say)
        self._now = asyncio.get_running_loop().time
        self.turns = Turns(line, plan, self._now, self.say)
        self._stops = Stops(line, plan, site, self.say)
        self.watchdogs = Watchdogs(line, plan, sim, self.say)
        self._now = asyncio.get_running_loop().time
        self._telegrams = Telegrams(sim)
        self._pauses = Pauses(line, sim, self.say)
        self._sayings = Sayings(line, sim, self._now, self.say)
        self.shown = Shown(line, sim, site, self._now, self.say)
        self.leases = (
            LeaseChecks(
                line, sim, site, self._stops, self.watchdogs, self.left, self._now, self.say
            )
            if line.leased else None
        )  # fmt: skip
        if self.leases is not None:
            self._stops.begun = self.leases.begun
        self._requests = Outcomes(site.worker, self.say, self._taken)
        sim.on_request = self._drives_heard
        self._addresses = {drive.address: drive.name for drive in line.roster.drives}
        self._asked = 0
        self._answered = 0
        self._begun = False
        self._losses = Losses(line, sim, site) if isinstance(line, TolerantLine) else None

    # -- what the world tells ----------------------------------------------------------------

    def begin(self, *, settled: bool) -> None:
        """Count from here: all drives that will come are there (`settled`: all, and looked at)."""
        self.sim.advance(self._now())
        self.watchdogs.begin()
        self.shown.begin()
        self._begun = True
        self.turns.begin()
        self.promises.begin(self._now(), settled=settled)

    def let_pause(self, paused_s: Callable[[float, float], float]) -> None:
        """The daemon will not run now and then; `paused_s` tells for how long of a stretch."""
        self._stops.paused_s = paused_s

    def end(self) -> None:
        """Look at what can only be judged at the end."""
        self.sim.advance(self._now())
        if self.leases is not None:
            self.leases.end()
        self.watchdogs.look(self._now())
        self.wire.end()
        self.promises.end(self._now())
        self.turns.end()
        self._requests.end()
        if self._asked != self._answered:
            self.say(f"{self._asked} requests had {self._answered} outcomes")

    def left(self, drive: str) -> None:
        """A drive goes away: its watchdog may act, and nobody can help it."""
        self.watchdogs.left(drive)
        self.shown.left(drive)

    def lost_power(self, drive: str) -> None:
        """A drive has been without its supply."""
        self.shown.lost_power(drive)
        if self.leases is not None:
            self.leases.lost_power(drive)

    def said(self, data: bytes) -> None:
        """A telegram goes out."""
        now_s = self._now()
        self.wire.said(data, now_s)
        telegram = self._telegrams.said(data, now_s)
        self._pauses.said(telegram)
        self._sayings.said(telegram)
        if self.leases is not None:
            loop = lecom_loop(self._site.worker)
            going = loop.ready or loop.under_way  # what was prepared goes before it is under way
            self.leases.said(telegram, going[0] if going is not None else None)
        if self._begun:
            if self._losses is not None:
                self._losses.said(telegram.address, now_s)
            self._stops.said(self._addresses.get(telegram.address, ""), now_s)

    def heard(self, data: bytes) -> None:
        """Bytes come in."""
        self.wire.heard(data, self._now())
        self._telegrams.heard()

    def _drives_heard(self, at_s: float, heard: ReceivedRequest) -> None:
        self._pauses.drives_heard(at_s, heard)
        self.promises.drives_heard(at_s, heard.address)

    def ended(self, report: ExchangeReport) -> None:
        """An exchange ended."""
        self.exchanges += 1
        self.wire.ended(report)
        self.shown.ended(report)
        telegrams = self._telegrams.ended(report)
        self.promises.ended(report)
        if self.leases is not None:
            self.leases.ended(report)
        if telegrams is not None:
            self._pauses.judge(*telegrams)
            self._sayings.judge(telegrams[1])
        if self._begun:
            if telegrams is not None:
                self.shown.judge(telegrams[1])
            self._stops.reported(report)
            self.watchdogs.ended(report)
            self.turns.ended(report)

    def _taken(self, request: Request) -> Callable[[Outcome], None]:
        """Tell all who want to know of a request, and what became of it."""
        taken = [self._sayings.taken(request)]
        if self.leases is not None:
            taken.append(self.leases.asked(request))

        def ended(outcome: Outcome) -> None:
            for one in taken:
                if one is not None:
                    one(outcome)

        return ended

    # -- what the clients tell ---------------------------------------------------------------

    def stop_asked(self, drive: str) -> float:
        """A drive is to be stopped; give when."""
        self._stops.asked(drive, self._now())
        self._sayings.stop_asked(drive)
        self.shown.stop_asked(drive)
        return self._now()

    def stop_ended(self, drive: str, outcome: str, asked_s: float) -> None:
        """The stop has its outcome."""
        self._stops.ended(drive)
        self.shown.stop_ended(drive, outcome, asked_s)

    def asked(self) -> None:
        """A request was made."""
        self._asked += 1

    def answered(self, outcome: str) -> None:
        """A request ended."""
        self._answered += 1
        self.outcomes[outcome] += 1

    def told_address(self, drive: str, wanted: int, told: str) -> None:
        """A drive was asked for its own address; a copy of another's answer passes for its own."""
        if told != str(wanted) and self._told_apart:
            self.say(f"{drive} was asked for its address {wanted} and the answer was {told}")

    def say(self, text: str) -> None:
        """Note what did not hold."""
        if len(self.broken) < MOST_SAID:
            self.broken.append(f"at {self._now() - 1000.0:.3f} s: {text}")


def _not_judged(_text: str) -> None:
    """Waits are promised to clients that ask one after the other; controllers come besides."""
