"""Fault tables and link reports from their data files.

They are read when the first fault is looked up: a line without a fault never needs them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Final, TypeVar

from lecombus.errors import DescriptionError

from ..field_types import BothLanguages, CodeNumber, Flag, Source, Words, whole
from ..texts import NOTHING
from ..yaml_models import FILE_TABLE, ReadAs, ReadFile, YamlFile, by_key, open_data_file
from .fault_tables import (
    CommunicationError,
    ExtendedFault,
    Fault,
    FaultKind,
    FaultTable,
    LinkReport,
    kind_by_thousands,
)

__all__ = [
    "TABLES",
    "fault_table",
    "link_report",
    "load_table",
]

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
    extended = {
        number: replace(fault, class_text=file.classes[fault.classification])
        for number, fault in file.extended.items()
    }
    return LinkReport(extended, file.communication)


def _check_class(document: YamlFile, name: str, file: _LinkReportFile, *path: int | str) -> None:
    if name not in file.classes:
        known = ", ".join(file.classes)
        raise document.error(f"{name} is not known here; {known} are", *path)
