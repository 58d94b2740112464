"""Bad data files are refused with file, line, column and what would be right."""

from __future__ import annotations

import pytest

from lecombus.drives.loading import load_family
from lecombus.errors import DescriptionError
from lecombus.protocol.addressing import Code

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
"""

SHARED = """\
fields:
  - {name: state, bits: [8, 11], texts: {0: fine, 8: fault}, fault: [8]}
codes:
  - {code: C0150, name: status, format: VH, hex_digits: 4, source: "1"}
"""


def load(own: str, shared: str = SHARED) -> object:
    files = {"test.yaml": own, "shared.yaml": shared}
    return load_family("test", files.__getitem__)


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
    ("codes: others", "codes: [C0041]", "family: test", "one entry with codes: others"),
    ("codes: others", "codes: [C0040]", "{codes: [C0040", "C0040 has an answer time already"),
    ("codes: [C0040]", "codes: others", "{codes: others", "given twice"),
    ("feed: C0150", "feed: C0151", "C0151", "C0151 is not described"),
    ("feed: C0150\n", "", "family: test", "feed is missing"),
    ("identity: [C0150]", "identity: C0150", "C0150", "a list is right here"),
    (
        "action_code: C0922",
        "action_code: C0921",
        "{time_code: C0923",
        "C0921 is not described as writable",
    ),
    (
        "actions: {none: 0, inhibit: 1}",
        "actions: {none: 0, explode: 1}",
        "explode: 1",
        "explode is no action",
    ),
    ("low_ms: 50", "low_ms: 65535", "{time_code: C0923", "low_ms is not below high_ms"),
    ("{7: inhibited}", "{7: inhibited, 6: inhibited}", "{7: inhibited", "two bits have one name"),
    ("{7: inhibited}", "{9: inhibited}", "{9: inhibited", "a bit of state has a name of its own"),
    ("{7: inhibited}", "{32: inhibited}", "32: inhibited", "from 0 to 31"),
    ("fields: [state]", "fields: [speed]", "speed", "there is no field speed; state"),
    (
        "{code: C0150, bits",
        "{code: C0040, bits",
        "{code: C0040",
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
        "{action: inhibit",
        "C0150 cannot be written",
    ),
    (
        "code: C0040, value: 0",
        "code: C0041, value: 0",
        "{action: inhibit",
        "C0041 is not described",
    ),
    ("value: 0, proofs", "value: 0, set: 8, proofs", "{action: inhibit", "either value or set"),
    ("[{code: C0040, equals: 0}]", "[{code: C0040}]", "{code: C0040", "equals is missing"),
    ("family: test", "family: other", "other", "family must be test"),
    ("include: [shared]", "include: [elsewhere]", "elsewhere", "no data file elsewhere.yaml"),
    ("addressing: [standard]", "addressing: [short]", "short", "short is no addressing form"),
    ("title: a drive", "titel: a drive", "family: test", "title is missing"),
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
    with pytest.raises(DescriptionError, match="include is not known here"):
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
