"""One line, put together: schedule, worker, store, health, supervisor and operations of a roster.

Nothing here talks to the world: the port's opener is handed in, so the same assembly runs over a
serial device, over TCP, and in tests over a simulated line on a virtual clock. `apply` takes a
roster, at the start and at every reload: drives that stayed the same keep their values, their
place in the cadence and their watchdog's feeding.

What must not live here: signals, sockets, HTTP (`daemon`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from lecombus import __version__
from lecombus.capacity.facts import answers_of, facts_of
from lecombus.capacity.watchdog_demand import faults_of
from lecombus.config import Roster, line_timing, with_address
from lecombus.drive_runtime import Drive, LineDrives
from lecombus.drives import StopAction
from lecombus.errors import ConfigError
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.readdress import Readdress
from lecombus.fieldbus.lecom.request_maker import RequestMaker
from lecombus.line.port import PortOpener, PortSettings
from lecombus.line.worker import LineWorker, WorkerOptions
from lecombus.line_events import LineRequests
from lecombus.metrics import LineSnapshot, Metrics
from lecombus.metrics.rolling_window import LATELY_S
from lecombus.operations.actions import Actions
from lecombus.operations.context import OperationContext
from lecombus.operations.facade import Operations
from lecombus.operations.identities import Identities
from lecombus.operations.requests import Requests
from lecombus.operations.wear import Wear
from lecombus.readings import DriveState, Json
from lecombus.schedule import Schedule
from lecombus.schedule.stats import ScheduleStats
from lecombus.state import State
from lecombus.store import Store
from lecombus.supervision.audit_queue import AuditQueue
from lecombus.supervision.command_effects import CommandEffects
from lecombus.supervision.configurations import Configurations
from lecombus.supervision.drive_changes import DriveChanges
from lecombus.supervision.drive_supervisor import DriveSupervisor
from lecombus.supervision.event_records import (
    MetricsRecord,
    StoreRecord,
    record_control_words,
)
from lecombus.supervision.exchange_recorder import ExchangeRecorder
from lecombus.supervision.fault_watch import FaultWatch
from lecombus.supervision.health import Health
from lecombus.supervision.line_requests import RequestsToLine
from lecombus.supervision.poll_overload import PollOverload
from lecombus.supervision.port_watch import PortWatch
from lecombus.supervision.second_answers import SecondAnswers
from lecombus.supervision.slow_drives import SlowDrives
from lecombus.supervision.write_prechecks import WritePrechecks

__all__ = ["Changes", "LineRuntime"]

STUCK_S = 6.0
"""Longer than any exchange (at 1200 baud about 4 s) and than the pause before a reopening (5 s)."""

ECHO = {"auto": None, "yes": True, "no": False}


@dataclass(frozen=True, slots=True)
class Changes:
    """The drives that a new roster changed, by name and in its order.

    Args:
        added: They are new.
        removed: They are gone.
        changed: Something is different about them.
    """

    added: tuple[str, ...]
    removed: tuple[str, ...]
    changed: tuple[str, ...]

    def __str__(self) -> str:
        """Write it for the log: `added=c,d removed=none changed=a`."""
        parts = {"added": self.added, "removed": self.removed, "changed": self.changed}
        return " ".join(f"{key}={','.join(names) or 'none'}" for key, names in parts.items())


class LineRuntime:
    """Everything that runs one line.

    Args:
        roster: The line and its drives.
        opener: Opens the port.
        clock: Monotonic time, the event loop's, seconds.
        wall: The time of day, Unix seconds.
        options: How the line is worked; None: by the roster.
        timing: The line's times; None: by the roster.
        state: What was kept from before; None: nothing, and nothing is kept.
    """

    def __init__(
        self,
        roster: Roster,
        opener: PortOpener,
        clock: Callable[[], float],
        wall: Callable[[], float],
        *,
        options: WorkerOptions | None = None,
        timing: LineTiming | None = None,
        state: State | None = None,
    ) -> None:
        line, self.roster = roster.line, roster
        self._clock = clock
        self._timing = timing = timing or line_timing(line)
        self.store = Store(clock, wall)
        self.metrics = self._make_metrics()
        self.schedule = Schedule(absent_share=line.absent_share)
        self.state = state or State()
        self.drives = LineDrives()
        self.audits = AuditQueue()
        self.health = Health(self.drives, self.schedule, self.store, self.audits, clock)
        self._recorder = ExchangeRecorder(self.drives, self.metrics)
        self.worker = self._make_worker(opener, timing, options or options_of(roster))
        maker = RequestMaker(timing, line.retries, self.metrics.counters.request_ended)
        self.requests = Requests(self.worker, maker, self.drives, clock)
        asked = RequestsToLine(self.requests, self.store, self.audits, self.health, clock)
        self.identities = Identities(self.state, self.store, wall, self.drives, asked)
        self.wear = Wear(self.state, self.drives, clock)
        self._subscribe(asked, wall)
        self.readdress = Readdress(
            self.requests, self.store, self.state, self.identities, clock, wall, self._follow
        )
        self.supervisor = self._make_supervisor()
        self._changes = self._make_changes()
        self._slow = SlowDrives(self.store, self.schedule)
        self.operations = self._make_operations()
        self._overload = PollOverload(self.store)
        self._second_answers = SecondAnswers(self.store)
        self.port_watch = PortWatch(self.store, line)
        self.apply(roster)

    def _subscribe(self, asked: LineRequests, wall: Callable[[], float]) -> None:
        """Set who follows the line's events, in this order and no other.

        First what was read and written is kept, so that all who follow find it. Health comes behind
        those that read values: what a drive said is known before it is judged by having said it.
        The counts come last, because a stop of a drive that is offline by now counts otherwise.
        """
        store, counts = StoreRecord(self.store), MetricsRecord(self.metrics)
        self._recorder.subscribe(
            exchanges=(
                store.exchange_ended,
                record_control_words,
                FaultWatch(self.store, asked, wall).exchange_ended,
                CommandEffects(self.store, asked, self._clock).exchange_ended,
                Configurations(asked).exchange_ended,
                self.identities.exchange_ended,
                self.wear.exchange_ended,
                self.health.exchange_ended,
                counts.exchange_ended,
            ),
            changes=(store.line_changed, self.health.line_changed, counts.line_changed),
        )

    def _make_operations(self) -> Operations:
        context = OperationContext(
            self.requests, self.store, self.wear, self._clock, lambda: self._recorder.disturbances
        )
        return Operations(
            context, Actions(self._clock), self.identities, self.readdress,
            restarted=self.health.restarted,
            times_changed=lambda drive: self._slow.look([drive]),
        )  # fmt: skip

    def _make_metrics(self) -> Metrics:
        name, clock = self.roster.line.name, self._clock
        return Metrics(name, self.store, version=__version__, clock=clock, snapshot=self._snapshot)

    def _make_worker(
        self, opener: PortOpener, timing: LineTiming, options: WorkerOptions
    ) -> LineWorker:
        line = self.roster.line
        settings = PortSettings(line.port, line.baud, line.direction, line.parity, line.name)
        return LineWorker(settings, opener, self.schedule, timing, options, self._recorder)

    def _make_supervisor(self) -> DriveSupervisor:
        prechecks = WritePrechecks(self.requests, self.store, self.identities, self.readdress)
        return DriveSupervisor(
            self.requests, self.schedule, self.store, self._clock, self.health, self.audits,
            prechecks,
        )  # fmt: skip

    def _make_changes(self) -> DriveChanges:
        return DriveChanges(
            self.requests, self.schedule, self.store, self.metrics, self.health, self.audits,
            self.supervisor, self._clock,
        )  # fmt: skip

    def apply(self, roster: Roster) -> Changes:
        """Take a roster's drives and groups; drives that did not change are left alone.

        Returns:
            What became of which drive.

        Raises:
            ConfigError: The line itself differs: that needs a restart. Nothing was changed.
        """
        fixed, now = (self.roster, roster)
        if (fixed.line, fixed.api, fixed.state) != (now.line, now.api, now.state):
            raise ConfigError(
                "`line`, `api` and `state` cannot change while lecombus runs: restart it, or "
                "put them back; the old roster is kept",
                file=roster.file,
            )
        wanted = {entry.name: entry for entry in roster.drives}
        before = self.drives.entries()
        self._changes.apply(roster.drives)
        for name in set(self.roster.groups) - set(roster.groups):
            self.metrics.counters.remove(name)
        for name in roster.groups:
            self.metrics.counters.add_group(name)
        self.state.bound(wanted)
        self.operations.set_roster(roster.drives, roster.groups)
        self.readdress.roster_changed()
        self.schedule.expect(faults_of(roster, self._timing))
        self.roster = roster
        self.worker.nudge()
        return Changes(
            added=tuple(name for name in wanted if name not in before),
            removed=tuple(name for name in before if name not in wanted),
            changed=tuple(
                name for name in wanted if before.get(name, wanted[name]) != wanted[name]
            ),
        )

    def tried_all(self) -> bool:
        """Whether the line is open and every drive has been tried once since the start."""
        return self.worker.is_open and all(drive.audit.tried for drive in self.drives)

    def note_cadence(self) -> None:
        """Say how far the cadence is stretched, and which watchdogs ran out; once a second."""
        self.operations.actions.look()
        now_s = self._clock()
        stats = self._gather(now_s)
        self._slow.look(self.drives)
        self._second_answers.look(self.worker.exchange_loop.duplicates.found(now_s), self.drives)
        self.health.check_overdue()
        self.supervisor.note_lapses(stats.feeds)
        starting = any(drive.health.state is DriveState.STARTING for drive in self.drives)
        is_open = self.worker.is_open
        self._overload.note(stats.stretch, now_s, is_open=is_open, starting=starting)

    def wants_look_at_port(self) -> bool:
        """Whether somebody should look who else has the port open; about once a second."""
        return self.port_watch.note(
            self._recorder.failures,
            self._clock(),
            is_open=self.worker.is_open,
            silent=self.health.is_silent,
            heard=any(drive.health.heard for drive in self.drives),
        )

    @property
    def longest_exchange_s(self) -> float:
        """A line task without progress for this long is stuck, seconds."""
        return STUCK_S

    def stop_action(self) -> StopAction | None:
        """What the roster wants done to all drives at the end."""
        wanted = self.roster.on_shutdown
        return None if wanted == "nothing" else StopAction(wanted)

    def _follow(self, drive: Drive, address: int) -> None:
        """Speak to a drive at another address, until a roster says otherwise."""
        self.apply(with_address(self.roster, drive.name, address))

    def _snapshot(self) -> LineSnapshot:
        now = self._clock()
        stats = self._gather(now)
        self.store.set_stretch(stats.stretch)
        window = self.metrics.rolling_window
        feeds = {name: feed for name, feed in stats.feeds.items() if not feed.paused}
        return LineSnapshot(
            stats.depth,
            stats.stretch,
            window.cyclic_late.most(now, LATELY_S) or 0.0,
            {name: feed.time_s - feed.age_s for name, feed in feeds.items()},
            {name: feed.lapses for name, feed in stats.feeds.items()},
            stats.refused,
            stats.cyclic_skipped + stats.cyclic_dropped,
            self.wear.figures(self.store.names()),
            None if math.isinf(stats.slack_s) else stats.slack_s,
            window.woken_late.most(now, LATELY_S) or 0.0,
            self._answer_ratios(),
        )

    def _answer_ratios(self) -> dict[str, float]:
        """By drive: the slowest answer measured, in its manual's time."""
        rows = {drive.name: drive.station.measured.rows() for drive in self.drives}
        return {name: of[0].measured_s / of[0].manual_s for name, of in rows.items() if of}

    def _gather(self, now_s: float) -> ScheduleStats:
        """Take a snapshot of the schedule into the last minutes; the only place that may."""
        stats = self.schedule.stats(now_s)
        window = self.metrics.rolling_window
        window.cyclic_late.note(stats.cyclic_late_most_s, now_s)
        window.woken_late.note(self.worker.lateness.take_s(), now_s)
        if not math.isinf(stats.slack_s):
            window.slack(stats.slack_s, now_s)
        for name, feed in stats.feeds.items():
            if not math.isinf(feed.margin_since_s):
                window.margin(name, feed.margin_since_s, now_s)
        return stats

    def plan_facts(self) -> dict[str, Json]:
        """Give what a plan of this line is made from, and what its last minutes showed."""
        now_s = self._clock()
        self._gather(now_s)
        stations = [drive.station for drive in self.drives]
        return {
            "roster": facts_of(self.roster, {one.name: one.measured.slow for one in stations}),
            "measured": self.metrics.rolling_window.as_json(now_s),
            "answers": answers_of({one.name: one.measured.rows() for one in stations}),
            "state": str(self.store.line().state),
            "away": [
                drive.name
                for drive in self.drives
                if self.store.state(drive.name) is DriveState.OFFLINE
            ],
        }


def options_of(roster: Roster) -> WorkerOptions:
    """How a roster wants its line worked."""
    line = roster.line
    return WorkerOptions(
        turnaround_s=line.turnaround_s,
        late_answer_s=line.late_answer_s,
        stall_s=line.stall_s,
        echo=ECHO[line.echo],
    )
