"""Likely causes of a refusal, by family, from `causes.yaml`, and how well each is supported.

A rule says what it needs and what would support it. `likely_causes` is given what is known (the
code's description, values of other codes, what C1962 and C0068 reported) and keeps the rules that
are supported best: proven by a value, reported by the drive, or at least usual. Nothing is sent
from here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from functools import cache
from typing import Annotated, Final

from pydantic import Field

from lecombus.drives.code_info import CodeInfo, Storage
from lecombus.parameters import Code, Value

from ..field_types import BothLanguages, CodeNumber, Flag, Words, whole
from ..yaml_models import FILE_TABLE, ReadFile, open_data_file
from .fault_tables import LinkReport, link_report
from .rules import Condition, Families, each_once

__all__ = [
    "Cause",
    "CauseRule",
    "FailedExchange",
    "Happened",
    "Support",
    "cause_rules",
    "likely_causes",
    "rules_for",
]

HIGHEST_C1962: Final = 255
HIGHEST_ERROR: Final = 15


class Happened(StrEnum):
    """What the drive did."""

    REFUSED = "refused"
    IGNORED = "ignored"
    UNKNOWN = "unknown"
    DAMAGED = "damaged"
    DENIED = "denied"


class When(StrEnum):
    """What may be known of an exchange without asking the drive."""

    READ_ONLY = "read-only"
    OUT_OF_RANGE = "out-of-range"
    NEEDS_INHIBIT = "needs-inhibit"
    STORED = "stored"
    SUBCODE = "subcode"
    OTHER_SET = "other-set"
    DESCRIBED = "described"
    UNDESCRIBED = "undescribed"
    UNANSWERED = "unanswered"


class Support(IntEnum):
    """How well a cause is supported."""

    USUAL = 1
    """Nothing speaks for it but that it is usual for this code."""
    SAID = 2
    """What C0068 said of the last exchange fits it."""
    NUMBERED = 3
    """C1962 reports it."""
    DESCRIBED = 4
    """The manual says it of this code or value."""
    PROVEN = 5
    """A value of the drive shows it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CauseRule:
    """One likely cause.

    Args:
        name: A stable word for it.
        families: Whose drives it is for.
        codes: The codes it is for; empty for all.
        happened: What must have happened.
        when: What must be known of the exchange.
        condition: A value that makes it so.
        extended: Numbers of C1962 that report it.
        communication: Errors in C0068 that report it.
        likely: Worth naming without anything that speaks for it.
        cause: What it is.
        remedy: What to do.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    name: Words
    families: frozenset[Words]
    codes: frozenset[CodeNumber] = frozenset()
    happened: frozenset[Happened]
    when: frozenset[When] = frozenset()
    condition: Annotated[Condition | None, Field(alias="value")] = None
    extended: frozenset[Annotated[int, whole(1, HIGHEST_C1962)]] = frozenset()
    communication: frozenset[Annotated[int, whole(1, HIGHEST_ERROR)]] = frozenset()
    likely: Flag = False
    cause: BothLanguages
    remedy: BothLanguages
    source: Words

    def fits(self, family: str, known: FailedExchange) -> bool:
        """Return whether it is a rule for this exchange at all."""
        return (
            family in self.families
            and known.happened in self.happened
            and (not self.codes or known.code in self.codes)
            and self.when <= known.facts
        )


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause that may be the one.

    Args:
        rule: The rule.
        support: How well it is supported.
        shown_by: What shows it, such as `C0001 reads 0`; empty where nothing does.
    """

    rule: CauseRule
    support: Support
    shown_by: str


@dataclass(frozen=True, slots=True, eq=False)
class FailedExchange:
    """What is known of an exchange that did not do what was asked.

    Args:
        happened: What the drive did.
        code: The code read or written.
        info: Its description, where there is one.
        value: The value written; None for a read.
        values: Values of other codes that are fresh enough to conclude from.
        extended: What C1962 read; 0 or None where it said nothing.
        communication: What C0068 bits 4 to 7 read; 0 or None where they said nothing.
        left_over: C1962 may be left from an earlier exchange: it is possible, and proves nothing.
        answered: The drive has answered a read of the code before.
        spoken: Names a code for people, as the drive's keypad does.
    """

    happened: Happened
    code: Code
    info: CodeInfo | None = None
    value: Value | None = None
    values: Mapping[Code, Value] = field(default_factory=dict)
    extended: int | None = None
    communication: int | None = None
    left_over: bool = False
    answered: bool = False
    spoken: Callable[[Code], str] = str

    @property
    def facts(self) -> frozenset[When]:
        """What the description says of the exchange."""
        info, number = self.info, None if self.value is None else self.value.quantity
        facts = {When.SUBCODE} if self.code.subcode else set()
        if not self.answered:
            facts.add(When.UNANSWERED)
        if info is None:
            return frozenset(facts | {When.UNDESCRIBED})
        facts.add(When.DESCRIBED)
        flags = {
            When.READ_ONLY: not info.writable,
            When.NEEDS_INHIBIT: info.needs_inhibit,
            When.STORED: info.storage is Storage.STORED,
            When.OTHER_SET: info.parameter_set > 1,
            When.OUT_OF_RANGE: number is not None and not info.may_be(number),
        }
        return frozenset(facts | {fact for fact, so in flags.items() if so})


def likely_causes(family: str, known: FailedExchange) -> list[Cause]:
    """Return the causes that are supported best, the best first; empty where none is known."""
    report = link_report()
    extended = believed_extended(report, known)
    found = [
        cause
        for rule in rules_for(family, known)
        if (cause := supported(rule, known, extended)) is not None
    ]
    best = max((one.support for one in found), default=None)
    best_found = [one for one in found if one.support is best]
    # What is said of this very code says more than what is said of any.
    return [one for one in best_found if one.rule.codes] or best_found


def rules_for(family: str, known: FailedExchange) -> list[CauseRule]:
    """Return the rules for an exchange, supported or not."""
    return [rule for rule in cause_rules() if rule.fits(family, known)]


def believed_extended(report: LinkReport, known: FailedExchange) -> int | None:
    """Return C1962 unless C0068 shows that it is left from an earlier exchange."""
    number = known.extended or None
    error = report.communication.get(known.communication or 0)
    reported = report.extended.get(number or 0)
    if error is not None and reported is not None and reported.classification not in error.allows:
        return None
    return number


def supported(rule: CauseRule, known: FailedExchange, extended: int | None) -> Cause | None:
    """Return how well a rule that fits is supported; None where something speaks against it."""
    condition = rule.condition
    if condition is not None:
        value = known.values.get(condition.code)
        holds = condition.holds(value)
        if holds is False:
            return None
        if holds and value is not None:
            return Cause(rule, Support.PROVEN, f"{known.spoken(condition.code)} reads {value.raw}")
    elif rule.when & {When.READ_ONLY, When.OUT_OF_RANGE}:
        return Cause(rule, Support.DESCRIBED, "")
    numbered = extended in rule.extended
    if numbered and not known.left_over:
        return Cause(rule, Support.NUMBERED, f"C1962 reads {extended}")
    if extended is not None and rule.extended and not known.left_over:
        return None
    if known.communication and known.communication in rule.communication:
        return Cause(rule, Support.SAID, f"C0068 shows error {known.communication}")
    if numbered:
        return Cause(rule, Support.USUAL, "")
    if known.communication and rule.communication:
        return None
    return Cause(rule, Support.USUAL, "") if rule.likely else None


@dataclass(frozen=True)
class _CausesFile:
    __pydantic_config__ = FILE_TABLE

    families: Families
    causes: Annotated[tuple[CauseRule, ...], each_once]


@cache
def cause_rules(read_file: ReadFile | None = None) -> tuple[CauseRule, ...]:
    """Return all rules, in the order of `causes.yaml`.

    Raises:
        DescriptionError: The file is missing, or says something that cannot be.
    """
    return open_data_file("faults", "causes", read_file).read(_CausesFile).causes
