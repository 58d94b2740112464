"""What causes and reasons share: files of named rules, and conditions on what a code reads.

Strategy: a file names its families first, for its own aliases, then its rules in the order in which
they count; a name that stands twice is refused with its place.

What must not live here: what a rule says (`causes`, `reasons`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar

from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value

from ..document import Item, Table
from ..readers import WORD_MAX, read_code_number
from .loading import ReadFile, open_document

__all__ = ["Condition", "Named", "load_rules", "read_condition", "read_each", "read_families"]

T = TypeVar("T")


class Named(Protocol):
    """A rule, as far as its file is concerned."""

    @property
    def name(self) -> str:
        """A stable word for it."""


N = TypeVar("N", bound=Named)

TESTS: Final = ("not_in", "in", "below", "last_digit_not", "clear", "set")


@dataclass(frozen=True, slots=True)
class Condition:
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
        """Say whether it is so; None where the value is not known or no number."""
        if value is None or isinstance(value.number, (str, bytes)):
            return None
        number = int(value.number)
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


def load_rules(name: str, read_file: ReadFile, read_rule: Callable[[Table], N]) -> tuple[N, ...]:
    """Read the rules of a file, in its order.

    Args:
        name: The file's name, which is also the key that the rules stand under.
        read_file: Gives its text.
        read_rule: Reads one rule and nothing beside it.

    Raises:
        DescriptionError: The file is missing, or says something that cannot be.
    """
    document = open_document(name, read_file)
    for _, families in document.take("families").table().pairs():
        families.items()
    found: dict[str, N] = {}
    for item in document.take(name).items():
        rule = read_rule(item.table())
        if rule.name in found:
            item.fail(f"{rule.name} stands here twice")
        found[rule.name] = rule
    document.done()
    return tuple(found.values())


def read_families(table: Table) -> frozenset[str]:
    """Read whose drives a rule is for."""
    return frozenset(item.text() for item in table.take("families").items())


def read_condition(table: Table) -> Condition:
    """Read a code and what it must read."""
    code = read_code_number(table.take("code"))
    given = [(test, item) for test in TESTS if (item := table.get(test)) is not None]
    table.done()
    if len(given) != 1:
        table.fail(f"one of {', '.join(TESTS)} is right here")
    ((test, item),) = given
    items = item.items() if test in ("not_in", "in") else [item]
    if not items:
        item.fail("at least one number is right here")
    return Condition(code, test, frozenset(one.integer(0, WORD_MAX) for one in items))


def read_each(item: Item | None, read: Callable[[Item], T]) -> list[T]:
    """Read the entries of a list that may be missing."""
    return [read(one) for one in item.items()] if item is not None else []
