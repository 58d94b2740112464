"""What looks after one line unasked: drives, watchdogs, leases, events and figures.

`LineSupervision` makes these parts in the order in which they need one another. It has no rules:
each part says in its own module what it does.
"""

from __future__ import annotations

from collections.abc import Callable

from lecombus.config import LineEntry
from lecombus.drive_state.store import Store
from lecombus.event_stream import EventStream
from lecombus.metrics import Metrics
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.facade import Operations
from lecombus.supervision.drive_changes import DriveChanges
from lecombus.supervision.drive_supervisor import DriveSupervisor
from lecombus.supervision.event_sources import EventSources
from lecombus.supervision.exchange_recorder import ExchangeRecorder
from lecombus.supervision.lease_watch import LeaseWatch
from lecombus.supervision.line_requests import RequestsToLine
from lecombus.supervision.line_watch import LineWatch

__all__ = ["LineSupervision"]


class LineSupervision:
    """The parts that look after one line.

    Args:
        requests: Has the worker, the schedule and the drives.
        store: Keeps values, states and remarks.
        metrics: Keeps the figures.
        recorder: Counts failed exchanges.
        asked: What supervision asks of the line; has the drives' health.
        operations: What users ask; has the leases.
        events: Where events are published.
        line: The line, as in the roster.
        members: Gives the drives of a group, by its name.
        clock: Monotonic time, seconds.

    Attributes:
        drives: Starts drives, brings them back and audits them.
        leases: Ends leases that are not renewed.
        changes: Adds, changes and removes drives.
        event_sources: Publishes what has changed.
        watch: Looks at the whole line once a second.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        metrics: Metrics,
        recorder: ExchangeRecorder,
        asked: RequestsToLine,
        operations: Operations,
        events: EventStream,
        line: LineEntry,
        members: Callable[[str], tuple[str, ...]],
        clock: Callable[[], float],
    ) -> None:
        health = asked.health
        self.drives = DriveSupervisor(requests, store, health, operations, clock)
        self.leases = LeaseWatch(requests, store, operations, health, clock)
        self.changes = DriveChanges(requests, store, metrics, health, self.drives, clock)
        self.event_sources = EventSources(
            events, store, operations.actions, line.name, members, clock
        )
        operations.leases.followers += (self.event_sources.lease_changed,)
        self.watch = LineWatch(
            requests, store, metrics, recorder, asked, operations, self.leases, events, line, clock
        )
