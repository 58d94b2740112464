"""Reasons why a drive does not turn, from `reasons.yaml`, and which of them hold.

Strategy: a reason is a few states that the words must show and a few values that codes must have.
What is not known holds nothing up and proves nothing: a reason holds only when all it asks for is
known to be so. Nothing here reads anything; `operations.why` brings what is known.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache

from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value

from ..document import Item, Table
from ..operating import OperatingState
from ..readers import read_choice, read_text
from ..texts import Text
from .loading import ReadFile, packaged
from .rules import Condition, load_rules, read_condition, read_each, read_families

__all__ = ["Reason", "Weight", "asked_codes", "holding", "load_reasons", "reasons"]


class Weight(StrEnum):
    """What a reason is worth as an answer."""

    REASON = "reason"
    """It keeps the drive from turning."""
    HINT = "hint"
    """It may."""
    NOTE = "note"
    """It is good to know."""


@dataclass(frozen=True, slots=True, eq=False)
class Reason:
    """One reason.

    Args:
        name: A stable word for it.
        families: Whose drives it is for.
        states: What the words must show.
        not_states: What they must not show.
        values: What codes must read.
        not_values: What codes must be known not to read.
        weight: What it is worth.
        text: What it is.
        remedy: What to do next.
        source: Manual and section.
        unless: Reasons that say the same more exactly: where one of them holds, this is not told.
    """

    name: str
    families: frozenset[str]
    states: frozenset[OperatingState]
    not_states: frozenset[OperatingState]
    values: tuple[Condition, ...]
    not_values: tuple[Condition, ...]
    weight: Weight
    text: Text
    remedy: Text
    source: str
    unless: frozenset[str] = frozenset()

    def holds(
        self,
        shown: frozenset[OperatingState],
        values: Mapping[Code, Value],
        absent: Container[Code] = (),
    ) -> bool:
        """Say whether everything it asks for is known to be so.

        Args:
            shown: What the words show.
            values: The values known.
            absent: Codes that the drive says it does not have: such a code is none of its values.
        """
        return (
            self.states <= shown
            and not self.not_states & shown
            and all(
                one.holds(values.get(one.code)) is True
                or (one.test == "not_in" and one.code in absent)
                for one in self.values
            )
            and all(one.holds(values.get(one.code)) is False for one in self.not_values)
        )


def holding(
    family: str,
    shown: frozenset[OperatingState],
    values: Mapping[Code, Value],
    absent: Container[Code] = (),
) -> list[Reason]:
    """Give the reasons that hold for a drive, the most important first.

    Where one of several reasons for the same state holds, only the first is told.

    Args:
        family: The drive's family.
        shown: What its words show.
        values: The values known of its codes.
        absent: Codes that the drive says it does not have.
    """
    found: list[Reason] = []
    told: set[frozenset[OperatingState]] = set()
    for reason in reasons():
        if family in reason.families and reason.holds(shown, values, absent):
            if reason.states and reason.states in told:
                continue
            if any(one.name in reason.unless for one in found):
                continue
            told.add(reason.states)
            found.append(reason)
    return found


def asked_codes(family: str) -> tuple[Code, ...]:
    """Name the codes whose values a family's reasons look at."""
    mine = [one for one in reasons() if family in one.families]
    conditions = [one for reason in mine for one in (*reason.values, *reason.not_values)]
    return tuple(dict.fromkeys(one.code for one in conditions))


@cache
def reasons() -> tuple[Reason, ...]:
    """Give all reasons, in the order of the file.

    Raises:
        DescriptionError: The data file is wrong.
    """
    return load_reasons(packaged)


def load_reasons(read_file: ReadFile) -> tuple[Reason, ...]:
    """Build the reasons from `reasons.yaml`.

    Raises:
        DescriptionError: The file is missing, or says something that cannot be.
    """
    return load_rules("reasons", read_file, _reason)


def _reason(table: Table) -> Reason:
    reason = Reason(
        name=table.take("name").text(),
        families=read_families(table),
        states=_states(table.get("states")),
        not_states=_states(table.get("not_states")),
        values=tuple(read_each(table.get("values"), _condition)),
        not_values=tuple(read_each(table.get("not_values"), _condition)),
        weight=read_choice(table.take("weight"), Weight),
        text=read_text(table.take("text")),
        remedy=read_text(table.take("remedy")),
        source=table.take("source").text(),
        unless=frozenset(read_each(table.get("unless"), lambda one: one.text())),
    )
    table.done()
    return reason


def _states(item: Item | None) -> frozenset[OperatingState]:
    return frozenset(read_each(item, lambda one: read_choice(one, OperatingState)))


def _condition(item: Item) -> Condition:
    return read_condition(item.table())
