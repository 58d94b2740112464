"""What the line's keys mean in seconds, for the cost model.

The one place that knows what an adapter adds where the roster does not say.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from lecombus.config.borders import is_network_port
from lecombus.config.models import LineEntry
from lecombus.drives import LineTiming

__all__ = ["adapter_latency_s", "line_timing", "with_slow_adapter"]

USB_LATENCY_S: Final = 0.016
"""The latency timer of FTDI adapters as shipped; other adapters stay below."""

NETWORK_LATENCY_S: Final = 0.050
"""A device server on the same site, with its own buffering."""
SIMULATED_LATENCY_S: Final = 0.005
"""No adapter at all, only a busy computer."""


LEAST_QUARANTINE_S: Final = 0.03
"""Silence after a failed exchange, besides twice the adapter's latency."""


def adapter_latency_s(line: LineEntry) -> float:
    """Return what the adapter adds to an answer, by the roster or else by the kind of port."""
    if line.adapter_latency_s is not None:
        return line.adapter_latency_s
    if is_network_port(line.port):
        return NETWORK_LATENCY_S
    return SIMULATED_LATENCY_S if line.port.startswith("sim:") else USB_LATENCY_S


def line_timing(line: LineEntry) -> LineTiming:
    """Return the line's times for `drives.costs`.

    The quarantine covers what an adapter may still have in its buffers. Answers later than that,
    up to `late_answer`, are not sat out but kept in doubt, which costs no line time.
    """
    latency_s = adapter_latency_s(line)
    return LineTiming(
        baud=line.baud,
        turnaround_s=line.turnaround_s,
        adapter_latency_s=latency_s,
        quarantine_s=min(line.late_answer_s, LEAST_QUARANTINE_S + 2.0 * latency_s),
    )


def with_slow_adapter(timing: LineTiming) -> LineTiming:
    """Give the times of a line whose adapter adds all that it may to every answer.

    Usual costs count the wire and the drive only: an adapter in its low latency mode adds a
    millisecond. What it may add stands in the time-outs, and here in the pause after each exchange.
    """
    pause_s = timing.turnaround_s + timing.adapter_latency_s
    return replace(timing, turnaround_s=pause_s, adapter_latency_s=0.0)
