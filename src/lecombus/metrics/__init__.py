"""Metrics of one line for Prometheus: instruments, and a page that never holds up a telegram.

`Metrics` is made by `LineRuntime`; `counters` counts, `gauges` reads current values, `exposition`
writes lines and `page` decides when. Nothing here is global: two lines in one process (as in tests)
share nothing.
"""

from __future__ import annotations

from lecombus.metrics.counters import TELEGRAM_KINDS, TELEGRAM_OUTCOMES, Counters
from lecombus.metrics.exposition import OPENMETRICS_TYPE, TEXT_TYPE, wants_openmetrics
from lecombus.metrics.gauges import LeaseFigures, LineSnapshot
from lecombus.metrics.page import Metrics

__all__ = [
    "OPENMETRICS_TYPE",
    "TELEGRAM_KINDS",
    "TELEGRAM_OUTCOMES",
    "TEXT_TYPE",
    "Counters",
    "LeaseFigures",
    "LineSnapshot",
    "Metrics",
    "wants_openmetrics",
]
