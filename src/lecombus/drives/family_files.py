"""Families from their data files: find, read, put together, check, keep.

A family's file names the files it includes. Lists of entries (codes, answer times, words, stops,
shared fields) are joined; every other key must be given by exactly one of the files. No entry
replaces another: a code described twice is a mistake, so that a family can be read off its files
without knowing an order. The files are joined first and validated as one (`FamilyFile`), section
after section: what names codes comes after the codes, wherever they stand. The first mistake is
raised with file, line and column (ADR 63).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Annotated, Any, Final, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo

from lecombus.errors import ConfigError, meant
from lecombus.parameters import AddressForm, Code, rules_of

from .code_info import CodeInfo, WriteClass
from .control_words import ControlWordInfo
from .entries import ALL_CODES, CONTROL_WORDS, STATUS_WORDS
from .family import AnswerTime, Family, SoftwareGate, WatchdogTraits
from .field_types import (
    CodeNumber,
    DescribedCode,
    Flag,
    ShownCode,
    Words,
    WritableCode,
    milliseconds,
    whole,
)
from .restore_rules import RESTORE, RestoreRule
from .stops import STOPS, StopAction, StopRule
from .verb_rules import VerbRules, check_control
from .words import WordFieldEntry, WordInfo
from .yaml_models import (
    FILE_TABLE,
    LIST_RIGHT,
    ReadAs,
    ReadFile,
    YamlFile,
    by_key,
    context_of,
    data_text,
    mistake,
    open_data_file,
    without_keys,
)

__all__ = ["FAMILY_NAMES", "add_families", "family", "load_family", "read_family_file"]

FAMILY_NAMES: Final = (
    "820x",
    "821x",
    "822x",
    "824x",
    "8200vector",
    "93xx",
    "smvector",
    "generic",
)
"""The families whose data files stand in `families/`: they are known without their protocol."""

_ADDED: Final[dict[str, ReadFile]] = {}
"""The families that protocols brought with them: what reads their data files, by name."""

NEVER_BY_DEFAULT: Final = frozenset({WriteClass.ADDRESS, WriteClass.SAVE})
"""Write classes that a roster must spell out: they cut the drive off or wear its memory."""

HIGHEST_SET_OFFSET: Final = 60_000
LONGEST_PERIOD_MS: Final = 86_400_000
LONGEST_HOLD_MS: Final = 10_000


def _or_others(given: Any) -> Any:
    """Read `codes` of an answer time: a list of codes, or `others` for all that have none."""
    if isinstance(given, str) and given != "others":
        raise mistake(f"{LIST_RIGHT}, or: others")
    return None if isinstance(given, str) else given


@dataclass(frozen=True, slots=True, kw_only=True)
class _AnswerTimeEntry(AnswerTime):
    codes: Annotated[tuple[CodeNumber, ...] | None, BeforeValidator(_or_others)]


def _answer_times(entries: tuple[_AnswerTimeEntry, ...]) -> dict[int | None, AnswerTime]:
    """Return the answer time of each code, and of the others under None."""
    found: dict[int | None, AnswerTime] = {}
    for place, entry in enumerate(entries):
        slow_read_s = entry.slow_read_s or entry.read_s
        slow_write_s = entry.slow_write_s or entry.write_s
        if slow_read_s < entry.read_s or slow_write_s < entry.write_s:
            raise mistake("the slow time is shorter than the usual one", place)
        times = replace(
            without_keys(AnswerTime, entry), slow_read_s=slow_read_s, slow_write_s=slow_write_s
        )
        for code in entry.codes if entry.codes is not None else (None,):
            number = None if code is None else code.number
            if number in found:
                what = code or "all other codes"
                raise mistake(f"the answer time of {what} is given twice", place, code=what)
            found[number] = times
    if None not in found:
        raise mistake("answer_times needs one entry with codes: others")
    return found


def _check_watchdog(traits: WatchdogTraits) -> WatchdogTraits:
    if traits.low_s >= traits.high_s:
        raise mistake("low_ms is not below high_ms")
    return traits


def _check_protocol(protocol: str) -> str:
    try:
        rules_of(protocol)
    except ConfigError as exc:
        raise mistake(str(exc)) from exc
    return protocol


def _forms(words: tuple[str, ...], info: ValidationInfo) -> tuple[AddressForm, ...]:
    if "protocol" not in info.data:
        return ()  # it is wrong, and refused itself
    known = rules_of(info.data["protocol"]).forms
    for place, word in enumerate(words):
        if word not in known:
            raise mistake(f"{word} is not known here; {', '.join(known)} are", place)
    return tuple(known[word] for word in words)


def _check_offsets(offsets: tuple[int, ...]) -> tuple[int, ...]:
    if offsets[:1] != (0,) or list(offsets) != sorted(set(offsets)):
        raise mistake("offsets begin with 0 and grow: [0, 2000]")
    return offsets


@dataclass(frozen=True, slots=True, kw_only=True)
class _StatusEntry:
    __pydantic_config__ = FILE_TABLE

    code: ShownCode
    period_s: Annotated[float, milliseconds(high=LONGEST_PERIOD_MS), Field(alias="every_ms")]


def _status(entries: tuple[_StatusEntry, ...]) -> tuple[tuple[Code, float], ...]:
    found = by_key(entries, lambda entry: entry.code, "{} is read cyclically twice")
    return tuple((code, entry.period_s) for code, entry in found.items())


def _check_default(codes: tuple[Code, ...], info: ValidationInfo) -> frozenset[Code]:
    """Refuse codes that a roster must name to have them written."""
    for place, code in enumerate(codes):
        write_class = context_of(info).write_class(code)
        if write_class in NEVER_BY_DEFAULT:
            message = f"{code} ({write_class}) is never writable by default"
            raise mistake(message, place, code=code)
    return frozenset(codes)


def _check_saves(code: Code, info: ValidationInfo) -> Code:
    write_class = context_of(info).write_class(code)
    if write_class is not WriteClass.SAVE:
        raise mistake(f"{code} does not save: its write_class is {write_class}")
    return code


W = TypeVar("W")
Configured = Mapping[str, Mapping[Code, W]]
"""Words by signal configuration; those that hold for any under the empty name."""

SetOffset = Annotated[int, whole(0, HIGHEST_SET_OFFSET)]


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyFile:
    """The data file of a family, joined with the files it includes.

    The keys have the meaning of the fields of `Family`. They are validated in this order: what
    names codes comes after `codes`.
    """

    __pydantic_config__ = FILE_TABLE

    name: Annotated[Words, Field(alias="family")]
    include: tuple[Words, ...] = ()
    title: Words
    manual: Words = ""
    protocol: Annotated[Words, AfterValidator(_check_protocol)]
    forms: Annotated[
        tuple[AddressForm, ...],
        ReadAs(tuple[Words, ...], _forms, informed=True),
        Field(alias="addressing"),
    ]
    set_offsets: Annotated[tuple[SetOffset, ...], AfterValidator(_check_offsets)] = (0,)
    keypad_offset: Annotated[int, whole(1, HIGHEST_SET_OFFSET)] | None = None
    stored_needs_inhibit: Flag = False
    codes: Annotated[Mapping[Code, CodeInfo], ALL_CODES]
    saved_by: Annotated[DescribedCode, AfterValidator(_check_saves)] | None = None
    answer_times: Annotated[
        Mapping[int | None, AnswerTime], ReadAs(tuple[_AnswerTimeEntry, ...], _answer_times)
    ]
    hold_after_write_s: Annotated[
        float, milliseconds(0, LONGEST_HOLD_MS), Field(alias="hold_after_write_ms")
    ]
    watchdog: Annotated[WatchdogTraits, AfterValidator(_check_watchdog)] | None = None
    software: SoftwareGate | None = None
    feed_code: Annotated[ShownCode, Field(alias="feed")]
    identity: tuple[ShownCode, ...]
    status: Annotated[tuple[tuple[Code, float], ...], ReadAs(tuple[_StatusEntry, ...], _status)]
    writable: Annotated[
        frozenset[Code], ReadAs(tuple[WritableCode, ...], _check_default, informed=True)
    ]
    fields: tuple[WordFieldEntry, ...] = ()
    words: Annotated[Configured[WordInfo], STATUS_WORDS] = field(default_factory=dict)
    control_words: Annotated[Configured[ControlWordInfo], CONTROL_WORDS] = field(
        default_factory=dict
    )
    configured_by: ShownCode | None = None
    stops: Annotated[Mapping[StopAction, StopRule], STOPS] = field(default_factory=dict)
    restore: Annotated[tuple[RestoreRule, ...], RESTORE] = ()
    verbs: Annotated[VerbRules, AfterValidator(check_control)] | None = None


LISTS: Final = ("codes", "answer_times", "fields", "words", "control_words", "stops", "restore")
"""Sections that a family's file and those it includes may all have: their entries are joined."""


def add_families(names: Iterable[str], read_file: ReadFile) -> None:
    """Make the families of a protocol known; none of their files is read yet.

    Args:
        names: Their names.
        read_file: Returns the text of a data file by its name with `.yaml`.
    """
    _ADDED.update(dict.fromkeys(names, read_file))


def read_family_file(name: str) -> str:
    """Return the text of a data file of `families/`, by its name with `.yaml`.

    Raises:
        OSError: There is no such file.
    """
    return data_text("families", name, None)


@cache
def family(name: str) -> Family:
    """Return the family of a roster's word for it.

    Args:
        name: One of `FAMILY_NAMES`, or of `families` of a protocol that was loaded.

    Raises:
        ConfigError: There is no such family; the message names those there are.
        DescriptionError: Its data file is wrong.
    """
    known = tuple(dict.fromkeys((*FAMILY_NAMES, *_ADDED)))
    if name not in known:
        raise ConfigError(f"there is no family {name}; {meant(name, known, 'the families')}")
    return load_family(name, _ADDED.get(name))


def load_family(name: str, read_file: ReadFile | None = None) -> Family:
    """Build a family from its data file and the files that one includes.

    Args:
        name: The file's name without `.yaml`; its `family` must be the same.
        read_file: Reads the files; None: from this package.

    Raises:
        DescriptionError: A file is missing, or says something that cannot be.
    """
    document = open_data_file("families", name, read_file)
    for number, included in enumerate(document.texts("include")):
        file = f"{included}.yaml"
        try:
            text = data_text("families", file, read_file)
        except (OSError, KeyError) as exc:
            error = document.error(f"there is no data file {file}", "include", number)
            raise error from exc
        document.include(YamlFile(text, f"families/{file}", family=name), LISTS)
    read = document.read(FamilyFile)
    if read.name != name:
        message = f"the file is named {name}.yaml: family must be {name}"
        raise document.error(message, "family")
    if read.words.keys() | read.control_words.keys() > {""} and read.configured_by is None:
        raise document.error("configured_by must name the code of the signal configuration")
    return _family(read)


def _family(read: FamilyFile) -> Family:
    words, controls = read.words, read.control_words
    times: dict[Any, AnswerTime] = dict(read.answer_times)
    variants: dict[str, Family] = {}
    made: dict[str, Any] = {
        "words": words.get("", {}),
        "control_words": controls.get("", {}),
        "other_answer_time": times.pop(None),
        "answer_times": times,
        "variants": variants,
    }
    same = {one.name for one in fields(Family)} & {one.name for one in fields(FamilyFile)}
    family = Family(**{key: getattr(read, key) for key in same} | made)
    for name in sorted(words.keys() | controls.keys() | {""}):
        variants[name] = (
            family
            if not name
            else replace(
                family,
                configuration=name,
                words=words.get(name, family.words),
                control_words=controls.get(name, family.control_words),
            )
        )
    return family
