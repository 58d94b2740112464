"""Metrics of one line for Prometheus: instruments, and a page that never holds up a telegram.

`Metrics` is what the daemon makes; `meters` counts, `figures` reads off, `text` writes lines and
`page` decides when. Nothing here is global: two lines in one process (as in tests) share nothing.
"""

from __future__ import annotations

from lecombus.metrics.figures import Figures
from lecombus.metrics.meters import TELEGRAM_KINDS, TELEGRAM_OUTCOMES, Meters
from lecombus.metrics.page import Metrics
from lecombus.metrics.text import OPENMETRICS_TYPE, TEXT_TYPE, wants_openmetrics

__all__ = [
    "OPENMETRICS_TYPE",
    "TELEGRAM_KINDS",
    "TELEGRAM_OUTCOMES",
    "TEXT_TYPE",
    "Figures",
    "Meters",
    "Metrics",
    "wants_openmetrics",
]
