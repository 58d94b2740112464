"""The port `sim:`: the roster's own drives, simulated inside the process.

For the demo, for trying a roster before the cabinet is wired, and for tests. The simulator is the
protocol's, and loaded where it is used: a daemon that starts again has watchdogs to feed.
"""

from __future__ import annotations

from typing import Final

from lecombus.config import Roster
from lecombus.fieldbus.port import PortOpener
from lecombus.fieldbus.protocols import find
from lecombus.line.opening import open_port

__all__ = ["SIM_URL", "opener_for"]

SIM_URL: Final = "sim:"


def opener_for(roster: Roster) -> PortOpener:
    """Give what opens the roster's port: a real one, or `sim:`."""
    if roster.line.port != SIM_URL:
        return open_port
    return find(roster.line.protocol).simulator(roster)
