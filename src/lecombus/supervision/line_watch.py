"""What is looked at once a second: the schedule's figures, and what follows from them.

`LineWatch` takes a snapshot of the schedule into the figures of the last minutes, for the metrics
and for `lecombus plan`. From it and from what the line counted come remarks (`line_remarks`), and
in the log watchdogs whose time ran out. `port_watch` says who else has the port open.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping

from lecombus.capacity.facts import answers_of, facts_of
from lecombus.config import LineEntry, Roster
from lecombus.drive_state.readings import DriveState
from lecombus.drive_state.store import Store
from lecombus.event_stream import EventStream
from lecombus.journal.journal import JournalFigures
from lecombus.metrics import LineSnapshot, Metrics
from lecombus.metrics.rolling_window import LATELY_S
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.facade import Operations
from lecombus.parameters import Json
from lecombus.schedule import WatchdogStats
from lecombus.schedule.stats import ScheduleStats
from lecombus.supervision.exchange_recorder import ExchangeRecorder
from lecombus.supervision.lease_watch import LeaseWatch
from lecombus.supervision.line_remarks import PollOverload, remark_second_answers
from lecombus.supervision.line_requests import RequestsToLine
from lecombus.supervision.port_watch import PortWatch

__all__ = ["LineWatch"]

logger = logging.getLogger(__name__)


class LineWatch:
    """Looks at one line once a second.

    Args:
        requests: Has the worker, the schedule and the drives.
        store: Gets the remarks.
        metrics: Keeps the figures of the last minutes.
        recorder: Counts failed exchanges.
        line: Uses measured answer times; has the drives' health.
        operations: Counts writes.
        leases: Knows what the metrics show of leases.
        events: Counts what is read along, and by how many.
        entry: The line, as in the roster.
        clock: Monotonic time, seconds.

    Attributes:
        port: Says who else has the port open.
        journal: Gives the figures of the journal; None: there is none.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        metrics: Metrics,
        recorder: ExchangeRecorder,
        line: RequestsToLine,
        operations: Operations,
        leases: LeaseWatch,
        events: EventStream,
        entry: LineEntry,
        clock: Callable[[], float],
    ) -> None:
        self._leases = leases
        self.port = PortWatch(store, entry)
        self.journal: Callable[[], JournalFigures] | None = None
        self._drives = requests.drives
        self._worker = requests.worker
        self._store = store
        self._window = metrics.rolling_window
        self._recorder = recorder
        self._line = line
        self._operations = operations
        self._events = events
        self._clock = clock
        self._overload = PollOverload(store)

    def look(self) -> None:
        """Log and remark what has changed; once a second."""
        self._operations.actions.look()
        now_s = self._clock()
        stats = self._gather(now_s)
        for drive in self._drives:
            self._line.use_answer_times(drive)
        found = self._worker.exchange_loop.second_answers(now_s)
        remark_second_answers(found, self._drives, self._store)
        self._line.health.check_overdue()
        self._note_lapses(stats.feeds)
        self._keep_lapses(now_s)
        states = {drive.health.state for drive in self._drives}
        self._overload.note(
            stats.stretch,
            now_s,
            answers=self._worker.is_open and DriveState.ONLINE in states,
            starting=DriveState.STARTING in states,
            stopping=bool(self._worker.schedule.stops()),
        )

    def wants_look_at_port(self) -> bool:
        """Whether to look who else has the port open; about once a second."""
        return self.port.note(
            self._recorder.failures,
            self._clock(),
            is_open=self._worker.is_open,
            silent=self._line.health.is_silent,
            heard=any(drive.health.heard for drive in self._drives),
        )

    def snapshot(self) -> LineSnapshot:
        """Return what the page of metrics shows besides what the store holds."""
        now = self._clock()
        stats = self._gather(now)
        self._store.set_stretch(stats.stretch)
        feeds = {name: feed for name, feed in stats.feeds.items() if not feed.paused}
        return LineSnapshot(
            queue_depth=stats.depth,
            stretch=stats.stretch,
            lateness_s=self._window.cyclic_late.most(now, LATELY_S) or 0.0,
            watchdog_margin_s={name: feed.time_s - feed.age_s for name, feed in feeds.items()},
            watchdog_misses={name: feed.lapses for name, feed in stats.feeds.items()},
            refused=stats.refused,
            cyclic_skipped=stats.cyclic_skipped + stats.cyclic_dropped,
            writes=self._operations.context.wear.figures(self._store.names()),
            slack_s=None if math.isinf(stats.slack_s) else stats.slack_s,
            woken_late_s=self._window.woken_late.most(now, LATELY_S) or 0.0,
            answer_ratio=self._answer_ratios(),
            leases=self._leases.figures(),
            journal=None if self.journal is None else self.journal(),
            events=self._events.published,
            event_readers=self._events.readers,
            event_readers_dropped=self._events.dropped,
            watchdog_lowest_s=self._window.lowest_margins_s(now, LATELY_S),
            watchdog_time_s={name: feed.time_s for name, feed in stats.feeds.items()},
        )

    def plan_facts(self, roster: Roster) -> dict[str, Json]:
        """Give what a plan of this line is made from, and what its last minutes showed."""
        now_s = self._clock()
        self._gather(now_s)
        stations = [drive.station for drive in self._drives]
        names = [drive.name for drive in self._drives]
        return {
            "roster": facts_of(roster, {one.name: one.measured.slow for one in stations}),
            "measured": self._window.as_json(now_s),
            "answers": answers_of({one.name: one.measured.rows() for one in stations}),
            "state": str(self._store.line().state),
            "away": [one for one in names if self._store.state(one) is DriveState.OFFLINE],
        }

    def _answer_ratios(self) -> dict[str, float]:
        """By drive: the slowest answer measured, in its manual's time."""
        rows = {drive.name: drive.station.measured.rows() for drive in self._drives}
        return {name: of[0].measured_s / of[0].manual_s for name, of in rows.items() if of}

    def _gather(self, now_s: float) -> ScheduleStats:
        """Take a snapshot of the schedule into the last minutes; the only place that may."""
        stats, window = self._worker.schedule.stats(now_s), self._window
        window.cyclic_late.note(stats.cyclic_late_most_s, now_s)
        window.woken_late.note(self._worker.lateness.take_s(), now_s)
        if not math.isinf(stats.slack_s):
            window.slack(stats.slack_s, now_s)
        for name, feed in stats.feeds.items():
            if not math.isinf(feed.margin_since_s):
                window.margin(name, feed.margin_since_s, now_s)
        return stats

    def _keep_lapses(self, now_s: float) -> None:
        """Keep for each drive that is silent now that its watchdog may have acted."""
        for drive in self._drives:
            if drive.control_word.watchdog_may_have_acted(now_s):
                quick_stops = drive.watchdog_quick_stops
                self._store.watchdog_lapsed(drive.name, now_s, quick_stops=quick_stops)

    def _note_lapses(self, feeds: Mapping[str, WatchdogStats]) -> None:
        """Log each watchdog whose time ran out unfed, once per lapse, and have it looked at."""
        for name, feed in feeds.items():
            drive = self._drives.find(name)
            if drive is None:
                continue
            if feed.lapses > drive.feed.lapses:
                logger.warning("drive=%s event=watchdog-missed time_s=%g", name, feed.time_s)
                drive.audit.unfed = True
            drive.feed.lapses = feed.lapses
