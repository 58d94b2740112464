"""A backup's file: YAML that a person reads and git compares line by line.

Strategy: one line a code, always in the same place and with the same comment column, so that a
changed value is one changed line. Values are written as they stand on the wire, numbers with the
digits the drive sent. Name, unit and meaning are comments: they say what stands there and are
never read back. The only line that differs between two backups of an unchanged drive is `taken`,
and, apart in their own section, process values.

A file may have been written by hand or merged by git, so everything in it is checked when it is
read: a code that stands twice, a value that is none, a family that is not known are refused with
line and column. In which section a code stands does not matter: what it is follows from its
description.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final

import yaml
from pydantic import Field

from lecombus.drives import CodeInfo, Family, family
from lecombus.drives.field_types import Words, read_words, whole
from lecombus.drives.yaml_models import FILE_TABLE, KEY, ReadBy, YamlFile, mistake
from lecombus.errors import CodeValueError
from lecombus.fieldbus.protocols import family_names, protocol_of
from lecombus.parameters import Code, Value

from .document import Backup, BackupEntry, Head, Section

__all__ = ["meaning_of", "read_backup", "write_backup"]

FORMAT_KEY: Final = "lecombus-backup"
FORMAT_VERSION: Final = 1
NOT_READ: Final = "not-read"

COMMENT_COLUMN: Final = 28

INTRODUCTION: Final = """\
# What lecombus read of one drive. Values are as on the wire; `lecombus diff` compares two such
# files or drives, `lecombus restore` writes parameters and module back. Comments are not read.
"""

SECTION_COMMENTS: Final[Mapping[Section, str]] = {
    Section.IDENTITY: "What was at the other end.",
    Section.PARAMETERS: "Settings that the drive keeps.",
    Section.MODULE: "Settings of the fieldbus module, lost at power-off.",
    Section.PROCESS: "How the drive was just then: compared only with --all, never restored.",
    Section.UNDESCRIBED: "Codes that no description knows: compared, never restored.",
}

WHY_NOT: Final[Mapping[str, str]] = {
    "no-such-code": "the drive does not know it",
    "no-answer": "the drive did not answer",
}

_PLAIN: Final = re.compile(r"-?(0|[1-9][0-9]*)(\.[0-9]+)?|H[0-9A-F]+", re.ASCII)
"""What YAML takes for a number or a text without quotes, and gives back letter by letter; octets
such as OFF are none of it."""

_WORD: Final = re.compile(r"[A-Za-z0-9-]+", re.ASCII)


def write_backup(backup: Backup) -> str:
    """Return the text of a backup's file."""
    head = backup.head
    lines = [
        f"{FORMAT_KEY}: {FORMAT_VERSION}",
        f"drive: {quoted(head.drive)}",
        f"line: {quoted(head.line)}",
        f"address: {head.address}",
        f"family: {quoted(head.family)}",
        f"taken: {quoted(head.taken)}",
        f"lecombus: {quoted(head.version)}",
    ]
    for section in Section:
        entries = backup.of(section)
        if entries:
            lines += ["", f"# {SECTION_COMMENTS[section]}", f"{section}:"]
            lines += entry_lines(backup.family, entries)
    if backup.not_read:
        lines += ["", "# What could not be read.", f"{NOT_READ}:"]
        lines += entry_lines(backup.family, backup.not_read)
    return INTRODUCTION + "\n".join(lines) + "\n"


def entry_lines(family: Family, entries: Iterable[BackupEntry]) -> Iterator[str]:
    """Give one line for each entry, and a comment where another parameter set begins."""
    parameter_set = 1
    for entry in entries:
        info = family.info(entry.code)
        if info is not None and info.parameter_set != parameter_set:
            parameter_set = info.parameter_set
            yield f"  # parameter set {parameter_set}"
        text = f"  {entry.code}: {value_text(entry)}"
        comment = comment_of(family, info, entry)
        yield f"{text:<{COMMENT_COLUMN - 1}} # {comment}" if comment else text


def value_text(entry: BackupEntry) -> str:
    """Return a value, or why there is none, as it stands in the file."""
    if entry.value is None:
        return quoted(entry.missing)
    raw = entry.value.raw
    return raw if _PLAIN.fullmatch(raw) else quoted(raw)


def comment_of(family: Family, info: CodeInfo | None, entry: BackupEntry) -> str:
    """Return what a person wants to know of a line: name, unit, meaning, or why it is missing."""
    if info is None:
        return ""
    name = " ".join(filter(None, (family.keypad_name(entry.code), info.name)))
    if entry.value is None:
        why = WHY_NOT.get(entry.missing, "")
        return f"{name}: {why}" if why else name
    meaning = meaning_of(info, entry.value)
    unit = f", {info.unit}" if info.unit else ""
    return name + unit + (f" = {meaning}" if meaning else "")


def meaning_of(info: CodeInfo | None, value: Value | None) -> str:
    """Return the selection's text for a value; empty where it has none."""
    meaning = info.meaning(value) if info is not None and value is not None else None
    return str(meaning) if meaning is not None else ""


def quoted(text: str) -> str:
    """Return a text as any reader of YAML gives it back; words that are only text stay plain."""
    if _WORD.fullmatch(text) and yaml.safe_load(text) == text:
        return text
    return json.dumps(text)


# ---- reading it ------------------------------------------------------------------------------

HIGHEST_FORMAT: Final = 1_000_000


def _read_family(given: object) -> str:
    if not isinstance(given, str) or protocol_of(given) is None:
        known = ", ".join(family_names())
        raise mistake(f"there is no family {read_words(given)}; {known} are known")
    return given


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
