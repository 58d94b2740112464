"""Fault tables from their data files: read when the first fault is looked up, then kept.

Strategy: as for families, the YAML nodes themselves are walked, so that a mistake is shown with
file, line and column. A number given twice, an entry without a source, a text in one language
only, a word nobody knows: all are refused. Reading the files takes milliseconds, and a line
without a fault never needs them; that is why nothing here runs at import.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import resources
from typing import Final

from lecombus.errors import DescriptionError

from ..document import Item, Origin, Table, read_document
from ..readers import read_code_number, read_source, read_text
from ..texts import NOTHING, Text
from .model import (
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
    "ReadFile",
    "fault_table",
    "link_report",
    "load_link_report",
    "load_table",
    "open_document",
    "packaged",
]

TABLES: Final = ("82xx", "93xx", "smvector")
HIGHEST_NUMBER: Final = 9999
HIGHEST_EXTENDED: Final = 255
HIGHEST_ERROR: Final = 15

ReadFile = Callable[[str], str]


@cache
def fault_table(family: str) -> FaultTable | None:
    """Give the fault table of a family; None for one without, such as `generic`.

    Raises:
        DescriptionError: A data file is wrong.
    """
    return _by_family().get(family)


@cache
def link_report() -> LinkReport:
    """Give what drives say about the last exchange.

    Raises:
        DescriptionError: The data file is wrong.
    """
    return load_link_report(packaged)


@cache
def _by_family() -> dict[str, FaultTable]:
    tables: dict[str, FaultTable] = {}
    for name in TABLES:
        table = load_table(name, packaged)
        for family in table.families:
            if family in tables:
                other = tables[family].name
                raise DescriptionError(f"{family} has its faults in {other} already", file=name)
            tables[family] = table
    return tables


def packaged(file: str) -> str:
    """Give the text of a data file of this package."""
    return (resources.files(__package__) / file).read_text(encoding="utf-8")


def load_table(name: str, read_file: ReadFile) -> FaultTable:
    """Build a fault table from its data file.

    Args:
        name: The file's name without `.yaml`; its `table` must be the same.
        read_file: Gives the text of a file by its name with `.yaml`.

    Raises:
        DescriptionError: The file is missing, or says something that cannot be.
    """
    document = open_document(name, read_file)
    own = document.take("table")
    if own.text() != name:
        own.fail(f"the file is named {name}.yaml: table must be {name}")
    manual = document.take("manual").text()
    look_up = read_text(document.take("look_up"))
    thousands, own_list = document.get("thousands"), document.get("own_list")
    table = FaultTable(
        name=name,
        families=tuple(item.text() for item in document.take("families").items()),
        faults=_faults(document.take("faults"), manual, look_up),
        thousands=thousands.flag() if thousands else False,
        memories=tuple(read_code_number(item) for item in document.take("memories").items()),
        look_up=look_up,
        source=f"{manual} {document.take('memories_source').text()}",
        lecom_numbers=not (own_list and own_list.flag()),
    )
    document.done()
    return table


def load_link_report(read_file: ReadFile) -> LinkReport:
    """Build what drives say about the last exchange from `extended.yaml`.

    Raises:
        DescriptionError: The file is missing, or says something that cannot be.
    """
    document = open_document("extended", read_file)
    manual = document.take("manual").text()
    classes = {
        key.text(): read_text(item) for key, item in document.take("classes").table().pairs()
    }
    extended: dict[int, ExtendedFault] = {}
    for number, entry in _numbered(document.take("extended"), HIGHEST_EXTENDED):
        name = _known(entry.take("class"), classes)
        extended[number] = ExtendedFault(
            number,
            name,
            read_text(entry.take("meaning")),
            classes[name],
            read_source(entry, manual),
        )
        entry.done()
    communication: dict[int, CommunicationError] = {}
    for number, entry in _numbered(document.take("communication"), HIGHEST_ERROR):
        allows = frozenset(_known(item, classes) for item in entry.take("allows").items())
        communication[number] = CommunicationError(
            number, read_text(entry.take("meaning")), allows, read_source(entry, manual)
        )
        entry.done()
    document.done()
    return LinkReport(extended, communication)


def open_document(name: str, read_file: ReadFile) -> Table:
    """Open a data file by its name without `.yaml`.

    Raises:
        DescriptionError: It is missing, or no YAML.
    """
    file = f"{name}.yaml"
    try:
        text = read_file(file)
    except (OSError, KeyError) as exc:
        raise DescriptionError("there is no such data file", file=f"faults/{file}") from exc
    return read_document(text, Origin(f"faults/{file}", name))


def _faults(entries: Item, manual: str, look_up: Text) -> dict[int, Fault]:
    faults: dict[int, Fault] = {}
    for item in entries.items():
        for fault, number in _read_fault(item.table(), manual, look_up):
            if fault.number in faults:
                number.fail(f"fault {fault.number} stands here twice")
            faults[fault.number] = fault
    return dict(sorted(faults.items()))


def _read_fault(entry: Table, manual: str, look_up: Text) -> Iterator[tuple[Fault, Item]]:
    """Read one entry: its words, for every number it stands for."""
    numbers = entry.take("numbers").items()
    shown = entry.get("keypad")
    kind = entry.get("kind")
    cause, remedy = entry.get("cause"), entry.get("remedy")
    keypad = shown.text() if shown else ""
    words = (
        read_text(entry.take("meaning")),
        read_text(cause) if cause else NOTHING,
        read_text(remedy) if remedy else look_up,
        read_source(entry, manual),
    )
    entry.done()
    if not numbers:
        entry.fail("an entry needs at least one number")
    for item in numbers:
        number = item.integer(1, HIGHEST_NUMBER)
        yield Fault(number, keypad, _kind(kind, number), *words), item


def _kind(item: Item | None, number: int) -> FaultKind:
    if item is None:
        return kind_by_thousands(number)
    return FaultKind(_known(item, FaultKind))


def _numbered(entries: Item, high: int) -> Iterator[tuple[int, Table]]:
    """Give each entry with its number; none may come twice."""
    seen: set[int] = set()
    for item in entries.items():
        entry = item.table()
        place = entry.take("number")
        number = place.integer(1, high)
        if number in seen:
            place.fail(f"{number} stands here twice")
        seen.add(number)
        yield number, entry


def _known(item: Item, known: Iterable[str]) -> str:
    words = tuple(known)
    if item.text() not in words:
        item.fail(f"{item.text()} is not known here; {', '.join(words)} are")
    return item.text()
