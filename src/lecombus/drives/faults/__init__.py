"""Faults of the drives: numbers, keypad texts, meanings, causes and remedies, from data files.

`model` says what a fault is, the `*.yaml` beside it what is known and from which manual section,
`loading` makes the one of the other when somebody first asks.
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
