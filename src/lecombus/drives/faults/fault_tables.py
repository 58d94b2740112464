"""What a number in a fault memory means, and what a drive reports about the last exchange.

A `FaultTable` is the list of one or more families; `ExtendedFault` and `CommunicationError` explain
C1962 and bits 4 to 7 of C0068. Whether a fault is active is shown by the status words only
(`words`). The data files are read when the first fault is looked up: a line without a fault never
needs them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Annotated, Final, TypeVar

from pydantic import Field

from lecombus.drives.field_types import NOTHING, Text
from lecombus.errors import DescriptionError
from lecombus.parameters import Code

from ..field_types import BothLanguages, CodeNumber, Flag, Source, Words, whole
from ..yaml_models import (
    FILE_TABLE,
    ReadAs,
    ReadFile,
    YamlFile,
    by_key,
    open_data_file,
)

__all__ = [
    "NO_FAULT",
    "TABLES",
    "CommunicationError",
    "ExtendedFault",
    "Fault",
    "FaultKind",
    "FaultTable",
    "LinkReport",
    "fault_table",
    "fits_digit",
    "kind_by_thousands",
    "link_report",
    "load_table",
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
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    number: Annotated[int, whole(1, 255)]
    classification: Annotated[Words, Field(alias="class")]
    meaning: BothLanguages
    source: Source


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


TABLES: Final = ("82xx", "93xx", "smvector")
HIGHEST_NUMBER: Final = 9999

N = TypeVar("N", ExtendedFault, CommunicationError)


@cache
def fault_table(family: str) -> FaultTable | None:
    """Return the fault table of a family; None for one without, such as `generic`.

    Raises:
        DescriptionError: A data file is wrong.
    """
    return _by_family().get(family)


@cache
def _by_family() -> dict[str, FaultTable]:
    tables: dict[str, FaultTable] = {}
    for name in TABLES:
        table = load_table(name)
        for family in table.families:
            if family in tables:
                other = tables[family].name
                raise DescriptionError(f"{family} has its faults in {other} already", file=name)
            tables[family] = table
    return tables


@dataclass(frozen=True, kw_only=True)
class _FaultEntry:
    """One entry of `faults`: what all of its numbers mean."""

    __pydantic_config__ = FILE_TABLE

    numbers: tuple[Annotated[int, whole(1, HIGHEST_NUMBER)], ...]
    keypad: Words = ""
    kind: FaultKind | None = None
    meaning: BothLanguages
    cause: BothLanguages = NOTHING
    remedy: BothLanguages | None = None
    source: Source


@dataclass(frozen=True, kw_only=True)
class _FaultsFile:
    __pydantic_config__ = FILE_TABLE

    table: Words
    families: tuple[Words, ...]
    manual: Words
    memories: tuple[CodeNumber, ...]
    memories_source: Source
    look_up: BothLanguages
    faults: tuple[_FaultEntry, ...]
    thousands: Flag = False
    own_list: Flag = False


def load_table(name: str, read_file: ReadFile | None = None) -> FaultTable:
    """Build a fault table from its data file.

    Args:
        name: The file's name without `.yaml`; its `table` must be the same.
        read_file: Reads it; None: from this package.

    Raises:
        DescriptionError: The file is missing, or says something that cannot be.
    """
    document = open_data_file("faults", name, read_file)
    file = document.read(_FaultsFile)
    if file.table != name:
        raise document.error(f"the file is named {name}.yaml: table must be {name}", "table")
    return FaultTable(
        name=name,
        families=file.families,
        faults=_faults(document, file),
        thousands=file.thousands,
        memories=file.memories,
        look_up=file.look_up,
        source=file.memories_source,
        lecom_numbers=not file.own_list,
    )


def _faults(document: YamlFile, file: _FaultsFile) -> dict[int, Fault]:
    faults: dict[int, Fault] = {}
    for place, entry in enumerate(file.faults):
        if not entry.numbers:
            raise document.error("an entry needs at least one number", "faults", place)
        for item, number in enumerate(entry.numbers):
            if number in faults:
                path = ("faults", place, "numbers", item)
                raise document.error(f"fault {number} stands here twice", *path)
            faults[number] = Fault(
                number=number,
                keypad=entry.keypad,
                kind=entry.kind or kind_by_thousands(number),
                meaning=entry.meaning,
                cause=entry.cause,
                remedy=entry.remedy or file.look_up,
                source=entry.source,
            )
    return dict(sorted(faults.items()))


def _by_number(entries: tuple[N, ...]) -> dict[int, N]:
    return by_key(entries, lambda entry: entry.number)


@dataclass(frozen=True)
class _LinkReportFile:
    __pydantic_config__ = FILE_TABLE

    manual: Words
    classes: dict[Words, BothLanguages]
    extended: Annotated[Mapping[int, ExtendedFault], ReadAs(tuple[ExtendedFault, ...], _by_number)]
    communication: Annotated[
        Mapping[int, CommunicationError], ReadAs(tuple[CommunicationError, ...], _by_number)
    ]


@cache
def link_report(read_file: ReadFile | None = None) -> LinkReport:
    """Return what drives say about the last exchange, from `extended.yaml`.

    Raises:
        DescriptionError: The file is missing, or says something that cannot be.
    """
    document = open_data_file("faults", "extended", read_file)
    file = document.read(_LinkReportFile)
    for place, fault in enumerate(file.extended.values()):
        _check_class(document, fault.classification, file, "extended", place, "class")
    for place, given in enumerate(document.data["communication"]):
        for item, name in enumerate(given["allows"]):
            _check_class(document, name, file, "communication", place, "allows", item)
    return LinkReport(file.extended, file.communication)


def _check_class(document: YamlFile, name: str, file: _LinkReportFile, *path: int | str) -> None:
    if name not in file.classes:
        known = ", ".join(file.classes)
        raise document.error(f"{name} is not known here; {known} are", *path)
