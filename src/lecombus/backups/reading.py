"""Reading a backup's file, with every complaint at its line and column.

A file may have been written by hand or merged by git, so nothing in it is taken on trust: a code
that stands twice, a value that is none, a family that is not known are refused with their place.
In which section a code stands does not matter: what it is follows from its description.

What must not live here: what is done with a backup.
"""

from __future__ import annotations

from typing import Final

from lecombus.drives import FAMILY_NAMES, family
from lecombus.drives.document import Item, Origin, Table, read_document
from lecombus.errors import CodeValueError
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value

from .document import Backup, Entry, Head, Section
from .writing import FORMAT_KEY, FORMAT_VERSION, NOT_READ

__all__ = ["read_backup"]

HIGHEST_FORMAT: Final = 1_000_000


def read_backup(text: str, file: str) -> Backup:
    """Read a backup.

    Args:
        text: The file's content.
        file: Its name, for complaints.

    Raises:
        ConfigError: It is no backup, or something in it cannot be.
    """
    table = read_document(text, Origin(file, ""), foreign=True)
    version = table.get(FORMAT_KEY)
    if version is None:
        table.fail(f"this is no backup: it does not begin with {FORMAT_KEY}: {FORMAT_VERSION}")
    if version.integer(1, HIGHEST_FORMAT) > FORMAT_VERSION:
        version.fail(f"a later lecombus wrote this: format {FORMAT_VERSION} is read here")
    head = read_head(table)
    entries: dict[Code, Entry] = {}
    for section in Section:
        for key, value in pairs(table, section.value):
            put(entries, key, Entry(read_code(key), read_value(value), place=key.place))
    for key, value in pairs(table, NOT_READ):
        put(entries, key, Entry(read_code(key), None, missing=value.text(), place=key.place))
    table.done()
    return Backup(head, family(head.family), dict(sorted(entries.items())), name=file)


def read_head(table: Table) -> Head:
    """Read whose backup it is."""
    name = table.take("family")
    if name.text() not in FAMILY_NAMES:
        name.fail(f"there is no family {name.text()}; {', '.join(FAMILY_NAMES)} are known")
    return Head(
        drive=table.take("drive").text(),
        line=table.take("line").text(),
        address=table.take("address").integer(1, 99),
        family=name.text(),
        taken=table.take("taken").text(),
        version=table.take("lecombus").text(),
    )


def pairs(table: Table, key: str) -> list[tuple[Item, Item]]:
    """Give the keys and values of a section that may be missing."""
    item = table.get(key)
    return list(item.table().pairs()) if item is not None else []


def put(entries: dict[Code, Entry], key: Item, entry: Entry) -> None:
    """Take an entry, unless its code stands in the file already, however it is written there."""
    other = entries.get(entry.code)
    if other is not None:
        key.fail(f"{entry.code} stands in this file twice: also at {other.place}")
    entries[entry.code] = entry


def read_code(key: Item) -> Code:
    """Read a code."""
    try:
        return Code.parse(key.text())
    except CodeValueError as exc:
        key.fail(str(exc))


def read_value(item: Item) -> Value:
    """Read a value as it stands on the wire."""
    try:
        return Value.parse(item.text())
    except CodeValueError as exc:
        item.fail(str(exc))
