"""Schedule operations per second while many requests wait: flat or logarithmic, never linear.

One operation is what one exchange asks of the schedule: choose, book the end, and take the next
request in, so that as many wait afterwards as before. Twenty drives have watchdogs and a cyclic
read each, as on a real line; what waits is spread over all drives and the lower classes.
"""

from __future__ import annotations

import time
from pathlib import Path
from statistics import median

from lecombus.schedule import Cyclic, Outcome, Priority, Request, Schedule, WatchdogFeeding

from .table import Row, spread

__all__ = ["measure"]

WAITING = (10, 1_000, 100_000)
OPERATIONS = 4_000
DRIVES = [f"d{number}" for number in range(20)]
COST_S, WORST_S = 0.02, 0.1
MOST_SLOWER = 3.0
"""100,000 requests are 10,000 times 10; their logarithms are as 5 to 1."""


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure the schedule with few and with many requests waiting, in turns."""
    found: dict[int, list[float]] = {waiting: [] for waiting in WAITING}
    for _ in range(rounds):
        for waiting in WAITING:
            found[waiting].append(operations_per_s(waiting))
    few = found[WAITING[0]]
    return [
        Row(
            f"schedule operations with {waiting} requests waiting",
            f"{spread(found[waiting], 0)} /s",
            f"with {WAITING[0]} waiting",
            median(few) / median(found[waiting]),
            MOST_SLOWER if waiting != WAITING[0] else None,
            note="times as slow",
        )
        for waiting in WAITING
    ]


def operations_per_s(waiting: int) -> float:
    """Run exchanges on a schedule in which so many requests wait, in no time."""
    schedule = Schedule(limits=dict.fromkeys(Priority, 2 * waiting))
    for name in DRIVES:
        schedule.add_drive(name)
        schedule.add_cyclic(Cyclic(name, 1.0, lambda name=name: request(name, Priority.CYCLIC)), 0)  # type: ignore[misc]
        feeding = WatchdogFeeding(2.0, lambda name=name: request(name, Priority.WATCHDOG))  # type: ignore[misc]
        schedule.set_feeding(name, feeding, 0.0)
    for number in range(waiting):
        schedule.submit(waiting_one(number), 0.0)
    now_s, began_s = 0.0, time.process_time()
    for number in range(OPERATIONS):
        chosen = schedule.next(now_s)
        assert chosen is not None
        schedule.finished(chosen, now_s, now_s + COST_S, True)
        chosen.end(Outcome.DONE)
        now_s += COST_S
        if chosen.priority in (Priority.INTERACTIVE, Priority.BACKGROUND):
            schedule.submit(waiting_one(number), now_s)
    return OPERATIONS / (time.process_time() - began_s)


def waiting_one(number: int) -> Request:
    """Make the request of a client."""
    classes = (Priority.INTERACTIVE, Priority.BACKGROUND)
    return request(DRIVES[number % len(DRIVES)], classes[number // len(DRIVES) % 2])


def request(drive: str, priority: Priority) -> Request:
    """Make a request that nobody waits for."""
    return Request(drive, priority, COST_S, WORST_S, ended)


def ended(outcome: Outcome, reason: str) -> None:
    """Nobody waits."""
