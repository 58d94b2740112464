"""Reading a backup's file, with line and column in every error.

A file may have been written by hand or merged by git, so everything in it is checked: a code that
stands twice, a value that is none, a family that is not known are refused with their place. In
which section a code stands does not matter: what it is follows from its description.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Final

from pydantic import Field

from lecombus.drives import FAMILY_NAMES, family
from lecombus.drives.field_types import Words, read_words, whole
from lecombus.drives.yaml_models import FILE_TABLE, KEY, ReadBy, YamlFile, mistake
from lecombus.errors import CodeValueError
from lecombus.parameters import Code, Value

from .document import Backup, BackupEntry, Head, Section
from .writing import FORMAT_KEY, FORMAT_VERSION, NOT_READ

__all__ = ["read_backup"]

HIGHEST_FORMAT: Final = 1_000_000


def _read_family(given: object) -> str:
    if given not in FAMILY_NAMES:
        known = ", ".join(FAMILY_NAMES)
        raise mistake(f"there is no family {read_words(given)}; {known} are known")
    return str(given)


def _read_value(given: object) -> Value:
    """Read a value as it stands on the wire."""
    try:
        return Value.parse(read_words(given))
    except CodeValueError as exc:
        raise mistake(str(exc)) from exc


Values = dict[str, Annotated[Value, ReadBy(_read_value)]]


@dataclass(frozen=True, kw_only=True)
class _BackupFile:
    __pydantic_config__ = FILE_TABLE

    version: Annotated[int, whole(1, HIGHEST_FORMAT), Field(alias=FORMAT_KEY)]
    drive: Words
    line: Words
    address: Annotated[int, whole(1, 99)]
    family: Annotated[str, ReadBy(_read_family)]
    taken: Words
    lecombus: Words
    identity: Values = field(default_factory=dict)
    parameters: Values = field(default_factory=dict)
    module: Values = field(default_factory=dict)
    process: Values = field(default_factory=dict)
    undescribed: Values = field(default_factory=dict)
    not_read: Annotated[dict[str, Words], Field(alias=NOT_READ)] = field(default_factory=dict)


def read_backup(text: str, file: str) -> Backup:
    """Read a backup.

    Args:
        text: The file's content.
        file: Its name, for errors.

    Raises:
        ConfigError: It is no backup, or something in it cannot be.
    """
    document = YamlFile(text, file, untrusted=True)
    if FORMAT_KEY not in document.data:
        raise document.error(
            f"this is no backup: it does not begin with {FORMAT_KEY}: {FORMAT_VERSION}"
        )
    version = document.data[FORMAT_KEY]
    # Checked first: a later format may have keys that are not known here, or lack some.
    if isinstance(version, str) and version.isdecimal() and int(version[:7]) > FORMAT_VERSION:
        message = f"a later lecombus wrote this: format {FORMAT_VERSION} is read here"
        raise document.error(message, FORMAT_KEY)
    backup = document.read(_BackupFile)
    head = Head(
        drive=backup.drive,
        line=backup.line,
        address=backup.address,
        family=backup.family,
        taken=backup.taken,
        version=backup.lecombus,
    )
    read = document.read(_BackupFile)
    entries: dict[Code, BackupEntry] = {}
    for section in (*Section, NOT_READ):
        values: dict[str, Value | str] = getattr(read, section.replace("-", "_"))
        for key, value in values.items():
            entry = _entry(document, section, key, value)
            other = entries.setdefault(entry.code, entry)
            if other is not entry:
                message = f"{entry.code} stands in this file twice: also at {other.place}"
                raise document.error(message, section, key, KEY)
    head = Head(
        drive=read.drive,
        line=read.line,
        address=read.address,
        family=read.family,
        taken=read.taken,
        version=read.lecombus,
    )
    return Backup(head, family(head.family), dict(sorted(entries.items())), name=file)


def _entry(document: YamlFile, section: str, key: str, value: Value | str) -> BackupEntry:
    place = document.place(section, key, KEY)
    try:
        code = Code.parse(key)
    except CodeValueError as exc:
        raise document.error(str(exc), section, key, KEY) from exc
    if isinstance(value, Value):
        return BackupEntry(code, value, place=place)
    return BackupEntry(code, None, missing=value, place=place)
