"""How each drive is doing, judged from what its exchanges come to.

::

    STARTING ──answered, audited──▶ ONLINE ──a failure──▶ DEGRADED ──too many in a row──▶ OFFLINE
       ▲  ▲                           ▲                      │                              │
       │  └── line reopened           └──────── answered ────┘                              │
       └────────────────────────── a probe was answered ────────────────────────────────────┘

A drive is called online only after it has answered *and* been audited (`drive_supervisor`); a drive
that failed twice or more in a row is audited again when it answers, because a short power failure
looks like that and the 2102 module forgets its settings in one (EDB2102EN 6.3). An offline drive
is parked in the schedule and only probed, so that it costs the others little.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from lecombus.capacity.exchange_costs import watched_s
from lecombus.drive_state.drive_runtime import Drive, HealthRecord, LineDrives, RunningAudit
from lecombus.drive_state.readings import DriveState
from lecombus.drive_state.store import Store
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.fieldbus.requests import StepKind
from lecombus.line_events import ExchangeEvent, LineChange
from lecombus.schedule import Schedule

__all__ = ["AuditQueue", "Health"]

logger = logging.getLogger(__name__)

OFFLINE_AFTER = 4
"""Failed exchanges in a row: on a line that loses one answer in eight, once in 4000 exchanges."""

OFFLINE_AFTER_UNHEARD = 1
"""A drive that has not answered since the line was opened is probably not there, and others wait
behind it; if it is, the probe that follows finds it."""

AUDIT_AFTER = 2
"""Failures in a row after which a drive is audited again when it answers."""

SWAP_S = 5.0
"""No person replaces a drive by another faster than this, seconds. One that was silent for
longer and is not offline only because it is seldom asked is not written to before its audit."""


UNAUDITED_S = 10.0
"""A drive that was silent for less is written to while its audit is due, but for no longer than
this, seconds: what it may have lost with its supply, its watchdog's settings, is not known."""

AGAIN_S = 60.0
"""A line that is opened again so soon flaps: that its drives start again is not logged then."""


class AuditQueue:
    """The audits of one line's drives that were asked for and have not begun.

    They are asked for by events of the line, which are not tasks and cannot start one; the drive
    supervisor's task starts them.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[Drive, RunningAudit]] = []
        self._wanted = asyncio.Event()

    def ask(self, drive: Drive, *, restarted: bool = True) -> None:
        """Have a drive audited; one under audit is audited once more when that has ended.

        Args:
            drive: The drive.
            restarted: It may have restarted: its control word is not known any more.
        """
        if restarted:
            drive.may_have_restarted()
        if drive.audit.running is not None:
            drive.audit.again = True
            drive.audit.running.repeat()
            return
        drive.audit.running = RunningAudit()
        self._waiting.append((drive, drive.audit.running))
        self._wanted.set()

    def withdraw(self, drive: Drive) -> None:
        """Cancel the audit of a drive, whether it has begun or not."""
        if drive.audit.running is not None:
            drive.audit.running.cancel()

    async def next(self) -> list[tuple[Drive, RunningAudit]]:
        """Wait for audits that were asked for."""
        await self._wanted.wait()
        self._wanted.clear()
        waiting, self._waiting = self._waiting, []
        return waiting


class Health:
    """Judges the drives of one line.

    Args:
        drives: The drives.
        schedule: Parks the drives that are offline.
        store: Keeps the states.
        clock: Monotonic time, seconds.

    Attributes:
        audits: The drives that must be audited before they are called online.
    """

    def __init__(
        self,
        drives: LineDrives,
        schedule: Schedule,
        store: Store,
        clock: Callable[[], float],
    ) -> None:
        self._drives = drives
        self._schedule = schedule
        self._store = store
        self.audits = AuditQueue()
        self._clock = clock
        self._opened_s = -AGAIN_S

    def begin(self, drive: Drive) -> None:
        """Show a drive that was added, or that begins again, as one that was not tried yet."""
        self._store.drive_state(drive.name, drive.health.state, "not tried yet")

    @property
    def is_silent(self) -> bool:
        """Whether drives were tried and none of them answers.

        Drives that answered until they were silenced on purpose say nothing of the line.
        """
        records = [drive.health for drive in self._drives]
        tried = [one for one in records if not one.silenced or one.misses >= OFFLINE_AFTER]
        return bool(tried) and all(health.state is DriveState.OFFLINE for health in tried)

    def line_changed(self, change: LineChange) -> None:
        """Start again with every drive: what happened while the line was away is not known."""
        if not change.is_open:
            return
        now = self._clock()
        is_news, self._opened_s = now - self._opened_s >= AGAIN_S, now
        self._schedule.port_opened()
        for drive in self._drives:
            health = drive.health
            if health.silenced:
                continue
            if health.state is DriveState.OFFLINE:
                self._schedule.set_probe(drive.name, None, now)
                self._schedule.unpark(drive.name, now)
            health.misses = 0
            health.heard = False
            reason = "the line was opened: to be audited"
            self._set(drive, DriveState.STARTING, reason, is_news=is_news)
            self.audits.ask(drive)

    def exchange_ended(self, event: ExchangeEvent) -> None:
        """Judge a drive by an exchange with it; a multicast says nothing of its members."""
        result = event.report.result
        if event.report.step.kind is not StepKind.MULTICAST:
            self.judge(event.drives[0], result.kind, result.fault)
            return
        for drive in event.drives:
            if drive.health.silenced:
                drive.health.silent_since_s = self._clock()

    def judge(self, drive: Drive, kind: ResultKind, fault: str) -> None:
        """Take the end of one exchange with a drive.

        Args:
            drive: The drive.
            kind: How it ended.
            fault: Why it failed, in words.
        """
        health = drive.health
        if health.silenced:  # a stop went out to it, or its last exchange ends
            health.silent_since_s = self._clock()
            if kind is ResultKind.ANSWERED:
                health.misses = 0
            return
        if kind is ResultKind.ANSWERED:
            if not health.heard:
                health.heard = True
                self._log_held_back(drive)
            if health.misses or health.state is DriveState.OFFLINE:
                self._answered(drive)
        elif kind is not ResultKind.LOST:
            self._missed(drive, fault)

    def doubted(self, drive: Drive, reason: str) -> None:
        """A drive may be another: nothing but stops is written to it before its audit."""
        if self._has(drive) and drive.health.state is not DriveState.OFFLINE:
            self._set(drive, DriveState.STARTING, reason)
            self.audits.ask(drive)

    def silence(self, drive: Drive, reason: str) -> None:
        """Send nothing more to a drive, stops apart, so that its own watchdog acts.

        Args:
            drive: The drive.
            reason: Why, in words.
        """
        now = self._clock()
        if not drive.health.silenced:
            drive.health.silent_since_s = now
        drive.health.silenced = reason
        self.audits.withdraw(drive)
        self._set(drive, DriveState.OFFLINE, reason)
        self._schedule.set_probe(drive.name, None, now)
        self._schedule.park(drive.name, now, f"{drive.name} is offline: {reason}")

    def is_silence_over(self, drive: Drive) -> bool:
        """Whether a silenced drive's watchdog has had its time since the last telegram to it.

        A stop that waits or is under way feeds the drive once more: it is not over before that.
        """
        over_s = drive.health.silent_since_s + (watched_s(drive.entry) or 0.0)
        return self._clock() >= over_s and not self._schedule.is_speaking_to(drive.name)

    def end_silence(self, drive: Drive) -> None:
        """Speak to a drive again; it is audited before it is called online."""
        now = self._clock()
        drive.health = HealthRecord(
            DriveState.STARTING, heard=drive.health.heard, logged=drive.health.logged
        )
        self._schedule.unpark(drive.name, now)
        self._set(drive, DriveState.STARTING, "it is spoken to again: being audited")
        self.audits.ask(drive)

    def audited(self, drive: Drive) -> None:
        """The supervisor has found the drive in order, or has put it in order."""
        if self._has(drive) and drive.health.state is not DriveState.OFFLINE:
            drive.health.audit_due = False
            self._set(drive, DriveState.ONLINE, "")

    def check_overdue(self) -> None:
        """Have nothing but stops written to drives whose audit takes too long; once a second."""
        late_s = self._clock() - UNAUDITED_S
        for drive in self._drives:
            health = drive.health
            writable = health.state in (DriveState.ONLINE, DriveState.DEGRADED)
            if health.audit_due and writable and health.due_from_s <= late_s:
                reason = f"it answered again {UNAUDITED_S:.0f} s ago and is not audited yet"
                self._set(drive, DriveState.STARTING, reason)

    def audit_failed(self, drive: Drive, reason: str) -> None:
        """The supervisor could not finish its audit; it will try again."""
        if self._has(drive) and drive.health.state is not DriveState.OFFLINE:
            self._set(drive, drive.health.state, f"not audited: {reason}")

    def _has(self, drive: Drive) -> bool:
        """Whether a drive has not left the roster, as it may during its audit."""
        return self._drives.find(drive.name) is drive

    def _answered(self, drive: Drive) -> None:
        health = drive.health
        misses, health.misses = health.misses, 0
        if health.state is DriveState.OFFLINE:
            now = self._clock()
            self._schedule.set_probe(drive.name, None, now)
            self._schedule.unpark(drive.name, now)
            self._set(drive, DriveState.STARTING, "it answers again: being audited")
            self.audits.ask(drive)
        elif health.state is DriveState.DEGRADED:
            if misses < AUDIT_AFTER and not health.audit_due:
                self._set(drive, DriveState.ONLINE, "")
                return
            away_s = self._clock() - health.silent_from_s
            # In so much time another drive may have been put in its place.
            state = DriveState.STARTING if away_s >= SWAP_S else DriveState.DEGRADED
            self._set(drive, state, "it answers again: being audited")
            if misses >= AUDIT_AFTER:
                if not health.audit_due:
                    health.audit_due, health.due_from_s = True, self._clock()
                self.audits.ask(drive)
        elif health.state is DriveState.STARTING and misses >= AUDIT_AFTER:
            drive.may_have_restarted()  # its audit looks at this

    def _log_held_back(self, heard: Drive) -> None:
        """Log the drives that are offline: with the first one heard it is no longer all of them."""
        for drive in self._drives:
            health = drive.health
            is_logged = health.logged is DriveState.OFFLINE
            if drive is not heard and health.state is DriveState.OFFLINE and not is_logged:
                self._log(drive, health.state, self._store.drive(drive.name).reason)

    def _missed(self, drive: Drive, fault: str) -> None:
        health = drive.health
        if not health.misses:
            health.silent_from_s = self._clock()
        health.misses += 1
        if health.state is DriveState.OFFLINE:
            return
        starting = health.state is DriveState.STARTING
        if health.misses >= (OFFLINE_AFTER if health.heard else OFFLINE_AFTER_UNHEARD):
            many = f"{health.misses} exchanges in a row" if health.misses > 1 else "the exchange"
            reason = f"{many} failed: {fault}"
            self._set(drive, DriveState.OFFLINE, reason)
            now = self._clock()
            self._schedule.park(drive.name, now, f"{drive.name} is offline: {reason}")
            self._schedule.set_probe(drive.name, drive.probe, now)
        elif not starting:
            self._set(drive, DriveState.DEGRADED, fault)

    def _set(self, drive: Drive, state: DriveState, reason: str, *, is_news: bool = True) -> None:
        # That no drive at all answers is said once for all of them (`port_watch`).
        unheard = state is DriveState.OFFLINE and not any(one.health.heard for one in self._drives)
        if is_news and state is not drive.health.logged and not unheard:
            self._log(drive, state, reason)
        drive.health.state = state
        self._store.drive_state(drive.name, state, reason)

    def _log(self, drive: Drive, state: DriveState, reason: str) -> None:
        log = logger.warning if state is DriveState.OFFLINE else logger.info
        logged = drive.health.logged
        log("drive=%s event=state from=%s to=%s reason=%s", drive.name, logged, state, reason)
        drive.health.logged = state
