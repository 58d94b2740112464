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

What must not live here: reading or writing anything; the schedule and the supervisor do that.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

from lecombus.protocol.exchange import ResultKind
from lecombus.readings import DriveState
from lecombus.schedule import Request, Schedule
from lecombus.store import Store

__all__ = ["Health"]

logger = logging.getLogger(__name__)

OFFLINE_AFTER = 4
"""Failed exchanges in a row: on a line that loses one answer in eight, once in 4000 exchanges."""

OFFLINE_AFTER_UNHEARD = 1
"""A drive that has not answered since the line was opened is probably not there, and others wait
behind it; if it is, the probe that follows at once finds it."""

AUDIT_AFTER = 2
"""Failures in a row after which a drive is audited again when it answers."""

SWAP_S = 5.0
"""Nobody puts another drive in a drive's place faster than this, seconds. One that was silent for
longer and is not offline only because it is seldom asked is not written to before its audit."""


UNAUDITED_S = 10.0
"""A drive that was silent for less is written to while its audit is due, but for no longer than
this, seconds: what it may have lost with its supply, its watchdog's settings, is not known."""

AGAIN_S = 60.0
"""A line that is opened again so soon flaps: that its drives start anew each time is not logged."""


@dataclass(slots=True)
class _Record:
    state: DriveState
    make_probe: Callable[[], Request]
    misses: int = 0
    silent_from_s: float = 0.0
    heard: bool = False
    audit_due: bool = False
    due_from_s: float = 0.0
    told: DriveState = DriveState.STARTING
    """The state that the log shows."""


class Health:
    """Judges the drives of one line.

    Args:
        schedule: Parks the drives that are offline.
        store: Told the states.
        wants_audit: Called with a drive that must be audited before it is called online.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self,
        schedule: Schedule,
        store: Store,
        wants_audit: Callable[[str], None],
        clock: Callable[[], float],
    ) -> None:
        self._schedule = schedule
        self._store = store
        self._wants_audit = wants_audit
        self._clock = clock
        self._records: dict[str, _Record] = {}
        self._opened_s = -AGAIN_S

    def add_drive(self, name: str, make_probe: Callable[[], Request]) -> None:
        """Watch a drive from now on; it starts as STARTING."""
        self._records[name] = _Record(DriveState.STARTING, make_probe)
        self._store.drive_state(name, DriveState.STARTING, "not tried yet")

    def remove_drive(self, name: str) -> None:
        """Watch it no longer."""
        self._records.pop(name, None)

    def state(self, name: str) -> DriveState:
        """How a drive is doing."""
        return self._records[name].state

    def was_heard(self, name: str) -> bool:
        """Whether a drive has answered since the line was opened."""
        record = self._records.get(name)
        return record is not None and record.heard

    @property
    def is_silent(self) -> bool:
        """Whether all drives were tried and none answers."""
        records = self._records.values()
        return bool(records) and all(one.state is DriveState.OFFLINE for one in records)

    def line_opened(self) -> None:
        """Begin anew with every drive: nobody knows what happened while the line was away."""
        now = self._clock()
        is_news, self._opened_s = now - self._opened_s >= AGAIN_S, now
        for name, record in self._records.items():
            if record.state is DriveState.OFFLINE:
                self._schedule.set_probe(name, None, now)
                self._schedule.unpark(name, now)
            record.misses = 0
            record.heard = False
            reason = "the line was opened: to be audited"
            self._set(name, record, DriveState.STARTING, reason, is_news=is_news)
            self._wants_audit(name)

    def exchange_ended(self, name: str, kind: ResultKind, fault: str) -> None:
        """Take the end of one exchange with a drive into account.

        Args:
            name: The drive.
            kind: How it ended.
            fault: Why it failed, in words.
        """
        record = self._records.get(name)
        if record is None:
            return
        if kind is ResultKind.ANSWERED:
            if not record.heard:
                record.heard = True
                self._tell_held_back(name)
            if record.misses or record.state is DriveState.OFFLINE:
                self._answered(name, record)
        elif kind is not ResultKind.LOST:
            self._missed(name, record, fault)

    def restarted(self, name: str) -> None:
        """A drive was made to start anew: what it forgot is put in order before it is online.

        Source: EDB2102EN 6.4 (TRIP reset of 820X: drive and fieldbus module are initialised).
        """
        record = self._records.get(name)
        if record is not None and record.state is not DriveState.OFFLINE:
            self._set(name, record, DriveState.STARTING, "it was made to restart: to be audited")
            self._wants_audit(name)

    def doubted(self, name: str, reason: str) -> None:
        """A drive says that it is another: nothing but stops is written to it before its audit."""
        record = self._records.get(name)
        if record is not None and record.state is not DriveState.OFFLINE:
            self._set(name, record, DriveState.STARTING, reason)
            self._wants_audit(name)

    def audited(self, name: str) -> None:
        """The supervisor has found the drive in order, or has put it in order."""
        record = self._records.get(name)
        if record is not None and record.state is not DriveState.OFFLINE:
            record.audit_due = False
            self._set(name, record, DriveState.ONLINE, "")

    def note_overdue(self) -> None:
        """Have nothing but stops written to drives whose audit takes too long; once a second."""
        late_s = self._clock() - UNAUDITED_S
        for name, record in self._records.items():
            writable = record.state in (DriveState.ONLINE, DriveState.DEGRADED)
            if record.audit_due and writable and record.due_from_s <= late_s:
                reason = f"it answered again {UNAUDITED_S:.0f} s ago and is not audited yet"
                self._set(name, record, DriveState.STARTING, reason)

    def audit_failed(self, name: str, reason: str) -> None:
        """The supervisor could not finish its audit; it will try again."""
        record = self._records.get(name)
        if record is not None and record.state is not DriveState.OFFLINE:
            self._set(name, record, record.state, f"not audited: {reason}")

    def _answered(self, name: str, record: _Record) -> None:
        misses, record.misses = record.misses, 0
        if record.state is DriveState.OFFLINE:
            now = self._clock()
            self._schedule.set_probe(name, None, now)
            self._schedule.unpark(name, now)
            self._set(name, record, DriveState.STARTING, "it answers again: being audited")
            self._wants_audit(name)
        elif record.state is DriveState.DEGRADED:
            if misses < AUDIT_AFTER and not record.audit_due:
                self._set(name, record, DriveState.ONLINE, "")
                return
            away_s = self._clock() - record.silent_from_s
            # Whoever had the time to put another drive there may have done so.
            state = DriveState.STARTING if away_s >= SWAP_S else DriveState.DEGRADED
            self._set(name, record, state, "it answers again: being audited")
            if misses >= AUDIT_AFTER:
                if not record.audit_due:
                    record.audit_due, record.due_from_s = True, self._clock()
                self._wants_audit(name)

    def _tell_held_back(self, heard: str) -> None:
        """Log the drives that are offline: with the first one heard it is no longer all of them."""
        for name, record in self._records.items():
            is_told = record.told is DriveState.OFFLINE
            if name != heard and record.state is DriveState.OFFLINE and not is_told:
                self._log(name, record, record.state, self._store.drive(name).reason)

    def _missed(self, name: str, record: _Record, fault: str) -> None:
        if not record.misses:
            record.silent_from_s = self._clock()
        record.misses += 1
        if record.state is DriveState.OFFLINE:
            return
        starting = record.state is DriveState.STARTING
        if record.misses >= (OFFLINE_AFTER if record.heard else OFFLINE_AFTER_UNHEARD):
            many = f"{record.misses} exchanges in a row" if record.misses > 1 else "the exchange"
            reason = f"{many} failed: {fault}"
            self._set(name, record, DriveState.OFFLINE, reason)
            now = self._clock()
            self._schedule.park(name, now, f"{name} is offline: {reason}")
            self._schedule.set_probe(name, record.make_probe, now)
        elif not starting:
            self._set(name, record, DriveState.DEGRADED, fault)

    def _set(
        self, name: str, record: _Record, state: DriveState, reason: str, *, is_news: bool = True
    ) -> None:
        # That no drive at all answers is said once for all of them (`port_watch`).
        unheard = state is DriveState.OFFLINE and not any(
            one.heard for one in self._records.values()
        )
        if is_news and state is not record.told and not unheard:
            self._log(name, record, state, reason)
        record.state = state
        self._store.drive_state(name, state, reason)

    def _log(self, name: str, record: _Record, state: DriveState, reason: str) -> None:
        log = logger.warning if state is DriveState.OFFLINE else logger.info
        log("drive=%s event=state from=%s to=%s reason=%s", name, record.told, state, reason)
        record.told = state
