"""Every code that EDB2102EN names, typed off the manual by hand and held against the data files.

The table below is not made from the data: it is a second reading of code table 8.2, of the tables
in chapter 6, and of the codes that their texts name. Each row is walked against each family, both
ways: nothing of the manual is missing, and nothing is described that the manual does not have.
How many codes each family has is said at the end of the run (`tests/conftest.py`).
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from lecombus.drives import Storage, family
from lecombus.parameters import Code, Format

ALL = "820x 821x 822x 824x 8200vector 93xx"
INVERTERS = "820x 821x 822x 824x 8200vector"
EIGHT = "820x 821x 822x 824x"
LATER = "821x 822x 824x 8200vector"
MIDDLE = "821x 822x 824x"

# Code, families, format, access (r, rw; -w: could be written, lecombus never does), values.
TABLE_8_2 = """
C0001        | INVERTERS   | VD | rw |
C0001        | EIGHT       | VD | rw | 0 1 2 3
C0009        | ALL         | VD | rw | 1..99
C0040        | ALL         | VD | rw | 0 1
C0043        | LATER 93xx  | VD | rw | 0 1
C0046        | INVERTERS   | VD | rw | 0..480
C0046        | 93xx        | VD | r  |
C0067        | 93xx        | VD | r  |
C0068        | ALL         | VH | r  |
C0125        | ALL         | VD | rw | 0 1 2 3 4
C0127        | MIDDLE      | VD | rw | 0 1
C0135        | ALL         | VH | rw |
C0141        | 93xx        | VD | rw |
C0150        | ALL         | VH | r  |
C0161        | ALL         | VD | r  |
C0162        | INVERTERS   | VD | r  |
C0163        | INVERTERS   | VD | r  |
C0164        | INVERTERS   | VD | r  |
C0168/1..8   | 93xx        | VD | r  |
C0248        | ALL         | VD | -w | 0..255
C0249        | ALL         | VD | -w | 0..15
C1810        | ALL         | VS | r  |
C1811        | ALL         | VS | r  |
C1920        | ALL         | VD | rw | 0 1
C1921        | ALL         | VD | rw | 0 1
C1922        | ALL         | VD | rw | 0 1 2
C1923        | ALL         | VD | rw | 50..65535
C1962        | ALL         | VD | r  |
"""

NAMED_ELSEWHERE = """
C0003        | 93xx        | VD | rw |
C0005        | 93xx        | VD | rw |
C0011        | INVERTERS   | VD | rw |
C0012        | ALL         | VD | rw |
C0013        | ALL         | VD | rw |
C0037        | INVERTERS   | VD | rw |
C0038        | INVERTERS   | VD | rw |
C0039        | INVERTERS   | VD | rw |
C0039/1..15  | 93xx        | VD | rw |
C0050        | INVERTERS   | VD | r  |
C0120        | INVERTERS   | VD | rw |
C0357/1..3   | 8200vector  | VD | rw |
C0370        | 8200vector  | VD | rw |
C0410        | 8200vector  | VD | rw |
C0412        | 8200vector  | VD | rw |
C0417        | 8200vector  | VD | rw |
C0421        | 8200vector  | VD | rw |
C0500        | LATER       | VD | rw |
C0501        | LATER       | VD | rw |
C0599        | 8200vector  | VD | rw |
C0102/1..3   | 93xx        | VD | rw |
C0103/1..3   | 93xx        | VD | rw |
C0141        | 820x        | VD | rw | 0..100
C0141        | MIDDLE      | VD | rw | -100..100
C0181        | 820x        | VD | rw | 0..80
C0200        | ALL         | VS | r  |
C0201        | ALL         | VS | r  |
"""

SETS = {"8200vector": (0, 2000, 4000, 6000), "93xx": (0,)}
TWO_SETS = (0, 2000)
IN_EVERY_SET = {Code(1), Code(11)}
"""Those that 6.1 and 6.2.1 say are in every set."""

Row = tuple[Code, str, str, str]


def rows_of(name: str, *tables: str) -> list[Row]:
    """Return the rows that are for a family: code, format, access, values."""
    found = []
    for line in "\n".join(tables).strip().splitlines():
        if not line.strip():
            continue
        written, families, kind, access, values = (part.strip() for part in line.split("|"))
        words = " ".join(str(globals().get(word, word)) for word in families.split()).split()
        if name in words:
            number, _, subcodes = written.partition("/")
            first, _, last = (subcodes or "0..0").partition("..")
            found += [
                (Code.parse(f"{number}/{n}"), kind, access, values)
                for n in range(int(first), int(last) + 1)
            ]
    return found


@pytest.mark.parametrize("name", ALL.split())
def test_every_code_of_the_manual_is_described_as_it_says(
    name: str, record_property: Callable[[str, object], None]
) -> None:
    drive = family(name)
    rows = rows_of(name, TABLE_8_2, NAMED_ELSEWHERE)
    for code, kind, access, values in rows:
        info = drive.info(code)
        assert info is not None, code
        assert info.format is Format(kind), code
        assert info.writable == (access == "rw"), code
        assert info.readable, code
        if ".." in values:
            low, high = values.split("..")
            assert (str(info.low), str(info.high)) == (low, high), code
        elif values:
            assert sorted(info.selection) == [int(value) for value in values.split()], code
    of_table = {code for code, *_ in rows_of(name, TABLE_8_2)}
    all_sets = len(list(drive.described()))
    record_property(
        "counted",
        f"EDB2102EN {name}: {len(of_table)} codes of table 8.2, "
        f"{len({code for code, *_ in rows})} with those named elsewhere, "
        f"{all_sets} with all parameter sets",
    )


@pytest.mark.parametrize("name", ALL.split())
def test_nothing_is_described_that_the_manual_does_not_have(name: str) -> None:
    drive = family(name)
    known = {code for code, *_ in rows_of(name, TABLE_8_2, NAMED_ELSEWHERE)}
    basic = {info.code for info in drive.described() if info.parameter_set == 1}
    assert basic == known
    unbounded = {
        code
        for code in known
        if not any(values for row, *_, values in rows_of(name, TABLE_8_2, NAMED_ELSEWHERE)
                   if row == code)
    }  # fmt: skip
    for code in unbounded:
        info = drive.info(code)
        assert info is not None
        assert (info.low, info.high, dict(info.selection)) == (None, None, {}), code


@pytest.mark.parametrize("name", ALL.split())
def test_further_parameter_sets_hold_what_the_manual_puts_there(name: str) -> None:
    drive = family(name)
    offsets = SETS.get(name, TWO_SETS)
    assert drive.set_offsets == offsets
    expected = {
        (Code(code.number + offset), number)
        for number, offset in enumerate(offsets[1:], start=2)
        for code in IN_EVERY_SET
    }
    found = {
        (info.code, info.parameter_set) for info in drive.described() if info.parameter_set > 1
    }
    assert found == expected
    for code, _ in found:
        one, two = drive.info(Code(code.number % 2000)), drive.info(code)
        assert one is not None
        assert two is not None
        assert (one.name, one.writable, one.unit) == (two.name, two.writable, two.unit)


@pytest.mark.parametrize("name", ALL.split())
def test_names_and_selections_are_there_in_both_languages(name: str) -> None:
    drive = family(name)
    same = {info.name for info in drive.described() if info.name == info.name_de}
    assert same == set()
    for info in drive.described():
        assert all(text.en and text.de for text in info.selection.values())


@pytest.mark.parametrize("name", ALL.split())
def test_what_the_module_holds_is_lost_with_its_supply(name: str) -> None:
    drive = family(name)
    held = {info.code.number for info in drive.described() if info.storage is Storage.MODULE}
    window = {181} if name == "820x" else set()
    assert held == {248, 249, 1920, 1921, 1922, 1923} | window


@pytest.mark.parametrize("name", ALL.split())
def test_what_needs_inhibit(name: str) -> None:
    needing = {info.code.number for info in family(name).described() if info.needs_inhibit}
    everything_stored = {1, 9, 11, 12, 13, 37, 38, 39, 120, 125, 2001, 2011}
    expected = {"820x": everything_stored, "93xx": {5}}.get(name, set())
    assert needing == expected


@pytest.mark.parametrize("name", ALL.split())
def test_defaults_are_those_printed_in_bold(name: str) -> None:
    defaults = {
        info.code.number: info.default
        for info in family(name).described()
        if info.default is not None and info.parameter_set == 1
    }
    expected = {9: "1", 125: "0", 248: "0", 249: "0", 1920: "0", 1921: "0", 1922: "0"}
    expected |= {1: "0"} if name in EIGHT.split() else {}
    expected |= {127: "0"} if name in MIDDLE.split() else {}
    assert defaults == expected


@pytest.mark.parametrize("name", ALL.split())
def test_whole_numbers_have_a_step_of_one_and_no_other_code_has_a_step(name: str) -> None:
    """The manual names no step of a setpoint: what lies between two values is the drive's own."""
    steps = {info.code.number: info.step for info in family(name).described() if info.step}
    assert steps == {9: 1, 248: 1, 249: 1, 1923: 1}
