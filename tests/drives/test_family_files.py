"""Bad data files are refused with file, line, column and what would be right."""

from __future__ import annotations

from dataclasses import fields
from decimal import Decimal

import pytest

from lecombus.drives import Family, Language, Storage
from lecombus.drives.family_files import FamilyFile, load_family
from lecombus.errors import DescriptionError
from lecombus.parameters import Code, Value

GOOD = """\
family: test
title: a drive for tests
manual: TEST1
addressing: [standard]
include: [shared]
codes:
  - {code: C0040, name: inhibit, format: VD, writable: true, motion: true, source: "1"}
  - {code: C0135, name: control word, format: VH, hex_digits: 4, writable: true, source: "1"}
  - {code: C0009, name: address, format: VD, writable: true, write_class: address, source: "1"}
  - {code: C0923, name: time, format: VD, writable: true, source: "1"}
  - {code: C0922, name: action, format: VD, writable: true, source: "1"}
answer_times:
  - {codes: [C0040], read_ms: 10, write_ms: 30, source: "2"}
  - {codes: others, read_ms: 20, write_ms: 20, slow_write_ms: 50, source: "2"}
hold_after_write_ms: 50
watchdog: {time_code: C0923, action_code: C0922, actions: {none: 0, inhibit: 1}, low_ms: 50,
           high_ms: 65535, volatile: true, source: "3"}
feed: C0150
identity: [C0150]
status:
  - {code: C0150, every_ms: 1000}
writable: [C0040]
words:
  - {code: C0150, bits: {7: inhibited}, fields: [state], source: "4"}
stops:
  - {action: inhibit, code: C0040, value: 0, proofs: [{code: C0040, equals: 0}], source: "5"}
protocol: lecom
"""

SHARED = """\
fields:
  - {name: state, bits: [8, 11], texts: {0: [fine, gut], 8: [fault, Fehler]}, fault: [8]}
codes:
  - {code: C0150, name: status, format: VH, hex_digits: 4, source: "1"}
"""


def load(own: str, shared: str = SHARED) -> Family:
    files = {"test.yaml": own, "shared.yaml": shared}
    return load_family("test", files.__getitem__)


def test_what_a_file_says_reaches_the_family() -> None:
    """A key of the file without a field of the same name in `Family` would be dropped."""
    kept = {one.name for one in fields(Family)}
    others = {one.name for one in fields(FamilyFile)} - kept
    # `manual` is for people; the others are used while the file is read.
    assert others == {"include", "fields", "stored_needs_inhibit", "manual"}


def test_good_file_loads_with_what_it_includes() -> None:
    files = {"test.yaml": GOOD, "shared.yaml": SHARED}
    drive = load_family("test", files.__getitem__)
    assert drive.codes.keys() == {Code(n) for n in (9, 40, 135, 150, 922, 923)}
    assert drive.codes[Code(150)].source == "TEST1 1"
    assert drive.status == ((Code(150), 1.0),)
    assert drive.active_fault(Code(150), 0x0800) is True
    assert drive.longest_answer_time_s(Code(5), write=True) == 0.050


def text_at(text: str, where: str) -> str:
    line, column = map(int, where.split(":"))
    return text.splitlines()[line - 1][column - 1 :]


BAD = [
    (
        'C0040, name: inhibit, format: VD, writable: true, motion: true, source: "1"}',
        "C0040, name: inhibit, format: VD, writable: true, motion: true}",
        "{code: C0040",
        "source is missing",
    ),
    (
        "code: C0922, name: action",
        "code: C0923, name: action",
        "{code: C0923",
        "C0923 is described twice",
    ),
    ("code: C0922, name", "code: C09X2, name", "C09X2", "is not a code"),
    ("inhibit, format: VD", "inhibit, format: VX", "VX", "VX is not known here; VD, VH, VS, VO"),
    (
        "inhibit, format: VD,",
        "inhibit, format: VD, write_clas: edge,",
        "write_clas: edge",
        "write_clas is not known here; .*write_class",
    ),
    ("write_class: address", "write_class: adress", "adress", "adress is not known here; plain"),
    ("name: inhibit, format", "name: '', format", "''", "a text is right here"),
    (
        "name: inhibit, format",
        "name: inhibit, name: again, format",
        "name: again",
        "name stands here twice",
    ),
    ("name: inhibit, format: VD", "name: inhibit", "{code: C0040", "format is missing"),
    (
        "inhibit, format: VD, writable: true",
        "inhibit, format: VD, writable: 1",
        "1",
        "true or false",
    ),
    ("hex_digits: 4, writable", "hex_digits: 3, writable", "3", "2, 4 or 8 are"),
    (
        "format: VH, hex_digits: 4, writable",
        "format: VH, writable",
        "{code: C0135",
        "hex_digits belongs",
    ),
    ("time, format: VD", "time, format: VD, hex_digits: 4", "{code: C0923", "hex_digits belongs"),
    ("every_ms: 1000", "every_ms: 0", "0", "whole number from 1 to"),
    ("every_ms: 1000", "every_ms: -5", "-5", "whole number from 1 to"),
    ("every_ms: 1000", "every_ms: 1s", "1s", "whole number from 1 to"),
    (
        "{code: C0150, every_ms: 1000}",
        "{code: C0151, every_ms: 1000}",
        "C0151",
        "C0151 is not described",
    ),
    (
        "  - {code: C0150, every_ms: 1000}\n",
        "  - {code: C0150, every_ms: 1000}\n  - {code: C150, every_ms: 500}\n",
        "{code: C150",
        "cyclically twice",
    ),
    ("writable: [C0040]", "writable: [C0041]", "C0041", "C0041 is not described"),
    ("writable: [C0040]", "writable: [C0150]", "C0150", "C0150 cannot be written"),
    ("writable: [C0040]", "writable: [C0009]", "C0009", "never writable by default"),
    ("read_ms: 10", "read_ms: 0", "0", "whole number from 1"),
    ("slow_write_ms: 50", "slow_write_ms: 5", "{codes: others", "slow time is shorter"),
    ("codes: others", "codes: C0040", "C0040", "or: others"),
    ("codes: others", "codes: [C0041]", "- {codes", "one entry with codes: others"),
    ("codes: others", "codes: [C0040]", "{codes: [C0040", "answer time of C0040 is given twice"),
    ("codes: [C0040]", "codes: others", "{codes: others", "all other codes is given twice"),
    ("feed: C0150", "feed: C0151", "C0151", "C0151 is not described"),
    ("feed: C0150\n", "", "family: test", "feed is missing"),
    ("identity: [C0150]", "identity: C0150", "C0150", "a list is right here"),
    (
        "action_code: C0922",
        "action_code: C0921",
        "C0921",
        "C0921 is not described",
    ),
    (
        "actions: {none: 0, inhibit: 1}",
        "actions: {none: 0, explode: 1}",
        "explode: 1",
        "explode is not known here; none",
    ),
    ("low_ms: 50", "low_ms: 65535", "{time_code: C0923", "low_ms is not below high_ms"),
    ("{7: inhibited}", "{7: inhibited, 6: inhibited}", "{7: inhibited", "two bits have one name"),
    ("{7: inhibited}", "{9: inhibited}", "{9: inhibited", "a bit of state has a name of its own"),
    ("{7: inhibited}", "{32: inhibited}", "32: inhibited", "from 0 to 31"),
    ("fields: [state]", "fields: [speed]", "speed", "there is no field speed; state"),
    (
        "{code: C0150, bits",
        "{code: C0040, bits",
        "C0040",
        "C0040 is not described as a word",
    ),
    (
        "action: inhibit, code",
        "action: coast, code",
        "coast",
        "coast is not known here; quick-stop",
    ),
    (
        "code: C0040, value: 0",
        "code: C0150, value: 0",
        "C0150",
        "C0150 cannot be written",
    ),
    (
        "code: C0040, value: 0",
        "code: C0041, value: 0",
        "C0041",
        "C0041 is not described",
    ),
    ("value: 0, proofs", "value: 0, set: 8, proofs", "{action: inhibit", "either value or set"),
    ("[{code: C0040, equals: 0}]", "[{code: C0040}]", "{code: C0040", "equals is missing"),
    ("family: test", "family: other", "other", "family must be test"),
    ("include: [shared]", "include: [elsewhere]", "elsewhere", "no data file elsewhere.yaml"),
    (
        "addressing: [standard]",
        "addressing: [short]",
        "short",
        "short is not known here; standard, ext",
    ),
    (
        "protocol: lecom",
        "protocol: profibus",
        "profibus",
        "there is no line protocol profibus",
    ),
    ("title: a drive", "titel: a drive", "family: test", "title is missing"),
    ("title: a drive for tests\n", "", "family: test", "title is missing"),
    ("title: a drive", "note: 1\ntitle: a drive", "note: 1", "note is not known here"),
    ("codes:\n", "codes: [\n", "- {code: C0040", "this is no YAML"),
]


@pytest.mark.parametrize(("right", "wrong", "at", "message"), BAD)
def test_mistake_is_named_with_its_place(right: str, wrong: str, at: str, message: str) -> None:
    assert right in GOOD
    text = GOOD.replace(right, wrong, 1)
    with pytest.raises(DescriptionError, match=message) as refused:
        load(text)
    assert refused.value.file == "families/test.yaml"
    assert text_at(text, refused.value.where).startswith(at)
    assert refused.value.drive_type == "test"


def test_code_described_in_two_files_is_refused() -> None:
    with pytest.raises(DescriptionError, match="C0150 is described twice") as refused:
        load(GOOD.replace("code: C0922, name", "code: C0150, name"))
    assert (refused.value.file, refused.value.where) == ("families/shared.yaml", "4:5")
    assert refused.value.code == "C0150"


def test_mistake_in_an_included_file_names_that_file() -> None:
    with pytest.raises(DescriptionError, match="VX is not known") as refused:
        load(GOOD, SHARED.replace("format: VH", "format: VX"))
    assert (refused.value.file, refused.value.where) == ("families/shared.yaml", "4:41")


def test_what_only_one_file_may_say_is_refused_from_two() -> None:
    with pytest.raises(DescriptionError, match="feed is also given by an included file"):
        load(GOOD, SHARED + "feed: C0150\n")


def test_included_file_includes_nothing_itself() -> None:
    with pytest.raises(DescriptionError, match="include is also given by an included file"):
        load(GOOD, SHARED + "include: [more]\n")


@pytest.mark.parametrize("number", ["010", "1:30", "1e3", "0x", "~"])
def test_number_that_reads_two_ways_is_refused(number: str) -> None:
    with pytest.raises(DescriptionError, match="whole number"):
        load(GOOD.replace("read_ms: 10", f"read_ms: {number}"))


@pytest.mark.parametrize(
    "text", ["", "just text", "- a list", "a: \x07", "a: {", "a: 1\n---\nb: 2"]
)
def test_file_that_is_no_table_is_refused(text: str) -> None:
    with pytest.raises(DescriptionError):
        load(text)


def test_missing_file_is_a_description_error() -> None:
    with pytest.raises(DescriptionError, match="there is no such data file"):
        load_family("nowhere", dict[str, str]().__getitem__)


FULL = """\
  - {code: C0011, name: maximum frequency, name_de: maximale Frequenz, unit: Hz, format: VD,
     range: [7.5, 480], step: 0.5, default: 50, writable: true, needs_inhibit: true, sets: true,
     source: "6"}
  - {code: C0168, subcodes: [1, 8], name: fault, name_de: Fehler, format: VD, source: "6"}
  - {code: C0001, name: mode, format: VD, selection: {0: [terminal, Klemme], 3: [LECOM, LECOM]},
     writable: true, storage: module, secret: true, source: "6"}
"""


def with_codes(entries: str, sets: str = "[0, 2000]") -> Family:
    own = GOOD.replace("answer_times:", f"{entries}set_offsets: {sets}\nanswer_times:", 1)
    return load(own)


def test_an_entry_says_what_a_code_can_be() -> None:
    drive = with_codes(FULL)
    info = drive.codes[Code(11)]
    assert (info.low, info.high, info.step) == (Decimal("7.5"), Decimal(480), Decimal("0.5"))
    assert (info.name_de, info.default, info.needs_inhibit) == ("maximale Frequenz", "50", True)
    assert (info.storage, info.readable, info.parameter_set) == (Storage.STORED, True, 1)
    assert info.allowed == "7.5 to 480 Hz in steps of 0.5"
    assert [info.may_be(Decimal(n)) for n in ("7.5", "7", "480.5", "8.25")] == [True] + 3 * [False]
    mode = drive.codes[Code(1)]
    assert (mode.storage, mode.secret) == (Storage.MODULE, True)
    assert mode.allowed == "0 (terminal), 3 (LECOM)"
    assert (mode.may_be(3), mode.may_be(1)) == (True, False)
    meaning = mode.meaning(Value.decimal(0))
    assert meaning is not None
    assert meaning.in_language(Language.DE) == "Klemme"
    assert mode.meaning(Value.decimal("0.5")) is None
    assert drive.codes[Code(150)].storage is Storage.VOLATILE


def test_a_range_of_subcodes_is_one_entry_for_many_codes() -> None:
    drive = with_codes(FULL)
    assert [drive.codes[Code(168, n)].name_de for n in (1, 8)] == ["Fehler 1", "Fehler 8"]
    assert drive.info(Code(168, 9)) is None
    assert drive.info(Code(168)) is None


def test_a_code_of_all_sets_answers_at_every_offset() -> None:
    drive = with_codes(FULL, "[0, 2000, 4000]")
    assert drive.set_offsets == (0, 2000, 4000)
    info = drive.info(Code(4011))
    assert info is not None
    assert (info.code, info.name, info.parameter_set) == (Code(4011), "maximum frequency", 3)
    assert drive.info(Code(2040)) is None
    assert [str(one.code) for one in drive.described()][-2:] == ["C2011", "C4011"]


def test_a_family_may_need_inhibit_for_all_that_it_stores() -> None:
    own = GOOD + "stored_needs_inhibit: true\n"
    codes = load(own).codes
    assert codes[Code(923)].needs_inhibit
    assert not codes[Code(40)].needs_inhibit


def test_saving_is_done_by_a_code_that_saves() -> None:
    own = GOOD.replace("C0922, name: action", "C0922, write_class: save, name: action")
    assert load(own + "saved_by: C0922\n").saved_by == Code(922)
    with pytest.raises(DescriptionError, match="C0923 does not save"):
        load(own + "saved_by: C0923\n")


BAD_CODES = [
    ("range: [7.5, 480]", "range: [7.5, 214748.3648]", "214748.3648", "-214748.3648 to"),
    ("range: [7.5, 480]", "range: [7.50001, 480]", "7.50001", "more than 4 decimals"),
    ("range: [7.5, 480]", "range: [480, 7.5]", "[480", "the lower end comes first"),
    ("range: [7.5, 480]", "range: [7.5]", "[7.5]", r"\[lowest, highest\]"),
    ("range: [7.5, 480]", "range: [low, 480]", "low", "a number from"),
    ("range: [7.5, 480]", "range: [7.5, .nan]", ".nan", "a number from"),
    ("step: 0.5", "step: 0.8", "0.8", "do not lead from 7.5 to 480"),
    ("step: 0.5", "step: 0", "0", "do not lead"),
    ("range: [7.5, 480], ", "", "0.5", "give the range too"),
    ("default: 50", "default: 5", "5", "outside 7.5 to 480"),
    ("VD,\n     range", "VH, hex_digits: 2,\n     range", "7.5", "whole number from 0 to 255"),
    ("VD,\n     range", "VS,\n     range", "[7.5", "only numbers"),
    ("{0: [terminal, Klemme]", "{0: terminal", "terminal", "a list is right here"),
    ("[terminal, Klemme]", "[terminal]", "[terminal]", "two languages"),
    ("0: [terminal", "0.5: [terminal", "0.5", "whole number from"),
    ("3: [LECOM", "0x0: [LECOM", "0x0", "0 stands here twice"),
    ("VD, selection", "VD, range: [0, 2], selection", "3: [", "3 lies outside 0 to 2"),
    ("VD, selection", "VS, selection", "{0: [", "only numbers"),
    ("selection: {", "default: 2, selection: {", "2", "2 is not in the selection"),
    ("VD, selection", "VD, bits: {1: [a, b]}, selection", "{1: [a", "or it has a range or a sel"),
    ("selection: {0:", "bits: {16:", "16", "whole number from 0 to 15"),
    ("selection: {0:", "bits: {4:", "3", "bit 3 stands after 4: the lowest comes first"),
    ("storage: module", "storage: ram", "ram", "ram is not known here; stored, module, volatile"),
    ("subcodes: [1, 8]", "subcodes: [8, 1]", "1", "whole number from 8 to 255"),
    ("subcodes: [1, 8]", "subcodes: [0, 8]", "0", "whole number from 1 to 255"),
    ("C0168, sub", "C0168/2, sub", "[1, 8]", "the code then has none"),
    ("name_de: Fehler,", "name_de: Fehler, readable: false,", "{code: C0168", "neither be read"),
    ("name_de: Fehler,", "name_de: Fehler, needs_inhibit: true,", "{code: C0168", "no inhibit"),
    ("C0001", "C0168/4", "{code: C0168/4", "C0168/4 is described twice: as fault 4"),
    ("C0001", "C2011", "{code: C2011", "C2011 is described twice: .* in parameter set 2"),
    ("C0011", "C2011", "{code: C2011", "begins at C2000"),
    ("[0, 2000]", "[2000]", "[2000]", "begin with 0"),
    ("[0, 2000]", "[0, 2000, 1000]", "[0, 2000, 1000]", "begin with 0"),
    ("{code: C0150, every_ms: 1000}", "{code: C0001, every_ms: 1}", "C0001", "is secret"),
    ("identity: [C0150]", "identity: [C0001]", "C0001", "C0001 is secret, so it is not read"),
]


@pytest.mark.parametrize(("right", "wrong", "at", "message"), BAD_CODES)
def test_a_description_that_cannot_be_is_named_with_its_place(
    right: str, wrong: str, at: str, message: str
) -> None:
    good = GOOD.replace("answer_times:", f"{FULL}set_offsets: [0, 2000]\nanswer_times:", 1)
    assert right in good
    text = good.replace(right, wrong, 1)
    with pytest.raises(DescriptionError, match=message) as refused:
        load(text)
    assert text_at(text, refused.value.where).startswith(at)


def test_what_is_read_unasked_can_be_read() -> None:
    own = GOOD.replace("name: action, format: VD", "name: action, format: VD, readable: false")
    with pytest.raises(DescriptionError, match="C0922 cannot be read"):
        load(own.replace("identity: [C0150]", "identity: [C0922]"))


WORDS = """\
configured_by: C0922
words:
  - {code: C0150, bits: {7: inhibited}, fields: [state], free: [0, 1],
     states: {inhibited: inhibited, fault: state = 8}, source: "4"}
  - {code: C0150, configuration: [1xx1], bits: {0: up}, states: {ready: not up}, source: "4"}
control_words:
  - code: C0135
    bits:
      3: {name: stop, off: [no stop, kein Halt], on: [stop, Halt]}
    fields:
      - {name: jog, bits: [0, 1], texts: {0: [none, keiner], 2: [second, zweiter]}}
    free: [2, 4]
    reserved: [5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]
    source: "4"
  - code: C0135
    configuration: [1xx1, 2xx1]
    bits:
      2: {name: up, off: [no, nein], on: [yes, ja]}
    source: "4"
"""
BEFORE = GOOD.partition("words:")[0], GOOD.partition("stops:")[2]


def wordy(words: str) -> str:
    return f"{BEFORE[0]}{words}stops:{BEFORE[1]}"


def test_a_configuration_adds_to_what_holds_for_all() -> None:
    drive = load(wordy(WORDS))
    one, two = drive.configured(1011), drive.configured(2001)
    assert [dict(each.words[Code(150)].bits) for each in (drive, one, two)] == [
        {"inhibited": 128}, {"up": 1, "inhibited": 128}, {"inhibited": 128},
    ]  # fmt: skip
    assert [each.words[Code(150)].free for each in (drive, one, two)] == [(0, 1), (1,), (0, 1)]
    assert [each.control_words[Code(135)].free for each in (drive, one)] == [(2, 4), (4,)]
    assert one.words[Code(150)].shown_states(0x0880) == ("inhibited", "fault", "ready")


BAD_WORDS = [
    ("configured_by: C0922\n", "", "family: test", "configured_by must name the code"),
    ("configured_by: C0922", "configured_by: C0999", "C0999", "C0999 is not described"),
    ("[1xx1]", "[1yy1]", "1yy1", "not a signal configuration such as 1xx1"),
    ("{0: up}", "{7: up}", "{code: C0150, configuration", "bit 7 is not free"),
    ("free: [0, 1]", "free: [0, 7]", "7", "bit 7 has a meaning"),
    ("free: [0, 1]", "free: [0, 9]", "9", "bit 9 has a meaning"),
    ("not up", "no up", "no up", "a bit, `not` and a bit, or a field"),
    ("not up", "down", "down", "; up are known"),
    ("ready: not up", "redy: not up", "redy", "redy is not known here; ready"),
    ("state = 8", "state = 9", "state = 9", "state has no text for 9"),
    ("state = 8", "state", "state", "or a field as in"),
    ("state = 8", "not state = 8", "not state = 8", "or a field as in"),
    ("C0150, bits: {7", "C0922, bits: {7", "C0922", "not described as a word"),
    ("free: [2, 4]", "free: [2]", "code: C0135", "bit 4 has no meaning"),
    ("free: [2, 4]", "free: [2, 4, 5]", "code: C0135", "bit 5 has two meanings"),
    ("bits: [0, 1]", "bits: [0, 2]", "code: C0135", "bit 2 has two meanings"),
    ("free: [2, 4]", "free: [2, 4, 16]", "16", "whole number from 0 to 15"),
    ("2: {name: up", "3: {name: up", "code: C0135", "bit 3 is not free"),
    ("2: {name: up", "16: {name: up", "16", "whole number from 0 to 15"),
    ("2: [second", "4: [second", "4", "whole number from 0 to 3"),
    ("{name: jog", "{name: stop", "{name: stop", "stop stands here twice"),
    ("on: [stop, Halt]", "on: stop", "stop", "a list is right here"),
    (", 2xx1]", ", 1xx1]", "code: C0135", "described twice"),
]


@pytest.mark.parametrize(("right", "wrong", "at", "message"), BAD_WORDS)
def test_a_word_that_cannot_be_is_named_with_its_place(
    right: str, wrong: str, at: str, message: str
) -> None:
    good = wordy(WORDS)
    assert right in good
    text = good.replace(right, wrong, 1)
    with pytest.raises(DescriptionError, match=message) as refused:
        load(text)
    assert text_at(text, refused.value.where).startswith(at)


def test_a_configuration_needs_what_holds_for_all() -> None:
    general = "    bits:\n      3"
    text = wordy(WORDS.replace(general, f"    configuration: [3xx1]\n{general}"))
    with pytest.raises(DescriptionError, match="no entry without configuration before this one"):
        load(text)
