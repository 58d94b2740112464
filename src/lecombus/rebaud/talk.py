"""What is said to drives at which baud rate, and what is heard.

Strategy: one step is one telegram with its answer, or a pause. An interruption lets the step under
way end and is raised before the next one, so that what a telegram brought is always known.

Must not live here: telegrams, time-outs, repetitions of reads (`line`).
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.rebaud.drives import Drive

__all__ = ["Came", "InterruptedTalkError", "Read", "Said", "Step", "Steps", "Talk", "Wait", "Write"]


@dataclass(frozen=True, slots=True)
class Read:
    """Read a code.

    Args:
        baud: At this baud rate, bit/s.
        drive: The drive's name.
        code: What to read.
        retries: How often a failed attempt is repeated.
    """

    baud: int
    drive: str
    code: Code
    retries: int


@dataclass(frozen=True, slots=True)
class Write:
    """Write a code, once; never repeated by whoever carries this out."""

    baud: int
    drive: str
    code: Code
    value: Value


@dataclass(frozen=True, slots=True)
class Wait:
    """Say nothing for some seconds."""

    baud: int
    for_s: float


Step = Read | Write | Wait


class Came(StrEnum):
    """What came back."""

    VALUE = "value"
    DONE = "done"
    """The write was acknowledged."""
    REFUSED = "refused"
    """NAK, or no such code: the drive is there, and nothing was changed."""
    NOTHING = "nothing"
    """Nothing usable, so nothing is known."""


@dataclass(frozen=True, slots=True)
class Said:
    """What came of a step.

    Args:
        came: What it was.
        value: The value, if it was one.
        text: What went wrong, for people.
    """

    came: Came
    value: Value | None = None
    text: str = ""


T = TypeVar("T")
Steps = Generator[Step, Said, T]

SURELY = 2
"""How often a read is repeated of a drive that is known to be there."""


class InterruptedTalkError(Exception):
    """Somebody wants this to end: no further telegram is begun."""


class Talk:
    """Says things, until it is interrupted.

    Attributes:
        interrupted: Set from outside; the step under way ends, no further one begins.
    """

    def __init__(self) -> None:
        self.interrupted = False

    def read(self, drive: Drive, baud: int, code: Code, *, retries: int = SURELY) -> Steps[Said]:
        """Read a code of a drive."""
        return (yield from self._say(Read(baud, drive.name, code, retries)))

    def wait(self, baud: int, for_s: float) -> Steps[None]:
        """Say nothing for some seconds."""
        yield from self._say(Wait(baud, for_s))

    def write(self, drive: Drive, baud: int, code: Code, number: int) -> Steps[Said]:
        """Write a number to a code of a drive, once."""
        return (yield from self._say(Write(baud, drive.name, code, Value.decimal(number))))

    def look(self, drive: Drive, baud: int, *, retries: int = 0) -> Steps[int | None]:
        """Ask a drive for the number of its baud rate; None: it does not answer with one."""
        said = yield from self.read(drive, baud, drive.subject.code, retries=retries)
        number = said.value.number if said.value is not None else None
        if number is None or isinstance(number, (str, bytes)) or number != int(number):
            return None
        return int(number)

    def go_on(self) -> None:
        """See that nobody wants this to end.

        Raises:
            InterruptedTalkError: Somebody does.
        """
        if self.interrupted:
            raise InterruptedTalkError

    def _say(self, step: Step) -> Steps[Said]:
        self.go_on()
        return (yield step)
