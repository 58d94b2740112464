"""Control words: what their bits and fields command, and how to change some of them.

A control word is described whole: every bit has a name with a meaning for each level, belongs to a
field, is free (the user of the drive decides what it does) or is reserved. `encode` changes the
named bits of the word that the drive holds now: a word made from nothing could lift an inhibit,
change the direction or the parameter set. Free and reserved bits cannot be changed by name, because
their effect is not known here. A 93XX's word depends on its signal configuration: see
`Family.configured`.

Source: EDB2102EN 8.2 (C0135); CMVLC401A table 9 (C0135).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

from lecombus.errors import CodeValueError

from .field_types import (
    WORD_MAX,
    BothLanguages,
    Source,
    WordCode,
    Words,
    numbered,
    whole,
)
from .words import BITS, BitField
from .yaml_models import FILE_TABLE, KEY, NOT_A_KEY, ReadAs, by_key, mistake

__all__ = ["ControlBit", "ControlWordInfo"]

QUICK_STOP = "quick_stop"
INHIBIT = "controller_inhibit"
TRIP_RESET = "trip_reset"
DIRECTION = "direction_ccw"
JOG = "jog"
"""Names that have one meaning in every family, by which verbs find them."""


ControlBitNumber = Annotated[int, whole(0, 15)]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlBit:
    """One named bit.

    Args:
        name: Its name, such as `quick_stop`.
        off: What 0 means.
        on: What 1 means.
        bit: Its number, 0..15; in a file the key that this stands under.
    """

    __pydantic_config__ = FILE_TABLE

    name: Words
    off: BothLanguages
    on: BothLanguages
    bit: Annotated[int, NOT_A_KEY] = 0


def _fields_by_name(fields: tuple[BitField, ...]) -> dict[str, BitField]:
    for place, one in enumerate(fields):
        highest = one.mask >> one.low
        for number in one.texts:
            if number > highest:
                right = f"a whole number from 0 to {highest} is right here"
                raise mistake(f"{number}: {right}", place, "texts", str(number), KEY)
    return by_key(fields, lambda one: one.name)


def _bits_by_name(bits: Mapping[int, ControlBit]) -> dict[str, ControlBit]:
    found: dict[str, ControlBit] = {}
    for number, bit in bits.items():
        if bit.name in found:
            raise mistake(f"two bits have the name {bit.name}", str(number), KEY)
        found[bit.name] = replace(bit, bit=number)
    return found


BITS_BY_NAME = ReadAs(Annotated[dict[ControlBitNumber, ControlBit], numbered], _bits_by_name)
FIELDS_BY_NAME = ReadAs(tuple[Annotated[BitField, BITS], ...], _fields_by_name)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlWordInfo:
    """The control word of one family, or of one signal configuration of it.

    Args:
        code: The code it is written to.
        bits: The named bits by name.
        fields: The fields by name.
        free: Bits that the drive's user assigns.
        reserved: Bits that do nothing, as far as the manual says.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    code: WordCode
    bits: Annotated[Mapping[str, ControlBit], BITS_BY_NAME]
    fields: Annotated[Mapping[str, BitField], FIELDS_BY_NAME] = field(default_factory=dict)
    free: tuple[ControlBitNumber, ...] = ()
    reserved: tuple[ControlBitNumber, ...] = ()
    source: Source

    @property
    def described_bits(self) -> list[int]:
        """The bits that have a name or lie in a field, each as often as that."""
        named = [bit.bit for bit in self.bits.values()]
        fields = self.fields.values()
        return named + [bit for field in fields for bit in range(field.low, field.high + 1)]

    @property
    def every_bit(self) -> list[int]:
        """All bits that the description accounts for, each as often as it does."""
        return [*self.described_bits, *self.free, *self.reserved]

    def encode(self, current: int, changes: Mapping[str, bool | int]) -> int:
        """Change the named bits and fields of a control word, and only those.

        Args:
            current: The word the drive holds now, 0..FFFFh, as last read.
            changes: What is to be changed: bits true or false, fields their number.

        Returns:
            The word to write.

        Raises:
            CodeValueError: A name is not one of this word's, or a field has no such number.
        """
        word = current
        for name, wanted in changes.items():
            if name in self.bits:
                mask = 1 << self.bits[name].bit
                word = word | mask if wanted else word & ~mask
            elif name in self.fields:
                word = self._with_field(self.fields[name], word, int(wanted))
            else:
                raise self._unknown(name)
        return word & WORD_MAX

    def decode(self, word: int) -> dict[str, bool | int]:
        """Return what a control word commands: every named bit and field."""
        bits = {name: bool(word >> bit.bit & 1) for name, bit in self.bits.items()}
        fields = {name: (word & field.mask) >> field.low for name, field in self.fields.items()}
        return bits | fields

    def _with_field(self, field: BitField, word: int, number: int) -> int:
        if number not in field.texts:
            known = ", ".join(f"{key} ({text})" for key, text in field.texts.items())
            raise CodeValueError(
                f"{field.name} of {self.code} cannot be {number}: {known} are right",
                code=str(self.code), value=number,
            )  # fmt: skip
        return word & ~field.mask | number << field.low

    def _unknown(self, name: str) -> CodeValueError:
        """Return why a name cannot be changed: `bit_4` may be a free or a reserved one."""
        known = ", ".join((*self.bits, *self.fields))
        kind, _, number = name.rpartition("_")
        bit = int(number) if kind == "bit" and number.isdecimal() else None
        why = f"{self.code} has no bit {name}"
        if bit in self.free:
            why = f"bit {bit} of {self.code} is free: what it does is set in the drive, not known"
        elif bit in self.reserved:
            why = f"bit {bit} of {self.code} is reserved"
        return CodeValueError(
            f"{why}; {known} can be changed by name", code=str(self.code), value=name
        )
