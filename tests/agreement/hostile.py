"""A simulated line whose drives, when told to, hold an exchange up for as long as they can.

Drives answer at their family's longest time. An answer that is to be lost begins at the last
moment at which it may, drips in with the longest pauses that are granted, and never ends.
"""

from __future__ import annotations

from dataclasses import dataclass

from lecombus.config import Roster, line_timing
from lecombus.fieldbus.lecom.simulator import SimLine
from lecombus.fieldbus.lecom.simulator.drive import SimDrive
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.lecom.simulator.receiver import ReceivedRequest
from support.drives import presets

__all__ = ["Drip", "HostileLine", "hostile_line"]

PAUSE_PART = 0.7
"""Of the longest pause that is granted inside an answer."""


@dataclass(frozen=True)
class Drip:
    """How an answer is to be lost.

    Args:
        first_s: When its first character arrives, on the line's clock.
        end_s: By when it would have to be complete.
        gap_s: The longest pause that is granted in it, seconds.
    """

    first_s: float
    end_s: float
    gap_s: float


class HostileLine(SimLine):
    """The line.

    Args:
        drives: Its drives.
        baud: Its baud rate.
        adapter_s: What the adapter may add to an answer, seconds; more is the machine's lateness.

    Attributes:
        late_s: How late the ends of answers were handed over in all, seconds.
    """

    def __init__(self, drives: list[SimDrive], baud: int, adapter_s: float) -> None:
        super().__init__(drives, baud=baud)
        self.late_s = 0.0
        self._adapter_s = adapter_s
        self._end_late_s = 0.0
        self._drips: dict[int, Drip] = {}

    def poll(self, now_s: float) -> bytes:
        """Give what has arrived, and note how late its last byte is."""
        due_s = max((at_s for at_s, *_ in self._outbox.runs if at_s <= now_s), default=None)
        if due_s is not None:
            self._end_late_s = max(0.0, now_s - due_s - self._adapter_s)
        return super().poll(now_s)

    def receive(self, data: bytes, now_s: float) -> None:
        """Take a telegram: the answer before it is over."""
        self.late_s += self._end_late_s
        self._end_late_s = 0.0
        super().receive(data, now_s)

    def lose(self, address: int, drip: Drip) -> None:
        """Lose the next answer of a drive."""
        self._drips[address] = drip

    def _ask(self, drive: SimDrive, heard: ReceivedRequest, at_s: float, faults: Faults) -> None:
        drip = self._drips.pop(drive.address, None)
        if drip is None or drip.first_s < at_s:  # none, or it came too late for its exchange
            super()._ask(drive, heard, at_s, faults)
            return
        reply = drive.hear(heard, at_s, self._spoiler.rng)
        if reply is None or len(reply.data) < 4:  # an acknowledgement: it does not come at all
            return
        byte_s = drip.first_s
        for byte in reply.data[:-2]:
            if byte_s >= drip.end_s:
                break
            self._outbox.put(byte_s, bytes((byte | (byte.bit_count() & 1) << 7,)), None)
            byte_s += PAUSE_PART * drip.gap_s


def hostile_line(roster: Roster) -> HostileLine:
    """Put a roster's drives on a line, their watchdogs set as it wants them."""
    adapter_s = line_timing(roster.line).adapter_latency_s
    drives = [
        SimDrive(entry.address, entry.family, entry.name, presets(entry), log_size=1)
        for entry in roster.drives
    ]
    return HostileLine(drives, roster.line.baud, adapter_s)
