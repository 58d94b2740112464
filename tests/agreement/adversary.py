"""Drives every class of a running line to its worst case, and notes how long it waited.

Strategy: it is told of every telegram at the moment it goes out. For one attack it waits until the
telegram goes out that can hold the line longest, lets that answer be lost, and puts its request in
behind it at once. Attacks of all kinds follow each other; between them the line falls quiet, but
for those made under load, before which the lower classes save up what they can.

The same attacks run on the virtual clock and on the real one: nothing here waits but by the loop.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial

import anyio

from agreement.hostile import Drip, HostileLine
from lecombus.capacity.work_ahead import Longest, work_ahead_on
from lecombus.config import line_timing
from lecombus.drives import StopAction
from lecombus.fieldbus.loop_interface import ExchangeReport, Observer, ResultKind
from lecombus.line_runtime import LineRuntime
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority, Request
from lecombus.schedule.polling import PollingEntry
from support.lecom_loop import lecom_loop

__all__ = ["Adversary", "Measured"]

CALM_S = 1.3
"""Between attacks: doubts about lost answers are over, and feeds have their order again."""
NOBODY_S = 6.0
PATIENCE_S = 4.0
"""So long the telegram to be attacked is waited for; then the next best will do."""
EARLY_S = 0.003
"""The answer that drips in begins so much before it would be given up."""
JUST_BEFORE_S = 0.002
FEW = 3
"""Drives of a client that asks again and again: some are left alone for a while after a write."""
HEARTBEAT_S = 0.005
UNSEEN_S = 0.001
"""Woken later than this is counted as the machine's lateness."""
DEPTH = 4
"""Requests of each class that wait, under load."""


@dataclass
class Measured:
    """The worst that was seen.

    Attributes:
        waits: Longest waits, seconds, by `class` or `class, loaded`, and how much of each was the
            machine's lateness; for `cyclic` how late a slot was, no request under way.
        failed: By drive and code, the longest a lost exchange held the line, seconds.
        fed: By drive, the longest from one feed to the next, seconds.
        lost: Exchanges that were lost.
        exchanges: How many there were.
    """

    waits: dict[str, tuple[float, float]] = field(default_factory=dict)
    failed: dict[tuple[str, str], tuple[float, float]] = field(default_factory=dict)
    fed: dict[str, float] = field(default_factory=dict)
    lost: int = 0
    exchanges: int = 0

    def note(self, what: str, wait_s: float, late_s: float) -> None:
        """Take one wait."""
        self.waits[what] = longer(self.waits.get(what), (wait_s, late_s))


def longer(old: tuple[float, float] | None, new: tuple[float, float]) -> tuple[float, float]:
    """Give the longer of two times, what the machine added to each taken off."""
    return new if old is None or new[0] - new[1] > old[0] - old[1] else old


class Adversary:
    """Attacks one line.

    Args:
        site: The line.
        sim: Its drives.
        hold: Held while the drives are told something.
        margin_s: An answer that is to drip in begins so much before it would be given up, seconds.
    """

    def __init__(
        self, site: LineRuntime, sim: HostileLine, lock: Callable[[Callable[[], None]], None],
        margin_s: float = EARLY_S,
    ) -> None:  # fmt: skip
        self._site = site
        self._sim = sim
        self._lock = lock
        self._margin_s = margin_s
        self._worker = site.worker
        self._schedule = site.schedule
        self.measured = Measured()
        self._open: set[Request] = set()  # requests of ours that have not ended
        self._asked: dict[Request, tuple[str, float, float]] = {}  # not begun: what, since when, ..
        self._begun = asyncio.Event()
        self._wanted: Callable[[Request, float], bool] | None = None
        self._strike: Callable[[], None] | None = None
        self._struck = asyncio.Event()
        self._saturating: set[Priority] = set()
        self._calm_from_s = math.inf
        self._addresses = {one.name: one.address for one in site.roster.drives}
        self._given_up_s = math.inf  # when the answer that is lost is given up
        self._loop_late_s = 0.0  # by how much tasks were woken late in all
        self._late_before_s = 0.0
        self._turn = 0
        self._others_s = math.inf  # when somebody else asked for something
        self._ahead = work_ahead_on(site.roster, line_timing(site.roster.line))
        site.worker.exchange_loop.observer = _Told(site.worker.exchange_loop.observer, self)

    def _late_s(self) -> float:
        """How late this machine has been in all."""
        return self._loop_late_s + self._sim.late_s

    # -- what the line tells ----------------------------------------------------------------------

    def telegram(self) -> None:
        """A telegram has gone out."""
        under_way = lecom_loop(self._worker).under_way
        if under_way is None:
            return
        request, _, prepared = under_way
        ask, started_s = prepared.ask, lecom_loop(self._worker).exchange.started_s
        found = self._asked.pop(request, None)
        if found is not None:
            what, since_s, late_s = found
            if what:
                wait_s = started_s - since_s
                self.measured.note(what, wait_s, self._late_s() - late_s)
                self._begun.set()
        wanted = self._wanted
        if wanted is not None and wanted(request, started_s):
            self._wanted = None
            first_s = started_s + ask.first_byte_s - self._margin_s
            self._given_up_s = started_s + ask.whole_s
            drip = Drip(first_s, started_s + ask.whole_s, ask.gap_s)
            self._lock(lambda: self._sim.lose(self._addresses[request.drive], drip))
            asyncio.get_running_loop().call_soon(self._now_strike)

    def _now_strike(self) -> None:
        if self._strike is not None:
            self._strike()
        self._struck.set()

    def ended(self, report: ExchangeReport) -> None:
        """An exchange has ended."""
        measured, result = self.measured, report.result
        if report.priority not in (Priority.CYCLIC, Priority.WATCHDOG) and not self._open:
            self._others_s = result.started_s
        measured.exchanges += 1
        if result.kind in (ResultKind.NO_REPLY, ResultKind.GARBLED):
            measured.lost += 1
            if report.step.value is None:
                held_s = (
                    result.ended_s - result.started_s + report.quarantined_s
                    + self._site.roster.line.turnaround_s
                )  # fmt: skip
                key = (report.drive, str(report.step.code))
                late_s = max(0.0, result.ended_s - self._given_up_s)
                measured.failed[key] = longer(measured.failed.get(key), (held_s, late_s))
        slot = report.priority is Priority.CYCLIC and report.attempt == 1
        if slot and result.started_s >= self._calm_from_s:
            measured.note("cyclic", report.waited_s, self._late_s() - self._late_before_s)

    # -- requests of ours -------------------------------------------------------------------------

    def _ask(self, priority: Priority, what: str, *, again: bool = False) -> None:
        """Put in a request; `again`: and another one when it ends, for as long as it is wanted."""

        def settle(outcome: Outcome, reason: str) -> None:
            if again and priority in self._saturating:
                asyncio.get_running_loop().call_soon(lambda: self._ask(priority, what, again=True))

        drives = [drive for drive in self._site.roster.drives if drive.family != "generic"]
        lone = again and self._saturating == {priority}
        number = min(FEW, len(drives)) if lone else len(drives)
        for _ in range(number):  # not one that is left alone after a write just now
            self._turn += 1
            drive = drives[self._turn % number]
            if not self._schedule.is_held(drive.name):
                break
        station = self._site.requests.station(drive.name)
        maker = self._site.requests.maker
        if priority is Priority.STOP:
            request = maker.stop(
                station, StopAction.INHIBIT, word=lambda: None, said=False, settle=settle
            )
        elif priority is Priority.CONTROL:
            code = Code({"smvector": 140, "93xx": 141}.get(drive.family, 46))
            request = maker.write(station, code, Value.parse("20.0"), settle=settle, verify=False)
            request.supersedes = None
        else:
            code = Code(1410 if drive.family == "smvector" else 9)
            request = maker.read(station, code, priority, settle=settle, retries=0)
        assert request.priority is priority
        self._put_in(request, what)

    async def quiet(self) -> None:
        """Wait until nobody asks: drives that have come are asked for this and that once."""
        loop = asyncio.get_running_loop()
        self._others_s = loop.time()
        while loop.time() < self._others_s + NOBODY_S:  # noqa: ASYNC110 - it moves on meanwhile
            await anyio.sleep(0.5)

    def _put_in(self, request: Request, what: str) -> None:
        self._asked[request] = (what, asyncio.get_running_loop().time(), self._late_s())
        self._open.add(request)
        settle = request.settle

        def settled(outcome: Outcome, reason: str) -> None:
            self._open.discard(request)
            found = self._asked.pop(request, None)
            if found is not None and found[0]:  # it ended unsaid: its drive is gone
                self._begun.set()
            settle(outcome, reason)

        request.settle = settled
        self._worker.submit(request)

    def _ask_longest(self, one: Longest, priority: Priority) -> Request:
        """Read what takes longest; writes that take as long could change how drives answer."""
        station = self._site.requests.station(one.drive)
        maker, family = self._site.requests.maker, station.family
        code = next(it.code for it in family.described() if family.spoken(it.code) == one.code)
        request = maker.read(station, code, priority, settle=_ignored, retries=0)
        self._put_in(request, "")
        return request

    def _saturate(self, *classes: Priority) -> None:
        self._saturating.update(classes)
        for priority in classes:
            for _ in range(DEPTH):
                self._ask(priority, "", again=True)

    # -- attacks ----------------------------------------------------------------------------------

    async def note_lateness(self) -> None:
        """Look every few milliseconds how late this task is woken, until it is cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            due_s = loop.time() + HEARTBEAT_S
            await asyncio.sleep(HEARTBEAT_S)
            late_s = loop.time() - due_s
            if late_s > UNSEEN_S:
                self._loop_late_s += late_s

    async def run(self, length_s: float) -> Measured:
        """Attack for so long, and say what came of it."""
        self.measured = Measured()
        for feed in self._schedule.watchdogs.by_drive.values():
            feed.margin_least_s = math.inf
        over_s = asyncio.get_running_loop().time() + length_s
        attacks = [
            self._quiet(Priority.CONTROL), self._quiet(Priority.INTERACTIVE), self._lateness,
            self._loaded(Priority.CONTROL), self._quiet(Priority.STOP), self._starve_feeds,
            self._behind_all, self._loaded(Priority.INTERACTIVE),
            self._loaded(Priority.STOP), self._squeezed(Priority.CONTROL),
            self._squeezed(Priority.INTERACTIVE),
        ]  # fmt: skip
        number = 0
        while asyncio.get_running_loop().time() < over_s:
            await attacks[number % len(attacks)]()
            self._calm_from_s = math.inf
            await anyio.sleep(CALM_S)
            number += 1
        self._note_feeds()
        return self.measured

    def _quiet(self, priority: Priority) -> Callable[[], Awaitable[None]]:
        """One request behind the longest exchange that the line has of its own."""

        async def attack() -> None:
            name = priority.name.lower()
            if not await self._lose_longest(lambda: self._ask(priority, name)):
                self._ask(priority, name)
            await self._until_begun()

        return attack

    def _loaded(self, priority: Priority) -> Callable[[], Awaitable[None]]:
        """The same with the lower classes full, behind the longest that a client can ask for."""

        async def attack() -> None:
            clients = (Priority.INTERACTIVE, Priority.BACKGROUND)
            self._saturate(*(one for one in clients if one > priority))
            await anyio.sleep(2.0)
            name = f"{priority.name.lower()}, loaded"
            by_time = _given_up if priority is Priority.STOP else _worst
            found = self._ahead
            lower = Priority.INTERACTIVE if priority < Priority.INTERACTIVE else Priority.BACKGROUND
            longest = self._ask_longest(max(found.own, found.read, key=by_time), lower)
            await self._lose(
                lambda request, now_s: request is longest, lambda: self._ask(priority, name)
            )
            await self._until_begun()
            self._saturating.clear()
            await self._until_nothing_waits()

        return attack

    def _squeezed(self, priority: Priority) -> Callable[[], Awaitable[None]]:
        """One client asks again and again while feeds are due that follow each other closely.

        They do so after something has been asked of all drives, directly one after the other. Of
        all the moments at which an answer could be lost it is the one after which most feeds must
        go before the client's request; a first such time shows how many that can be.
        """

        async def attack() -> None:
            most_s = 0.0
            for part in (2.0, 0.9):
                await self._pack_feeds()

                def wanted(request: Request, now_s: float, part: float = part) -> bool:
                    nonlocal most_s
                    if request in self._open:
                        return False
                    forced_s = self._forced_s(now_s + request.worst_s)
                    most_s = max(most_s, forced_s)
                    return forced_s >= part * most_s

                self._saturating.add(priority)
                self._ask(priority, priority.name.lower(), again=True)
                await self._lose(wanted, lambda: None, within_s=self._feeds_last_s())
                await anyio.sleep(0.8)
                self._saturating.clear()
                await self._until_nothing_waits()

        return attack

    async def crowd(self, length_s: float) -> Measured:
        """Let clients of all classes ask without a pause, and ask once in a class where none does.

        The request comes when an exchange of the others is lost.
        """
        self.measured = Measured()
        over_s = asyncio.get_running_loop().time() + length_s
        clients = (Priority.CONTROL, Priority.INTERACTIVE, Priority.BACKGROUND)
        while asyncio.get_running_loop().time() < over_s:
            for priority in clients[1:]:
                self._saturate(*(one for one in clients if one is not priority))
                await anyio.sleep(2.0)
                for _ in range(3):
                    await self._lose(
                        lambda request, now_s: request in self._open,
                        partial(self._ask, priority, f"{priority.name.lower()}, crowded"),
                    )
                    await self._until_begun()
                self._saturating.clear()
                await self._until_nothing_waits()
        return self.measured

    async def _pack_feeds(self) -> None:
        """Ask all drives for something at once, and wait until the first of them must be fed."""
        loop = asyncio.get_running_loop()
        for _ in self._site.roster.drives:
            self._ask(Priority.CONTROL, "")
        await self._until_nothing_waits()
        due_s = min((one.due_s for one in self._schedule.watchdogs.by_drive.values()), default=0.0)
        await anyio.sleep(max(0.0, due_s - loop.time() - JUST_BEFORE_S))

    def _feeds_last_s(self) -> float:
        return 0.5 + 2.0 * sum(one.cost_s for one in self._schedule.watchdogs.by_drive.values())

    def _forced_s(self, at_s: float) -> float:
        """How long feeds must go first, for want of slack, before a request may begin."""
        worst_s = self._ahead.control.times.worst_s
        ordered = sorted(self._schedule.watchdogs.by_drive.values(), key=lambda feed: feed.hard_s)
        total_s = forced_s = 0.0
        for feed in ordered:
            total_s += feed.cost_s
            if feed.hard_s - total_s < at_s + worst_s:
                forced_s = total_s
        return forced_s

    async def _starve_feeds(self) -> None:
        """Everybody asks, and an answer is lost when feeds have the least slack."""
        self._saturate(Priority.CONTROL, Priority.INTERACTIVE, Priority.BACKGROUND)
        await anyio.sleep(1.0)
        feeds = self._schedule.watchdogs
        least = [math.inf]

        def wanted(request: Request, now_s: float) -> bool:
            left_s = feeds.slack_s(now_s) - request.worst_s
            least[0] = min(least[0], left_s)
            return left_s < 0.02

        await self._lose(wanted, lambda: None)
        await anyio.sleep(0.5)
        self._saturating.clear()
        await self._until_nothing_waits()

    async def _lateness(self) -> None:
        """An answer is lost just before all slots are due at once."""
        self._calm_from_s = asyncio.get_running_loop().time()
        await self._lose_before_all(lambda: None)
        await anyio.sleep(2.0)

    async def _behind_all(self) -> None:
        """A background request behind that."""
        if not await self._lose_before_all(lambda: self._ask(Priority.BACKGROUND, "background")):
            self._ask(Priority.BACKGROUND, "background")
        await self._until_begun()

    async def _lose_before_all(self, strike: Callable[[], None]) -> bool:
        """Let all slots be due at once, but for one that comes just before and is lost."""
        cadence = self._schedule.polling
        entries = [one for found in cadence.by_drive.values() for one in found if one.version >= 0]
        if not entries:
            return False
        first = max(entries, key=_saved_by_losing)
        at_s = asyncio.get_running_loop().time() + 1.0
        for entry in entries:
            entry.due_v = at_s - cadence.offset_s - (JUST_BEFORE_S if entry is first else 0.0)
            cadence.set_apart(entry)
            cadence.rejoin(entry, 0.0)
        self._schedule.wanted_at_s(at_s - 1.0)  # what was chosen beforehand is chosen again
        self._worker.nudge()
        self._late_before_s = self._late_s()
        return await self._lose(lambda request, now_s: request.source is first, strike)

    async def _lose_longest(self, strike: Callable[[], None]) -> bool:
        """Lose the exchange that holds the line longest of all that go out."""
        most = [0.0]
        began_s = asyncio.get_running_loop().time()

        def wanted(request: Request, now_s: float) -> bool:
            if (
                type(request.source) is not PollingEntry
                and request.priority is not Priority.WATCHDOG
            ):
                return False
            learning = now_s < began_s + PATIENCE_S / 2
            if learning:
                most[0] = max(most[0], request.worst_s)
            return not learning and request.worst_s >= most[0] - 1e-6

        return await self._lose(wanted, strike)

    async def _lose(
        self,
        wanted: Callable[[Request, float], bool],
        strike: Callable[[], None],
        within_s: float = 3.0 * PATIENCE_S,
    ) -> bool:
        self._begun.clear()
        self._struck.clear()
        self._wanted, self._strike = wanted, strike
        with anyio.move_on_after(within_s):
            await self._struck.wait()
        self._wanted = None
        return self._struck.is_set()

    async def _until_begun(self) -> None:
        with anyio.move_on_after(60.0):
            await self._begun.wait()

    async def _until_nothing_waits(self) -> None:
        with anyio.move_on_after(60.0):
            while self._open:  # noqa: ASYNC110 - whatever is left of ours
                await anyio.sleep(0.05)

    def _note_feeds(self) -> None:
        stats = self._schedule.stats(asyncio.get_running_loop().time())
        for name, feed in self._schedule.watchdogs.by_drive.items():
            assert name in stats.feeds
            self.measured.fed[name] = feed.time_s - feed.margin_least_s


class _Told:
    """Stands before the books."""

    def __init__(self, inner: Observer, adversary: Adversary) -> None:
        self._inner = inner
        self._adversary = adversary

    def exchange_ended(self, report: ExchangeReport) -> None:
        self._adversary.ended(report)
        self._inner.exchange_ended(report)

    def line_changed(self, up: bool, reason: str) -> None:
        self._inner.line_changed(up, reason)

    def thinking(self, for_s: float) -> None:
        self._inner.thinking(for_s)
        self._adversary.telegram()

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        self._inner.stray_bytes(data, late_answer)


def _saved_by_losing(entry: PollingEntry) -> float:
    return entry.made().worst_s - entry.made().cost_s


def _ignored(outcome: Outcome, reason: str) -> None:
    """Nobody waits for it."""


def _worst(one: Longest) -> float:
    return one.times.worst_s


def _given_up(one: Longest) -> float:
    return one.times.given_up_s
