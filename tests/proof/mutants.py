"""Copies of the daemon with one small defect each: the proof must find every one of them out.

A mutant is one function in which one piece of text is another. Where the text no longer stands
there just once, `mutated` fails and names the place, so that no mutant can come to nothing unseen.
On one of `seeds` at least it shows; without it they are clean. There are several because whatever
is changed elsewhere moves the moments at which things happen.

`broken` has copies that break what is watched as a whole; these here are slips of one line.
"""

from __future__ import annotations

import contextlib
import inspect
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass

from lecombus.drive_state.judging import Judge
from lecombus.fieldbus.lecom.exchanges.exchange_loop import LecomExchangeLoop
from lecombus.fieldbus.lecom.exchanges.idle_receive import BusIdleTimer
from lecombus.fieldbus.lecom.exchanges.jobs import ReadJob, WriteJob
from lecombus.fieldbus.lecom.exchanges.late_answers import PendingLateAnswers
from lecombus.fieldbus.lecom.exchanges.prepared_telegrams import TelegramPreparer
from lecombus.fieldbus.lecom.exchanges.read_back_proof import ReadBackProof
from lecombus.fieldbus.lecom.exchanges.stop_job import StopJob
from lecombus.fieldbus.lecom.protocol.exchange import Exchange
from lecombus.schedule.schedule import Schedule
from lecombus.schedule.shares import Shares
from lecombus.schedule.silent_stops import SilentStops
from lecombus.schedule.waiting import Waiting
from lecombus.schedule.watchdog_set import WatchdogSet
from lecombus.supervision.health import Health
from lecombus.supervision.watchdogs import WatchdogAudit
from proof.lease_lines import leased_line
from proof.lines import RandomLine, line_of
from proof.losses import tolerant_line

__all__ = ["MUTANTS", "Mutant", "applied", "mutated"]


@dataclass(frozen=True)
class Mutant:
    """One defect.

    Args:
        owner: The class or module that has the function.
        name: The function.
        right: What stands in it, just once.
        wrong: What stands there instead.
        seeds: Lines that show it, or one of which does.
        quick: It is in the tests that are run each time.
        tolerate: The lines are those of `losses`, with so many lost answers; None: random ones.
        leased: The lines are those of `lease_lines`.
    """

    owner: object
    name: str
    right: str
    wrong: str
    seeds: tuple[int, ...]
    quick: bool = False
    tolerate: int | None = None
    leased: bool = False

    def line(self, seed: int, length_s: float) -> RandomLine:
        """Give the line of one of its seeds."""
        if self.leased:
            return leased_line(seed, length_s)
        if self.tolerate is None:
            return line_of(seed, length_s)
        return tolerant_line(seed, tolerate=self.tolerate, losses=self.tolerate, length_s=length_s)


MUTANTS: dict[str, Mutant] = {
    # -- watchdogs: what may stand before a feed ------------------------------------------------
    "no slack check": Mutant(
        WatchdogSet,
        "_fit",
        "return end_s <= others_s",
        "return True",
        (46, 90),
        quick=True,
    ),
    "an exchange that is begun is reckoned to take no time": Mutant(
        WatchdogSet,
        "fits",
        "end_s = now_s + worst_s",
        "end_s = now_s",
        (18, 46),
    ),
    "no room for the time for which the members of a multicast are left alone": Mutant(
        WatchdogSet,
        "_whole_need_s",
        "request.worst_s + request.hold_s + behind_s",
        "request.worst_s",
        (152529, 150723),
        tolerate=0,
    ),
    "a feed is counted from the end of its exchange": Mutant(
        Schedule,
        "finished",
        "feed.reached(started_s)",
        "feed.reached(now_s)",
        (119, 882),
        tolerate=1,
    ),
    "a write feeds for longer than a read": Mutant(
        Schedule,
        "finished",
        "feed.reached(started_s)",
        "feed.reached(started_s + 0.5 * feed.time_s * (request.priority == 1))",
        (4, 8),
        quick=True,
    ),
    "silent drives are stopped at any cost": Mutant(
        SilentStops,
        "goes",
        "return fits and self._late(now_s) is None",
        "return True",
        (46, 54, 50),
        quick=True,
    ),
    # -- stops ----------------------------------------------------------------------------------
    "a stop does not end what waits": Mutant(
        Waiting,
        "_end_writes",
        "ended += drive.writes",
        "ended += ()",
        (18, 15),
        quick=True,
    ),
    "a write under way goes on after a stop": Mutant(
        Waiting,
        "_cut_off",
        "request.writes and self._stopped_since(request)",
        "False",
        (123, 327),
    ),
    "a stop waits for the turn of others": Mutant(
        Schedule,
        "next",
        "if stop is not None:",
        "if stop is not None and self._arbiter.first(now_s)[0] is None:",
        (15, 18),
        quick=True,
    ),
    "a stop is called verified when it is acknowledged": Mutant(
        StopJob,
        "advance",
        "self._checking = None, 0, 0, True",
        "self._checking = None, 0, 0, True; return Outcome.VERIFIED, ''",
        (15, 1),
        quick=True,
    ),
    "a stop is said once": Mutant(
        StopJob,
        "_unread",
        "over = over and self.attempts >= self._least_sayings",
        "over = True",
        (18, 15),
        quick=True,
    ),
    "a quick stop forgets what stood in the control word": Mutant(
        sys.modules[StopJob.__module__],
        "stop_value",
        "control_word | rule.set_mask",
        "rule.set_mask",
        (15, 18),
        quick=True,
    ),
    # -- shares ---------------------------------------------------------------------------------
    "no shares": Mutant(
        sys.modules[Shares.__module__],
        "_entitled",
        "if priority > top and",
        "if False and",
        (113, 125),
        quick=True,
    ),
    "last come, first served": Mutant(
        Waiting,
        "number",
        "request.serial = request.place = self._serial",
        "request.serial, request.place = self._serial, -self._serial",
        (13, 1),
        quick=True,
    ),
    # -- the wire -------------------------------------------------------------------------------
    "the turnaround is forgotten": Mutant(
        BusIdleTimer,
        "exchange_ended",
        "ended_s + self.turnaround_s",
        "ended_s",
        (0,),
        quick=True,
    ),
    "the turnaround is forgotten where the next telegram is ready": Mutant(
        LecomExchangeLoop,
        "_follow",
        "result.ended_s + self._options.turnaround_s",
        "result.ended_s",
        (0,),
    ),
    "the quarantine is a tenth shorter": Mutant(
        BusIdleTimer,
        "answer_missing",
        "quarantine_s)",
        "0.9 * quarantine_s)",
        (2,),
        quick=True,
    ),
    "no hold after a write": Mutant(
        LecomExchangeLoop,
        "_conclude",
        "if prepared.hold_s and result.kind is not ResultKind.LOST:",
        "if False:",
        (18, 107),
        quick=True,
    ),
    "a multicast leaves its members no time": Mutant(
        TelegramPreparer,
        "_multicast",
        "self._timing.adapter_latency_s + job.processing_s",
        "self._timing.adapter_latency_s",
        (15, 31),
        quick=True,
    ),
    "given up after half the time": Mutant(
        Exchange,
        "deadline_s",
        "first = self._said_s + ask.first_byte_s",
        "first = self._said_s + 0.5 * ask.first_byte_s",
        (15, 8),
        quick=True,
    ),
    "a late answer is forgotten": Mutant(
        PendingLateAnswers,
        "blocked_until_s",
        "return until",
        "return now_s",
        (15, 3),
        quick=True,
    ),
    "the addressing form does not alternate": Mutant(
        TelegramPreparer,
        "_free",
        "if until_s <= now_s:",
        "if True:",
        (15, 3),
    ),
    "an answer to something else is taken": Mutant(
        Exchange,
        "_fits",
        "field = self._ask.field",
        "field = getattr(answer, 'field', self._ask.field)",
        (15, 43),
        quick=True,
    ),
    # -- what is said for a request -------------------------------------------------------------
    "the retries of a read are not counted": Mutant(
        ReadJob,
        "advance",
        "self.attempts += 1",
        "pass",
        (7, 47),
        quick=True,
    ),
    "a proof is not compared": Mutant(
        ReadBackProof,
        "take",
        "if not _shows(",
        "if type(what) is not WrittenValue and not _shows(",
        (59, 107, 223),
        quick=True,
    ),
    "a refusal is taken for an acknowledgement": Mutant(
        WriteJob,
        "advance",
        "type(answer) is AckAnswer",
        "answer is not None",
        (255, 327),
        quick=True,
    ),
    # -- what is shown --------------------------------------------------------------------------
    "no drive is ever offline": Mutant(
        Health,
        "_missed",
        "if health.misses >= (",
        "if health.misses >= 1000 + (",
        (2,),
        quick=True,
    ),
    "values of drives that are away stay good": Mutant(
        Judge,
        "_quality",
        "if record.state is DriveState.OFFLINE:",
        "if False:",
        (46, 15),
        quick=True,
    ),
    "old values stay good": Mutant(
        Judge,
        "_quality",
        "if age_s > allowed_s:",
        "if False:",
        (66, 82),
        quick=True,
    ),
    "a failed read leaves its value good": Mutant(
        Judge,
        "_quality",
        "if cell.failure is not None:",
        "if False:",
        (31, 15, 35),
        quick=True,
    ),
    "a drive that is back is not audited": Mutant(
        WatchdogAudit,
        "settle",
        "await self._audit_watchdog(drive, station, traits, action)",
        "pass",
        (146, 102, 162),
        quick=True,
    ),
}


@contextlib.contextmanager
def mutated(name: str) -> Iterator[None]:
    """Let every line run with one mutant."""
    with applied(MUTANTS[name]):
        yield


@contextlib.contextmanager
def applied(mutant: Mutant) -> Iterator[None]:
    """Let every line run with a mutant."""
    kept = inspect.getattr_static(mutant.owner, mutant.name)
    setattr(mutant.owner, mutant.name, _changed(mutant, kept))
    try:
        yield
    finally:
        setattr(mutant.owner, mutant.name, kept)


def _changed(mutant: Mutant, kept: object) -> object:
    """Compile the function again with the other text in it."""
    function = inspect.unwrap(getattr(kept, "fget", kept))  # type: ignore[arg-type]
    source = textwrap.dedent(inspect.getsource(function))
    right, wrong = textwrap.dedent(mutant.right), textwrap.dedent(mutant.wrong)
    place = f"{mutant.name} in {function.__module__}"
    assert source.count(right) == 1, f"the mutant no longer fits: {right!r} in {place}"
    found: dict[str, object] = {}
    code = compile(source.replace(right, wrong), f"<mutant of {place}>", "exec")
    exec(code, sys.modules[function.__module__].__dict__, found)
    return found[mutant.name]
