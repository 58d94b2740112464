"""A line with a group that is a decade and one that is not, for the tests of groups and stops."""

from __future__ import annotations

from lecombus.drives import StopAction
from lecombus.parameters import Code
from support.rosters import roster_text
from support.site_host import Plant

TEENS = [("a", 11, "8200vector"), ("b", 12, "8200vector"), ("c", 13, "821x")]
MIXED = [*TEENS, ("d", 21, "smvector"), ("g", 22, "generic")]
STATUS, SETPOINT, ENABLE, PLAIN, WORD = Code(150), Code(46), Code(40), Code(11), Code(135)
MODULE = Code(1920)  # not stored: written without being read first
WRITABLE = "cyclic: [], writable: [C0011, C0040, C0043, C0046, C0135, C1920]"
GROUPS = "groups:\n  teens: {members: [a, b, c], multicast: yes}\n  two: {members: [a, b]}\n"
ROSTER = roster_text(MIXED, drive=WRITABLE, sections=GROUPS)
CAUTIOUS = ROSTER.replace(", multicast: yes", "")
"""The same without the word that no other drive hears the group's telegram."""
QUICK, INHIBIT = StopAction.QUICK_STOP, StopAction.INHIBIT


def written(plant: Plant, since: int) -> list[bytes]:
    """The addresses that were written to since the so-manieth telegram."""
    return [one.data[1:3] for one in plant.end.sent[since:] if b"\x02" in one.data]
