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

from pydantic import BeforeValidator, Discriminator, Tag, ValidationInfo

from lecombus.parameters import Code

from .control_words import ControlWordInfo
from .field_types import Source, WordCode, Words, numbered, read_words
from .words import Bit, OperatingState, StateRule, WordField, WordFieldEntry, WordInfo
from .yaml_models import FILE_TABLE, ReadAs, ReadBy, mistake, without_keys

__all__ = ["CONTROL_WORDS", "STATUS_WORDS"]

CONFIGURATION: Final = re.compile(r"[0-9x]{1,5}")
"""A signal configuration as the manual writes it: `1xx1`, any digit for an x."""

_STATE: Final = re.compile(r"(?P<no>not )?(?P<name>\w+)(?: = (?P<number>\d+))?", re.ASCII)

GENERAL: Final = ""
CONTROL_BITS: Final = frozenset(range(16))

Mistake = tuple[str, *tuple[str | int, ...]]
AnyWord = TypeVar("AnyWord", WordInfo, ControlWordInfo)


def _read_configuration(given: object) -> str:
    if CONFIGURATION.fullmatch(read_words(given)) is None:
        raise mistake(f"{given} is no signal configuration such as 1xx1")
    return read_words(given)


Configurations = tuple[Annotated[str, ReadBy(_read_configuration)], ...]

FieldOrName = Annotated[
    Annotated[Words, Tag("[name]")] | Annotated[WordFieldEntry, Tag("[field]")],
    Discriminator(lambda given: "[name]" if isinstance(given, str) else "[field]"),
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

    code: WordCode
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


def _status_words(
    entries: tuple[WordEntry, ...], info: ValidationInfo
) -> dict[str, dict[Code, WordInfo]]:
    known: dict[str, dict[Code, WordInfo]] = {GENERAL: {}}
    shared = {field.name: field for field in info.data.get("fields", ())}
    for place, entry in enumerate(entries):
        fields = []
        for number, one in enumerate(entry.fields):
            if isinstance(one, str) and one not in shared:
                message = f"there is no field {one}; {', '.join(shared) or 'none'} are shared"
                raise mistake(message, place, "fields", number)
            fields.append(shared[one] if isinstance(one, str) else one)
        word = WordInfo(
            bits=tuple((name, 1 << bit) for bit, name in sorted(entry.bits.items())),
            fields=tuple(fields),
            fault_mask=0 if entry.fault_bit is None else 1 << entry.fault_bit,
            source=entry.source,
            states=tuple(_states(entry, fields, place)),
            free=entry.free,
        )
        for message, *below in _wrong_bits(entry, word):
            raise mistake(message, place, *below)
        _put(known, entry, word, _joined, place)
    return _with_general(known)


def _control_words(
    entries: tuple[ControlWordEntry, ...],
) -> dict[str, dict[Code, ControlWordInfo]]:
    known: dict[str, dict[Code, ControlWordInfo]] = {GENERAL: {}}
    for place, entry in enumerate(entries):
        for number, name in enumerate(entry.fields):
            if name in entry.bits:
                raise mistake(f"{name} stands here twice", place, "fields", number)
        _put(known, entry, without_keys(ControlWordInfo, entry), _joined_control, place)
        for configuration in entry.configuration:
            every = known[configuration][entry.code].every_bit
            for bit in sorted(CONTROL_BITS | set(every)):
                if every.count(bit) != 1 or bit not in CONTROL_BITS:
                    none = "no meaning: named, field, free, reserved?"
                    times = "two meanings" if bit in every else none
                    raise mistake(f"bit {bit} has {times}", place, code=entry.code)
    return _with_general(known)


STATUS_WORDS = ReadAs(tuple[WordEntry, ...], _status_words, informed=True)
CONTROL_WORDS = ReadAs(tuple[ControlWordEntry, ...], _control_words)
"""Read the sections `words` and `control_words`, by signal configuration; empty: any."""


def _with_general(known: dict[str, dict[Code, AnyWord]]) -> dict[str, dict[Code, AnyWord]]:
    """Add to the words of each configuration those that hold for every drive."""
    return {name: known[GENERAL] | words for name, words in known.items()}


def _wrong_bits(entry: WordEntry, word: WordInfo) -> Iterator[Mistake]:
    if len(set(entry.bits.values())) < len(entry.bits):
        yield "two bits have one name", "bits"
    for field in word.fields:
        if any(field.low <= bit <= field.high for bit in entry.bits):
            yield f"a bit of {field.name} has a name of its own", "bits"
    for number, bit in enumerate(entry.free):
        if bit in word.described_bits:
            yield f"bit {bit} has a meaning: it is not free", "free", number


def _put(
    known: dict[str, dict[Code, AnyWord]],
    entry: WordEntry | ControlWordEntry,
    word: AnyWord,
    join: Callable[[AnyWord, AnyWord], AnyWord],
    place: int,
) -> None:
    """Take a word for each of its configurations, joined with what holds for every drive."""
    code = entry.code
    for configuration in entry.configuration:
        words, general = known.setdefault(configuration, {}), known[GENERAL].get(code)
        if code in words:
            raise mistake(f"{code} is described twice", place, code=code)
        if configuration == GENERAL:
            words[code] = word
            continue
        if general is None:
            message = f"{code} has no entry without configuration before this one"
            raise mistake(message, place, code=code)
        wrong = set(word.every_bit) - set(general.free)
        if wrong:
            message = f"bit {min(wrong)} is not free, so no configuration gives it a meaning"
            raise mistake(message, place)
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


def _states(entry: WordEntry, fields: list[WordField], place: int) -> Iterator[StateRule]:
    """Return what shows which state: a bit, `not` a bit, or a number of a field."""
    known = {field.name: field for field in fields}
    masks = {name: 1 << bit for bit, name in entry.bits.items()}
    for state, conditions in (entry.states or {}).items():
        for number, condition in enumerate(conditions):
            path = (place, "states", state, number)
            match = _STATE.fullmatch(condition)
            name, shown = (match["name"], match["number"]) if match else ("", None)
            if match and name in masks and shown is None:
                yield StateRule(state, masks[name], 0 if match["no"] else masks[name])
            elif match and name in known and shown and not match["no"]:
                field = known[name]
                if int(shown) not in field.texts:
                    message = f"{name} has no text for {shown}, so it shows no state"
                    raise mistake(message, *path)
                yield StateRule(state, field.mask, int(shown) << field.low)
            else:
                right = "a bit, `not` and a bit, or a field as in `{state} = 8` is right here"
                names = ", ".join((*masks, *known))
                raise mistake(f"{condition}: {right}; {names} are known", *path)
