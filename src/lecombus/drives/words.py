"""Status words: what bits and fields of C0150 and C0068 are called, decoding, operating states.

A bit has a name only where the manual gives it one meaning: bits that the drive lets its user
assign (8200 vector C0417, 93XX without a known signal configuration) are listed as free and not
decoded. A field of several bits gives a number and, where the manual lists it, a text; a number
that the manual does not list is shown as a number.

Operating states are what words show, in the same words for every family. "Running" is derived from
none of them (EDB2102EN 8.2, CMVLC401A table 9). A rule is a mask and a number (`StateRule`, from
the family's data file). A state has a rule only where the manual gives the bit that one meaning:
bits that users assign have none, and neither have bits that two manuals contradict each other about
(the "power stage energized" bits of SMVector). The absence of a state proves nothing: "not
inhibited" does not mean that the motor turns. An output frequency of 0 does not mean standstill:
only a drive that measures its speed reports that.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from typing import Annotated

from pydantic import AfterValidator

from .field_types import NOTHING, BothLanguages, Text, Words, ends, numbered, whole
from .yaml_models import FILE_TABLE, ReadFile, mistake, open_data_file

__all__ = [
    "BitField",
    "FieldReading",
    "OperatingState",
    "StateRule",
    "WordField",
    "WordFieldEntry",
    "WordInfo",
    "believed_states",
    "german_name",
    "join_states",
]


class OperatingState(StrEnum):
    """One thing that a drive reports of itself."""

    READY = "ready"
    """Ready for operation: no fault, no overvoltage or undervoltage."""
    INITIALISING = "initialising"
    START_LOCK = "start_lock"
    """Autostart lock, switch-on inhibit: it waits for a fresh enable."""
    INHIBITED = "inhibited"
    """Controller inhibit."""
    OPERATION_INHIBITED = "operation_inhibited"
    """By the controller status: the line, a terminal or the drive itself inhibits it."""
    ENABLED = "enabled"
    """Operation enabled: not that the motor turns."""
    QUICK_STOP = "quick_stop"
    PULSES_INHIBITED = "pulses_inhibited"
    AT_SETPOINT = "at_setpoint"
    RAMP_DONE = "ramp_done"
    """The ramp generator's output has reached its input."""
    OUTPUT_FREQUENCY_0 = "output_frequency_0"
    """An inverter puts out a frequency of 0: its motor may still coast."""
    ZERO_SPEED = "zero_speed"
    """The drive measures an actual speed of 0; only a 93XX does."""
    BELOW_THRESHOLD = "below_threshold"
    ABOVE_THRESHOLD = "above_threshold"
    CURRENT_LIMIT = "current_limit"
    TORQUE_LIMIT = "torque_limit"
    DIRECTION_CCW = "direction_ccw"
    PARAMETER_SET_2 = "parameter_set_2"
    FLYING_RESTART = "flying_restart"
    DC_BRAKING = "dc_braking"
    HOMING = "homing"
    HOMED = "homed"
    OVERVOLTAGE = "overvoltage"
    WARNING = "warning"
    MESSAGE = "message"
    """It has stopped the pulses by itself and goes on when the cause is gone."""
    FAULT = "fault"
    POWER_OFF = "power_off"


@dataclass(frozen=True, slots=True)
class StateRule:
    """Values of a word that show a state: `word & mask == equals`."""

    state: OperatingState
    mask: int
    equals: int

    def holds(self, word: int) -> bool:
        """Return whether a word shows the state."""
        return word & self.mask == self.equals


OPPOSITES = {
    OperatingState.ENABLED: OperatingState.INHIBITED,
    OperatingState.INHIBITED: OperatingState.ENABLED,
}


def join_states(words: Iterable[Iterable[OperatingState]]) -> tuple[OperatingState, ...]:
    """Join the states that several words of a drive show.

    Words are read at different times: where one contradicts another, the earlier in the list is
    believed and the other says nothing.

    Args:
        words: The states of each word, the word that is read most often first.
    """
    found: dict[OperatingState, None] = {}
    for states in words:
        known = frozenset(found)
        found |= {state: None for state in states if OPPOSITES.get(state) not in known}
    return tuple(sorted(found, key=ORDER.__getitem__))


def believed_states(
    words: Sequence[tuple[float, Collection[OperatingState], Collection[OperatingState]]],
) -> list[tuple[OperatingState, ...]]:
    """Leave out of each word what a newer one denies.

    A word denies what it could show and does not show, and the opposite of what it shows.

    Args:
        words: Age in seconds, states shown and states that could be shown, of each word.
    """
    denied = [
        (age_s, (set(able) - set(shown)) | {OPPOSITES[one] for one in shown if one in OPPOSITES})
        for age_s, shown, able in words
    ]
    return [
        tuple(
            state
            for state in shown
            if not any(newer_s < age_s and state in states for newer_s, states in denied)
        )
        for age_s, shown, _ in words
    ]


ORDER = {state: number for number, state in enumerate(OperatingState)}


Bit = Annotated[int, whole(0, 31)]
Number = Annotated[int, whole(0, 0xFFFF_FFFF)]
BITS, LOW, HIGH = ends("bits", "bits is the lowest and the highest bit: [8, 11]", equal=True)


@dataclass(frozen=True, slots=True)
class FieldReading:
    """One field of a status word, read.

    Args:
        number: The field's number as the drive sent it.
        text: What the manual says the number means; empty where it says nothing.
    """

    number: int
    text: Text


@dataclass(frozen=True, slots=True, eq=False)
class BitField:
    """A number inside a word.

    Args:
        name: The field's name, such as `controller_status` or `jog`.
        low: Its lowest bit, 0..31.
        high: Its highest bit, `low`..31.
        texts: What the manual says each number means.
    """

    __pydantic_config__ = FILE_TABLE

    name: Words
    low: Annotated[Bit, LOW]
    high: Annotated[Bit, HIGH]
    texts: Annotated[Mapping[Number, BothLanguages], numbered] = field(default_factory=dict)

    @property
    def mask(self) -> int:
        """Its bits."""
        return ((1 << self.high - self.low + 1) - 1) << self.low


@dataclass(frozen=True, slots=True, eq=False)
class WordField(BitField):
    """A number inside a status word.

    Args:
        fault: The numbers that mean an active fault; empty where the field says nothing of it.
    """

    fault: frozenset[Number] = frozenset()

    def read(self, word: int) -> FieldReading:
        """Take this field out of a word."""
        number = (word & self.mask) >> self.low
        return FieldReading(number, self.texts.get(number, NOTHING))


def _check_field(field: WordField) -> WordField:
    if not field.fault <= field.texts.keys():
        raise mistake("every number under fault needs a text")
    return field


WordFieldEntry = Annotated[WordField, BITS, AfterValidator(_check_field)]
"""A field as it stands in a file."""


@dataclass(frozen=True, slots=True, eq=False)
class WordInfo:
    """The description of one status word of one family.

    Args:
        bits: Name and mask of every bit that has one fixed meaning.
        fields: The numbers inside the word.
        fault_mask: The bit that is set while a fault is active; 0 where there is none.
        source: Manual and section.
        states: What shows which state of the drive.
        free: Bits that the drive's user assigns.
    """

    bits: tuple[tuple[str, int], ...]
    fields: tuple[WordField, ...]
    fault_mask: int
    source: str
    states: tuple[StateRule, ...] = ()
    free: tuple[int, ...] = ()

    @property
    def described_bits(self) -> list[int]:
        """The bits that have a name or lie in a field."""
        named = [mask.bit_length() - 1 for _, mask in self.bits]
        return named + [bit for field in self.fields for bit in range(field.low, field.high + 1)]

    @property
    def every_bit(self) -> list[int]:
        """All bits that the description accounts for."""
        return [*self.described_bits, *self.free]

    def flags(self, word: int) -> dict[str, bool]:
        """Return every described bit and say whether it is set."""
        return {name: bool(word & mask) for name, mask in self.bits}

    def shown_states(self, word: int) -> tuple[OperatingState, ...]:
        """Return the states that the word shows."""
        return tuple(dict.fromkeys(rule.state for rule in self.states if rule.holds(word)))

    @property
    def possible_states(self) -> frozenset[OperatingState]:
        """The states that the word can show: without one of them it says that this is not so."""
        return frozenset(rule.state for rule in self.states)

    def readings(self, word: int) -> dict[str, FieldReading]:
        """Read every described field."""
        return {field.name: field.read(word) for field in self.fields}

    def active_fault(self, word: int) -> bool | None:
        """Return whether the word reports an active fault.

        Returns:
            True or False where the manual defines it; None where this word says nothing of it, or
            shows a number that the manual does not list.
        """
        if self.fault_mask:
            return bool(word & self.fault_mask)
        for one in self.fields:
            if one.fault:
                number = one.read(word).number
                return number in one.fault if number in one.texts else None
        return None

    def notice(self, word: int) -> str:
        """Say which notice short of a fault the word shows.

        Returns:
            `message` (pulses inhibited while it lasts), `warning`, or nothing.

        Source: EDB2102EN 8.2 (C0150: controller status 7, bits 12 and 13 where they have this
        meaning).
        """
        shown = self.flags(word)
        state = self.readings(word).get("controller_status")
        is_message = state is not None and state.text.en.startswith("message active")
        if shown.get("message") or is_message:
            return "message"
        return "warning" if shown.get("warning") else ""


@dataclass(frozen=True)
class _BitNamesFile:
    __pydantic_config__ = FILE_TABLE

    names: dict[Words, Words]


def german_name(name: str) -> str:
    """Return what a bit or field is called in German; a name that has none stays as it is.

    A bit's name in a family's file is a word for programs, the same in every language; the German
    names stand once for all families.

    Args:
        name: As in a family's file, such as `pulse_inhibit`.
    """
    return bit_names().get(name, name)


@cache
def bit_names(read_file: ReadFile | None = None) -> dict[str, str]:
    """Return all German names, from `bit-names.yaml`.

    Raises:
        DescriptionError: It says something that cannot be.
    """
    return open_data_file("families", "bit-names", read_file).read(_BitNamesFile).names
