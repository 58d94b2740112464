"""Building a family's rules for verbs from the table `verbs` of its data file.

Each reader refuses what it cannot mean with file, line and column, and every code that the rules
name must be described, those that are written as writable: a rule that could never be carried out
is a mistake of the file, not a surprise at the machine.

What must not live here: what the rules come to for one drive (`verbs`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value

from .codes import CodeInfo
from .commands import INHIBIT, QUICK_STOP, ControlWordInfo
from .document import Item, Table
from .readers import WORD_MAX, read_choice, read_code_number, read_decimal, read_source
from .sections import read_proofs
from .verb_rules import (
    Access,
    Condition,
    Demand,
    EnableRule,
    ResetRule,
    SetpointRule,
    VerbRules,
)

__all__ = ["read_verbs"]

UNITS = ("Hz", "%")
DIGITS = (1, 10, 100, 1000, 10_000)
HIGHEST_SETTING = 99_999


def read_verbs(
    item: Item,
    manual: str,
    codes: Mapping[Code, CodeInfo],
    words: Mapping[Code, ControlWordInfo],
) -> VerbRules:
    """Read `verbs`.

    Args:
        item: The table.
        manual: The manual its sources stand in.
        codes: The family's described codes.
        words: Its control words.

    Raises:
        DescriptionError: It says something that cannot be.
    """
    return _Reader(manual, codes, words).verbs(item.table())


class _Reader:
    """Reads the parts of one table."""

    def __init__(
        self, manual: str, codes: Mapping[Code, CodeInfo], words: Mapping[Code, ControlWordInfo]
    ) -> None:
        self._manual = manual
        self._codes = codes
        self._words = words

    def verbs(self, table: Table) -> VerbRules:
        demands = table.get("demands")
        rules = VerbRules(
            control=self._control(table.take("control")),
            demands=tuple(self._demand(one.table()) for one in demands.items()) if demands else (),
            enable=self._enable(table.take("enable").table()),
            reset=self._reset(table.take("reset").table()),
            setpoints=tuple(self._setpoints(table.take("setpoints"))),
        )
        table.done()
        return rules

    def _control(self, item: Item) -> Code:
        code = self._written(item)
        word = self._words.get(code)
        if word is None or not {QUICK_STOP, INHIBIT} <= word.bits.keys():
            item.fail(f"{code} is no control word with bits {QUICK_STOP} and {INHIBIT}")
        return code

    def _demand(self, table: Table) -> Demand:
        return Demand(
            access=frozenset(read_choice(one, Access) for one in table.take("for").items()),
            remedy=table.take("remedy").text(),
            source=read_source(table, self._manual),
            condition=self._condition(table),
        )

    def _condition(self, table: Table) -> Condition:
        digit = table.get("digit")
        place = digit.integer(1, DIGITS[-1]) if digit else 0
        if digit is not None and place not in DIGITS:
            digit.fail(f"{', '.join(map(str, DIGITS))} are right here")
        found = Condition(
            code=self._read(table.take("code")),
            values=frozenset(
                one.integer(0, 9 if place else HIGHEST_SETTING)
                for one in table.take("values").items()
            ),
            digit=place,
        )
        if not found.values:
            table.fail("values must not be empty")
        table.done()
        return found

    def _enable(self, table: Table) -> EnableRule:
        rule = EnableRule(
            code=self._written(table.take("code")),
            value=Value.decimal(table.take("value").integer(0, WORD_MAX)),
            proofs=read_proofs(table.take("proofs")),
            otherwise=table.take("otherwise").text(),
            source=read_source(table, self._manual),
        )
        for code in rule.proofs:
            if code not in self._codes:
                table.fail(f"{code} is not described", code=str(code))
        table.done()
        return rule

    def _reset(self, table: Table) -> ResetRule:
        code, value = table.get("code"), table.get("value")
        if (code is None) != (value is None):
            table.fail("code and value belong together; without them, an enable resets the fault")
        rule = ResetRule(
            code=self._written(code) if code else None,
            value=Value.decimal(value.integer(0, WORD_MAX)) if value else None,
            number=self._read(table.take("number")),
            source=read_source(table, self._manual),
        )
        table.done()
        return rule

    def _setpoints(self, item: Item) -> Iterator[SetpointRule]:
        for one in item.items():
            yield self._setpoint(one.table())

    def _setpoint(self, table: Table) -> SetpointRule:
        unit, bounds = table.take("unit"), table.take("range").items()
        if unit.text() not in UNITS:
            unit.fail(f"{' and '.join(UNITS)} are right here")
        if len(bounds) != 2 or read_decimal(bounds[0]) >= read_decimal(bounds[1]):
            table.fail("range is the least and the greatest value: [0, 480]")
        full, least, when = table.get("full_scale"), table.get("least"), table.get("when")
        step = table.get("step")
        rule = SetpointRule(
            code=self._written(table.take("code")),
            unit=unit.text(),
            low=read_decimal(bounds[0]),
            high=read_decimal(bounds[1]),
            step=read_decimal(step) if step else None,
            least=self._read(least) if least else None,
            full_scale=self._read(full) if full else None,
            when=self._condition(when.table()) if when else None,
            source=read_source(table, self._manual),
        )
        if rule.step is not None and rule.step <= 0:
            table.fail("step is over 0")
        table.done()
        return rule

    def _read(self, item: Item) -> Code:
        """Read a code that will be read from the drive."""
        code = read_code_number(item)
        if code not in self._codes:
            item.fail(f"{code} is not described", code=str(code))
        return code

    def _written(self, item: Item) -> Code:
        """Read a code that will be written to the drive."""
        code = self._read(item)
        if not self._codes[code].writable:
            item.fail(f"{code} cannot be written", code=str(code))
        return code
