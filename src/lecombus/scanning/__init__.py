"""Finding out what is on a line: which addresses answer, what each drive is, and a roster for it.

Read `asking` for what is asked and heard, `search` for the order of addresses and baud rates,
`identifying` for how families are told apart, `diagnosis` for what is said of a line that gives no
answers, `proposal` for the roster that comes of it.

Everything here is written as generators that yield what is to be said and are sent what was heard:
whether a port of its own or a running daemon says it is the caller's business. Nothing here ever
writes to a drive; there is no way to.

Must not live here: input or output of any kind, time, HTTP, progress bars.
"""

from __future__ import annotations

from lecombus.scanning.asking import Ask, Heard, HeardKind, Listen
from lecombus.scanning.diagnosis import why_nothing
from lecombus.scanning.finding import Finding, FoundWatchdog, Unclear
from lecombus.scanning.proposal import Place, check_place, entries, propose
from lecombus.scanning.search import ForeignTalkError, Plan, Scan

__all__ = [
    "Ask",
    "Finding",
    "ForeignTalkError",
    "FoundWatchdog",
    "Heard",
    "HeardKind",
    "Listen",
    "Place",
    "Plan",
    "Scan",
    "Unclear",
    "check_place",
    "entries",
    "propose",
    "why_nothing",
]
