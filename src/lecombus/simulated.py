"""The port `sim:`: the roster's own drives, simulated inside the process.

For the demo, for trying a roster before the cabinet is wired, and for tests. It stands here and
not in the line room, because the line must know nothing of the simulator. The simulator is loaded
where it is used: a daemon that starts again has watchdogs to feed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lecombus.config import Roster
from lecombus.fieldbus.port import PortOpener
from lecombus.line.opening import open_port

if TYPE_CHECKING:
    from lecombus.fieldbus.lecom.simulator.line import SimLine

__all__ = ["SIM_URL", "opener_for", "simulated_line"]

SIM_URL = "sim:"


def simulated_line(roster: Roster, *, faults: str = "", seed: int = 0) -> SimLine:
    """Build the simulated drives of a roster."""
    from lecombus.fieldbus.lecom.simulator.line import build

    drives = [(entry.name, entry.address, entry.family) for entry in roster.drives]
    return build(drives, baud=roster.line.baud, faults=faults, seed=seed)


def opener_for(roster: Roster) -> PortOpener:
    """Give what opens the roster's port: a real one, or `sim:`."""
    if roster.line.port != SIM_URL:
        return open_port
    from lecombus.fieldbus.lecom.simulator.memory import MemoryEnd

    return MemoryEnd(simulated_line(roster)).open
