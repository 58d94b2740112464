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
from dataclasses import dataclass, replace

from lecombus import __version__
from lecombus.capacity.exchange_costs import watched_s
from lecombus.capacity.facts import answers_of, facts_of
from lecombus.capacity.watchdog_demand import faults_of
from lecombus.config import DriveEntry, Roster, line_timing, with_address
from lecombus.drives import Family, LineTiming, StopAction, family
from lecombus.drives.measured import MeasuredTimes
from lecombus.drives.stops import inhibit_mask, inhibit_proofs
from lecombus.errors import ConfigError
from lecombus.line.port import PortOpener, PortSettings
from lecombus.line.station import Station
from lecombus.line.worker import LineWorker, WorkerOptions
from lecombus.metrics import Figures, Metrics
from lecombus.metrics.minutes import LATELY_S
from lecombus.operations.actions import Actions
from lecombus.operations.context import OperationContext
from lecombus.operations.control_words import ControlWords
from lecombus.operations.facade import Operations
from lecombus.operations.identities import Identities
from lecombus.operations.maintenance import Maintenance
from lecombus.operations.readdress import Readdress
from lecombus.operations.recorded import RecordedMaintenance, RecordedOperations
from lecombus.operations.request_maker import RequestMaker
from lecombus.operations.requests import Requests
from lecombus.operations.wear import Wear
from lecombus.protocol.addressing import Code
from lecombus.readings import DriveState, Json
from lecombus.schedule import Feed, Priority, Schedule, Settle
from lecombus.schedule.stats import ScheduleStats
from lecombus.state import State
from lecombus.store import Store
from lecombus.supervision.command_effects import CommandEffects
from lecombus.supervision.configurations import Configurations
from lecombus.supervision.cyclic_reads import CyclicReads
from lecombus.supervision.drive_supervisor import DriveSupervisor
from lecombus.supervision.exchange_recorder import ExchangeRecorder
from lecombus.supervision.fault_watch import FaultWatch
from lecombus.supervision.health import Health
from lecombus.supervision.poll_overload import PollOverload
from lecombus.supervision.port_watch import PortWatch
from lecombus.supervision.second_answers import SecondAnswers
from lecombus.supervision.slow_drives import SlowDrives
from lecombus.supervision.write_prechecks import WritePrechecks

__all__ = ["Changes", "LineRuntime"]

STUCK_S = 6.0
"""Longer than any exchange (at 1200 baud about 4 s) and than the pause before a reopening (5 s)."""

ASKED_FOR_S = 10.0
"""What a change calls for is not read any more after this: its own turn has come by then."""

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
        self.store = Store(clock, wall)
        self.metrics = self._make_metrics()
        self.schedule = Schedule(absent_share=line.absent_share)
        self.words = ControlWords(clock)
        self.state = state or State()
        self.wear = Wear(self.state, self.store, clock)
        self._timing = timing = timing or line_timing(line)
        maker = RequestMaker(timing, line.retries, self.metrics.meters.request_ended)
        self.health = Health(self.schedule, self.store, self._wants_audit, clock)
        self._configurations = self._make_configurations()
        self.identities = self._make_identities(wall)
        self._recorder = recorder = self._make_recorder(wall)
        self.worker = self._make_worker(opener, timing, options or options_of(roster), recorder)
        self.requests = Requests(self.worker, maker, clock)
        self.readdress = Readdress(
            self.requests, self.store, self.state, self.identities, clock, wall, self._follow
        )
        self.supervisor = self._make_supervisor(clock)
        context = OperationContext(
            self.requests, self.store, self.words, self.wear, clock, lambda: recorder.disturbances
        )
        self.operations = Operations(context, self.health.restarted)
        self._slow = SlowDrives(self.store, self.schedule.costs_changed)
        self.maintenance = self._make_maintenance()
        self.actions, self.recorded, self.recorded_maintenance = self._make_recorded()
        self._overload = PollOverload(self.store)
        self._second_answers = SecondAnswers(self.store)
        self.port_watch = PortWatch(self.store, line)
        self._reads = CyclicReads(self.requests, self.schedule, self.store, self.metrics.minutes)
        self._entries: dict[str, DriveEntry] = {}
        self.apply(roster)

    def _make_identities(self, wall: Callable[[], float]) -> Identities:
        return Identities(self.state, self.store, wall, self._wants_audit, self.health.doubted)

    def _make_recorded(self) -> tuple[Actions, RecordedOperations, RecordedMaintenance]:
        actions = Actions(self._clock)
        operations = RecordedOperations(self.operations, actions, self._is_secret)
        return actions, operations, RecordedMaintenance(self.maintenance, actions)

    def _is_secret(self, target: str, code: Code) -> bool:
        """Whether a code of a drive, or of one of a group, is a password."""
        group = self.roster.groups.get(target)
        names = (target,) if group is None else group.members
        infos = (
            self.requests.station(name).family.info(code) for name in names if name in self._entries
        )
        return any(info is not None and info.secret for info in infos)

    def _make_maintenance(self) -> Maintenance:
        return Maintenance(
            self.identities, self.wear, self.readdress, self.requests,
            lambda station: self._slow.look([station]),
        )  # fmt: skip

    def _make_configurations(self) -> Configurations:
        return Configurations(
            self._take_family, self._take_response, self._read_soon, self._read_later
        )

    def _make_metrics(self) -> Metrics:
        name, clock = self.roster.line.name, self._clock
        return Metrics(name, self.store, version=__version__, clock=clock, figures=self._figures)

    def _make_worker(
        self,
        opener: PortOpener,
        timing: LineTiming,
        options: WorkerOptions,
        recorder: ExchangeRecorder,
    ) -> LineWorker:
        line = self.roster.line
        settings = PortSettings(line.port, line.baud, line.direction, line.parity, line.name)
        return LineWorker(settings, opener, self.schedule, timing, options, recorder)

    def _make_recorder(self, wall: Callable[[], float]) -> ExchangeRecorder:
        watch = FaultWatch(self.store, self._read_soon, wall)
        effects = CommandEffects(self.store, self._read_soon, self._read_later, self._clock)
        return ExchangeRecorder(
            self.store, self.metrics, self.health, self.words, watch, effects,
            self._configurations, self.identities, self.wear, self._has_drive,
        )  # fmt: skip

    def _make_supervisor(self, clock: Callable[[], float]) -> DriveSupervisor:
        prechecks = WritePrechecks(
            self.requests, self.store, self.identities, self.words, self.readdress
        )
        return DriveSupervisor(
            self.requests, self.schedule, self.store, clock, self.health, prechecks
        )

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
        before, left = dict(self._entries), {}
        for name, entry in list(self._entries.items()):
            new = wanted.get(name)
            if new is None or entry.asks_for_audit(new):
                left[name] = self._remove_drive(name, kept=new is not None)
            elif new != entry:
                self._change_use(new)
        for entry in roster.drives:
            if entry.name not in self._entries:
                self._add_drive(entry)
                self._resume_feeding(before.get(entry.name), entry, left.get(entry.name))
        for name in set(self.roster.groups) - set(roster.groups):
            self.metrics.meters.remove(name)
        for name in roster.groups:
            self.metrics.meters.add_group(name)
        self.state.bound(wanted)
        self.operations.set_roster(roster.drives, roster.groups)
        self.readdress.set_roster(wanted)
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
        return self.worker.is_open and self.supervisor.tried >= set(self._entries)

    def note_cadence(self) -> None:
        """Say how far the cadence is stretched, and which watchdogs ran out; once a second."""
        self.actions.look()
        now_s = self._clock()
        stats = self._gather(now_s)
        self._slow.look(map(self.requests.station, self._entries))
        addresses = {name: entry.address for name, entry in self._entries.items()}
        self._second_answers.look(self.worker.talk.duplicates.found(now_s), addresses)
        self.health.note_overdue()
        self.supervisor.note_lapses(stats.feeds)
        starting = any(self.health.state(name) is DriveState.STARTING for name in self._entries)
        is_open = self.worker.is_open
        self._overload.note(stats.stretch, now_s, is_open=is_open, starting=starting)

    def wants_look_at_port(self) -> bool:
        """Whether somebody should look who else has the port open; about once a second."""
        return self.port_watch.note(
            self._recorder.failures,
            self._clock(),
            is_open=self.worker.is_open,
            silent=self.health.is_silent,
            heard=any(map(self.health.was_heard, self._entries)),
        )

    @property
    def longest_exchange_s(self) -> float:
        """A line task without progress for this long is stuck, seconds."""
        return STUCK_S

    def stop_action(self) -> StopAction | None:
        """What the roster wants done to all drives at the end."""
        wanted = self.roster.on_shutdown
        return None if wanted == "nothing" else StopAction(wanted)

    def _add_drive(self, entry: DriveEntry) -> None:
        kind = family(entry.family)
        station = Station(
            entry.name,
            entry.address,
            kind,
            entry.forms,
            hold_s=kind.hold_after_write_s,
            answer_time_s=entry.answer_time_s,
            measured=MeasuredTimes(self.requests.maker.timing.adapter_latency_s),
        )
        self._entries[entry.name] = entry
        self.store.add_drive(entry.name, entry.address, kind)
        self._configurations.watch(entry.name, kind)
        self.identities.add_drive(entry)
        self.wear.add_drive(entry)
        self.metrics.meters.add_drive(entry.name)
        self.requests.add_station(station)
        self.schedule.add_drive(entry.name)
        self.health.add_drive(entry.name, self.requests.maker.probe(station))
        for rule in kind.stops.values():
            if rule.value is None:
                others = (one.code for one in kind.stops.values() if one is not rule)
                self.words.watch(
                    entry.name, rule.code, mask=inhibit_mask(kind, rule.code), moved_by=others,
                    inhibited_by=inhibit_proofs(kind), watchdog_s=watched_s(entry),
                    watchdog_inhibits=entry.watchdog is not None
                    and entry.watchdog.action == "inhibit",
                )  # fmt: skip
        self._reads.take(entry, self._clock())
        self.supervisor.add_drive(entry)
        if self.worker.is_open:
            self.supervisor.audit_soon(entry.name)

    def _change_use(self, entry: DriveEntry) -> None:
        """Read other codes of a drive, or allow other things; it stays the drive it is.

        What else looks at entries, `operations` and `readdress`, is handed all of them at the end.
        """
        self._entries[entry.name] = entry
        self.identities.change_entry(entry)
        self.wear.add_drive(entry)
        self.supervisor.change_entry(entry)
        self._reads.take(entry, self._clock())

    def _resume_feeding(self, old: DriveEntry | None, new: DriveEntry, left: Feed | None) -> None:
        """Let no deadline of a drive that stayed slip because its entry changed."""
        if old is not None and left is not None:
            is_same = (old.address, old.family) == (new.address, new.family)
            self.schedule.resume_feeding(new.name, left, is_same=is_same)

    def _remove_drive(self, name: str, *, kept: bool) -> Feed | None:
        """Take a drive out; `kept`: it comes back at once with other settings."""
        del self._entries[name]
        self.supervisor.remove_drive(name)
        self.health.remove_drive(name)
        now_s, reason = self._clock(), f"{name} was taken out of the roster"
        left = self.schedule.remove_drive(name, now_s, reason)
        self.requests.remove_station(name)
        self.words.forget(name)
        self.identities.remove_drive(name)
        self._recorder.forget(name)
        self._slow.forget(name)
        self._reads.forget(name)
        if not kept:
            self.store.remove_drive(name)
            self.metrics.meters.remove(name)
            self.metrics.minutes.forget(name)
        return left

    def _follow(self, name: str, address: int) -> None:
        """Speak to a drive at another address, until a roster says otherwise."""
        self.apply(with_address(self.roster, name, address))

    def _has_drive(self, name: str, address: int | None) -> bool:
        entry = self._entries.get(name)
        return entry is not None and address in (None, entry.address)

    def _wants_audit(self, name: str) -> None:
        self.words.forget(name)
        self.supervisor.audit_soon(name)

    def _take_family(self, name: str, kind: Family) -> None:
        """Take a drive by another description of its family: its words mean something else."""
        self.store.take_family(name, kind)
        station = self.requests.station(name)
        self.requests.replace_station(station, replace(station, family=kind))

    def _take_response(self, name: str, early: bool | None) -> None:
        """Leave a drive alone after a write if it acknowledges early, or may (None)."""
        station = self.requests.station(name)
        hold_s = 0.0 if early is False else station.family.hold_after_write_s
        if (station.hold_s, station.answers_early) != (hold_s, early is True):
            changed = replace(station, hold_s=hold_s, answers_early=early is True)
            self.requests.replace_station(station, changed)

    def _read_soon(self, name: str, code: Code, settle: Settle) -> None:
        """Read a code before the cyclic ones, without waiting for it here."""
        station = self.requests.station(name)
        expires_at_s = self._clock() + ASKED_FOR_S
        self.worker.submit(
            self.requests.maker.read(
                station, code, Priority.INTERACTIVE, settle=settle, expires_at_s=expires_at_s
            )
        )

    def _read_later(self, name: str, code: Code, settle: Settle) -> None:
        """Read a code when the line has time for it."""
        station = self.requests.station(name)
        self.worker.submit(
            self.requests.maker.read(station, code, Priority.BACKGROUND, settle=settle)
        )

    def _figures(self) -> Figures:
        now = self._clock()
        stats = self._gather(now)
        self.store.set_stretch(stats.stretch)
        minutes = self.metrics.minutes
        feeds = {name: feed for name, feed in stats.feeds.items() if not feed.paused}
        return Figures(
            stats.depth,
            stats.stretch,
            minutes.cyclic_late.most(now, LATELY_S) or 0.0,
            {name: feed.time_s - feed.age_s for name, feed in feeds.items()},
            {name: feed.lapses for name, feed in stats.feeds.items()},
            stats.refused,
            stats.cyclic_skipped + stats.cyclic_dropped,
            self.wear.figures(),
            None if math.isinf(stats.slack_s) else stats.slack_s,
            minutes.woken_late.most(now, LATELY_S) or 0.0,
            self._answer_ratios(),
        )

    def _answer_ratios(self) -> dict[str, float]:
        """By drive: the slowest answer measured, in its manual's time."""
        rows = {name: self.requests.station(name).measured.rows() for name in self._entries}
        return {name: of[0].measured_s / of[0].manual_s for name, of in rows.items() if of}

    def _gather(self, now_s: float) -> ScheduleStats:
        """Take a snapshot of the schedule into the last minutes; the only place that may."""
        stats = self.schedule.stats(now_s)
        minutes = self.metrics.minutes
        minutes.cyclic_late.note(stats.cyclic_late_most_s, now_s)
        minutes.woken_late.note(self.worker.lateness.take_s(), now_s)
        if not math.isinf(stats.slack_s):
            minutes.slack(stats.slack_s, now_s)
        for name, feed in stats.feeds.items():
            if not math.isinf(feed.margin_since_s):
                minutes.margin(name, feed.margin_since_s, now_s)
        return stats

    def plan_facts(self) -> dict[str, Json]:
        """Give what a plan of this line is made from, and what its last minutes showed."""
        now_s = self._clock()
        self._gather(now_s)
        stations = [self.requests.station(name) for name in self._entries]
        return {
            "roster": facts_of(self.roster, {one.name: one.measured.slow for one in stations}),
            "measured": self.metrics.minutes.as_json(now_s),
            "answers": answers_of({one.name: one.measured.rows() for one in stations}),
            "state": str(self.store.line().state),
            "away": [
                name for name in self._entries if self.store.state(name) is DriveState.OFFLINE
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
