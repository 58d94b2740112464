"""One line, put together: schedule, worker, store, operations and supervision of a roster.

Nothing here talks to the world: the port's opener is handed in, so the same assembly runs over a
serial device, over TCP, and in tests over a simulated line on a virtual clock. `apply` takes a
roster, at the start and at every reload: drives that stayed the same keep their values, their
place in the cadence and their watchdog's feeding.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable

from lecombus.capacity.load import load_on
from lecombus.config import (
    FIXED,
    LineEntry,
    Roster,
    RosterChanges,
    line_timing,
    roster_changes,
    with_address,
)
from lecombus.drive_state.drive_runtime import LineDrives
from lecombus.drive_state.store import Store
from lecombus.errors import ConfigError
from lecombus.event_stream import EventStream
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.port import Framing, PortOpener, PortSettings
from lecombus.fieldbus.protocols import find
from lecombus.line.worker import LineWorker, WorkerOptions
from lecombus.metrics import LineSnapshot, Metrics
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.facade import Operations
from lecombus.saved_state import State
from lecombus.schedule import Schedule
from lecombus.supervision.exchange_recorder import ExchangeRecorder, follow_line
from lecombus.supervision.line_requests import RequestsToLine
from lecombus.supervision.line_supervision import LineSupervision

__all__ = ["LineRuntime"]

STUCK_S = 6.0
"""Longer than any exchange (at 1200 baud about 4 s) and than the pause before a reopening (5 s), if
no drive is waited for longer because the roster says so (`answer_time`)."""

ECHO = {"auto": None, "yes": True, "no": False}


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
        self._timing = timing = timing or line_timing(line)
        # What is known.
        self.state = state or State()
        self.store = store = Store(clock, wall)
        self.drives = LineDrives()
        self.metrics = metrics = Metrics(line.name, store, clock=clock, snapshot=self._snapshot)
        # The line, and requests to it.
        self.schedule = Schedule(absent_share=line.absent_share)
        recorder = ExchangeRecorder(self.drives, metrics)
        fieldbus = find(line.protocol)
        self.worker = LineWorker(
            fieldbus, port_settings(line, fieldbus.framing(line.parity)), opener,
            self.schedule, timing, options or options_of(roster), recorder,
        )  # fmt: skip
        maker = fieldbus.request_maker(
            timing, line.retries, metrics.counters.request_ended, self.worker.exchange_loop
        )
        self.requests = requests = Requests(self.worker, maker, self.drives, clock)
        # What users ask, and what looks after the drives.
        asked = RequestsToLine(requests, store, clock)
        self.health = asked.health
        self.operations = operations = Operations(
            requests, store, self.state, asked, clock, wall, follow=self._follow,
            disturbances=lambda: recorder.disturbances,
        )  # fmt: skip
        follow_line(recorder, store, metrics, asked, operations, clock, wall)
        self.events = EventStream(secrets.token_hex(4))
        self.supervision = LineSupervision(
            requests, store, metrics, recorder, asked, operations, self.events, line,
            self._members, clock,
        )  # fmt: skip
        self.apply(roster)

    def apply(self, roster: Roster) -> RosterChanges:
        """Take a roster's drives and groups; drives that did not change are left alone.

        Returns:
            What differs from the roster before; nothing at the start.

        Raises:
            ConfigError: The line itself differs: that needs a restart. Nothing was changed.
        """
        fixed, now = (self.roster, roster)
        if any(getattr(fixed, part) != getattr(now, part) for part in FIXED):
            raise ConfigError(
                "`line`, `api`, `journal` and `state` cannot change while lecombus runs: restart "
                "it, or put them back; the old roster is kept",
                file=roster.file,
            )
        changes = roster_changes(self.roster, roster)
        self.store.plan_stretch(load_on(roster.drives, self._timing).stretch)
        self.supervision.changes.apply(self.roster, roster)
        self.state.bound(entry.name for entry in roster.drives)
        self.operations.set_roster(roster.drives, roster.groups)
        self.operations.readdressing.roster_changed()
        self.supervision.leases.roster_changed()
        self.roster = roster
        self.worker.nudge()
        return changes

    def tried_all(self) -> bool:
        """Whether the line is open and every drive has been tried once since the start."""
        return self.worker.is_open and all(drive.audit.tried for drive in self.drives)

    @property
    def longest_exchange_s(self) -> float:
        """A line task without progress for this long is stuck, seconds."""
        return STUCK_S + self.roster.longest_wait_s

    def _snapshot(self) -> LineSnapshot:
        """Return what the metrics show of the line at this moment."""
        return self.supervision.watch.snapshot()

    def _members(self, group: str) -> tuple[str, ...]:
        entry = self.roster.groups.get(group)
        return () if entry is None else entry.members

    def _follow(self, drive: str, address: int) -> None:
        """Speak to a drive at another address, until a roster says otherwise."""
        address_of = self.worker.fieldbus.multicast_address
        self.apply(with_address(self.roster, drive, address, address_of))


def port_settings(line: LineEntry, framing: Framing) -> PortSettings:
    """How a roster wants its port opened."""
    return PortSettings(line.port, line.baud, line.direction, framing, line.name)


def options_of(roster: Roster) -> WorkerOptions:
    """How a roster wants its line worked."""
    line = roster.line
    return WorkerOptions(
        turnaround_s=line.turnaround_s,
        late_answer_s=line.late_answer_s,
        stall_s=line.stall_s,
        echo=ECHO[line.echo],
    )
