"""The description of one code: format, range, meaning, and what repeating a write could do.

A description holds what the manual says and no more. `low`, `high`, `step` and `selection` are
absent where the manual gives none; no value is refused then. Where a range and a selection are
given, the range rules and the selection names some of its values. A selection alone lists all
values, unless it is marked as partial.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from decimal import Decimal
from enum import StrEnum
from typing import Annotated

from lecombus.parameters import HIGHEST_VALUE_CHARS, LOWEST_DECIMAL, Format, Value

from .field_types import (
    WORD_MAX,
    BothLanguages,
    CodeNumber,
    Flag,
    Language,
    Number,
    Source,
    Text,
    WordNumber,
    Words,
    ends,
    numbered,
    whole,
)
from .yaml_models import FILE_TABLE, NOT_A_KEY

__all__ = ["BY_OWN_MANUAL", "OTHERS", "CodeInfo", "PlainWhen", "Storage", "WriteClass"]


RANGE_WORDS = {Language.EN: ("to", "in steps of"), Language.DE: ("bis", "in Schritten von")}
BY_OWN_MANUAL = {
    Language.EN: "by the drive's own manual",
    Language.DE: "nach dem Handbuch des Antriebs",
}
OTHERS = {
    Language.EN: f"others {BY_OWN_MANUAL[Language.EN]}",
    Language.DE: f"weitere {BY_OWN_MANUAL[Language.DE]}",
}
"""Stands after a selection of which the manual names some values only."""


RANGE, LOW, HIGH = ends("range", "a range is [lowest, highest]: the lower end comes first")
SelectionNumber = Annotated[int, whole(int(LOWEST_DECIMAL), 0xFFFF_FFFF)]
BitNumber = Annotated[int, whole(0, 15)]


class WriteClass(StrEnum):
    """What repeating a write could do; only PLAIN may be repeated after a failed read-back."""

    PLAIN = "plain"
    """The value simply is what it is: writing it again changes nothing."""
    EDGE = "edge"
    """Acts on the change, such as a TRIP reset."""
    STEP = "step"
    """Each write moves something further, such as UP and DOWN."""
    SAVE = "save"
    """Stores parameters: wears memory and takes time."""
    ADDRESS = "address"
    """Changes the address or the baud rate: the drive then answers elsewhere."""
    RESET = "reset"
    """Restarts drive or module and is not acknowledged."""


class Storage(StrEnum):
    """Where a code's value is kept, and so what a power cycle leaves of it."""

    STORED = "stored"
    """In the drive, over a power cycle. Each write may wear its memory (see `Family.saved_by`)."""
    MODULE = "module"
    """In the fieldbus module: back at its default after a power cycle."""
    VOLATILE = "volatile"
    """A process value: a setpoint, a command, an actual value, a status."""


@dataclass(frozen=True, slots=True)
class PlainWhen:
    """Values of a delicate code that may be repeated: those with `number & mask == equals`."""

    __pydantic_config__ = FILE_TABLE

    mask: Annotated[int, whole(1, WORD_MAX)]
    equals: WordNumber


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CodeInfo:
    """One described code.

    Args:
        code: Its number and subcode; in another parameter set the number with that set's offset.
        name: Its English name, in lower case, as in the manual.
        unit: Its unit; None for numbers without one.
        format: Its format on the wire.
        hex_digits: 2, 4 or 8 for VH; None otherwise.
        chars: The usual length of its value on the wire, format letter included.
        write_class: What repeating a write could do.
        plain_when: Values for which the write is PLAIN all the same.
        writable: The drive accepts writes at all.
        motion: Writing it can move the drive: a stop cancels such a write while it waits.
        control_source: It says from where the drive takes its setpoint, control word or enable.
        source: Manual and section.
        name_de: Its German name.
        low: The least value, in `unit`; None where the manual gives none.
        high: The greatest value, in `unit`; None where the manual gives none.
        step: The distance between two values, counted from `low`; None where not given.
        selection: What some values mean. Without a range these are all the values there are.
        bits: What single bits mean, in a value that is made of them; others have no meaning.
        storage: Where the value is kept.
        readable: The drive gives the value when asked.
        needs_inhibit: It has to be inhibited before this is written.
        default: The value as delivered, as it stands on the wire; None where not given.
        parameter_set: Which parameter set this reaches, from 1.
        secret: A password: never in a backup, a metric or a list of values.
        selection_partial: The manual names only some of the values that there are.
        array: Its values are reached by subcodes, of which the manual does not say how many.
    """

    __pydantic_config__ = FILE_TABLE

    code: CodeNumber
    name: Words
    format: Format
    source: Source
    name_de: Words = ""
    unit: Words | None = None
    hex_digits: Annotated[int, whole(2, 8)] | None = None
    chars: Annotated[int, whole(1, HIGHEST_VALUE_CHARS)] = 0
    low: Annotated[Number | None, LOW] = None
    high: Annotated[Number | None, HIGH] = None
    step: Number | None = None
    selection: Annotated[Mapping[SelectionNumber, BothLanguages], numbered] = field(
        default_factory=dict
    )
    selection_partial: Flag = False
    bits: Annotated[Mapping[BitNumber, BothLanguages], numbered] = field(default_factory=dict)
    default: Words | None = None
    writable: Flag = False
    readable: Flag = True
    motion: Flag = False
    control_source: Flag = False
    write_class: WriteClass = WriteClass.PLAIN
    plain_when: PlainWhen | None = None
    storage: Storage = Storage.VOLATILE
    needs_inhibit: Flag = False
    secret: Flag = False
    array: Flag = False
    parameter_set: Annotated[int, NOT_A_KEY] = 1

    def name_in(self, language: Language) -> str:
        """Return its name in a language."""
        return self.name_de if language is Language.DE and self.name_de else self.name

    def meaning(self, value: Value) -> Text | None:
        """Return what the manual says a value means; None where it says nothing of it.

        Of a value made of bits those that are set are named, the lowest first.
        """
        number = value.whole
        if number is None:
            return None
        set_bits = [text for bit, text in self.bits.items() if number >> bit & 1]
        if set_bits:
            return Text(*(", ".join(words) for words in zip(*map(astuple, set_bits), strict=True)))
        return self.selection.get(number)

    def may_be(self, number: Decimal | int) -> bool:
        """Return whether the manual allows a value: in the range, on the step, in the selection."""
        if self.low is None or self.high is None:
            return self.selection_partial or not self.selection or number in self.selection
        if not self.low <= number <= self.high:
            return False
        return self.step is None or (number - self.low) % self.step == 0

    @property
    def allowed(self) -> str:
        """What may be written, for people: `0 to 480 Hz`, `0 (off), 1 (on)`; empty if not known."""
        return self.allowed_in(Language.EN)

    def allowed_in(self, language: Language) -> str:
        """Return what may be written, for people, in a language."""
        if self.low is None or self.high is None:
            named = [
                f"{number} ({text.in_language(language)})"
                for number, text in self.selection.items()
            ]
            return ", ".join([*named, *([OTHERS[language]] if self.selection_partial else [])])
        to, by = RANGE_WORDS[language]
        unit = f" {self.unit}" if self.unit else ""
        step = f" {by} {self.step}" if self.step is not None else ""
        return f"{self.low} {to} {self.high}{unit}{step}"
