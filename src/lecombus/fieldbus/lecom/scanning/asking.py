"""What a scan asks of a line, and the answers.

A question goes to an address, not to a drive: silence is an answer to it. So is "no such code",
which only a drive can say. Every answer repeats its question's code, so that a late answer of one
address is not taken for that of another (see `search`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.operations.address_reads import Heard, HeardKind
from lecombus.parameters import AddressForm, Code

__all__ = ["AddressAccess", "Heard", "HeardKind", "Question", "read_surely"]

TRIES = 3
"""How often a drive that is known to be there is asked for one code."""


@dataclass(frozen=True, slots=True)
class Question:
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
    form: AddressForm = Form.STANDARD
    family: str = "generic"
    patient: bool = False


class AddressAccess(Protocol):
    """A line on which addresses are asked: a port of a command, or a running daemon."""

    async def ask(self, ask: Question) -> Heard:
        """Read a code at an address, once."""

    async def listen(self, baud: int, for_s: float) -> Heard:
        """Send nothing for some seconds; return what was heard."""


async def read_surely(access: AddressAccess, ask: Question) -> Heard:
    """Ask a drive that is there until its answer is certain.

    One damaged character turns a value into "no such code", so that must come twice.
    """
    refusals = 0
    heard = Heard(HeardKind.SILENCE)
    for _ in range(TRIES):
        heard = await access.ask(ask)
        if heard.kind is HeardKind.VALUE:
            return heard
        if heard.kind is HeardKind.NO_SUCH_CODE:
            refusals += 1
            if refusals == 2:
                return heard
    return heard if heard.kind is not HeardKind.NO_SUCH_CODE else Heard(HeardKind.GARBLED)
