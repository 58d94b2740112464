"""How a family is enabled, set to a speed and reset: rules as data, and the steps of a verb.

A user says "belt: 35 Hz"; what that is on the wire differs from family to family and with the
drive's settings. The rules stand in the family's file, so that an electrician can read them beside
the manual: what the bits of the control word mean, which settings a write needs to have an effect,
where a setpoint goes in which unit. `verbs` and `speeds` make steps of them.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo

from lecombus.parameters import Code, Value

from .control_words import INHIBIT, QUICK_STOP
from .field_types import (
    DescribedCode,
    Number,
    Source,
    Words,
    WordValue,
    WritableCode,
    ends,
    whole,
    whole_number,
)
from .stops import Proofs
from .yaml_models import FILE_TABLE, ReadAs, ReadBy, mistake, without_keys

__all__ = [
    "Access",
    "BitsStep",
    "Condition",
    "Demand",
    "EnableRule",
    "InhibitStep",
    "ResetRule",
    "RestartStep",
    "SetpointRule",
    "Verb",
    "VerbRules",
    "VerbStep",
    "WriteStep",
    "check_control",
]


class Verb(StrEnum):
    """What a person can have a drive do."""

    ENABLE = "enable"
    INHIBIT = "inhibit"
    QUICK_STOP = "quick-stop"
    SET_SPEED = "set-speed"
    RESET_FAULT = "reset-fault"


class Access(StrEnum):
    """What a setting of the drive can open or close to the line."""

    CONTROL_WORD = "control-word"
    ENABLE = "enable"
    SETPOINT = "setpoint"
    RESET = "reset"


HIGHEST_SETTING: Final = 99_999
DIGITS: Final = (1, 10, 100, 1000, 10_000)


def _read_digit(given: object) -> int:
    digit = whole_number(given, DIGITS[0], DIGITS[-1])
    if digit not in DIGITS:
        raise mistake(f"{', '.join(map(str, DIGITS))} are right here")
    return digit


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """A setting that has one of a few values.

    Args:
        code: The setting.
        values: What it, or one digit of it, must be.
        digit: 1 looks at the last digit only, 1000 at the fourth from the right; 0: at the whole.
    """

    __pydantic_config__ = FILE_TABLE

    code: DescribedCode
    values: frozenset[Annotated[int, whole(0, HIGHEST_SETTING)]]
    digit: Annotated[int, ReadBy(_read_digit)] = 0

    def holds(self, value: Value | None) -> bool:
        """Return whether a setting that was read is as wanted; one that is not known is not."""
        whole = value.whole if value is not None else None
        if whole is None:
            return False
        return (whole // self.digit % 10 if self.digit else whole) in self.values


def _check_condition(condition: Condition) -> Condition:
    if not condition.values:
        raise mistake("values must not be empty")
    highest = 9 if condition.digit else HIGHEST_SETTING
    for value in condition.values:
        if value > highest:
            raise mistake(f"{value}: a whole number from 0 to {highest} is right here", "values")
    return condition


@dataclass(frozen=True, slots=True, eq=False)
class Demand:
    """A setting without which the drive does not follow the line.

    Args:
        access: What it is needed for.
        condition: The setting and its right values.
        remedy: What to set, for people.
        source: Manual and section.
    """

    access: frozenset[Access]
    condition: Condition
    remedy: str
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class EnableRule:
    """How an inhibit is lifted.

    Args:
        code: The code written.
        value: The value written.
        proofs: Status words that show that nothing inhibits the drive any more.
        otherwise: What else may inhibit it, for people: terminals that no code shows.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    code: WritableCode
    value: WordValue
    proofs: Proofs
    otherwise: Words
    source: Source


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResetRule:
    """How a fault is reset.

    Args:
        code: The code written; None where an inhibit and an enable after it do it, whereupon the
            drive restarts and does not answer.
        value: The value written.
        number: Where the number of the fault is read.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    code: WritableCode | None = None
    value: WordValue | None = None
    number: DescribedCode
    source: Source


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _DemandEntry(Condition):
    access: Annotated[frozenset[Access], Field(alias="for")]
    remedy: Words
    source: Source

    def demand(self) -> Demand:
        condition = _check_condition(without_keys(Condition, self))
        return Demand(self.access, condition, self.remedy, self.source)


RANGE, LOW, HIGH = ends("range", "range is the least and the greatest value: [0, 480]")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SetpointRule:
    """One way to give a speed.

    Args:
        code: The code written.
        unit: Its unit, `Hz` or `%`.
        low: The least value.
        high: The greatest value.
        step: What values are rounded to when they are converted, and may not be finer than; None
            where the manual gives none.
        least: The setting that holds the least value in force; None: `low` is it.
        full_scale: The setting in Hz that 100 % stands for, and that a frequency may not exceed.
        when: The setting in which the drive takes it from there; None: in every one.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    code: WritableCode
    unit: Annotated[Literal["Hz", "%"], BeforeValidator(str)]  # pydantic 2.8 takes no subclass
    low: Annotated[Number, LOW]
    high: Annotated[Number, HIGH]
    step: Number | None = None
    least: DescribedCode | None = None
    full_scale: DescribedCode | None = None
    when: Annotated[Condition, AfterValidator(_check_condition)] | None = None
    source: Source


def _check_reset(rule: ResetRule) -> ResetRule:
    if (rule.code is None) != (rule.value is None):
        raise mistake("code and value belong together; without them, an enable resets the fault")
    return rule


def _check_setpoint(rule: SetpointRule) -> SetpointRule:
    if rule.step is not None and rule.step <= 0:
        raise mistake("step is over 0", "step")
    return rule


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VerbRules:
    """Everything that verbs are made of in one family.

    Args:
        control: Where the control word is written.
        demands: Settings that must be so.
        enable: How an inhibit is lifted.
        reset: How a fault is reset.
        setpoints: The ways to give a speed, the first that fits counts.
    """

    __pydantic_config__ = FILE_TABLE

    control: WritableCode
    demands: tuple[Annotated[Demand, ReadAs(_DemandEntry, _DemandEntry.demand)], ...] = ()
    enable: EnableRule
    reset: Annotated[ResetRule, AfterValidator(_check_reset)]
    setpoints: tuple[Annotated[SetpointRule, RANGE, AfterValidator(_check_setpoint)], ...]

    def not_writable(self, verb: Verb, writable: Container[Code]) -> tuple[Code, ...]:
        """Return the codes that a verb writes and that may not be written; stops need none.

        Of several ways to give a speed one is enough: which one it takes follows from the drive's
        settings. Where none may be written, all are returned.

        Args:
            verb: The verb.
            writable: The codes that may be written.
        """
        needed: tuple[Code, ...] = ()
        if verb is Verb.ENABLE:
            needed = (self.enable.code, self.control)
        elif verb is Verb.RESET_FAULT:
            needed = (self.reset.code or self.control,)
        elif verb is Verb.SET_SPEED:
            needed = tuple(rule.code for rule in self.setpoints)
            if any(code in writable for code in needed):
                return ()
        return tuple(dict.fromkeys(code for code in needed if code not in writable))


def check_control(rules: VerbRules, info: ValidationInfo) -> VerbRules:
    """Refuse rules whose control word lacks the bits that verbs change."""
    word = info.data.get("control_words", {}).get("", {}).get(rules.control)
    if word is None or not {QUICK_STOP, INHIBIT} <= word.bits.keys():
        message = f"{rules.control} is not a control word with bits {QUICK_STOP} and {INHIBIT}"
        raise mistake(message, "control")
    return rules


@dataclass(frozen=True, slots=True)
class WriteStep:
    """Write a code."""

    code: Code
    value: Value


@dataclass(frozen=True, slots=True)
class BitsStep:
    """Change bits of the control word as it is then.

    Args:
        code: The control word.
        set_mask: Bits set.
        clear_mask: Bits cleared.
        always: Write it also where the bits are so already.
    """

    code: Code
    set_mask: int = 0
    clear_mask: int = 0
    always: bool = False

    def applied(self, word: int) -> int:
        """Return the word with the bits changed."""
        return (word | self.set_mask) & ~self.clear_mask


@dataclass(frozen=True, slots=True)
class InhibitStep:
    """Inhibit the drive, as a stop is said and proven."""


@dataclass(frozen=True, slots=True)
class RestartStep(BitsStep):
    """Change bits after which the drive restarts without an answer; wait until it is back."""


VerbStep = WriteStep | BitsStep | InhibitStep | RestartStep
