"""Building the status and control words of a family from the entries of its data files.

Strategy: an entry without `configuration` describes a word as every drive of the family has it.
An entry with one describes what that signal configuration adds: bits that the general entry leaves
free and nothing else, so that no entry replaces another. `WordBook` takes them all, joins each
configuration with the general entry, and refuses what overlaps or, in a control word, is left out.

A status word and a control word read::

    words:
      - code: C0150
        configuration: [6xx1, 7xx1]       # where the family has signal configurations
        bits: {3: torque_below_limit, 15: ready}
        fields: [communication_error]     # shared under `fields`, or described here
        free: [14]
        states: {ready: ready, torque_limit: not torque_below_limit, fault: status = 8}
        source: "8.2"
    control_words:
      - code: C0135
        bits:
          3: {name: quick_stop, off: [not active, nicht aktiv], on: [active, aktiv]}
        fields:
          - {name: jog, bits: [0, 1], texts: {0: [C0046 active, C0046 aktiv]}}
        free: [2]
        reserved: [4, 5, 6, 7, 8]
        source: "8.2"
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

from lecombus.protocol.addressing import Code

from .codes import CodeInfo
from .commands import ControlWordInfo
from .control_entries import check_whole, control_bits, read_control_word
from .document import Item, Table
from .operating import OperatingState, StateRule
from .readers import (
    read_choice,
    read_code_number,
    read_items,
    read_numbers,
    read_source,
    read_span,
    read_text,
)
from .texts import Text
from .words import WordField, WordInfo

__all__ = ["CONFIGURATION", "WordBook"]

LONGEST_WORD = 0xFFFF_FFFF

CONFIGURATION = re.compile(r"[0-9x]{1,5}")
"""A signal configuration as the manual writes it: `1xx1`, any digit for an x."""

_STATE = re.compile(r"(?P<no>not )?(?P<name>\w+)(?: = (?P<number>\d+))?", re.ASCII)

GENERAL = ""


class WordBook:
    """The words of one family while its files are read.

    Args:
        fields: The entries of `fields`, which several words share.
        codes: The family's described codes.
        manual: What sources begin with.
    """

    def __init__(self, fields: Iterable[Item], codes: Mapping[Code, CodeInfo], manual: str) -> None:
        self._codes = codes
        self._manual = manual
        self._shared = {field.name: field for field in map(_read_field, map(Item.table, fields))}
        self._words: dict[str, dict[Code, WordInfo]] = {GENERAL: {}}
        self._controls: dict[str, dict[Code, ControlWordInfo]] = {GENERAL: {}}

    def add_word(self, item: Item) -> None:
        """Take one entry of `words`."""
        table = item.table()
        code = self._word_code(table)
        names = _configurations(table)
        word = self._read_word(table)
        table.done()
        for name in names:
            known = self._words.setdefault(name, {})
            if code in known:
                item.fail(f"{code} is taken apart twice", code=str(code))
            known[code] = word if name == GENERAL else self._joined(item, code, word)

    def add_control_word(self, item: Item) -> None:
        """Take one entry of `control_words`."""
        table = item.table()
        code = self._word_code(table)
        names = _configurations(table)
        word = read_control_word(table, code, self._manual)
        table.done()
        for name in names:
            known = self._controls.setdefault(name, {})
            if code in known:
                item.fail(f"{code} is described twice", code=str(code))
            known[code] = word if name == GENERAL else self._joined_control(item, word)
            check_whole(item, known[code])

    @property
    def configurations(self) -> tuple[str, ...]:
        """The signal configurations that have words of their own."""
        return tuple(sorted((self._words.keys() | self._controls.keys()) - {GENERAL}))

    def words(self, configuration: str = GENERAL) -> dict[Code, WordInfo]:
        """Give the status words of a configuration."""
        return self._words[GENERAL] | self._words.get(configuration, {})

    def control_words(self, configuration: str = GENERAL) -> dict[Code, ControlWordInfo]:
        """Give the control words of a configuration."""
        return self._controls[GENERAL] | self._controls.get(configuration, {})

    def _word_code(self, table: Table) -> Code:
        item = table.take("code")
        code = read_code_number(item)
        if code not in self._codes or self._codes[code].hex_digits is None:
            table.fail(f"{code} is not described as a word (VH)", code=str(code))
        return code

    def _read_word(self, table: Table) -> WordInfo:
        """Read one entry of `words`; its fields stand in it or are named from `fields`."""
        fields = [self._field(item) for item in read_items(table, "fields")]
        fault_bit = table.get("fault_bit")
        bits = _bits(table.take("bits").table(), fields)
        free = read_numbers(table, "free", 31)
        for item, bit in zip(read_items(table, "free"), free, strict=True):
            if bit in _taken(bits, fields):
                item.fail(f"bit {bit} has a meaning: it is not free")
        return WordInfo(
            bits=bits,
            fields=tuple(fields),
            fault_mask=1 << fault_bit.integer(0, 31) if fault_bit else 0,
            source=read_source(table, self._manual),
            states=tuple(_states(table.get("states"), bits, fields)),
            free=free,
        )

    def _field(self, item: Item) -> WordField:
        if not item.is_text():
            return _read_field(item.table())
        if item.text() not in self._shared:
            known = ", ".join(self._shared) or "none"
            item.fail(f"there is no field {item.text()}; {known} are shared")
        return self._shared[item.text()]

    def _joined(self, item: Item, code: Code, extra: WordInfo) -> WordInfo:
        """Join what a configuration says of a word with what holds for every drive."""
        general = self._words[GENERAL].get(code)
        if general is None:
            item.fail(f"{code} has no entry without configuration before this one", code=str(code))
        taken = _taken(extra.bits, extra.fields)
        self._only_free(item, taken | set(extra.free), general.free)
        return replace(
            general,
            bits=tuple(sorted((*general.bits, *extra.bits), key=lambda bit: bit[1])),
            fields=(*general.fields, *extra.fields),
            states=(*general.states, *extra.states),
            free=tuple(bit for bit in general.free if bit not in taken),
        )

    def _joined_control(self, item: Item, extra: ControlWordInfo) -> ControlWordInfo:
        general = self._controls[GENERAL].get(extra.code)
        if general is None:
            item.fail(
                f"{extra.code} has no entry without configuration before this one",
                code=str(extra.code),
            )
        taken = set(control_bits(extra))
        self._only_free(item, taken | set(extra.free) | set(extra.reserved), general.free)
        return replace(
            general,
            bits={**general.bits, **extra.bits},
            fields={**general.fields, **extra.fields},
            free=tuple(bit for bit in general.free if bit not in taken),
        )

    def _only_free(self, item: Item, bits: set[int], free: tuple[int, ...]) -> None:
        """Refuse to give a bit of a configuration another meaning than it always has."""
        wrong = sorted(bits - set(free))
        if wrong:
            item.fail(f"bit {wrong[0]} is not free, so no configuration gives it a meaning")


def _configurations(table: Table) -> list[str]:
    """Read which signal configurations an entry is for; the general one if it does not say."""
    item = table.get("configuration")
    if item is None:
        return [GENERAL]
    names = item.items()
    for name in names:
        if CONFIGURATION.fullmatch(name.text()) is None:
            name.fail(f"{name.text()} is no signal configuration such as 1xx1")
    return [name.text() for name in names]


def _read_field(table: Table) -> WordField:
    """Read a number inside a status word."""
    low, high = read_span(table, 31)
    texts, fault = table.get("texts"), table.get("fault")
    field = WordField(
        name=table.take("name").text(),
        low=low,
        high=high,
        texts=_texts(texts.table()) if texts else {},
        fault=frozenset(item.integer(0, LONGEST_WORD) for item in fault.items())
        if fault
        else frozenset(),
    )
    if not field.fault <= field.texts.keys():
        table.fail("every number under fault needs a text")
    table.done()
    return field


def _states(
    item: Item | None, bits: tuple[tuple[str, int], ...], fields: list[WordField]
) -> Iterable[StateRule]:
    """Read what shows which state: a bit, `not` a bit, or a number of a field."""
    known = {field.name: field for field in fields}
    masks = dict(bits)
    for key, value in item.table().pairs() if item else ():
        state = read_choice(key, OperatingState)
        for condition in [value] if value.is_text() else value.items():
            match = _STATE.fullmatch(condition.text())
            name = match["name"] if match else ""
            if match and name in masks and match["number"] is None:
                yield StateRule(state, masks[name], 0 if match["no"] else masks[name])
            elif match and name in known and match["number"] and not match["no"]:
                yield _field_rule(condition, state, known[name], int(match["number"]))
            else:
                condition.fail(
                    f"{condition.text()}: a bit, `not` and a bit, or a field as in `{state} = 8` "
                    f"is right here; {', '.join((*masks, *known))} are known"
                )


def _field_rule(item: Item, state: OperatingState, field: WordField, number: int) -> StateRule:
    if number not in field.texts:
        item.fail(f"{field.name} has no text for {number}, so it shows no state")
    return StateRule(state, field.mask, number << field.low)


def _bits(table: Table, fields: list[WordField]) -> tuple[tuple[str, int], ...]:
    numbered = _numbered(table, 31)
    if len(set(numbered.values())) < len(numbered):
        table.fail("two bits have one name")
    for field in fields:
        if any(field.low <= bit <= field.high for bit in numbered):
            table.fail(f"a bit of {field.name} has a name of its own")
    return tuple((name, 1 << bit) for bit, name in sorted(numbered.items()))


def _taken(bits: Iterable[tuple[str, int]], fields: Iterable[WordField]) -> set[int]:
    """Give the numbers of the bits that have a meaning."""
    named = {mask.bit_length() - 1 for _, mask in bits}
    return named | {bit for field in fields for bit in range(field.low, field.high + 1)}


def _texts(table: Table) -> dict[int, Text]:
    return {key.integer(0, LONGEST_WORD): read_text(value) for key, value in table.pairs()}


def _numbered(table: Table, high: int) -> dict[int, str]:
    return {key.integer(0, high): value.text() for key, value in table.pairs()}
