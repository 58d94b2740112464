"""What a backup may write back into a drive, and in which order.

The rules are data (`restore` in the family's file), each with the manual's section: what comes
first because other codes follow from it, what comes last because it may lock further access, what
is never written, what must be the same in both drives, and how parameters are saved at the end.
What follows from a code's description (read only, a process value, an edge) needs no rule. The
daemon calls `not_restored` before every such write, the command line before it shows its plan, so
both agree.

A rule names a code of parameter set 1 and holds for every set.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Final

from pydantic import Field, ValidationInfo

from lecombus.parameters import Code

from .code_info import CodeInfo, Storage, WriteClass
from .field_types import DescribedCode, Source, WordNumber, Words
from .yaml_models import FILE_TABLE, ReadAs, context_of, mistake

if TYPE_CHECKING:
    from .family import Family

__all__ = [
    "RESTORE",
    "RestoreRule",
    "RestoreWord",
    "is_last",
    "must_be_same",
    "not_restored",
    "restore_rank",
    "restore_rule",
    "saving_rule",
]


class RestoreWord(StrEnum):
    """What a rule says of its codes."""

    FIRST = "first"
    """Written before the others, in the order given."""
    LAST = "last"
    """Written after the others, in the order given."""
    NEVER = "never"
    """Left alone."""
    SAME = "same"
    """Distinguishes drives: a restore into a drive that reads otherwise must be confirmed."""
    SAVE = "save"
    """Written once at the end, to keep what was written."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RestoreRule:
    """One rule of a family for restoring.

    Args:
        word: What it says.
        codes: The codes it says it of, in parameter set 1.
        because: Why, in words.
        value: What is written to save; None for every other word.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    word: Annotated[RestoreWord, Field(alias="rule")]
    codes: tuple[DescribedCode, ...]
    because: Words
    value: WordNumber | None = None
    source: Source


def _check_rules(rules: tuple[RestoreRule, ...], info: ValidationInfo) -> tuple[RestoreRule, ...]:
    for place, rule in enumerate(rules):
        if (rule.value is not None) != (rule.word is RestoreWord.SAVE):
            raise mistake("value belongs to the rule save, and only there", place)
        for code in rule.codes:
            described: CodeInfo | None = context_of(info).codes.get(code)
            if described is not None and described.parameter_set != 1:
                raise mistake(f"a rule for {code} is written for parameter set 1", place, code=code)
            saves = described is not None and described.write_class is WriteClass.SAVE
            if rule.word is RestoreWord.SAVE and not saves:
                raise mistake(f"{code} does not save", place, code=code)
    return rules


RESTORE = ReadAs(tuple[RestoreRule, ...], _check_rules, informed=True)
"""Reads the section `restore`."""


DELICATE: Final = {
    WriteClass.EDGE: "writing it is a command, not a setting",
    WriteClass.STEP: "writing it is a command, not a setting",
    WriteClass.SAVE: "writing it saves parameters",
    WriteClass.ADDRESS: "it belongs to this drive's place on the line",
    WriteClass.RESET: "writing it restarts the drive or sets it back",
}

FIRST_RANK, USUAL_RANK, LAST_RANK = 0, 1, 2


def not_restored(family: Family, code: Code, owned: Collection[Code] = ()) -> str | None:
    """Return why a code is left out of a restore; None where it is put back.

    Args:
        family: The drive's family.
        code: The code.
        owned: Codes that lecombus itself sets from the roster.
    """
    info = family.info(code)
    if info is None:
        return "no description says what writing it does"
    if info.secret:
        return "it is a password"
    if not info.writable:
        return "it is read only"
    if info.write_class is not WriteClass.PLAIN:
        return DELICATE[info.write_class]
    if info.storage is Storage.VOLATILE:
        return "it is a process value, not a setting"
    if code in owned:
        return "the roster sets it (watchdog)"
    rule = restore_rule(family, code)
    return rule.because if rule is not None and rule.word is RestoreWord.NEVER else None


def restore_rule(family: Family, code: Code) -> RestoreRule | None:
    """Return the first rule that names a code, in any parameter set."""
    base = base_code(family, family.info(code), code)
    return next((rule for rule in family.restore if base in rule.codes), None)


def restore_rank(family: Family, code: Code) -> tuple[int, int, int, int, Code]:
    """Return what sorts codes into the order in which they are written."""
    base = base_code(family, family.info(code), code)
    for number, rule in enumerate(family.restore):
        if base in rule.codes and rule.word in (RestoreWord.FIRST, RestoreWord.LAST):
            group = FIRST_RANK if rule.word is RestoreWord.FIRST else LAST_RANK
            return group, number, rule.codes.index(base), 0, code
    info = family.info(code)
    return USUAL_RANK, 0, 0, 1 if info is None else info.parameter_set, code


def is_last(family: Family, code: Code) -> bool:
    """Return whether a code is one of those that may lock further access."""
    return restore_rank(family, code)[0] == LAST_RANK


def must_be_same(family: Family) -> tuple[Code, ...]:
    """Return the codes that must be the same in two drives with the same parameters."""
    return tuple(
        code for rule in family.restore if rule.word is RestoreWord.SAME for code in rule.codes
    )


def saving_rule(family: Family) -> RestoreRule | None:
    """Return what is written at the end to keep the parameters; None where each write keeps."""
    return next((rule for rule in family.restore if rule.word is RestoreWord.SAVE), None)


def base_code(family: Family, info: CodeInfo | None, code: Code) -> Code:
    """Return the code that means the same in parameter set 1."""
    if info is None or info.parameter_set == 1:
        return code
    return Code(code.number - family.set_offsets[info.parameter_set - 1], code.subcode)
