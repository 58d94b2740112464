"""A backup in memory, and its file: YAML that a person reads and git compares line by line.

In memory: whose it is, and what every code read, in the order of codes, which is also the order of
parameter sets. Where a code stands in the file (settings, process values, identity) follows from
its description and is never stored, so that a better description sorts old files better.

Strategy: one line a code, always in the same place and with the same comment column, so that a
changed value is one changed line. Values are written as they stand on the wire, numbers with the
digits the drive sent. Name, unit and meaning are comments: they say what stands there and are
never read back. The only line that differs between two backups of an unchanged drive is `taken`,
and, apart in their own section, process values.

A file may have been written by hand or merged by git, so everything in it is checked when it is
read: a code that stands twice, a value that is none, a family that is not known are refused with
line and column. In which section a code stands in a file that is read does not matter.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Final

import yaml
from pydantic import Field

from lecombus.drives import CodeInfo, Family, Storage, WriteClass, family, must_be_same
from lecombus.drives.field_types import Words, read_words, whole
from lecombus.drives.yaml_models import FILE_TABLE, KEY, ReadBy, YamlFile, mistake
from lecombus.errors import CodeValueError
from lecombus.fieldbus.protocols import family_names, protocol_of
from lecombus.parameters import HEX_DIGITS, Code, Format, Value

__all__ = [
    "Backup",
    "BackupEntry",
    "BackupHead",
    "Section",
    "is_own",
    "meaning_of",
    "read_backup",
    "section_of",
    "wanted_codes",
    "write_backup",
]


class Section(StrEnum):
    """Where a code stands in the file, and what it is for a comparison."""

    IDENTITY = "identity"
    """What is at the other end: software, drive ID."""
    PARAMETERS = "parameters"
    """Settings that the drive keeps."""
    MODULE = "module"
    """Settings of the fieldbus module, lost at power-off."""
    PROCESS = "process"
    """Setpoints, commands, actual values, fault memories: how the drive was just then."""
    UNDESCRIBED = "undescribed"
    """Read because the user asked for it; no description knows it."""


@dataclass(frozen=True, slots=True)
class BackupHead:
    """Whose backup it is.

    Args:
        drive: The drive's name in the roster.
        line: The line's name.
        address: 1..99.
        family: The family's name.
        taken: When, RFC 3339.
        version: lecombus' version.
    """

    drive: str
    line: str
    address: int
    family: str
    taken: str
    version: str


@dataclass(frozen=True, slots=True)
class BackupEntry:
    """One code of a backup.

    Args:
        code: The code.
        value: What it read; None where it could not be read.
        missing: Why not, as a stable word.
        place: Where it stands, `FILE:LINE:COLUMN`; empty when it was read from a drive.
    """

    code: Code
    value: Value | None
    missing: str = ""
    place: str = ""


@dataclass(frozen=True, slots=True)
class Backup:
    """All that was read of one drive at one time.

    Args:
        head: Whose it is.
        family: Its family.
        entries: What each code read, by code.
        name: What the user calls it: a file or a drive.
    """

    head: BackupHead
    family: Family
    entries: Mapping[Code, BackupEntry] = field(default_factory=dict)
    name: str = ""

    def of(self, section: Section) -> list[BackupEntry]:
        """Give the entries that were read and belong into a section, in order."""
        return [
            entry for entry in self.entries.values()
            if entry.value is not None and section_of(self.family, entry.code) is section
        ]  # fmt: skip

    @property
    def not_read(self) -> list[BackupEntry]:
        """The entries that could not be read, in order."""
        return [entry for entry in self.entries.values() if entry.value is None]


def section_of(family: Family, code: Code) -> Section:
    """Say where a code stands."""
    info = family.info(code)
    if code in family.identity or code in must_be_same(family):
        return Section.IDENTITY
    if info is None:
        return Section.UNDESCRIBED
    if info.format is Format.VS and not info.writable:
        return Section.IDENTITY  # what a drive says of itself in words never changes by itself
    kept = {Storage.STORED: Section.PARAMETERS, Storage.MODULE: Section.MODULE}
    # A number that is kept and cannot be set, such as the hours run, is not a setting either.
    return kept.get(info.storage, Section.PROCESS) if info.writable else Section.PROCESS


def is_own(info: CodeInfo | None) -> bool:
    """Whether a code belongs to one drive's place on the line: address and baud rate."""
    return info is not None and info.write_class is WriteClass.ADDRESS


def wanted_codes(family: Family, also: Iterable[Code] = ()) -> tuple[Code, ...]:
    """Name the codes that a backup holds: all that are described and can be read.

    Passwords are never read; other codes only where the user names them.

    Args:
        family: The drive's family.
        also: Further codes, which no description needs to know.
    """
    described = {
        info.code
        for info in family.described()
        if info.readable and not info.secret and not info.array
    } | set(family.identity)
    return tuple(sorted(code for code in described | set(also) if not family.is_secret(code)))


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
_HEXADECIMAL: Final = re.compile(r"0[xX]([0-9A-Fa-f]+)", re.ASCII)


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
    """Read a value as it stands on the wire; a word may be written `0x0208`, too."""
    text = read_words(given)
    hexadecimal = _HEXADECIMAL.fullmatch(text)
    if hexadecimal is not None:
        digits = hexadecimal[1]
        text = "H" + digits.zfill(next((n for n in HEX_DIGITS if n >= len(digits)), 0))
    try:
        return Value.parse(text)
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
        ConfigError: It is not a backup, or something in it cannot be.
    """
    document = YamlFile(text, file, untrusted=True)
    if FORMAT_KEY not in document.data:
        raise document.error(
            f"this is not a backup: it does not begin with {FORMAT_KEY}: {FORMAT_VERSION}"
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
    head = BackupHead(
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
