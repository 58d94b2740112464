"""What a scan says on the line, and what it hears.

A question goes to an address, not to a drive: silence is an answer to it. So is "no such code",
which only a drive can say. Every answer repeats its question's code, which is how a scan keeps one
address's late answer from passing for another's (see `search`).

Must not live here: telegrams and time-outs (`line`); what comes back is `operations`' `Heard`.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

from lecombus.operations.address_reads import Heard, HeardKind
from lecombus.protocol.addressing import Code, Form

__all__ = ["Ask", "Heard", "HeardKind", "Listen", "Reading", "Step", "read_surely"]

TRIES = 3
"""How often a drive that is known to be there is asked the same."""


@dataclass(frozen=True, slots=True)
class Ask:
    """Read a code at an address.

    Args:
        baud: At this baud rate, bit/s.
        address: 1..99, not ending in 0.
        code: What to read.
        form: In this addressing form and no other.
        family: Whose answer times to wait by; the most patient is `820x`.
        patient: Wait longer than any description says: something came late.
    """

    baud: int
    address: int
    code: Code
    form: Form = Form.STANDARD
    family: str = "generic"
    patient: bool = False


@dataclass(frozen=True, slots=True)
class Listen:
    """Say nothing and hear whether somebody else speaks."""

    baud: int
    for_s: float


Step = Ask | Listen
Reading = Generator[Step, Heard, Heard]


def read_surely(ask: Ask) -> Reading:
    """Ask a drive that is there until its answer can be relied on.

    One damaged character makes "no such code" of a value, so that is believed when heard twice.
    """
    refusals = 0
    heard = Heard(HeardKind.SILENCE)
    for _ in range(TRIES):
        heard = yield ask
        if heard.kind is HeardKind.VALUE:
            return heard
        if heard.kind is HeardKind.NO_SUCH_CODE:
            refusals += 1
            if refusals == 2:
                return heard
    return heard if heard.kind is not HeardKind.NO_SUCH_CODE else Heard(HeardKind.GARBLED)
