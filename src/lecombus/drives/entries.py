"""Making the codes, status words and control words of a family from the entries of its data files.

The entry of a code has the keys of a `CodeInfo` and two more. `subcodes: [1, 8]` makes it many:
each gets its subcode after its name. `sets: true` repeats it in each parameter set.

An entry of a word without `configuration` describes it as every drive of the family has it. An
entry with one says what that signal configuration adds: it gives a meaning to bits that the general
entry leaves free, so that no entry replaces another. Every bit of a control word must be described,
because a program that changes one bit must know what the others do.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Annotated, Any, Final, TypeVar

from pydantic import BeforeValidator, Discriminator, Tag, ValidationInfo, WrapValidator

from lecombus.parameters import (
    HEX_DIGITS,
    HIGHEST_DECIMAL,
    HIGHEST_SUBCODE,
    HIGHEST_VALUE_CHARS,
    LOWEST_DECIMAL,
    Code,
    Format,
    Value,
)

from .code_info import RANGE, CodeInfo, Storage
from .control_words import ControlWordInfo
from .field_types import (
    Flag,
    Source,
    WordCode,
    Words,
    numbered,
    read_number,
    read_words,
    whole,
    whole_number,
)
from .words import Bit, OperatingState, StateRule, WordField, WordFieldEntry, WordInfo
from .yaml_models import FILE_TABLE, KEY, ReadAs, ReadBy, context_of, mistake, without_keys

__all__ = ["ALL_CODES", "CONTROL_WORDS", "STATUS_WORDS"]

TYPICAL_CHARS = {Format.VD: 9, Format.VS: 16, Format.VO: HIGHEST_VALUE_CHARS}
"""Length of a value where the file does not say: 9 is what the manual's tables of telegram times
take for a number; 16 is a string of 15, such as a software label (EDB2102EN 3.5, 8.2)."""

Subcode = Annotated[int, whole(1, HIGHEST_SUBCODE)]
Limits = tuple[Decimal, Decimal]
Mistake = tuple[str, *tuple[str | int, ...]]
"""What is wrong, and the path of the wrong value in its entry."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Entry(CodeInfo):
    subcodes: tuple[Subcode, ...] | None = None
    sets: Flag = False


def _all_codes(entries: tuple[_Entry, ...], info: ValidationInfo) -> dict[Code, CodeInfo]:
    """Return the codes that the entries describe; later sections are checked against them."""
    found: dict[Code, CodeInfo] = {}
    offsets = info.data.get("set_offsets", (0,))
    for place, entry in enumerate(entries):
        described = without_keys(CodeInfo, entry)
        if info.data.get("stored_needs_inhibit") and entry.storage is Storage.STORED:
            described = replace(described, needs_inhibit=entry.writable or entry.needs_inhibit)
        for one in _spread_subcodes(described, entry.subcodes):
            for spread in _spread_sets(one, offsets if entry.sets else (0,), place):
                other = found.setdefault(spread.code, spread)
                if other is not spread:
                    names = (f"{each.name} in parameter set {each.parameter_set}"
                             for each in (other, spread))  # fmt: skip
                    message = f"{spread.code} is described twice: as {' and as '.join(names)}"
                    raise mistake(message, place, code=spread.code)
    codes = dict(sorted(found.items()))
    context_of(info).codes = codes
    return codes


def _spread_sets(info: CodeInfo, offsets: tuple[int, ...], place: int) -> Iterator[CodeInfo]:
    """Repeat a code in each further parameter set."""
    yield info
    number = info.code.number
    for parameter_set, offset in enumerate(offsets[1:], start=2):
        if number >= offsets[1]:
            message = f"{info.code} lies in parameter set 2, which begins at C{offset}"
            raise mistake(message, place)
        code = Code(number + offset, info.code.subcode)
        yield replace(info, code=code, parameter_set=parameter_set)


def _spread_subcodes(info: CodeInfo, subcodes: tuple[int, ...] | None) -> Iterator[CodeInfo]:
    if subcodes is None:
        yield info
        return
    for number in range(subcodes[0], subcodes[1] + 1):
        name, name_de = (f"{one} {number}" for one in (info.name, info.name_de))
        yield replace(info, code=Code(info.code.number, number), name=name, name_de=name_de)


def _read_entry(given: Any, read: Callable[[Any], _Entry]) -> _Entry:
    """Read an entry, check what its keys must be together, and fill in what it leaves out.

    Where nothing is said of storage, what moves a drive or is only read is a process value.

    Source: EDB2102EN 6, 6.1.1 (control words and setpoints are not saved).
    """
    entry = read(given)
    for message, *below in (*_wrong_limits(entry, given), *_wrong_flags(entry, given)):
        raise mistake(message, *below)
    usual = Storage.STORED if entry.writable and not entry.motion else Storage.VOLATILE
    return replace(
        entry,
        name_de=entry.name_de or entry.name,
        chars=entry.chars or TYPICAL_CHARS.get(entry.format, 1 + (entry.hex_digits or 0)),
        storage=entry.storage if "storage" in given else usual,
        default=None if entry.default is None else _default(entry, entry.default),
    )


CodeEntry = Annotated[_Entry, RANGE, WrapValidator(_read_entry)]
ALL_CODES = ReadAs(tuple[CodeEntry, ...], _all_codes, informed=True)
"""Reads the section `codes`."""


def _carried(entry: CodeInfo) -> Limits | None:
    """Return the numbers a format can carry; None for one that carries no numbers.

    Source: EDB2102EN 8.3.1; CMVLC401A 5.4.
    """
    if entry.hex_digits is not None:
        return Decimal(0), Decimal(16**entry.hex_digits - 1)
    return (LOWEST_DECIMAL, HIGHEST_DECIMAL) if entry.format is Format.VD else None


def _range(entry: CodeInfo) -> Limits | None:
    return None if entry.low is None or entry.high is None else (entry.low, entry.high)


def _wrong_limits(entry: _Entry, given: Any) -> Iterator[Mistake]:
    """Find what is wrong with format, range, step and selection."""
    if (entry.hex_digits is not None) != (entry.format is Format.VH):
        yield ("hex_digits belongs to format VH, and only there",)
        return
    if entry.hex_digits is not None and entry.hex_digits not in HEX_DIGITS:
        yield f"{entry.hex_digits} hexadecimal digits are not sent; 2, 4 or 8 are", "hex_digits"
    carried, limits, step = _carried(entry), _range(entry), entry.step
    if carried is None:
        for key in {"range", "selection"} & given.keys():
            yield "only numbers (VD, VH) have a range or a selection", key
        return
    if limits is not None:
        for number, end in enumerate(limits):
            if entry.hex_digits and (end % 1 or not carried[0] <= end <= carried[1]):
                right = f"a whole number from 0 to {carried[1]} is right here"
                yield f"{end}: {right}", "range", number
    if step is not None and limits is None:
        yield "a step is counted from the range's lower end: give the range too", "step"
    if step is not None and limits and (step <= 0 or (limits[1] - limits[0]) % step):
        yield "steps of {} do not lead from {} to {}".format(step, *limits), "step"
    low, high = limits or carried
    for key, number in zip(given.get("selection", ()), entry.selection, strict=True):
        if not low <= number <= high:
            yield f"{number} lies outside {low} to {high}", "selection", key, KEY


def _wrong_flags(entry: _Entry, given: Any) -> Iterator[Mistake]:
    """Find which of the other keys contradict each other."""
    if entry.bits and (entry.selection or entry.low is not None):
        yield "a value is made of bits, or it has a range or a selection", "bits"
    numbers = list(entry.bits)
    for key, before, bit in zip(
        list(given.get("bits", ()))[1:], numbers, numbers[1:], strict=False
    ):
        if bit < before:
            yield f"bit {bit} stands after {before}: the lowest comes first", "bits", key, KEY
    if entry.selection_partial and (not entry.selection or entry.low is not None):
        yield ("selection_partial belongs to a selection without a range",)
    if not entry.writable and not entry.readable:
        yield (f"{entry.code} can neither be read nor written",)
    if not entry.writable and entry.needs_inhibit:
        yield (f"{entry.code} cannot be written, so it needs no inhibit",)
    if entry.subcodes is not None:
        if len(entry.subcodes) != 2 or entry.code.subcode:
            yield "subcodes is [first, last], and the code then has none: C0168", "subcodes"
        elif entry.subcodes[0] > entry.subcodes[1]:
            right = f"a whole number from {entry.subcodes[0]} to {HIGHEST_SUBCODE} is right here"
            yield f"{entry.subcodes[1]}: {right}", "subcodes", 1


def _default(entry: CodeInfo, text: str) -> str:
    """Return the value as delivered, as it stands on the wire."""
    carried, limits = _carried(entry), _range(entry)
    if carried is None:
        return text
    digits = entry.hex_digits
    number = (
        Decimal(whole_number(text, 0, int(carried[1]), "default"))
        if digits
        else read_number(text, "default")
    )
    if limits is not None and not limits[0] <= number <= limits[1]:
        raise mistake(f"{number} lies outside {limits[0]} to {limits[1]}", "default")
    if limits is None and entry.selection and number not in entry.selection:
        raise mistake(f"{number} is not in the selection", "default")
    return (Value.hexadecimal(int(number), digits) if digits else Value.decimal(number)).raw


CONFIGURATION: Final = re.compile(r"[0-9x]{1,5}")
"""A signal configuration as the manual writes it: `1xx1`, any digit for an x."""

_STATE: Final = re.compile(r"(?P<no>not )?(?P<name>\w+)(?: = (?P<number>\d+))?", re.ASCII)

GENERAL: Final = ""
CONTROL_BITS: Final = frozenset(range(16))

AnyWord = TypeVar("AnyWord", WordInfo, ControlWordInfo)


def _read_configuration(given: object) -> str:
    if CONFIGURATION.fullmatch(read_words(given)) is None:
        raise mistake(f"{given} is not a signal configuration such as 1xx1")
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
