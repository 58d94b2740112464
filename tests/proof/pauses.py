"""How long the host leaves the line and each drive alone, measured on the wire.

* Between the end of an answer and the next telegram lies the turnaround, whatever comes next.
* After a telegram that drew nothing at all the line stays silent for twice the time that the drive
  may think, what adapter and computer add, and the quarantine; a stop alone breaks it.
* After a multicast the slowest member has its processing time.
* A module that acknowledges before it has passed a value on (C1921 = 1) hears nothing meanwhile:
  no telegram but that of a stop goes to it.

The figures are those of the manual and of the roster, reckoned here without the daemon's; how long
a drive may think is asked of the simulated drive. Source: EDB2102EN 3.4, 6.3.2, 8.3.4, 8.3.5.
"""

from __future__ import annotations

from collections.abc import Callable

from lecombus.fieldbus.lecom.simulator.drive import SimDrive
from lecombus.fieldbus.lecom.simulator.families.f82xx import Drive82XX
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.fieldbus.lecom.simulator.receiver import ReceivedRequest
from proof.lines import RandomLine
from proof.telegrams import CHARACTER_BITS, Telegram

__all__ = ["Pauses"]

ROUNDING_S = 1e-6
ADAPTER_S = 0.005
"""What the roster's port, a simulated one, may add."""
LATENESS_S = 0.020
QUARANTINE_S = 0.030 + 2.0 * ADAPTER_S
MOST_STRAY = 3
"""Noise may put so many characters behind an answer: the host does not wait for them."""
LIMIT_S = 0.5
"""Answer times of the module's own codes are limits already: a fifth more, not twice."""


class Pauses:
    """Watches the pauses of one line.

    Args:
        line: The line.
        sim: Its drives.
        say: Told what did not hold.
    """

    def __init__(self, line: RandomLine, sim: SimLine, say: Callable[[str], None]) -> None:
        self._sim = sim
        self._say = say
        # Old answers, or copies of them, may stand between an answer and the next telegram.
        self._sole = line.is_told_apart and "stubborn" not in line.faults
        # Whether a module acknowledges early is read; a copy of another's answer may say no.
        self._known_busy = line.is_told_apart
        stray = MOST_STRAY if line.faults else 0  # what noise appends is not a part of an answer
        self._turnaround_s = line.roster.line.turnaround_s - stray * CHARACTER_BITS / sim.host_baud
        # An EOT has no checksum: one that noise made within an answer ends it for the host.
        self._made_ends = "noise" in line.faults
        self._left_alone: dict[int, float] = {}

    def drives_heard(self, at_s: float, heard: ReceivedRequest) -> None:
        """A request has come to the drives: a module may be busy with it from here on."""
        if heard.text is None or heard.damaged:
            return
        for drive in self._reached(heard.address):
            model = drive.model
            if isinstance(model, Drive82XX) and model.shortened():
                self._left_alone[drive.address] = at_s + model.shortened_s

    def _reached(self, address: int) -> list[SimDrive]:
        if address % 10:
            return [drive for drive in self._sim.drives if drive.address == address]
        decade = address // 10
        return [drive for drive in self._sim.drives if not decade or drive.address // 10 == decade]

    def said(self, one: Telegram) -> None:
        """A telegram goes out."""
        one.busy_until_s = self._left_alone.get(one.address, 0.0)

    def judge(self, before: Telegram | None, one: Telegram) -> None:
        """Judge the pause before a telegram."""
        if before is None:
            return
        if before.answered and before.answer_end_s is not None and self._sole:
            end_s = before.answer_end_s
            if self._made_ends and before.ended_s is not None:
                end_s = min(end_s, before.ended_s)
            self._need(one, end_s + self._turnaround_s, "of its turnaround")
        if before.group:
            self._need(one, before.end_s + self._slowest_s(before), "of a multicast's members")
        elif not before.heard and not one.stop:
            silent_s = self._patience_s(before) + ADAPTER_S + LATENESS_S + QUARANTINE_S
            self._need(one, before.end_s + silent_s, "of the silence after a lost answer")
        if not one.stop and self._known_busy:
            self._need(one, one.busy_until_s, "for which the drive is busy with a write")

    def _need(self, one: Telegram, from_s: float, what: str) -> None:
        short_s = from_s - one.said_s
        if short_s > ROUNDING_S:
            self._say(f"a telegram to {one.address} came {short_s * 1000:.1f} ms short {what}")

    def _slowest_s(self, one: Telegram) -> float:
        members = self._reached(one.address)
        return max((self._think_s(drive, one) for drive in members), default=0.0)

    def _patience_s(self, one: Telegram) -> float:
        think_s = max((self._think_s(d, one) for d in self._reached(one.address)), default=0.0)
        return think_s * (1.2 if think_s >= LIMIT_S else 2.0)

    @staticmethod
    def _think_s(drive: SimDrive, one: Telegram) -> float:
        write = one.text is not None
        return drive.model.think_s(one.code[0], write=write, now_s=one.end_s + 10.0)
