"""Families from their data files: find, put together, check, keep.

Strategy: a family's file names the shared files it includes. Lists of entries (codes, answer
times, words, stops, shared fields) are joined; everything else must be given by exactly one of
the files. No entry replaces another: a code described twice is a mistake, so that what a family
does can be read off its files without knowing an order. Then the whole is checked across its
sections, and the first mistake is raised with file, line and column.

Families are kept: a second `family()` costs a dictionary access. A bad data file is a bad release
or a bad extension, never a user's roster; that is why one mistake at a time is enough here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from importlib import resources
from typing import Final

from lecombus.errors import ConfigError, DescriptionError, meant
from lecombus.protocol.addressing import Code

from .code_entries import CodeBook
from .codes import CodeInfo, WriteClass
from .document import Item, Origin, Table, read_document
from .family import AnswerTime, Family, SoftwareGate, WatchdogTraits
from .readers import read_code_number
from .restoring import RestoreRule, RestoreWord
from .sections import (
    read_answer_time,
    read_form,
    read_restore,
    read_software,
    read_stop,
    read_watchdog,
)
from .stops import StopAction, StopRule
from .verb_rules import VerbRules
from .verb_sections import read_verbs
from .word_entries import WordBook

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

NEVER_BY_DEFAULT = frozenset({WriteClass.ADDRESS, WriteClass.SAVE})
"""Write classes that a roster must spell out: they cut the drive off or wear its memory."""

HIGHEST_SET_OFFSET = 60_000
LONGEST_PERIOD_MS = 86_400_000
LONGEST_HOLD_MS = 10_000

ReadFile = Callable[[str], str]


@cache
def family(name: str) -> Family:
    """Give the family of a roster's word for it.

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
        read_file: Gives the text of a file by its name with `.yaml`.

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
        self._read_file = read_file
        self._own = self._open(f"{name}.yaml")
        include = self._own.get("include")
        self._tables = [self._own]
        for item in include.items() if include else []:
            self._tables.append(self._open(f"{item.text()}.yaml", item))
        manual = self._single("manual")
        self._manual = manual.text() if manual else ""

    def build(self) -> Family:
        own = self._own.take("family")
        if own.text() != self._name:
            own.fail(f"the file is named {self._name}.yaml: family must be {self._name}")
        offsets = self._set_offsets()
        codes = self._codes(offsets)
        answer_times, other = self._answer_times()
        watchdog = self._single("watchdog")
        software = self._single("software")
        book = self._words(codes)
        variants: dict[str, Family] = {}
        family = Family(
            name=self._name,
            title=self._required("title").text(),
            forms=tuple(read_form(item) for item in self._required("addressing").items()),
            codes=codes,
            status=tuple(self._status(codes)),
            writable=frozenset(self._writable(codes)),
            watchdog=self._watchdog(watchdog, codes) if watchdog else None,
            feed_code=self._feed(codes),
            hold_after_write_s=self._required("hold_after_write_ms").integer(0, LONGEST_HOLD_MS)
            / 1000,
            identity=tuple(self._shown(item, codes) for item in self._required("identity").items()),
            stops=self._stops(codes),
            words=book.words(),
            control_words=book.control_words(),
            configured_by=self._configured_by(codes, book),
            variants=variants,
            answer_times=answer_times,
            other_answer_time=other,
            software=self._software(software, codes) if software else None,
            set_offsets=offsets,
            saved_by=self._saved_by(codes),
            restore=tuple(self._restore(codes)),
            verbs=self._verbs(codes, book),
            keypad_offset=self._keypad_offset(),
        )
        for table in self._tables:
            table.done()
        variants |= _variants(family, book)
        return family

    def _open(self, file: str, named: Item | None = None) -> Table:
        try:
            text = self._read_file(file)
        except (OSError, KeyError) as exc:
            if named is not None:
                named.fail(f"there is no data file {file}")
            raise DescriptionError("there is no such data file", file=file) from exc
        return read_document(text, Origin(f"families/{file}", self._name))

    def _single(self, key: str) -> Item | None:
        """Take what at most one of the files may give."""
        found = [item for table in self._tables if (item := table.get(key)) is not None]
        if len(found) > 1:
            found[0].fail(f"{key} is also given by an included file")
        return found[0] if found else None

    def _required(self, key: str) -> Item:
        item = self._single(key)
        if item is None:
            self._own.fail(f"{key} is missing, here and in the included files")
        return item

    def _entries(self, key: str) -> Iterator[Item]:
        """Take the entries of a list from all files that have it."""
        for table in self._tables:
            items = table.get(key)
            if items is not None:
                yield from items.items()

    def _codes(self, offsets: tuple[int, ...]) -> dict[Code, CodeInfo]:
        inhibit = self._single("stored_needs_inhibit")
        book = CodeBook(offsets, stored_needs_inhibit=inhibit.flag() if inhibit else False)
        for item in self._entries("codes"):
            book.add(item, self._manual)
        return dict(sorted(book.codes.items()))

    def _set_offsets(self) -> tuple[int, ...]:
        item = self._single("set_offsets")
        if item is None:
            return (0,)
        offsets = tuple(one.integer(0, HIGHEST_SET_OFFSET) for one in item.items())
        if offsets[:1] != (0,) or list(offsets) != sorted(set(offsets)):
            item.fail("offsets begin with 0 and grow: [0, 2000]")
        return offsets

    def _keypad_offset(self) -> int | None:
        item = self._single("keypad_offset")
        return item.integer(1, HIGHEST_SET_OFFSET) if item is not None else None

    def _saved_by(self, codes: dict[Code, CodeInfo]) -> Code | None:
        item = self._single("saved_by")
        if item is None:
            return None
        code = self._described(item, codes)
        if codes[code].write_class is not WriteClass.SAVE:
            item.fail(f"{code} does not save: its write_class is {codes[code].write_class}")
        return code

    def _restore(self, codes: dict[Code, CodeInfo]) -> Iterator[RestoreRule]:
        for item in self._entries("restore"):
            rule = read_restore(item.table(), self._manual)
            for code in rule.codes:
                if code not in codes:
                    item.fail(f"{code} is not described", code=str(code))
                if codes[code].parameter_set != 1:
                    item.fail(f"a rule for {code} is written for parameter set 1", code=str(code))
                if rule.word is RestoreWord.SAVE and codes[code].write_class is not WriteClass.SAVE:
                    item.fail(f"{code} does not save", code=str(code))
            yield rule

    def _answer_times(self) -> tuple[dict[int, AnswerTime], AnswerTime]:
        times: dict[int, AnswerTime] = {}
        other: AnswerTime | None = None
        for item in self._entries("answer_times"):
            codes, time = read_answer_time(item.table(), self._manual)
            if codes is None and other is not None:
                item.fail("the answer time of all other codes is given twice")
            if codes is None:
                other = time
            for code in codes or ():
                if code.number in times:
                    item.fail(f"{code} has an answer time already", code=str(code))
                times[code.number] = time
        if other is None:
            self._own.fail("answer_times needs one entry with codes: others")
        return times, other

    def _words(self, codes: dict[Code, CodeInfo]) -> WordBook:
        book = WordBook(self._entries("fields"), codes, self._manual)
        for item in self._entries("words"):
            book.add_word(item)
        for item in self._entries("control_words"):
            book.add_control_word(item)
        return book

    def _configured_by(self, codes: dict[Code, CodeInfo], book: WordBook) -> Code | None:
        item = self._single("configured_by")
        if item is None and book.configurations:
            self._own.fail("configured_by must name the code of the signal configuration")
        return self._shown(item, codes) if item else None

    def _stops(self, codes: dict[Code, CodeInfo]) -> dict[StopAction, StopRule]:
        stops: dict[StopAction, StopRule] = {}
        for item in self._entries("stops"):
            action, rule = read_stop(item.table(), self._manual)
            if action in stops:
                item.fail(f"{action} is given twice")
            for code in (rule.code, *rule.proofs):
                if code not in codes:
                    item.fail(f"{code} is not described", code=str(code))
            if not codes[rule.code].writable:
                item.fail(f"{rule.code} cannot be written", code=str(rule.code))
            stops[action] = rule
        return stops

    def _verbs(self, codes: dict[Code, CodeInfo], book: WordBook) -> VerbRules | None:
        item = self._single("verbs")
        return read_verbs(item, self._manual, codes, book.control_words()) if item else None

    def _status(self, codes: dict[Code, CodeInfo]) -> Iterator[tuple[Code, float]]:
        seen: set[Code] = set()
        for item in self._required("status").items():
            table = item.table()
            code = self._shown(table.take("code"), codes)
            period_s = table.take("every_ms").integer(1, LONGEST_PERIOD_MS) / 1000
            table.done()
            if code in seen:
                item.fail(f"{code} is read cyclically twice", code=str(code))
            seen.add(code)
            yield code, period_s

    def _writable(self, codes: dict[Code, CodeInfo]) -> Iterator[Code]:
        for item in self._required("writable").items():
            code = self._described(item, codes)
            info = codes[code]
            if not info.writable:
                item.fail(f"{code} cannot be written", code=str(code))
            if info.write_class in NEVER_BY_DEFAULT:
                item.fail(
                    f"{code} ({info.write_class}) is never writable by default", code=str(code)
                )
            yield code

    def _watchdog(self, item: Item, codes: dict[Code, CodeInfo]) -> WatchdogTraits:
        traits = read_watchdog(item.table(), self._manual)
        for code in (traits.time_code, traits.action_code):
            if code not in codes or not codes[code].writable:
                item.fail(f"{code} is not described as writable", code=str(code))
        return traits

    def _software(self, item: Item, codes: dict[Code, CodeInfo]) -> SoftwareGate:
        gate = read_software(item.table(), self._manual)
        if gate.code not in codes:
            item.fail(f"{gate.code} is not described", code=str(gate.code))
        return gate

    def _feed(self, codes: dict[Code, CodeInfo]) -> Code:
        item = self._required("feed")
        return self._shown(item, codes) if codes else read_code_number(item)

    def _shown(self, item: Item, codes: dict[Code, CodeInfo]) -> Code:
        """Read a code that is read unasked, whose value is then there for everyone to see."""
        code = self._described(item, codes)
        if codes[code].secret or not codes[code].readable:
            why = "is secret" if codes[code].secret else "cannot be read"
            item.fail(f"{code} {why}, so it is not read unasked", code=str(code))
        return code

    def _described(self, item: Item, codes: dict[Code, CodeInfo]) -> Code:
        code = read_code_number(item)
        if code not in codes:
            item.fail(f"{code} is not described", code=str(code))
        return code


def _variants(family: Family, book: WordBook) -> dict[str, Family]:
    """Give the family in each signal configuration, and in any under the empty name."""
    return {"": family} | {
        name: replace(
            family,
            configuration=name,
            words=book.words(name),
            control_words=book.control_words(name),
        )
        for name in book.configurations
    }
