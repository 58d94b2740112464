"""Making the status and control words of a family from the entries of its data files.

An entry without `configuration` describes a word as every drive of the family has it. An entry
with one says what that signal configuration adds: it gives a meaning to bits that the general
entry leaves free, so that no entry replaces another. Every bit of a control word must be described,
because a program that changes one bit must know what the others do.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Final, TypeVar

from pydantic import BeforeValidator, Discriminator, Tag

from lecombus.protocol.addressing import Code

from .codes import CodeInfo
from .commands import ControlWordInfo
from .field_types import CodeNumber, Source, Words, numbered, read_words
from .operating import OperatingState, StateRule
from .words import Bit, WordField, WordFieldEntry, WordInfo
from .yaml_models import FILE_TABLE, Place, Reads, mistake, without_keys

__all__ = ["ControlWordEntry", "WordBook", "WordEntry"]

CONFIGURATION: Final = re.compile(r"[0-9x]{1,5}")
"""A signal configuration as the manual writes it: `1xx1`, any digit for an x."""

_STATE: Final = re.compile(r"(?P<no>not )?(?P<name>\w+)(?: = (?P<number>\d+))?", re.ASCII)

GENERAL: Final = ""
CONTROL_BITS: Final = frozenset(range(16))

AnyWord = TypeVar("AnyWord", WordInfo, ControlWordInfo)


def _read_configuration(given: object) -> str:
    if CONFIGURATION.fullmatch(read_words(given)) is None:
        raise mistake(f"{given} is no signal configuration such as 1xx1")
    return read_words(given)


Configurations = tuple[Annotated[str, Reads(_read_configuration)], ...]

FieldOrName = Annotated[
    Annotated[Words, Tag("a name")] | Annotated[WordFieldEntry, Tag("a field")],
    Discriminator(lambda given: "a name" if isinstance(given, str) else "a field"),
]

Conditions = Annotated[
    tuple[Words, ...], BeforeValidator(lambda given: [given] if isinstance(given, str) else given)
]


@dataclass(frozen=True, slots=True, kw_only=True)
class WordEntry:
    """One entry of `words`: a status word.

    Args:
        code: Its code.
        configuration: The signal configurations that the entry is for.
        bits: The name of each bit.
        fields: The numbers inside the word; by name where they stand under `fields` of the file.
        free: Bits that the drive's user assigns.
        fault_bit: The bit that is set while a fault is active.
        states: What shows which state: `ready`, `not ready`, `controller_status = 8`.
        source: Section of the manual.
    """

    __pydantic_config__ = FILE_TABLE

    code: CodeNumber
    configuration: Configurations = (GENERAL,)
    bits: Annotated[Mapping[Bit, Words], numbered]
    fields: tuple[FieldOrName, ...] = ()
    free: tuple[Bit, ...] = ()
    fault_bit: Bit | None = None
    states: Mapping[OperatingState, Conditions] | None = None
    source: Source


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlWordEntry(ControlWordInfo):
    """One entry of `control_words`."""

    configuration: Configurations = (GENERAL,)


class WordBook:
    """The words of one family while its files are read.

    Args:
        shared: The fields that several words name.
        codes: The family's described codes.
    """

    def __init__(self, shared: Mapping[str, WordField], codes: Mapping[Code, CodeInfo]) -> None:
        self._codes = codes
        self._shared = shared
        self._words: dict[str, dict[Code, WordInfo]] = {GENERAL: {}}
        self._controls: dict[str, dict[Code, ControlWordInfo]] = {GENERAL: {}}

    def add_word(self, at: Place, entry: WordEntry) -> None:
        """Take one entry of `words`.

        Raises:
            DescriptionError: It contradicts itself or another entry.
        """
        self._check_is_word(at, entry.code)
        fields = tuple(self._field(at, number, one) for number, one in enumerate(entry.fields))
        numbers = sorted(entry.bits.items())
        word = WordInfo(
            bits=tuple((name, 1 << bit) for bit, name in numbers),
            fields=fields,
            fault_mask=0 if entry.fault_bit is None else 1 << entry.fault_bit,
            source=entry.source,
            states=tuple(_states(at, entry, fields)),
            free=entry.free,
        )
        if len(set(entry.bits.values())) < len(entry.bits):
            at.fail("two bits have one name", "bits")
        for field in fields:
            if any(field.low <= bit <= field.high for bit in entry.bits):
                at.fail(f"a bit of {field.name} has a name of its own", "bits")
        for number, bit in enumerate(entry.free):
            if bit in word.described_bits:
                at.fail(f"bit {bit} has a meaning: it is not free", "free", number)
        for name in entry.configuration:
            _put(at, self._words, name, entry.code, word, _joined)

    def add_control_word(self, at: Place, entry: ControlWordEntry) -> None:
        """Take one entry of `control_words`.

        Raises:
            DescriptionError: It contradicts itself or another entry.
        """
        self._check_is_word(at, entry.code)
        word = without_keys(ControlWordInfo, entry)
        for number, field in enumerate(word.fields):
            if field in word.bits:
                at.fail(f"{field} stands here twice", "fields", number)
        for name in entry.configuration:
            _put(at, self._controls, name, entry.code, word, _joined_control)
            _check_whole(at, self._controls[name][entry.code])

    @property
    def configurations(self) -> tuple[str, ...]:
        """The signal configurations that have words of their own."""
        return tuple(sorted((self._words.keys() | self._controls.keys()) - {GENERAL}))

    def words(self, configuration: str = GENERAL) -> dict[Code, WordInfo]:
        """Return the status words of a configuration."""
        return self._words[GENERAL] | self._words.get(configuration, {})

    def control_words(self, configuration: str = GENERAL) -> dict[Code, ControlWordInfo]:
        """Return the control words of a configuration."""
        return self._controls[GENERAL] | self._controls.get(configuration, {})

    def _check_is_word(self, at: Place, code: Code) -> None:
        if code not in self._codes or self._codes[code].hex_digits is None:
            at.fail(f"{code} is not described as a word (VH)", code=str(code))

    def _field(self, at: Place, number: int, field: str | WordField) -> WordField:
        if isinstance(field, WordField):
            return field
        if field not in self._shared:
            known = ", ".join(self._shared) or "none"
            at.fail(f"there is no field {field}; {known} are shared", "fields", number)
        return self._shared[field]


def _put(
    at: Place,
    known: dict[str, dict[Code, AnyWord]],
    configuration: str,
    code: Code,
    word: AnyWord,
    join: Callable[[AnyWord, AnyWord], AnyWord],
) -> None:
    """Take a word of one configuration, joined with what holds for every drive."""
    words, general = known.setdefault(configuration, {}), known[GENERAL].get(code)
    if code in words:
        at.fail(f"{code} is described twice", code=str(code))
    if configuration == GENERAL:
        words[code] = word
        return
    if general is None:
        at.fail(f"{code} has no entry without configuration before this one", code=str(code))
    wrong = set(word.every_bit) - set(general.free)
    if wrong:
        at.fail(f"bit {min(wrong)} is not free, so no configuration gives it a meaning")
    words[code] = join(general, word)


def _joined(general: WordInfo, extra: WordInfo) -> WordInfo:
    return replace(
        general,
        bits=tuple(sorted((*general.bits, *extra.bits), key=lambda bit: bit[1])),
        fields=(*general.fields, *extra.fields),
        states=(*general.states, *extra.states),
        free=tuple(bit for bit in general.free if bit not in extra.described_bits),
    )


def _joined_control(general: ControlWordInfo, extra: ControlWordInfo) -> ControlWordInfo:
    return replace(
        general,
        bits={**general.bits, **extra.bits},
        fields={**general.fields, **extra.fields},
        free=tuple(bit for bit in general.free if bit not in extra.described_bits),
    )


def _check_whole(at: Place, word: ControlWordInfo) -> None:
    """Refuse a control word of which a bit has two meanings, or none."""
    every = word.every_bit
    for bit in sorted(CONTROL_BITS | set(every)):
        if every.count(bit) != 1:
            times = "two meanings" if bit in every else "no meaning: named, field, free, reserved?"
            at.fail(f"bit {bit} has {times}", code=str(word.code))


def _states(at: Place, entry: WordEntry, fields: tuple[WordField, ...]) -> Iterator[StateRule]:
    """Return what shows which state: a bit, `not` a bit, or a number of a field."""
    known = {field.name: field for field in fields}
    masks = {name: 1 << bit for bit, name in entry.bits.items()}
    for state, conditions in (entry.states or {}).items():
        for place, condition in enumerate(conditions):
            match = _STATE.fullmatch(condition)
            name, number = (match["name"], match["number"]) if match else ("", None)
            if match and name in masks and number is None:
                yield StateRule(state, masks[name], 0 if match["no"] else masks[name])
            elif match and name in known and number and not match["no"]:
                field = known[name]
                if int(number) not in field.texts:
                    why = f"{name} has no text for {number}, so it shows no state"
                    at.fail(why, "states", state, place)
                yield StateRule(state, field.mask, int(number) << field.low)
            else:
                at.fail(
                    f"{condition}: a bit, `not` and a bit, or a field as in `{state} = 8` "
                    f"is right here; {', '.join((*masks, *known))} are known",
                    "states", state, place,
                )  # fmt: skip
