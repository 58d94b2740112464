"""What a restore would do: what is written in which order, what is left out and why.

Strategy: the plan is made from the file, the family's rules and what the drive reads now; nothing
is sent for it but reads. Codes that read the wanted value already are not written: drives wear
their memory. What makes a restore wrong as a whole (another family, another drive, a value that
cannot be one) stands in `blockers`, and then there is no restore.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from lecombus.drives import (
    Family,
    encode_for,
    must_be_same,
    not_restored,
    restore_rank,
    restore_rule,
    saving_rule,
)
from lecombus.drives.procedures import ReadAttempt
from lecombus.errors import CodeValueError
from lecombus.parameters import Code, Format, Value

from .backup_file import Backup, BackupEntry, Section, meaning_of, section_of

__all__ = ["RestorePlan", "RestoreStep", "Skip", "codes_to_read", "make_plan"]


@dataclass(frozen=True, slots=True)
class RestoreStep:
    """One write of a restore.

    Args:
        code: The code.
        name: Its name.
        unit: Its unit, where it has one.
        now: What it reads now.
        value: What is written.
        now_means: What the present value means; empty where no description says.
        value_means: What the new value means.
        because: Why it stands where it does in the order; empty for most.
    """

    code: Code
    name: str
    unit: str | None
    now: Value
    value: Value
    now_means: str = ""
    value_means: str = ""
    because: str = ""


@dataclass(frozen=True, slots=True)
class Skip:
    """A code of the file that is left out.

    Args:
        code: The code.
        name: Its name; empty where no description knows it.
        why: Why.
        expected: It is left out of every restore of this family: it is not listed.
    """

    code: Code
    name: str
    why: str
    expected: bool


@dataclass(frozen=True, slots=True)
class RestorePlan:
    """What a restore would do.

    Args:
        family: The drive's family.
        steps: What is written, in order.
        same: What reads the wanted value already.
        skips: What is left out.
        blockers: Why it must not be done at all; empty when it may.
        mistakes: Those of the blockers that are values of the file which cannot be.
        remarks: What should be known before.
        save: What is written at the end to keep it all; None where each write keeps.
    """

    family: Family
    steps: tuple[RestoreStep, ...]
    same: Mapping[Code, Value]
    skips: tuple[Skip, ...]
    blockers: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    save: tuple[Code, Value] | None = None
    mistakes: tuple[str, ...] = ()

    @property
    def wanted(self) -> dict[Code, Value]:
        """What the drive must read in the end, by code."""
        return dict(sorted({**self.same, **{step.code: step.value for step in self.steps}}.items()))


def codes_to_read(backup: Backup, owned: Collection[Code]) -> tuple[Code, ...]:
    """Name what has to be read of a drive before a plan can be made."""
    family = backup.family
    restored = {
        code for code, entry in backup.entries.items()
        if entry.value is not None and not_restored(family, code, owned) is None
    }  # fmt: skip
    return tuple(sorted(restored | set(must_be_same(family)) | set(family.identity)))


def make_plan(
    backup: Backup,
    family: Family,
    now: Mapping[Code, ReadAttempt],
    *,
    owned: Collection[Code] = (),
    other_drive: bool = False,
) -> RestorePlan:
    """Make a plan.

    Args:
        backup: What is to be put back.
        family: The drive's family by the roster.
        now: What the drive reads, by code (`codes_to_read`).
        owned: Codes that lecombus itself sets from the roster.
        other_drive: The user knows that it is another drive than the backup's.
    """
    if backup.family is not family:
        wrong = (
            f"the backup is of a {backup.family.name}, the drive is a {family.name}: "
            "the same code means something else there"
        )
        return RestorePlan(family, (), {}, (), (wrong,))
    steps: list[RestoreStep] = []
    skips: list[Skip] = []
    same: dict[Code, Value] = {}
    wrong_values: list[str] = []
    for code in sorted(backup.entries, key=lambda code: restore_rank(family, code)):
        entry = backup.entries[code]
        why = why_skipped(family, entry, now, owned)
        if why is not None:
            skips.append(skip(family, entry, why, owned))
            wrong_values += digits_for_a_word(family, entry)
            continue
        assert entry.value is not None
        present = now[code].value
        assert present is not None
        try:
            value = encode_for(family, code, entry.value.raw)
        except CodeValueError as exc:
            wrong_values.append(refusal(entry, exc))
            continue
        if present.means_same(value):
            same[code] = value
        else:
            steps.append(step(family, code, present, value))
    strange = signs_of_another_drive(backup, family, now)
    blockers = (*wrong_values, *(() if other_drive else strange))
    remarks = (*values_not_in_manual(family, steps), *(strange if other_drive else ()))
    return RestorePlan(
        family, tuple(steps), same, tuple(skips), tuple(blockers), tuple(remarks), saving(family),
        tuple(wrong_values),
    )  # fmt: skip


def why_skipped(
    family: Family, entry: BackupEntry, now: Mapping[Code, ReadAttempt], owned: Collection[Code]
) -> str | None:
    """Say why an entry is left out; None where it is not."""
    why = not_restored(family, entry.code, owned)
    if why is not None:
        return why
    if entry.value is None:
        return f"it was not read for the backup ({entry.missing})"
    answer = now.get(entry.code)
    if answer is None or answer.value is None:
        text = answer.text if answer is not None else "it was not asked"
        return f"the drive does not give it now: {text}"
    return None


def digits_for_a_word(family: Family, entry: BackupEntry) -> Iterator[str]:
    """Refuse digits that could be a word or a decimal, also where they are not written.

    A drive sends such a code as a word: somebody edited the file, and means something by it.
    """
    info, value = family.info(entry.code), entry.value
    if info is None or value is None or info.format is not Format.VH or value.format is Format.VH:
        return
    try:
        encode_for(family, entry.code, value.raw)
    except CodeValueError as exc:
        yield refusal(entry, exc)


def refusal(entry: BackupEntry, error: CodeValueError) -> str:
    """Say what is wrong with a value of the file, and where it stands."""
    return ": ".join(filter(None, (entry.place, str(error))))


def skip(family: Family, entry: BackupEntry, why: str, owned: Collection[Code]) -> Skip:
    """Describe what is left out."""
    info = family.info(entry.code)
    process = section_of(family, entry.code) in (Section.PROCESS, Section.IDENTITY)
    return Skip(entry.code, "" if info is None else info.name, why, expected=process)


def step(family: Family, code: Code, now: Value, value: Value) -> RestoreStep:
    """Describe a write."""
    info = family.info(code)
    assert info is not None
    rule = restore_rule(family, code)
    name = " ".join(filter(None, (family.keypad_name(code), info.name)))
    return RestoreStep(
        code,
        name,
        info.unit,
        now,
        value,
        meaning_of(info, now),
        meaning_of(info, value),
        f"{rule.word}: {rule.because}" if rule is not None else "",
    )


def signs_of_another_drive(
    backup: Backup, family: Family, now: Mapping[Code, ReadAttempt]
) -> tuple[str, ...]:
    """Say what shows that this may be another drive than the backup's."""
    said = []
    for code in must_be_same(family):
        entry, answer = backup.entries.get(code), now.get(code)
        if entry is None or entry.value is None:
            continue  # the backup says nothing of it
        info, rule = family.info(code), restore_rule(family, code)
        name = f" ({info.name})" if info is not None else ""
        if answer is None or answer.value is None:
            said.append(f"{family.spoken(code)}{name} was {entry.value} and cannot be read now")
        elif not answer.value.means_same(entry.value):
            why = f": {rule.because}" if rule is not None else ""
            said.append(f"{family.spoken(code)}{name} was {entry.value} and is {answer.value}{why}")
    return tuple(said)


def values_not_in_manual(family: Family, steps: list[RestoreStep]) -> tuple[str, ...]:
    """Say which values the manual does not know; the drive has the last word on them."""
    said = []
    for one in steps:
        info = family.info(one.code)
        number = one.value.quantity
        if info is None or number is None or info.may_be(number):
            continue
        said.append(
            f"{family.spoken(one.code)} ({info.name}): {one.value} is not among what the "
            f"manual allows, {info.allowed}; the drive may refuse it"
        )
    return tuple(said)


def saving(family: Family) -> tuple[Code, Value] | None:
    """Give what keeps the parameters at the end."""
    rule = saving_rule(family)
    if rule is None or rule.value is None:
        return None
    return rule.codes[0], encode_for(family, rule.codes[0], rule.value)
