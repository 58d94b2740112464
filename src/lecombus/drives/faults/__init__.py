"""Faults of the drives: numbers, keypad texts, meanings, causes and remedies, from data files.

`model` has the classes, the `*.yaml` beside it the data with the manuals' sections. `loading` reads
a file when the first fault is looked up.
"""

from __future__ import annotations

from .loading import TABLES, fault_table, link_report, load_link_report, load_table
from .model import (
    NO_FAULT,
    CommunicationError,
    ExtendedFault,
    Fault,
    FaultKind,
    FaultTable,
    LinkReport,
    fits_digit,
    kind_by_thousands,
)

__all__ = [
    "NO_FAULT",
    "TABLES",
    "CommunicationError",
    "ExtendedFault",
    "Fault",
    "FaultKind",
    "FaultTable",
    "LinkReport",
    "fault_table",
    "fits_digit",
    "kind_by_thousands",
    "link_report",
    "load_link_report",
    "load_table",
]
