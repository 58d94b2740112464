"""The port `sim:`: the roster's own drives, simulated inside the process.

For the demo, for trying a roster before the cabinet is wired, and for tests. It stands here and
not in the line room, because the line must know nothing of the simulator.
"""

from __future__ import annotations

from lecombus.config import Roster
from lecombus.line.opening import open_port
from lecombus.line.port import PortOpener
from lecombus.simulator.line import SimLine
from lecombus.simulator.memory import MemoryEnd
from lecombus.simulator.world import build

__all__ = ["SIM_URL", "opener_for", "simulated_line"]

SIM_URL = "sim:"


def simulated_line(roster: Roster, *, faults: str = "", seed: int = 0) -> SimLine:
    """Build the simulated drives of a roster."""
    drives = [(entry.name, entry.address, entry.family) for entry in roster.drives]
    return build(drives, baud=roster.line.baud, faults=faults, seed=seed)


def opener_for(roster: Roster) -> PortOpener:
    """Give what opens the roster's port: a real one, or `sim:`."""
    if roster.line.port != SIM_URL:
        return open_port
    return MemoryEnd(simulated_line(roster)).open
