"""What two backups differ in.

Strategy: numbers are compared as numbers (35 is 35.0, H0008 is 8), texts as texts. A code that
only one side has, or that one side could not read, is a difference: it was not shown that it is
equal. Left out, unless everything is asked for: process values, what belongs to one drive's place
on the line (address, baud rate), and the identity of the drives; the last becomes a remark.
"""

from __future__ import annotations

from dataclasses import dataclass

from lecombus.drives import Family
from lecombus.parameters import Code

from .backup_file import Backup, BackupEntry, Section, is_own, meaning_of, section_of
from .restore_plan import digits_for_a_word

__all__ = ["Comparison", "Difference", "compare"]


@dataclass(frozen=True, slots=True)
class Difference:
    """One code that two backups differ in.

    Args:
        code: The code.
        family: The family whose description names it.
        name: Its name, with the keypad's where that differs from the code.
        unit: Its unit, where it has one.
        one: What the first has; None where it does not have the code.
        other: What the second has.
        meaning_one: What the first value means; empty where no description says.
        meaning_other: What the second means.
    """

    code: Code
    family: Family
    name: str
    unit: str | None
    one: BackupEntry | None
    other: BackupEntry | None
    meaning_one: str = ""
    meaning_other: str = ""


@dataclass(frozen=True, slots=True)
class Comparison:
    """What came of comparing two backups.

    Args:
        differences: What they differ in, by code.
        same: How many codes are equal.
        left_out: How many were not compared.
        remarks: What else should be known.
    """

    differences: tuple[Difference, ...]
    same: int
    left_out: int
    remarks: tuple[str, ...] = ()

    @property
    def equal(self) -> bool:
        """Whether they differ in nothing that was compared."""
        return not self.differences


def compare(one: Backup, other: Backup, *, everything: bool = False) -> Comparison:
    """Compare two backups.

    Args:
        one: The first.
        other: The second.
        everything: Also process values, addresses and identities.
    """
    differences: list[Difference] = []
    same = left_out = 0
    for code in sorted(one.entries.keys() | other.entries.keys()):
        first, second = one.entries.get(code), other.entries.get(code)
        if not everything and not is_compared(one, other, code):
            left_out += 1
        elif is_same(first, second):
            same += 1
        else:
            differences.append(difference(one, other, code))
    return Comparison(tuple(differences), same, left_out, tuple(remarks(one, other)))


def is_compared(one: Backup, other: Backup, code: Code) -> bool:
    """Whether a code is one of those that are compared unless everything is."""
    settings = (Section.PARAMETERS, Section.MODULE, Section.UNDESCRIBED)
    known = [backup for backup in (one, other) if code in backup.entries]
    return all(
        section_of(backup.family, code) in settings and not is_own(backup.family.info(code))
        for backup in known
    )


def is_same(one: BackupEntry | None, other: BackupEntry | None) -> bool:
    """Whether two entries say the same; both unread for the same reason do."""
    if one is None or other is None:
        return False
    if one.value is None or other.value is None:
        return one.value is other.value and one.missing == other.missing
    return one.value.means_same(other.value)


def difference(one: Backup, other: Backup, code: Code) -> Difference:
    """Describe a difference."""
    first, second = one.entries.get(code), other.entries.get(code)
    info = one.family.info(code) or other.family.info(code)
    family = one.family if one.family.info(code) is not None else other.family
    name = "" if info is None else info.name
    return Difference(
        code,
        family,
        " ".join(filter(None, (family.keypad_name(code), name))),
        None if info is None else info.unit,
        first,
        second,
        meaning_of(one.family.info(code), first.value if first else None),
        meaning_of(other.family.info(code), second.value if second else None),
    )


def remarks(one: Backup, other: Backup) -> list[str]:
    """Say what is different about the drives themselves, and what a file does not say clearly."""
    said = []
    if one.family is not other.family:
        said.append(
            f"different families, {one.family.name} and {other.family.name}: "
            "the same code may mean something else"
        )
    for backup in (one, other):
        for entry in backup.entries.values():
            said += digits_for_a_word(backup.family, entry)
    for code in sorted({*one.family.identity, *other.family.identity}):
        first, second = one.entries.get(code), other.entries.get(code)
        if first is None or second is None or first.value is None or second.value is None:
            continue
        if not first.value.means_same(second.value):
            info = one.family.info(code) or other.family.info(code)
            name = f" ({info.name})" if info is not None else ""
            said.append(f"{one.family.spoken(code)}{name} is {first.value} and {second.value}")
    return said
