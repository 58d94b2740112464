"""What is known of each drive while the baud rate of its line is changed.

Strategy: `place` says where a drive is as far as anybody knows, `rate` only what it answered at
last. What was not seen is never assumed: a drive whose write was not followed by a look is
`written`, also after an acknowledgement.

Must not live here: what is said to drives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from lecombus.drives import Family
from lecombus.fieldbus.lecom.address_codes import baud_code, baud_numbers
from lecombus.parameters import AddressForm, Code, Value

__all__ = ["DrivePlace", "RebaudDrive", "Subject"]


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
