"""The line time of the exchanges that a roster asks for, and the times of its line.

Uses the cost model of the protocol, as the schedule and the time-outs do, so that a plan and the
running line use the same numbers. Turnaround is included in all costs: the line is busy then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from lecombus.drives import confirm_codes, family, stop_value
from lecombus.fieldbus.costs import Cost, ExchangeCosts, LineTiming
from lecombus.fieldbus.protocols import find
from lecombus.parameters import Code, Value
from lecombus.roster import DriveEntry, LineEntry, is_network_port

__all__ = [
    "Times",
    "adapter_latency_s",
    "dearest_feed_times",
    "dearest_read_times",
    "feed_times",
    "line_timing",
    "own_longest_s",
    "read_times",
    "stop_attempt_s",
    "stop_s",
    "watched_s",
    "with_slow_adapter",
    "write_times",
]


USB_LATENCY_S: Final = 0.016
"""The latency timer of FTDI adapters as shipped; other adapters stay below."""
NETWORK_LATENCY_S: Final = 0.050
"""A device server on the same site, with its own buffering."""
SIMULATED_LATENCY_S: Final = 0.005
"""No adapter at all, only a busy computer."""
LEAST_QUARANTINE_S: Final = 0.03
"""Silence after a failed exchange, besides twice the adapter's latency."""


@dataclass(frozen=True, slots=True)
class Times:
    """The line time of one exchange, in seconds, turnaround included.

    Args:
        usual_s: Answered as usual.
        given_up_s: Until its answer is given up: a stop may go out then.
        worst_s: One attempt that fails, with the silence kept after it.
    """

    usual_s: float
    given_up_s: float
    worst_s: float


def read_times(drive: DriveEntry, code: Code, timing: LineTiming) -> Times:
    """Give the times of reading a code, in the drive's usual way."""
    return _times(timing, _costs(drive).reads(timing, drive, code)[:1])


def dearest_read_times(drive: DriveEntry, code: Code, timing: LineTiming) -> Times:
    """Give the times of reading a code in the longest way in which the drive is asked for it.

    While a late answer could be taken for one in the usual way, another one is used.
    """
    return _times(timing, _costs(drive).reads(timing, drive, code))


def write_times(drive: DriveEntry, code: Code, value: Value, timing: LineTiming) -> Times:
    """Give the times of writing a code, in the drive's usual way."""
    return _times(timing, [_costs(drive).write(timing, drive, code, value)])


def _costs(drive: DriveEntry) -> ExchangeCosts:
    return find(family(drive.family).protocol).costs


def _times(timing: LineTiming, costs: Sequence[Cost]) -> Times:
    """Give the longest of some costs, with the turnaround."""
    return Times(
        max(cost.expected_s for cost in costs) + timing.turnaround_s,
        max(cost.whole_s for cost in costs) + timing.turnaround_s,
        max(cost.worst_s for cost in costs) + timing.turnaround_s,
    )


def feed_times(drive: DriveEntry, timing: LineTiming) -> Times:
    """Give the times of the cheapest read, which feeds a watchdog."""
    return read_times(drive, family(drive.family).feed_code, timing)


def dearest_feed_times(drive: DriveEntry, timing: LineTiming) -> Times:
    """Give the times of a feed in the longer form, which is used after a lost answer."""
    return dearest_read_times(drive, family(drive.family).feed_code, timing)


def watched_s(drive: DriveEntry) -> float | None:
    """Give the time of a watchdog that lecombus has to feed, seconds; None: there is none."""
    watchdog = drive.watchdog
    if watchdog is None or watchdog.action == "none" or watchdog.time_s <= 0.0:
        return None
    return watchdog.time_s


def own_longest_s(drive: DriveEntry, timing: LineTiming) -> float:
    """Give the longest line time of one exchange that the program makes by itself, seconds.

    Its reads, its feed, and the write that stops it: nothing else can feed it during that time.
    """
    of = family(drive.family)
    codes = [of.feed_code, *(entry.code for entry in drive.cyclic)]
    reads = [read_times(drive, code, timing).usual_s for code in codes]
    stops = [write_times(drive, *stop_value(of, one, 0), timing).usual_s for one in of.stops]
    return max(*reads, *stops)


def own_alone_s(drive: DriveEntry, timing: LineTiming) -> tuple[float, float]:
    """Give for how long a drive is not fed from the beginning of a write on, seconds.

    A module that acknowledges early is left alone then; whether it does is known only when it was
    asked. Until then one that acknowledges when it has done the write is left alone as well.

    Returns:
        After a write that is acknowledged soon, and after the longest write that stops it; zero for
        a family that is not left alone.
    """
    of = family(drive.family)
    hold_s, soon_s = of.hold_after_write_s, feed_times(drive, timing).usual_s
    if hold_s <= 0.0:
        return 0.0, 0.0
    stops = [write_times(drive, *stop_value(of, one, 0), timing).usual_s for one in of.stops]
    return hold_s + soon_s, hold_s + max(soon_s, *stops)


def stop_s(drive: DriveEntry, timing: LineTiming) -> float:
    """Give the line time of stopping a drive and reading back that it stopped, seconds.

    Zero for a family that knows no stop.
    """
    of = family(drive.family)
    stops = [
        write_times(drive, *stop_value(of, action, 0), timing).usual_s
        + read_times(drive, confirm_codes(of, action)[0], timing).usual_s
        for action in of.stops
    ]
    return max(stops, default=0.0)


def stop_attempt_s(drive: DriveEntry, timing: LineTiming) -> float:
    """Give the longest that one unanswered telegram of a drive's stop holds the line, seconds.

    Sent in any way; zero for a family that knows no stop.
    """
    costs = _costs(drive).stop_attempts(timing, drive)
    return _times(timing, costs).worst_s if costs else 0.0


def adapter_latency_s(line: LineEntry) -> float:
    """Return what the adapter adds to an answer, by the roster or else by the kind of port."""
    if line.adapter_latency_s is not None:
        return line.adapter_latency_s
    if is_network_port(line.port):
        return NETWORK_LATENCY_S
    return SIMULATED_LATENCY_S if line.port.startswith("sim:") else USB_LATENCY_S


def line_timing(line: LineEntry) -> LineTiming:
    """Return the line's times, by which exchanges cost what they do.

    The quarantine covers what an adapter may still have in its buffers. Answers later than that,
    up to `late_answer`, are not sat out (`exchanges.late_answers`), which costs no line time.
    """
    latency_s = adapter_latency_s(line)
    return LineTiming(
        baud=line.baud,
        turnaround_s=line.turnaround_s,
        adapter_latency_s=latency_s,
        quarantine_s=min(line.late_answer_s, LEAST_QUARANTINE_S + 2.0 * latency_s),
        bits_per_char=find(line.protocol).bits_per_char,
    )


def with_slow_adapter(timing: LineTiming) -> LineTiming:
    """Give the times of a line whose adapter adds all that it may to every answer.

    Usual costs count the wire and the drive only: an adapter in its low latency mode adds a
    millisecond. What it may add stands in the time-outs, and here in the pause after each exchange.
    """
    pause_s = timing.turnaround_s + timing.adapter_latency_s
    return replace(timing, turnaround_s=pause_s, adapter_latency_s=0.0)
