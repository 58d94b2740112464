"""In which order several drives are written to and proven, so that all of it ends soonest.

A write is sent, then its drive may have to be left alone for a while, then it is read back. While
one drive is left alone the line speaks to the others; so the longest waits must begin first, to run
under the others' exchanges. That is Jackson's rule for jobs with delivery times: the longest tail
first (J. R. Jackson, "Scheduling a production line to minimize maximum tardiness", 1955). It gives
the least time where the tails need no line. Here they end with a telegram, the proof, which makes a
two-stage shop with delays of it. No quick rule is known that is always best (it is
NP-hard: W. Yu, J. A. Hoogeveen and J. K. Lenstra, J. of Scheduling 7, 2004): one short tail ahead
of the long ones may fill the gap before the first proof. So the order by tails is taken if it
leaves the line no idle moment, which no order can beat; else single drives are moved for as long
as that saves time. Against every permutation of small groups of the families' own times the tests
find nothing better.

How the line serves the steps is the schedule's: a proof whose drive may be spoken to again goes
ahead of the writes still to be sent (`Schedule.again`).

Pure: times in seconds, no word of any protocol.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final

__all__ = ["Part", "least_order", "took_s"]

MOST_MOVED: Final = 16
"""In larger groups nothing is moved: the others' exchanges hide every wait but the last few, and
the event loop has other things to do."""

LEAST_GAIN_S: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Part:
    """What one drive of a group takes of the line.

    Args:
        say_s: The write with its acknowledgement, seconds.
        wait_s: How long the drive is then left alone, seconds.
        prove_s: Reading it back, seconds; 0: it is not read back.
    """

    say_s: float
    wait_s: float
    prove_s: float


def least_order(parts: Sequence[Part]) -> list[int]:
    """Find the order in which to send them that has all of them sent and verified soonest.

    Returns:
        Indices into `parts`; among equal ones in the order they were given.
    """
    order = sorted(range(len(parts)), key=lambda index: (-parts[index].wait_s, parts[index].say_s))
    if len(parts) > MOST_MOVED:
        return order
    least_s, best_s = _bound_s(parts), took_s(parts[index] for index in order)
    while best_s > least_s + LEAST_GAIN_S:
        moved = min(_moves(order, parts), key=lambda move: move[0], default=None)
        if moved is None or moved[0] > best_s - LEAST_GAIN_S:
            break
        best_s, order = moved
    return order


def took_s(parts: Iterable[Part]) -> float:
    """Reckon how long the line is at it, if nothing else is asked of it, seconds."""
    now_s, waiting = 0.0, list[tuple[float, float]]()
    for part in parts:
        while waiting and waiting[0][0] <= now_s:
            now_s += heappop(waiting)[1]
        now_s += part.say_s
        if part.prove_s:
            heappush(waiting, (now_s + part.wait_s, part.prove_s))
    while waiting:
        ready_s, prove_s = heappop(waiting)
        now_s = max(now_s, ready_s) + prove_s
    return now_s


def _bound_s(parts: Sequence[Part]) -> float:
    """Less than this no order takes: the line is never idle, and each drive waits its time."""
    busy_s = sum(part.say_s + part.prove_s for part in parts)
    alone_s = (part.say_s + part.wait_s + part.prove_s for part in parts if part.prove_s)
    return max(busy_s, *alone_s, 0.0)


def _moves(order: list[int], parts: Sequence[Part]) -> Iterable[tuple[float, list[int]]]:
    """Return every order that differs by the place of one part, with the time it takes."""
    for place, index in enumerate(order):
        if place and parts[index] == parts[order[place - 1]]:
            continue  # moving its equal did the same
        others = order[:place] + order[place + 1 :]
        for to in range(len(order)):
            if to != place:
                moved = [*others[:to], index, *others[to:]]
                yield took_s(parts[one] for one in moved), moved
