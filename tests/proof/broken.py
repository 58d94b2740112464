"""Copies of the daemon that are broken on purpose: each check of the proof must see its own.

`mutants` holds schedules that are wrong in one thought; here whole promises are broken, one for
each sentence of what is watched. `BROKEN` names each copy, what must be said about it, and lines
that show it.
"""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from lecombus.capacity.plan import Promises, make_promises
from lecombus.config import Roster
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.exchanges.exchange_loop import LecomExchangeLoop
from lecombus.fieldbus.lecom.exchanges.idle_receive import BusIdleTimer
from lecombus.fieldbus.lecom.protocol.exchange import Ask, Exchange, Result
from lecombus.fieldbus.lecom.protocol.telegrams import ValueAnswer
from lecombus.parameters import Value
from lecombus.schedule import (
    Cyclic,
    FaultHypothesis,
    Outcome,
    Priority,
    Request,
    Schedule,
    watchdog_deadline,
    watchdog_set,
)
from lecombus.supervision import drive_changes
from proof import invariants, promises

__all__ = ["BROKEN", "broken"]

IMPATIENCE_S = 0.004
DELAY_S = 3.0
TIGHTER = 0.05
EVERY = 7
FALLS_AT = 300
Patch = tuple[type | object, str, Any]


def _impatient() -> list[Patch]:
    """Gives an answer up while the drive still thinks, and speaks at once."""
    begin = Exchange.begin

    def begin_impatiently(self: Exchange, ask: Ask, now_s: float, *more: Any, **keys: Any) -> None:
        first_s = ask.request_s + IMPATIENCE_S
        begin(
            self,
            dataclasses.replace(ask, first_byte_s=first_s, whole_s=first_s),
            now_s,
            *more,
            **keys,
        )

    def leave_no_quarantine(self: BusIdleTimer, ended_s: float, quarantine_s: float) -> None:
        self.quiet_until_s = ended_s

    return [
        (Exchange, "begin", begin_impatiently),
        (BusIdleTimer, "answer_missing", leave_no_quarantine),
    ]


def _twice() -> list[Patch]:
    """Says a second telegram while an exchange is open."""
    begin = LecomExchangeLoop._begin

    def begin_twice(self: LecomExchangeLoop, prepared: Any, now: float, loss: Any) -> None:
        begin(self, prepared, now, loss)
        if self.exchanges % EVERY == 0 and self._connection.port is not None:
            asyncio.get_running_loop().call_later(
                prepared.ask.request_s + IMPATIENCE_S, self._connection.say, prepared.ask.sent
            )

    return [(LecomExchangeLoop, "_begin", begin_twice)]


def _old_answers() -> list[Patch]:
    """Takes the value before for the one that has come, now and then."""
    feed = Exchange.feed
    before: list[Value] = []

    def feed_old(self: Exchange, data: bytes, now_s: float, *more: Any) -> Result | None:
        result = feed(self, data, now_s, *more)
        if result is None or not isinstance(result.answer, ValueAnswer):
            return result
        before.append(result.answer.value)
        if len(before) % EVERY:
            return result
        answer = ValueAnswer(result.answer.field, before[-2])
        return dataclasses.replace(result, answer=answer)

    return [(Exchange, "feed", feed_old)]


def _two_outcomes() -> list[Patch]:
    """Tells the end of a request twice."""

    def end_twice(self: Request, outcome: Outcome, reason: str = "") -> None:
        self.settled = True
        self.settle(outcome, reason)
        self.settle(Outcome.UNKNOWN, reason)

    return [(Request, "end", end_twice)]


def _no_outcome() -> list[Patch]:
    """Forgets to tell the end of some reads."""
    end = Request.end

    def end_seldom(self: Request, outcome: Outcome, reason: str = "") -> None:
        if self.priority is not Priority.INTERACTIVE or self.serial % EVERY:
            end(self, outcome, reason)

    return [(Request, "end", end_seldom)]


def _late_stops() -> list[Patch]:
    """Lets others go before a stop."""
    submit = Schedule.submit

    def submit_late(self: Schedule, request: Request, now_s: float) -> None:
        if request.priority is not Priority.STOP:
            submit(self, request, now_s)
            return
        loop = asyncio.get_running_loop()
        loop.call_later(DELAY_S, lambda: submit(self, request, loop.time()))

    return [(Schedule, "submit", submit_late)]


def _falling() -> list[Patch]:
    """Falls over in the middle of its work."""
    feed, count = Exchange.feed, iter(range(10_000))

    def feed_and_fall(self: Exchange, data: bytes, now_s: float, *more: Any) -> Result | None:
        if next(count) == FALLS_AT:
            raise RuntimeError("on purpose")
        return feed(self, data, now_s, *more)

    return [(Exchange, "feed", feed_and_fall)]


def _promising(only: str = "", **factors: float) -> list[Patch]:
    """Promises a part of what the plan promises, to all classes or to one."""

    def make_better(roster: Roster, timing: LineTiming | None = None) -> Promises:
        plan = make_promises(roster, timing)
        waits = (
            dataclasses.replace(
                wait, **{name: getattr(wait, name) * part for name, part in factors.items()}
            )
            if only in ("", wait.name)
            else wait
            for wait in plan.waits
        )
        return dataclasses.replace(plan, waits=tuple(waits))

    return [(where, "make_promises", make_better) for where in (invariants, promises)]


def _short_waits() -> list[Patch]:
    return _promising(quiet_s=TIGHTER, loaded_s=TIGHTER)


def _short_slot_waits() -> list[Patch]:
    return _promising("cyclic", quiet_s=TIGHTER)


def _short_exchanges() -> list[Patch]:
    return _promising(own_s=TIGHTER)


def _seldom() -> list[Patch]:
    """Reads cyclic codes a third as often as it is asked to."""

    def cyclic(drive: str, every_s: float, make: Callable[[], Request]) -> Cyclic:
        return Cyclic(drive, 3.0 * every_s, make)

    return [(drive_changes, "Cyclic", cyclic)]


def _last_moment() -> list[Patch]:
    """Feeds at the very end of a watchdog's time."""
    return [
        (watchdog_deadline, "SOFT_PART", 0.97),
        (watchdog_deadline, "HARD_PART", 0.99),
        (watchdog_set, "HARD_PART", 0.99),
        (watchdog_set, "SPARE_PART", 0.0),
        (FaultHypothesis, "least_room_s", lambda *_: 0.0),
    ]


@dataclasses.dataclass(frozen=True)
class Broken:
    """One copy.

    Args:
        patches: Makes what is put in the place of what.
        words: Must stand in what is said to be broken.
        seeds: Lines that show it, or one of which does.
    """

    patches: Callable[[], list[Patch]]
    words: str
    seeds: tuple[int, ...] = (8,)


BROKEN = {
    "gives up too early": Broken(_impatient, "was not through with the one before"),
    "opens a second exchange": Broken(_twice, "was reported that was not said then"),
    "takes an old answer": Broken(_old_answers, "did not answer"),
    "ends requests twice": Broken(_two_outcomes, "had a second outcome"),
    "forgets requests": Broken(_no_outcome, "was forgotten"),
    "overtakes stops": Broken(_late_stops, "went before the stop of", (0, 1)),
    "falls over": Broken(_falling, "the daemon fell over: RuntimeError('on purpose')"),
    "promises short waits": Broken(_short_waits, " waited ", (12, 36)),
    "promises short waits to slots": Broken(_short_slot_waits, "cyclic to ", (54388, 63180)),
    "promises short exchanges": Broken(_short_exchanges, "it took"),
    "reads seldom": Broken(_seldom, "was not read for", (64, 72)),
    "feeds at the last moment": Broken(_last_moment, "was not fed for", (84, 69, 4)),
}


@contextmanager
def broken(name: str) -> Iterator[None]:
    """Let every line be broken in one way."""
    patches = BROKEN[name].patches()
    kept = [(where, what, getattr(where, what)) for where, what, _ in patches]
    for where, what, wrong in patches:
        setattr(where, what, wrong)
    try:
        yield
    finally:
        for where, what, right in kept:
            setattr(where, what, right)
