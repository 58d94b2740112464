"""Control words: what their bits and fields command, and how to change some of them.

Strategy: a control word is described whole (`ControlWordInfo`, from the family's data file): every
bit has a name with a meaning for each level, belongs to a field, is free (the user of the drive
decides what it does) or is reserved. `encode` changes what is named and nothing else, from the
word the drive holds now: a word made up from nothing could lift an inhibit, change the direction
or the parameter set. Free and reserved bits cannot be changed by name, because nobody here knows
what they would do.

Which word a 93XX has follows from its signal configuration: see `Family.configured`. When a word
may be sent at all is decided elsewhere (`stops`, `operations`).

Source: EDB2102EN 8.2 (C0135); CMVLC401A table 9 (C0135).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lecombus.errors import CodeValueError
from lecombus.protocol.addressing import Code

from .texts import Text

__all__ = ["ControlBit", "ControlField", "ControlWordInfo"]

WORD_MAX = 0xFFFF

QUICK_STOP = "quick_stop"
INHIBIT = "controller_inhibit"
TRIP_RESET = "trip_reset"
DIRECTION = "direction_ccw"
JOG = "jog"
"""Names that have one meaning in every family, by which verbs find them."""


@dataclass(frozen=True, slots=True, eq=False)
class ControlBit:
    """One named bit.

    Args:
        name: Its name, such as `quick_stop`.
        bit: Its number, 0..15.
        off: What 0 means.
        on: What 1 means.
    """

    name: str
    bit: int
    off: Text
    on: Text


@dataclass(frozen=True, slots=True, eq=False)
class ControlField:
    """A number inside a control word.

    Args:
        name: Its name, such as `jog`.
        low: Its lowest bit.
        high: Its highest bit.
        texts: What each number means.
    """

    name: str
    low: int
    high: int
    texts: Mapping[int, Text]

    @property
    def mask(self) -> int:
        """Its bits."""
        return ((1 << self.high - self.low + 1) - 1) << self.low


@dataclass(frozen=True, slots=True, eq=False)
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

    code: Code
    bits: Mapping[str, ControlBit]
    fields: Mapping[str, ControlField]
    free: tuple[int, ...]
    reserved: tuple[int, ...]
    source: str

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
        """Name what a control word commands: every named bit and field."""
        bits = {name: bool(word >> bit.bit & 1) for name, bit in self.bits.items()}
        fields = {name: (word & field.mask) >> field.low for name, field in self.fields.items()}
        return bits | fields

    def _with_field(self, field: ControlField, word: int, number: int) -> int:
        if number not in field.texts:
            known = ", ".join(f"{key} ({text})" for key, text in field.texts.items())
            raise CodeValueError(
                f"{field.name} of {self.code} cannot be {number}: {known} are right",
                code=str(self.code), value=number,
            )  # fmt: skip
        return word & ~field.mask | number << field.low

    def _unknown(self, name: str) -> CodeValueError:
        """Say why a name cannot be changed: `bit_4` may be a free or a reserved one."""
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
