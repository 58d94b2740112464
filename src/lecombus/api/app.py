"""The HTTP application: all routes, stops first.

Strategy: Starlette finds the route. Answers are plain responses, so that no request holds the event
loop for long. A request that was begun on the line runs to its end also when its client goes away;
a write that was not sent by then is withdrawn.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Sequence

from starlette.applications import Starlette
from starlette.middleware import Middleware

from lecombus.api.error_answers import ERROR_ANSWERS
from lecombus.api.event_readers import EventReaders
from lecombus.api.event_routes import EventRoutes
from lecombus.api.idempotency import Idempotency
from lecombus.api.journal_routes import JournalRoutes
from lecombus.api.lease_routes import LeaseRoutes
from lecombus.api.read_routes import ReadRoutes
from lecombus.api.refusals import Refusals
from lecombus.api.scopes import guarded
from lecombus.api.service_routes import Check, ServiceRoutes
from lecombus.api.write_routes import StopRoutes, WriteRoutes, with_plain_stop_paths
from lecombus.config import RosterChanges
from lecombus.drive_state.store import Store
from lecombus.journal.journal import Journal
from lecombus.journal.kept import KeyRow
from lecombus.metrics import Metrics
from lecombus.operations.facade import Operations
from lecombus.parameters import Json

__all__ = ["create_app"]


def create_app(
    ops: Operations,
    store: Store,
    metrics: Metrics,
    *,
    plan_facts: Callable[[], dict[str, Json]],
    line_name: str,
    ready: Check,
    healthy: Check,
    reload: Callable[[], Awaitable[RosterChanges]],
    readers: EventReaders,
    port: str = "",
    baud: int = 9600,
    read_only: bool = False,
    journal: Journal | None = None,
    kept_keys: Sequence[KeyRow] | None = (),
    version: str = "",
    clock: Callable[[], float] = time.monotonic,
) -> Starlette:
    """Return the application of one line.

    Args:
        ops: What is done on the line.
        store: What is known.
        metrics: The metrics page.
        plan_facts: What a plan is made from, and what the last minutes showed.
        line_name: The line's name.
        ready: Whether the line is open and every drive was tried once.
        healthy: Whether the line task makes progress.
        reload: Reads the roster again and applies it.
        readers: Those who read events.
        port: The line's port, as the roster has it.
        baud: Its baud rate, bit/s.
        read_only: Whether all but reads and stops are refused.
        journal: The journal; None: there is none.
        kept_keys: What it keeps of requests of the run before; None: that cannot be read yet.
        version: lecombus' version, for the OpenAPI document.
        clock: A monotonic clock for idempotency keys, seconds.
    """
    facts: dict[str, Json] = {"line": line_name, "port": port, "baud": baud}
    routes = [
        *StopRoutes(ops).routes(),
        *ReadRoutes(ops, store, facts, plan_facts, clock).routes(),
        *LeaseRoutes(ops).routes(),
        *WriteRoutes(
            ops, Idempotency(clock, journal, kept_keys), Refusals(clock, ops, journal), reload
        ).routes(),
        *JournalRoutes(journal, ops).routes(),
        *EventRoutes(readers, ops, store).routes(),
        *ServiceRoutes(metrics, ready, healthy, version or "0").routes(),
    ]
    app = Starlette(
        routes=guarded(routes, ops, store.family, read_only=read_only),
        middleware=[Middleware(with_plain_stop_paths)],
        exception_handlers=ERROR_ANSWERS,
    )
    app.router.redirect_slashes = False
    return app
