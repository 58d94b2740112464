"""Simulated drives: bytes in, bytes out, on a pseudo terminal, a TCP port or in memory.

Start reading at `line.SimLine`. The room has its own tables and its own code, from the manuals, and
shares only control characters and block check with the master's `protocol/`: a mistake made on both
sides would prove nothing.

What must not live here: rosters, which the caller maps; and clocks, threads or descriptors in what
simulates the line and its drives: only the ends (`pty`, `tcp`, `memory`), `pacing` and
`control_socket` use them.
"""

from __future__ import annotations

from .control import Control, ControlError
from .control_socket import LONGEST_PATH, ControlSocket, send_to_simulator
from .drive import SimDrive
from .faults import Faults, LateKind, parse_faults
from .line import SimLine, build
from .memory import MemoryEnd, MemoryPort
from .pty import PtyEnd
from .tcp import TcpEnd

__all__ = [
    "LONGEST_PATH",
    "Control",
    "ControlError",
    "ControlSocket",
    "Faults",
    "LateKind",
    "MemoryEnd",
    "MemoryPort",
    "PtyEnd",
    "SimDrive",
    "SimLine",
    "TcpEnd",
    "build",
    "parse_faults",
    "send_to_simulator",
]
