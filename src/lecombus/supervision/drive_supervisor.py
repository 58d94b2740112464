"""The supervisor: audits every drive's watchdog, arms it where the roster says so, keeps it fed.

What its user sees: after the start, and whenever a drive or the line comes back, each drive is
audited (`audit` says what that is) before it is called online. A 2102 module forgets its
watchdog's settings with its supply (EDB2102EN 6.3), so this is not a formality.

Feeding itself is the schedule's: the supervisor says which drive must be spoken to how often
(`Schedule.set_feeding`), and the schedule finds the telegram, mostly one that was due anyhow. It
begins with the roster's time at the start, before the audit: after a restart of lecombus the
drives' watchdogs are already running. A multicast never counts as feeding.

The supervisor's task cannot end silently: it lives in the daemon's root task group, and an error in
it ends the daemon, which the service manager starts again.

What must not live here: telegrams, time-outs, who goes first.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping

import anyio

from lecombus.config import DriveEntry
from lecombus.errors import LecombusError
from lecombus.line.station import Station
from lecombus.operations.requests import Requests, is_of_the_line
from lecombus.readings import DriveState
from lecombus.schedule import Feeding, FeedStats, Schedule
from lecombus.store import Store
from lecombus.supervision.audit import Audit
from lecombus.supervision.health import Health
from lecombus.supervision.rechecks import Rechecks
from lecombus.supervision.watchdogs import WatchdogAudit
from lecombus.supervision.write_prechecks import WritePrechecks

__all__ = ["DriveSupervisor"]

logger = logging.getLogger(__name__)

FIRST_RETRY_S = 1.0
LONGEST_RETRY_S = 30.0

SLOW_S = 0.1
"""Audits of modules whose own codes take longer than this to read are made one after the other."""


class _Running:
    """An audit that runs or is about to."""

    __slots__ = ("asked_again", "cancelled", "scope")

    def __init__(self) -> None:
        self.asked_again = asyncio.Event()
        self.cancelled = False
        self.scope: anyio.CancelScope | None = None

    def cancel(self) -> None:
        """End it, whether it has begun or not."""
        self.cancelled = True
        if self.scope is not None:
            self.scope.cancel()


class DriveSupervisor:
    """Keeps the watchdogs of one line.

    Args:
        requests: Sends requests and waits for their end.
        schedule: Told which drives to feed.
        store: Gets the remarks.
        clock: Monotonic time, seconds.
        health: Told when a drive has been audited.
        prechecks: What decides whether a drive may be written to.
    """

    def __init__(
        self,
        requests: Requests,
        schedule: Schedule,
        store: Store,
        clock: Callable[[], float],
        health: Health,
        prechecks: WritePrechecks,
    ) -> None:
        self._requests = requests
        self._schedule = schedule
        watchdogs = WatchdogAudit(requests, store, self._feed)
        self._audits = Audit(requests, prechecks, watchdogs)
        self._rechecks = Rechecks(requests, watchdogs, health, lambda: self._entries)
        self._prechecks = prechecks
        self._clock = clock
        self._entries: dict[str, DriveEntry] = {}
        self._auditing: dict[str, _Running] = {}
        self._again: set[str] = set()
        self._lapses: dict[str, int] = {}
        self._run_out: set[str] = set()
        self._waiting: list[tuple[str, _Running]] = []
        self._wanted = asyncio.Event()
        self._one_at_a_time = anyio.Lock()
        self._health = health
        self.tried: set[str] = set()

    async def run(self) -> None:
        """Audit whatever asks for it, for as long as the daemon lives.

        Audits are asked for by the line's callbacks too, which are no tasks and cannot start one.
        """
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._rechecks.run)
            while True:
                await self._wanted.wait()
                self._wanted.clear()
                waiting, self._waiting = self._waiting, []
                for name, audit in waiting:
                    tasks.start_soon(self._audit_within, name, audit)

    def add_drive(self, entry: DriveEntry) -> None:
        """Keep a drive from now on: feed it by the roster's word until the audit knows more."""
        self._entries[entry.name] = entry
        if entry.watchdog is not None:
            self._feed(entry.name, entry.watchdog.time_s)

    def change_entry(self, entry: DriveEntry) -> None:
        """Take another entry of a drive whose watchdog is to be as it was: nothing is audited."""
        self._entries[entry.name] = entry

    def remove_drive(self, name: str) -> None:
        """Keep it no longer: nothing is sent to it on account of its watchdog."""
        self._entries.pop(name, None)
        self.tried.discard(name)
        audit = self._auditing.pop(name, None)
        if audit is not None:
            audit.cancel()

    def audit_soon(self, name: str) -> None:
        """Audit a drive; a drive under audit is audited once more when that has ended."""
        if name in self._auditing:
            self._again.add(name)
            self._auditing[name].asked_again.set()
            return
        audit = self._auditing[name] = _Running()
        self._waiting.append((name, audit))
        self._wanted.set()

    async def _audit_within(self, name: str, audit: _Running) -> None:
        """Audit a drive for as long as it is the drive it was: a reload cancels its audit."""
        with anyio.CancelScope() as audit.scope:
            if audit.cancelled:
                return
            await self._audit_until_done(name, audit)
        if self._auditing.get(name) is audit:
            del self._auditing[name]

    async def _audit_until_done(self, name: str, running: _Running) -> None:
        """Audit one drive, again and again until it is done or the drive is offline.

        Failures are waited out longer and longer, until there is news such as a line reopened.
        """
        delay_s = FIRST_RETRY_S
        while name in self._entries:
            self._again.discard(name)
            running.asked_again.clear()
            try:
                await self._audit(self._entries[name])
            except LecombusError as exc:
                self._audit_failed(name, exc)
                if self._is_offline(name):
                    return
                await anyio.sleep(FIRST_RETRY_S)
                with anyio.move_on_after(delay_s - FIRST_RETRY_S):
                    await running.asked_again.wait()
                is_news = running.asked_again.is_set()
                delay_s = FIRST_RETRY_S if is_news else min(2.0 * delay_s, LONGEST_RETRY_S)
            else:
                if name not in self._again:
                    self._health.audited(name)
                    self._prechecks.passed(name)
                    await self._learn_the_rest(name)
                if name not in self._again:
                    return

    async def _audit(self, entry: DriveEntry) -> None:
        """Audit one drive once.

        First contact is made with all drives at once, and so is the rest where it is quick. Where
        reading a module's own codes takes up to 500 ms each, drives come online one by one.
        """
        if self._health.state(entry.name) is not DriveState.DEGRADED:
            self._audits.forget(entry.name)
        station = self._requests.station(entry.name)
        try:
            await self._audits.contact(station)
        finally:
            self.tried.add(entry.name)
        slow = is_slow(station)
        turn = (lambda: self._one_at_a_time) if slow else contextlib.nullcontext
        await self._audits.examine(entry, turn)

    async def _learn_the_rest(self, name: str) -> None:
        await self._audits.learn_the_rest(self._entries[name], self._requests.station(name))

    def note_lapses(self, feeds: Mapping[str, FeedStats]) -> None:
        """Log each watchdog whose time ran out unfed, once per lapse.

        Args:
            feeds: The schedule's figures, looked at every second or so.
        """
        run_out = {name for name, feed in feeds.items() if feed.age_s > feed.time_s}
        for name, feed in feeds.items():
            # The schedule does not count for drives that are offline; short lapses it does.
            counted = feed.lapses > self._lapses.get(name, 0)
            is_new = name not in self._run_out and (counted or name in run_out)
            # Of a drive not heard since the port was opened nobody knows that it is there at all.
            if is_new and self._health.was_heard(name):
                logger.warning("drive=%s event=watchdog-missed time_s=%g", name, feed.time_s)
        self._run_out = run_out
        self._lapses = {name: feed.lapses for name, feed in feeds.items()}

    def _is_offline(self, name: str) -> bool:
        return self._health.state(name) is DriveState.OFFLINE

    def _audit_failed(self, name: str, exc: LecombusError) -> None:
        if name in self._entries:
            self._health.audit_failed(name, str(exc))
        # `port-lost` or `line-silent` says it once for all drives, `state` for one.
        if not is_of_the_line(exc) and self._health.was_heard(name):
            logger.info("drive=%s event=audit-failed reason=%s", name, exc)

    def _feed(self, name: str, time_s: float | None) -> None:
        feeding = None
        if time_s is not None:
            feeding = Feeding(time_s, self._requests.feed_maker(name))
        self._schedule.set_feeding(name, feeding, self._clock())


def is_slow(station: Station) -> bool:
    """Whether a drive's audit takes line time that others notice."""
    traits = station.family.watchdog
    return (
        traits is not None and station.family.answer_time_s(traits.time_code, write=False) > SLOW_S
    )
