"""What a number in a fault memory means, and what a drive reports about the last exchange.

A `FaultTable` is the list of one or more families; `ExtendedFault` and `CommunicationError` explain
C1962 and bits 4 to 7 of C0068. Whether a fault is active is shown by the status words only
(`words`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from pydantic import Field

from lecombus.parameters import Code

from ..field_types import BothLanguages, Source, Words, whole
from ..texts import NOTHING, Text
from ..yaml_models import FILE_TABLE, NOT_A_KEY

__all__ = [
    "NO_FAULT",
    "CommunicationError",
    "ExtendedFault",
    "Fault",
    "FaultKind",
    "FaultTable",
    "LinkReport",
    "fits_digit",
    "kind_by_thousands",
]

NO_FAULT = 0
"""What every fault memory holds that holds none. Source: EDB2102EN 8.2; CMVLC401A 9.1."""

THOUSAND = 1000
DIGIT_MAX = 0xF


class FaultKind(StrEnum):
    """What a fault does to the drive."""

    TRIP = "trip"
    """The drive is off until the fault is reset."""
    MESSAGE = "message"
    """The pulses are inhibited for as long as it lasts; it goes by itself."""
    WARNING = "warning"
    """The drive goes on."""


def kind_by_thousands(number: int) -> FaultKind:
    """Return the kind of a number: TRIP n, message 1000 + n, warning 2000 + n.

    Source: EDB2102EN 8.2 (fault memory P93XX; OU and LU under P82XX).
    """
    kinds = {1: FaultKind.MESSAGE, 2: FaultKind.WARNING}
    return kinds.get(number // THOUSAND, FaultKind.TRIP)


def fits_digit(number: int, digit: int) -> bool:
    """Return whether a fault number can be the one that C0068 shows the tens digit of.

    A digit of 0 says nothing: it stands for a number below 10 too, and for no fault at all. Of a
    number of three digits either the digit itself or all tens may be shown (105: 0, or 10).

    Args:
        number: LECOM fault number.
        digit: Bits 0 to 3 of C0068.

    Source: EDB2102EN 8.2 (C0068): TRIP OH = 5, its number being 50.
    """
    tens = number % THOUSAND // 10
    return digit == 0 or digit in (tens % 10, tens & DIGIT_MAX)


@dataclass(frozen=True, slots=True)
class Fault:
    """What one LECOM fault number means.

    Args:
        number: As it stands in the fault memory.
        keypad: What the keypad shows; empty where the manual gives nothing.
        kind: TRIP, message or warning.
        meaning: What it is.
        cause: What usually lies behind it; empty where the manual does not say.
        remedy: What to do.
        source: Manual and section.
    """

    number: int
    keypad: str
    kind: FaultKind
    meaning: Text
    cause: Text
    remedy: Text
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class FaultTable:
    """The faults of the families that share one list.

    Args:
        name: The data file's name.
        families: Whose list it is.
        faults: By number.
        thousands: A number is looked up without its thousands too, and they give its kind.
        memories: The codes of the fault memory, the active or newest fault first.
        look_up: What to do about a fault of which the manual names no remedy, or does not list.
        source: Manual and section of the fault memory.
        lecom_numbers: The memory holds LECOM fault numbers, whose tens digit C0068 shows. An
            SMVector's P500 has another list, and its C0068 shows a digit of another scale.
    """

    name: str
    families: tuple[str, ...]
    faults: Mapping[int, Fault]
    thousands: bool
    memories: tuple[Code, ...]
    look_up: Text
    source: str
    lecom_numbers: bool = True

    def fits(self, number: int, digit: int) -> bool:
        """Return whether a number can be the fault that C0068 shows a digit of (bits 0 to 3)."""
        return not self.lecom_numbers or fits_digit(number, digit)

    def fault(self, number: int) -> Fault | None:
        """Return a fault by its number; None for no fault, or a number the manual does not list."""
        found = self.faults.get(number)
        if found is not None or not self.thousands:
            return found
        # The same fault with another reaction than the manual's list has it with.
        for known in (number % THOUSAND + add for add in (0, THOUSAND, 2 * THOUSAND)):
            like = self.faults.get(known)
            if like is not None and number < 3 * THOUSAND:
                kind = kind_by_thousands(number)
                return Fault(
                    number, like.keypad, kind, like.meaning, like.cause, like.remedy, like.source
                )
        return None


@dataclass(frozen=True, slots=True)
class ExtendedFault:
    """One extended fault number of the 2102 module (C1962).

    Args:
        number: As read.
        classification: The manual's class of it, as a word.
        meaning: What it is.
        class_text: What the class is called.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    number: Annotated[int, whole(1, 255)]
    classification: Annotated[Words, Field(alias="class")]
    meaning: BothLanguages
    source: Source
    class_text: Annotated[Text, NOT_A_KEY] = NOTHING


@dataclass(frozen=True, slots=True)
class CommunicationError:
    """One communication error (C0068 bits 4 to 7).

    Args:
        number: As read.
        meaning: What it is.
        allows: Classes of C1962 that can stand beside it.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    number: Annotated[int, whole(1, 15)]
    meaning: BothLanguages
    allows: frozenset[Words]
    source: Source


@dataclass(frozen=True, slots=True, eq=False)
class LinkReport:
    """What drives say about the last exchange.

    Args:
        extended: Extended fault numbers (C1962).
        communication: Communication errors (C0068 bits 4 to 7).
    """

    extended: Mapping[int, ExtendedFault]
    communication: Mapping[int, CommunicationError]
