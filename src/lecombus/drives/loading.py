"""Families from their data files: find, read, put together, check, keep.

A family's file names the files it includes. Lists of entries (codes, answer times, words, stops,
shared fields) are joined; every other key must be given by exactly one of the files. No entry
replaces another: a code described twice is a mistake, so that a family can be read off its files
without knowing an order. Each file is validated by itself (`FamilyFile`). Then the references
between sections are checked. The first mistake is raised with file, line and column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib import resources
from typing import Annotated, Any, Final, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field

from lecombus.errors import ConfigError, DescriptionError, meant
from lecombus.protocol.addressing import Code, Form

from .code_entries import CodeBook, CodeEntry
from .codes import CodeInfo, WriteClass
from .commands import INHIBIT, QUICK_STOP
from .family import AnswerTime, Family, SoftwareGate, WatchdogTraits
from .field_types import CodeNumber, Flag, Words, milliseconds, whole
from .restoring import RestoreRule, RestoreWord
from .stops import StopAction, StopRule
from .verb_rules import VerbRules
from .word_entries import ControlWordEntry, WordBook, WordEntry
from .words import WordFieldEntry
from .yaml_models import FILE_TABLE, KEY, LIST_RIGHT, Document, Place, mistake, without_keys

__all__ = ["FAMILY_NAMES", "family", "load_family"]

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

NEVER_BY_DEFAULT: Final = frozenset({WriteClass.ADDRESS, WriteClass.SAVE})
"""Write classes that a roster must spell out: they cut the drive off or wear its memory."""

HIGHEST_SET_OFFSET: Final = 60_000
LONGEST_PERIOD_MS: Final = 86_400_000
LONGEST_HOLD_MS: Final = 10_000

ReadFile = Callable[[str], str]
T = TypeVar("T")


def _or_others(given: Any) -> Any:
    """Read `codes` of an answer time: a list of codes, or `others` for all that have none."""
    if isinstance(given, str):
        if given != "others":
            raise mistake(f"{LIST_RIGHT}, or: others")
        return None
    return given


@dataclass(frozen=True, slots=True, kw_only=True)
class _AnswerTimeEntry(AnswerTime):
    codes: Annotated[tuple[CodeNumber, ...] | None, BeforeValidator(_or_others)]


def _check_times(times: _AnswerTimeEntry) -> _AnswerTimeEntry:
    slow_read_s, slow_write_s = (
        times.slow_read_s or times.read_s,
        times.slow_write_s or times.write_s,
    )
    if slow_read_s < times.read_s or slow_write_s < times.write_s:
        raise mistake("the slow time is shorter than the usual one")
    return replace(times, slow_read_s=slow_read_s, slow_write_s=slow_write_s)


def _check_watchdog(traits: WatchdogTraits) -> WatchdogTraits:
    if traits.low_s >= traits.high_s:
        raise mistake("low_ms is not below high_ms")
    return traits


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _StopEntry(StopRule):
    action: StopAction


def _check_stop(entry: _StopEntry) -> _StopEntry:
    if (entry.value is None) == (not entry.set_mask):
        raise mistake("either value or set is right here")
    return entry


def _check_restore(rule: RestoreRule) -> RestoreRule:
    if (rule.value is not None) != (rule.word is RestoreWord.SAVE):
        raise mistake("value belongs to the rule save, and only there")
    return rule


def _check_offsets(offsets: tuple[int, ...]) -> tuple[int, ...]:
    if offsets[:1] != (0,) or list(offsets) != sorted(set(offsets)):
        raise mistake("offsets begin with 0 and grow: [0, 2000]")
    return offsets


@dataclass(frozen=True, slots=True, kw_only=True)
class _StatusEntry:
    __pydantic_config__ = FILE_TABLE

    code: CodeNumber
    period_s: Annotated[float, milliseconds(high=LONGEST_PERIOD_MS), Field(alias="every_ms")]


SetOffset = Annotated[int, whole(0, HIGHEST_SET_OFFSET)]


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyFile:
    """One data file: of a family, or included by several.

    `family` and `include` stand in a family's own file only. See `Family` for the meaning of the
    other keys.
    """

    __pydantic_config__ = FILE_TABLE

    family: Words | None = None
    include: tuple[Words, ...] = ()
    title: Words | None = None
    manual: Words | None = None
    addressing: tuple[Form, ...] | None = None
    codes: tuple[CodeEntry, ...] = ()
    stored_needs_inhibit: Flag | None = None
    set_offsets: Annotated[tuple[SetOffset, ...], AfterValidator(_check_offsets)] | None = None
    keypad_offset: Annotated[int, whole(1, HIGHEST_SET_OFFSET)] | None = None
    saved_by: CodeNumber | None = None
    answer_times: tuple[Annotated[_AnswerTimeEntry, AfterValidator(_check_times)], ...] = ()
    hold_after_write_ms: Annotated[float, milliseconds(0, LONGEST_HOLD_MS)] | None = None
    watchdog: Annotated[WatchdogTraits, AfterValidator(_check_watchdog)] | None = None
    software: SoftwareGate | None = None
    feed: CodeNumber | None = None
    identity: tuple[CodeNumber, ...] | None = None
    status: tuple[_StatusEntry, ...] | None = None
    writable: tuple[CodeNumber, ...] | None = None
    configured_by: CodeNumber | None = None
    fields: tuple[WordFieldEntry, ...] = ()
    words: tuple[WordEntry, ...] = ()
    control_words: tuple[ControlWordEntry, ...] = ()
    stops: tuple[Annotated[_StopEntry, AfterValidator(_check_stop)], ...] = ()
    restore: tuple[Annotated[RestoreRule, AfterValidator(_check_restore)], ...] = ()
    verbs: VerbRules | None = None


@cache
def family(name: str) -> Family:
    """Return the family of a roster's word for it.

    Args:
        name: One of `FAMILY_NAMES`.

    Raises:
        ConfigError: There is no such family; the message names those there are.
        DescriptionError: Its data file is wrong.
    """
    if name not in FAMILY_NAMES:
        remedy = meant(name, FAMILY_NAMES, "the families")
        raise ConfigError(f"there is no family {name}; {remedy}")
    return load_family(name, _packaged)


def load_family(name: str, read_file: ReadFile) -> Family:
    """Build a family from its data file and the files that one includes.

    Args:
        name: The file's name without `.yaml`; its `family` must be the same.
        read_file: Returns the text of a file by its name with `.yaml`.

    Raises:
        DescriptionError: A file is missing, or says something that cannot be.
    """
    return _Builder(name, read_file).build()


def _packaged(file: str) -> str:
    return (resources.files(__package__) / "families" / file).read_text(encoding="utf-8")


class _Builder:
    """The files of one family, read together."""

    def __init__(self, name: str, read_file: ReadFile) -> None:
        self._name = name
        try:
            own = self._open(f"{name}.yaml", read_file)
        except (OSError, KeyError) as exc:
            raise DescriptionError("there is no such data file", file=f"{name}.yaml") from exc
        documents = [own, *self._included(own, read_file)]
        manual = next((one.data["manual"] for one in documents if "manual" in one.data), "")
        files = [(one, one.read(FamilyFile, manual=str(manual))) for one in documents]
        self._own = Place(own, ())
        self._check_names(files)
        self._places: dict[str, list[Place]] = {}
        self._file = self._joined(files)
        self._codes = self._described_codes()

    def _open(self, file: str, read_file: ReadFile) -> Document:
        return Document(read_file(file), f"families/{file}", family=self._name)

    def _included(self, own: Document, read_file: ReadFile) -> Iterator[Document]:
        named = own.data.get("include")
        for number, name in enumerate(named if isinstance(named, list) else ()):
            try:
                yield self._open(f"{name}.yaml", read_file)
            except (OSError, KeyError) as exc:
                error = own.error(f"there is no data file {name}.yaml", "include", number)
                raise error from exc

    def _check_names(self, files: list[tuple[Document, FamilyFile]]) -> None:
        (own, file), *included = files
        if file.family is None:
            raise own.error("family is missing")
        if file.family != self._name:
            message = f"the file is named {self._name}.yaml: family must be {self._name}"
            raise own.error(message, "family")
        for document, shared in included:
            for key in ("family", "include"):
                if getattr(shared, key):
                    raise document.error(
                        f"{key} is not known here: a family includes this", key, KEY
                    )

    def _joined(self, files: list[tuple[Document, FamilyFile]]) -> FamilyFile:
        """Join the entries of all files; take any other key from the file that has it."""
        joined: dict[str, Any] = {}
        for key, default in ((one.name, one.default) for one in fields(FamilyFile)):
            found = [
                (one, value) for one, file in files if (value := getattr(file, key)) != default
            ]
            if default == ():
                joined[key] = tuple(entry for _, entries in found for entry in entries)
                self._places[key] = [
                    Place(document, (key, number))
                    for document, entries in found
                    for number in range(len(entries))
                ]
            elif found:
                document, joined[key] = found[0]
                self._places[key] = [Place(document, (key,))]
                if len(found) > 1:
                    self._places[key][0].fail(f"{key} is also given by an included file")
        return FamilyFile(**joined)

    def build(self) -> Family:
        file, book = self._file, self._words()
        answer_times, other = self._answer_times()
        variants: dict[str, Family] = {}
        family = Family(
            name=self._name,
            title=self._required("title", file.title),
            forms=self._required("addressing", file.addressing),
            codes=self._codes,
            status=tuple(self._status()),
            writable=frozenset(self._writable()),
            watchdog=self._watchdog(),
            feed_code=self._feed(),
            hold_after_write_s=self._required("hold_after_write_ms", file.hold_after_write_ms),
            identity=self._identity(),
            stops=self._stops(),
            words=book.words(),
            control_words=book.control_words(),
            configured_by=self._configured_by(book),
            variants=variants,
            answer_times=answer_times,
            other_answer_time=other,
            software=self._software(),
            set_offsets=file.set_offsets or (0,),
            saved_by=self._saved_by(),
            restore=tuple(self._restore()),
            verbs=self._verbs(book),
            keypad_offset=file.keypad_offset,
        )
        variants |= _variants(family, book)
        return family

    def _required(self, key: str, value: T | None) -> T:
        if value is None:
            self._own.fail(f"{key} is missing, here and in the included files")
        return value

    def _at(self, key: str) -> Place:
        return self._places[key][0]

    def _entries(self, key: str, entries: tuple[T, ...]) -> Iterator[tuple[Place, T]]:
        """Return the entries of a list with their places."""
        return zip(self._places[key], entries, strict=True)

    def _described_codes(self) -> dict[Code, CodeInfo]:
        file = self._file
        inhibit = file.stored_needs_inhibit or False
        book = CodeBook(file.set_offsets or (0,), stored_needs_inhibit=inhibit)
        for at, entry in self._entries("codes", file.codes):
            book.add(at, entry)
        return dict(sorted(book.codes.items()))

    def _words(self) -> WordBook:
        file = self._file
        book = WordBook({field.name: field for field in file.fields}, self._codes)
        for at, word in self._entries("words", file.words):
            book.add_word(at, word)
        for at, control in self._entries("control_words", file.control_words):
            book.add_control_word(at, control)
        return book

    def _answer_times(self) -> tuple[dict[int, AnswerTime], AnswerTime]:
        times: dict[int, AnswerTime] = {}
        other: AnswerTime | None = None
        for at, entry in self._entries("answer_times", self._file.answer_times):
            if entry.codes is None and other is not None:
                at.fail("the answer time of all other codes is given twice")
            time = without_keys(AnswerTime, entry)
            if entry.codes is None:
                other = time
            for code in entry.codes or ():
                if code.number in times:
                    at.fail(f"{code} has an answer time already", code=str(code))
                times[code.number] = time
        if other is None:
            self._own.fail("answer_times needs one entry with codes: others")
        return times, other

    def _status(self) -> Iterator[tuple[Code, float]]:
        at, seen = self._at, set[Code]()
        for number, entry in enumerate(self._required("status", self._file.status)):
            self._check_shown(at("status"), entry.code, number, "code")
            if entry.code in seen:
                message = f"{entry.code} is read cyclically twice"
                at("status").fail(message, number, code=str(entry.code))
            seen.add(entry.code)
            yield entry.code, entry.period_s

    def _writable(self) -> Iterator[Code]:
        for number, code in enumerate(self._required("writable", self._file.writable)):
            at = self._at("writable")
            self._check_writable(at, code, number)
            write_class = self._codes[code].write_class
            if write_class in NEVER_BY_DEFAULT:
                why = f"{code} ({write_class}) is never writable by default"
                at.fail(why, number, code=str(code))
            yield code

    def _watchdog(self) -> WatchdogTraits | None:
        traits = self._file.watchdog
        for code in (traits.time_code, traits.action_code) if traits is not None else ():
            if code not in self._codes or not self._codes[code].writable:
                self._at("watchdog").fail(f"{code} is not described as writable", code=str(code))
        return traits

    def _feed(self) -> Code:
        code = self._required("feed", self._file.feed)
        if self._codes:
            self._check_shown(self._at("feed"), code)
        return code

    def _identity(self) -> tuple[Code, ...]:
        codes = self._required("identity", self._file.identity)
        for number, code in enumerate(codes):
            self._check_shown(self._at("identity"), code, number)
        return codes

    def _configured_by(self, book: WordBook) -> Code | None:
        code = self._file.configured_by
        if code is not None:
            self._check_shown(self._at("configured_by"), code)
        elif book.configurations:
            self._own.fail("configured_by must name the code of the signal configuration")
        return code

    def _software(self) -> SoftwareGate | None:
        gate = self._file.software
        if gate is not None:
            self._check_described(self._at("software"), gate.code)
        return gate

    def _saved_by(self) -> Code | None:
        code = self._file.saved_by
        if code is not None:
            at = self._at("saved_by")
            self._check_described(at, code)
            write_class = self._codes[code].write_class
            if write_class is not WriteClass.SAVE:
                at.fail(f"{code} does not save: its write_class is {write_class}")
        return code

    def _restore(self) -> Iterator[RestoreRule]:
        for at, rule in self._entries("restore", self._file.restore):
            for code in rule.codes:
                self._check_described(at, code)
                info = self._codes[code]
                if info.parameter_set != 1:
                    at.fail(f"a rule for {code} is written for parameter set 1", code=str(code))
                if rule.word is RestoreWord.SAVE and info.write_class is not WriteClass.SAVE:
                    at.fail(f"{code} does not save", code=str(code))
            yield rule

    def _stops(self) -> dict[StopAction, StopRule]:
        stops: dict[StopAction, StopRule] = {}
        for at, entry in self._entries("stops", self._file.stops):
            if entry.action in stops:
                at.fail(f"{entry.action} is given twice")
            for code in entry.proofs:
                self._check_described(at, code)
            self._check_writable(at, entry.code)
            stops[entry.action] = without_keys(StopRule, entry)
        return stops

    def _verbs(self, book: WordBook) -> VerbRules | None:
        """Check the rules for verbs: each code that they read or write must be there."""
        rules = self._file.verbs
        if rules is None:
            return None
        at, reset = self._at("verbs"), rules.reset
        word = book.control_words().get(rules.control)
        self._check_writable(at, rules.control, "control")
        if word is None or not {QUICK_STOP, INHIBIT} <= word.bits.keys():
            message = f"{rules.control} is no control word with bits {QUICK_STOP} and {INHIBIT}"
            at.fail(message, "control")
        for number, demand in enumerate(rules.demands):
            self._check_described(at, demand.condition.code, "demands", number, "code")
        self._check_writable(at, rules.enable.code, "enable", "code")
        for code in rules.enable.proofs:
            self._check_described(at, code, "enable")
        if (reset.code is None) != (reset.value is None):
            at.fail("code and value belong together; without them, an enable resets the fault",
                    "reset")  # fmt: skip
        if reset.code is not None:
            self._check_writable(at, reset.code, "reset", "code")
        self._check_described(at, reset.number, "reset", "number")
        for number, rule in enumerate(rules.setpoints):
            here = Place(at.document, (*at.path, "setpoints", number))
            self._check_writable(here, rule.code, "code")
            for key, other in (("least", rule.least), ("full_scale", rule.full_scale)):
                if other is not None:
                    self._check_described(here, other, key)
            if rule.when is not None:
                self._check_described(here, rule.when.code, "when", "code")
        return rules

    def _check_described(self, at: Place, code: Code, *below: int | str) -> None:
        if code not in self._codes:
            at.fail(f"{code} is not described", *below, code=str(code))

    def _check_writable(self, at: Place, code: Code, *below: int | str) -> None:
        self._check_described(at, code, *below)
        if not self._codes[code].writable:
            at.fail(f"{code} cannot be written", *below, code=str(code))

    def _check_shown(self, at: Place, code: Code, *below: int | str) -> None:
        """Check a code that is read without a request: every user sees its value."""
        self._check_described(at, code, *below)
        info = self._codes[code]
        if info.secret or not info.readable:
            why = "is secret" if info.secret else "cannot be read"
            at.fail(f"{code} {why}, so it is not read unasked", *below, code=str(code))


def _variants(family: Family, book: WordBook) -> dict[str, Family]:
    """Return the family in each signal configuration, and in any under the empty name."""
    return {"": family} | {
        name: replace(
            family,
            configuration=name,
            words=book.words(name),
            control_words=book.control_words(name),
        )
        for name in book.configurations
    }
