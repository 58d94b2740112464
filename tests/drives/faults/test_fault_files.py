"""A fault table that says something impossible is refused with its place."""

from __future__ import annotations

import pytest

from lecombus.drives.faults.fault_tables import FaultKind, link_report, load_table
from lecombus.errors import DescriptionError

HEAD = """\
table: t
families: [generic]
manual: M1
memories: [C0161]
memories_source: "1"
look_up: [look it up, nachsehen]
faults:
"""
ENTRY = """  - {numbers: [50], keypad: OH, meaning: [hot, heiß], source: "2"}\n"""

NO_FILES: dict[str, str] = {}


def load(text: str) -> object:
    return load_table("t", {"t.yaml": text}.__getitem__)


def test_an_entry_is_what_the_file_says() -> None:
    table = load_table("t", {"t.yaml": HEAD + ENTRY}.__getitem__)
    fault = table.faults[50]
    assert (fault.keypad, fault.kind, fault.meaning.de) == ("OH", FaultKind.TRIP, "heiß")
    assert (fault.cause.en, fault.remedy.en, fault.source) == ("", "look it up", "M1 2")
    assert table.source == "M1 1"


@pytest.mark.parametrize(
    ("entry", "place", "why"),
    [
        ('  - {numbers: [50], keypad: OH, meaning: [hot, heiß]}\n', "8:5", "source is missing"),
        ('  - {numbers: [], keypad: OH, meaning: [hot, heiß], source: "2"}\n', "8:5", "one number"),
        ('  - {numbers: [50], meaning: [hot], source: "2"}\n', "8:30", "two languages"),
        ('  - {numbers: [50], meaning: [hot, ""], source: "2"}\n', "8:36", "a text is right"),
        ('  - {numbers: [0], meaning: [a, b], source: "2"}\n', "8:16", "from 1 to 9999"),
        (ENTRY + ENTRY, "9:16", "fault 50 stands here twice"),
        (ENTRY.replace("[50]", "[50, 50]"), "8:20", "twice"),
        (ENTRY.replace("keypad", "kepad"), "8:21", "kepad is not known here"),
        (ENTRY.replace("keypad: OH", "kind: oops"), "8:27", "trip, message, warning are"),
    ],
)  # fmt: skip
def test_a_wrong_entry_is_refused_with_file_line_and_column(
    entry: str, place: str, why: str
) -> None:
    with pytest.raises(DescriptionError, match=why) as caught:
        load(HEAD + entry)
    assert str(caught.value).startswith(f"faults/t.yaml:{place}: ")


def test_a_file_under_another_name_and_one_that_is_missing_are_refused() -> None:
    with pytest.raises(DescriptionError, match="table must be t"):
        load(HEAD.replace("table: t", "table: x") + ENTRY)
    with pytest.raises(DescriptionError, match="no such data file"):
        load_table("t", NO_FILES.__getitem__)


LINK = """\
manual: M1
classes: {access: [access error, Zugriffsfehler]}
extended:
  - {number: 7, class: access, meaning: [a, b], source: "2"}
communication:
  - {number: 6, meaning: [a, b], allows: [access], source: "2"}
"""


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("class: access", "class: acess", "extended.yaml:4:24: acess is not known here; access"),
        ("allows: [access]", "allows: [x]", "extended.yaml:6:43: x is not known"),
        ("number: 6", "number: 16", "from 1 to 15"),
        ('b], source: "2"}\ncomm', "b]}\ncomm", "source is missing"),
    ],
)
def test_what_drives_say_of_an_exchange_is_checked_too(old: str, new: str, why: str) -> None:
    link_report({"extended.yaml": LINK}.__getitem__)
    with pytest.raises(DescriptionError, match=why):
        link_report({"extended.yaml": LINK.replace(old, new)}.__getitem__)
