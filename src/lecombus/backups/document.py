"""A backup in memory: whose it is, and what every code read.

Strategy: entries are kept by code in the order of codes, which is also the order of parameter
sets. Where a code stands in the file (settings, process values, identity)
follows from its description and is never stored, so that a better description sorts old files
better.

What must not live here: the file's text, any drive.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from lecombus.drives import CodeInfo, Family, Storage, WriteClass, must_be_same
from lecombus.parameters import Code, Format, Value

__all__ = ["Backup", "BackupEntry", "Head", "Section", "is_own", "section_of", "wanted_codes"]


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
class Head:
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

    head: Head
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
    # A number that is kept and cannot be set, such as the hours run, is no setting either.
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
    secret = {info.code for info in family.described() if info.secret}
    return tuple(sorted((described | set(also)) - secret))
