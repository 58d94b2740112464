"""Reasons why a drive does not turn, from `reasons.yaml`, and which of them hold.

A reason is a few states that the words must show and a few values that codes must have. It holds
only when all of these are known to be so: what is not known proves nothing.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Annotated

from lecombus.drives.words import OperatingState
from lecombus.parameters import Code, Value

from ..field_types import BothLanguages, Words
from ..verb_rules import Verb
from ..yaml_models import FILE_TABLE, ReadFile, open_data_file
from .rules import Condition, Families, each_once

__all__ = ["Reason", "Weight", "asked_codes", "holding", "reasons"]


class Weight(StrEnum):
    """What a reason is worth as an answer."""

    REASON = "reason"
    """It keeps the drive from turning."""
    HINT = "hint"
    """It may."""
    NOTE = "note"
    """It is good to know."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
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
        verb: The verb that the remedy advises, where it advises one.
        unless: Reasons that say the same more exactly: where one of them holds, this is left out.
    """

    __pydantic_config__ = FILE_TABLE

    name: Words
    families: frozenset[Words]
    states: frozenset[OperatingState] = frozenset()
    not_states: frozenset[OperatingState] = frozenset()
    values: tuple[Condition, ...] = ()
    not_values: tuple[Condition, ...] = ()
    weight: Weight
    text: BothLanguages
    remedy: BothLanguages
    source: Words
    verb: Verb | None = None
    unless: frozenset[Words] = frozenset()

    def holds(
        self,
        shown: frozenset[OperatingState],
        values: Mapping[Code, Value],
        absent: Container[Code] = (),
    ) -> bool:
        """Return whether everything it asks for is known to be so.

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
    """Return the reasons that hold for a drive, the most important first.

    Of several reasons for the same states only the first that holds is returned.

    Args:
        family: The drive's family.
        shown: What its words show.
        values: The values known of its codes.
        absent: Codes that the drive says it does not have.
    """
    found: list[Reason] = []
    explained: set[frozenset[OperatingState]] = set()
    for reason in reasons():
        if family in reason.families and reason.holds(shown, values, absent):
            if reason.states and reason.states in explained:
                continue
            if any(one.name in reason.unless for one in found):
                continue
            explained.add(reason.states)
            found.append(reason)
    return found


def asked_codes(family: str) -> tuple[Code, ...]:
    """Return the codes whose values a family's reasons look at."""
    mine = [one for one in reasons() if family in one.families]
    conditions = [one for reason in mine for one in (*reason.values, *reason.not_values)]
    return tuple(dict.fromkeys(one.code for one in conditions))


@dataclass(frozen=True)
class _ReasonsFile:
    __pydantic_config__ = FILE_TABLE

    families: Families
    reasons: Annotated[tuple[Reason, ...], each_once]


@cache
def reasons(read_file: ReadFile | None = None) -> tuple[Reason, ...]:
    """Return all reasons, in the order of `reasons.yaml`.

    Raises:
        DescriptionError: The file is missing, or says something that cannot be.
    """
    return open_data_file("faults", "reasons", read_file).read(_ReasonsFile).reasons
