"""Faults of the drives: numbers, keypad texts, meanings, causes and remedies, from data files.

`fault_tables` has the classes, the `*.yaml` beside it the data with the manuals' sections.
`fault_files` reads a file when the first fault is looked up.
"""

from __future__ import annotations

from .fault_files import TABLES, fault_table, link_report, load_table
from .fault_tables import (
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
    "load_table",
]
