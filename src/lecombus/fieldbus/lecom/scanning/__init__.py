"""Finding out what is on a line: which addresses answer, what each drive is, and a roster for it.

`asking` holds a question and its answer, `search` the order of addresses and baud rates,
`identifying` how families are distinguished, `diagnosis` why a line gives no answers, `proposal`
the roster.

Pure: coroutines here await nothing but `AddressAccess`, which the command carries out on a port of
its own or through a running daemon, and tests on a simulated line. It has no way to write to a
drive.
"""

from __future__ import annotations

from .asking import Heard, HeardKind, Question
from .diagnosis import why_nothing
from .identifying import FoundDrive, FoundWatchdog, Unclear
from .proposal import ProposedLine, check_place, entries, propose
from .search import ForeignTalkError, Scan, ScanPlan

__all__ = [
    "ForeignTalkError",
    "FoundDrive",
    "FoundWatchdog",
    "Heard",
    "HeardKind",
    "ProposedLine",
    "Question",
    "Scan",
    "ScanPlan",
    "Unclear",
    "check_place",
    "entries",
    "propose",
    "why_nothing",
]
