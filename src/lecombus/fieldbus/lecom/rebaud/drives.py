"""The drives of a line while its baud rate is changed: what is known of each, reads and writes.

Strategy: `place` says where a drive is as far as anybody knows, `rate` only what it answered at
last. What was not seen is never assumed: a drive that was written to and not read
afterwards is `written`, also after an acknowledgement.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from lecombus.drives import Family
from lecombus.drives.procedures import DriveAccess, ReadAttempt, WriteAttempt
from lecombus.fieldbus.lecom.address_codes import baud_code, baud_numbers
from lecombus.parameters import AddressForm, Code, Value

__all__ = [
    "DrivePlace",
    "InterruptedRebaudError",
    "LineAccess",
    "RebaudDrive",
    "RebaudLine",
    "Subject",
]


class DrivePlace(StrEnum):
    """Where a drive is."""

    UNSEEN = "unseen"
    """It has not been asked yet."""
    OLD = "old"
    """It answers at the old baud rate and holds it."""
    WRITTEN = "written"
    """Another rate was written to it, and it has not been seen since."""
    PENDING = "pending"
    """It answers at one rate and holds the other: it changes when it is switched off and on."""
    NEW = "new"
    """It answers at the new baud rate and holds it, and is the same drive."""
    LOST = "lost"
    """Another rate was written to it, and it answers at neither."""


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """A drive of the roster.

    Args:
        name: Its name.
        address: 1..99, not ending in 0.
        family: Its description.
        form: The addressing form it is spoken to in: extended where it knows that, because C0248
            and C0249 do not redirect it.
        asked: Codes of its identity.
        expected: What they must read, where that is known, by code.
        accept_software: Software that may be written to besides that of its manual.
    """

    name: str
    address: int
    family: Family
    form: AddressForm
    asked: tuple[Code, ...] = ()
    expected: Mapping[Code, str] = field(default_factory=dict)
    accept_software: tuple[str, ...] = ()

    @property
    def code(self) -> Code:
        """The code of its baud rate."""
        return baud_code(self.family)

    @property
    def spoken(self) -> str:
        """The code of its baud rate as its keypad names it."""
        return self.family.spoken(self.code)

    def number(self, baud: int) -> int | None:
        """What that code is at a baud rate, bit/s; None: it knows no such rate."""
        return baud_numbers(self.family).get(baud)


@dataclass(slots=True, eq=False)
class RebaudDrive:
    """What is known of one drive.

    Args:
        subject: The drive.
        place: Where it is.
        rate: The baud rate at which it was last seen, bit/s; None: nowhere.
        why: What went wrong with it; empty where nothing did.
        identity: What it said of itself when it was checked.
        motion: What it says of its motion; empty: it was not asked.
        note: What its watchdog will do; empty: nothing.
        writes: How often a rate was written to it on the present way.
        saved: Whether the rate it has outlives switching off, for a drive that has to save it;
            None: it was never written here, or needs no saving.
    """

    subject: Subject
    place: DrivePlace = DrivePlace.UNSEEN
    rate: int | None = None
    why: str = ""
    identity: Mapping[Code, Value] = field(default_factory=dict)
    motion: str = ""
    note: str = ""
    writes: int = 0
    saved: bool | None = None

    @property
    def name(self) -> str:
        """Its name."""
        return self.subject.name

    def is_seen(self) -> bool:
        """Whether it answers at a rate that is known."""
        return self.rate is not None

    def be(self, place: DrivePlace, rate: int | None, why: str = "") -> None:
        """Note where it is."""
        self.place, self.rate, self.why = place, rate, why


TRIES_MORE = 2
"""How often a read is repeated of a drive that is known to be there."""


class LineAccess(Protocol):
    """A line without a daemon; a call at another baud rate reopens its port at that rate."""

    def at(self, baud: int, drive: str, *, retries: int) -> DriveAccess:
        """Return a drive at a baud rate, bit/s; `retries`: how often a failed read is repeated."""

    async def wait(self, baud: int, for_s: float) -> None:
        """Send nothing for some seconds, with the port open at a baud rate."""


class InterruptedRebaudError(Exception):
    """The user interrupted the change: no further telegram is begun."""


class RebaudLine:
    """Reads and writes at either baud rate.

    An interruption lets the telegram under way end and is raised before the next one, so that the
    result of a telegram is always known.

    Attributes:
        access: The line; set by each procedure before its first telegram.
        interrupted: Whether the user has interrupted; set from outside.
    """

    access: LineAccess

    def __init__(self) -> None:
        self.interrupted = False

    async def read(
        self, drive: RebaudDrive, baud: int, code: Code, *, retries: int = TRIES_MORE
    ) -> ReadAttempt:
        """Read a code of a drive."""
        self.check_interruption()
        return await self.access.at(baud, drive.name, retries=retries).read(code)

    async def wait(self, baud: int, for_s: float) -> None:
        """Send nothing for some seconds."""
        self.check_interruption()
        await self.access.wait(baud, for_s)

    async def write(self, drive: RebaudDrive, baud: int, code: Code, number: int) -> WriteAttempt:
        """Write a number to a code of a drive, once."""
        self.check_interruption()
        access = self.access.at(baud, drive.name, retries=0)
        return await access.write(code, Value.decimal(number), verify=False)

    async def read_rate(self, drive: RebaudDrive, baud: int, *, retries: int = 0) -> int | None:
        """Read the number of a drive's baud rate; None: it does not answer with one."""
        answer = await self.read(drive, baud, drive.subject.code, retries=retries)
        return answer.value.whole if answer.value is not None else None

    def check_interruption(self) -> None:
        """Raise if the user has interrupted.

        Raises:
            InterruptedRebaudError: The user has.
        """
        if self.interrupted:
            raise InterruptedRebaudError
