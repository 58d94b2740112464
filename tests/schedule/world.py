"""A line in virtual time that runs whatever a schedule chooses, and writes down what happened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import count
from typing import Any

from lecombus.schedule import (
    Cyclic,
    Outcome,
    PollingEntry,
    Priority,
    Request,
    Schedule,
    WatchdogFeeding,
)

COST_S = 0.02
WORST_S = 0.1


@dataclass
class Sent:
    """One exchange."""

    at_s: float
    end_s: float
    request: Request
    reached: bool
    silent: frozenset[str] = frozenset()  # drives whose stops wait for feeds, when it began


@dataclass
class World:
    """Drives that answer in `cost_s`, or, while they are in `silent`, take `worst_s`."""

    schedule: Schedule = field(default_factory=Schedule)
    now_s: float = 0.0
    silent: set[str] = field(default_factory=set)
    sent: list[Sent] = field(default_factory=list)
    ended: list[tuple[Request, Outcome, str, float]] = field(default_factory=list)
    after: Callable[[Request, bool], bool] | None = None  # True: it has seen to the request
    rehearses: bool = False  # the next choice is made beforehand, while an exchange lasts
    follows: bool = False  # and what was foreseen is begun before the exchange is booked
    followed: int = 0
    lasts_s: float | None = None  # how long an answered exchange lasts; None: what it says
    made: int = 0

    def __post_init__(self) -> None:
        self._events: list[tuple[float, int, Callable[[], object]]] = []
        self._numbers = count()
        self._begun: Request | None = None

    def drives(self, *names: str) -> World:
        for name in names:
            self.schedule.add_drive(name)
        return self

    def request(
        self,
        drive: str = "a",
        priority: Priority = Priority.INTERACTIVE,
        cost_s: float = COST_S,
        worst_s: float = WORST_S,
        **more: Any,
    ) -> Request:
        self.made += 1

        def settle(outcome: Outcome, reason: str) -> None:
            self.ended.append((request, outcome, reason, self.now_s))

        request = Request(drive, priority, cost_s, worst_s, settle, **more)
        return request

    def submit(
        self, drive: str = "a", priority: Priority = Priority.INTERACTIVE, **more: Any
    ) -> Request:
        request = self.request(drive, priority, **more)
        self.schedule.submit(request, self.now_s)
        return request

    def feed(self, drive: str, time_s: float, **more: Any) -> None:
        feeding = WatchdogFeeding(time_s, lambda: self.request(drive, Priority.WATCHDOG, **more))
        self.schedule.set_feeding(drive, feeding, self.now_s)
        self.schedule.watchdogs.by_drive[drive].heard_at(self.now_s)

    def cyclic(self, drive: str, period_s: float, **more: Any) -> PollingEntry:
        cyclic = Cyclic(drive, period_s, lambda: self.request(drive, Priority.CYCLIC, **more))
        return self.schedule.add_cyclic(cyclic, self.now_s)

    def probe(self, drive: str, **more: Any) -> None:
        self.schedule.set_probe(
            drive, lambda: self.request(drive, Priority.CYCLIC, **more), self.now_s
        )

    def at(self, at_s: float, do: Callable[[], object]) -> None:
        heappush(self._events, (at_s, next(self._numbers), do))

    def _happen(self) -> None:
        while self._events and self._events[0][0] <= self.now_s:
            heappop(self._events)[2]()

    def step(self) -> Request | None:
        """Run one exchange, if one may go now."""
        self._happen()
        request, self._begun = self._begun or self.schedule.next(self.now_s), None
        if request is None:
            return None
        assert not request.settled
        started_s, silent = self.now_s, self.schedule.silent
        if self.rehearses:
            self.schedule.look_ahead(request, started_s, started_s + request.cost_s)
        reached = request.drive not in self.silent
        cost_s = request.cost_s if self.lasts_s is None else self.lasts_s
        self.now_s += cost_s if reached else request.worst_s
        self.sent.append(Sent(started_s, self.now_s, request, reached, silent))
        self._happen()  # what comes in during the exchange comes before its end is known
        self._begun = self.schedule.planned(self.now_s) if self.follows and reached else None
        if self._begun is not None:
            self.followed += 1
            self.schedule.follow(request, started_s, self.now_s, self.now_s)
        else:
            self.schedule.finished(request, started_s, self.now_s, reached)
        if self.after is None or not self.after(request, reached):
            request.end(Outcome.DONE if reached else Outcome.UNKNOWN, "")
        return request

    def run(self, until_s: float) -> World:
        """Run the line until a time."""
        idle = 0
        while self.now_s < until_s:
            if self.step() is not None:
                idle = 0
                continue
            times = [until_s]
            wake_s = self.schedule.wake_at_s(self.now_s)
            if wake_s is not None:
                times.append(wake_s)
            if self._events:
                times.append(self._events[0][0])
            if min(times) <= self.now_s:
                idle += 1
                assert idle < 5000, "the schedule asks to be asked again, and gives nothing"
            else:
                idle = 0
                self.now_s = min(times)
        return self

    def saturate(self, priority: Priority, drives: list[str], depth: int = 4, **more: Any) -> None:
        """Keep that many requests of a class waiting at all times."""
        turn = count()
        earlier = self.after

        def put() -> None:
            self.submit(drives[next(turn) % len(drives)], priority, **more)

        def after(request: Request, reached: bool) -> bool:
            if request.priority is priority and request.drive in drives:
                put()
            return earlier(request, reached) if earlier is not None else False

        self.after = after
        for _ in range(depth):
            put()

    def starts(self, of: Callable[[Request], bool]) -> list[float]:
        return [sent.at_s for sent in self.sent if of(sent.request)]

    def busy_s(self, priority: Priority) -> float:
        return sum(s.end_s - s.at_s for s in self.sent if s.request.priority is priority)

    def outcome(self, request: Request) -> tuple[Outcome, str]:
        (found,) = [(outcome, reason) for r, outcome, reason, _ in self.ended if r is request]
        return found
