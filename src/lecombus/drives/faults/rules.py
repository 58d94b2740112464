"""What causes and reasons share: files of named rules, and conditions on what a code reads.

A file lists its families first, for its own aliases, then its rules in the order in which they
count.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Protocol, TypeVar

from pydantic import AfterValidator, Field

from lecombus.parameters import Code, Value

from ..field_types import WORD_MAX, CodeNumber, WordNumber, Words, whole_number
from ..yaml_models import FILE_TABLE, ReadAs, ReadBy, by_key, mistake

__all__ = ["Condition", "Families", "ValueCondition", "each_once"]


class _Named(Protocol):
    """A rule, as far as its file is concerned."""

    @property
    def name(self) -> str:
        """A stable word for it."""


N = TypeVar("N", bound=_Named)

TESTS: Final = ("not_in", "in", "below", "last_digit_not", "clear", "set")


@dataclass(frozen=True, slots=True)
class ValueCondition:
    """A value of the drive that makes a rule true.

    Args:
        code: Which code.
        test: One of `TESTS`.
        numbers: What the test compares with.
    """

    code: Code
    test: str
    numbers: frozenset[int]

    def holds(self, value: Value | None) -> bool | None:
        """Return whether it is so; None where the value is not known or no number."""
        quantity = None if value is None else value.quantity
        if quantity is None:
            return None
        number = int(quantity)
        (first, *_) = self.numbers
        if self.test == "below":
            return number < first
        if self.test == "last_digit_not":
            return number % 10 != first
        if self.test == "clear":
            return not number & first
        if self.test == "set":
            return number & first == first
        return (number in self.numbers) == (self.test == "in")


def _not_empty(numbers: frozenset[int]) -> frozenset[int]:
    if not numbers:
        raise mistake("at least one number is right here")
    return numbers


def _read_one(given: object) -> frozenset[int]:
    return frozenset({whole_number(given, 0, WORD_MAX)})


One = Annotated[frozenset[int], ReadBy(_read_one)] | None
Several = Annotated[frozenset[WordNumber], AfterValidator(_not_empty)] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _ConditionEntry:
    """The key of a field is the name of its test."""

    __pydantic_config__ = FILE_TABLE

    code: CodeNumber
    not_in: Several = None
    in_: Annotated[Several, Field(alias="in")] = None
    below: One = None
    last_digit_not: One = None
    clear: One = None
    set: One = None

    def condition(self) -> ValueCondition:
        tests = {test: getattr(self, "in_" if test == "in" else test) for test in TESTS}
        given = [(test, numbers) for test, numbers in tests.items() if numbers is not None]
        if len(given) != 1:
            raise mistake(f"one of {', '.join(TESTS)} is right here")
        return ValueCondition(self.code, *given[0])


Condition = Annotated[ValueCondition, ReadAs(_ConditionEntry, _ConditionEntry.condition)]
"""A condition as it stands in a file."""


def _refuse_twice(rules: tuple[N, ...]) -> tuple[N, ...]:
    return tuple(by_key(rules, lambda rule: rule.name).values())


each_once: Final = AfterValidator(_refuse_twice)
"""Marks a list of rules whose names differ."""

Families = dict[str, tuple[Words, ...]]
"""Aliases for lists of families, which YAML resolves."""
