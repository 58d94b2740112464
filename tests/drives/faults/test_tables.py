"""The fault tables hold what the manuals' tables hold: copied here by hand, entry by entry."""

from __future__ import annotations

import sys

import pytest

from lecombus.drives import FAMILY_NAMES, family
from lecombus.drives.faults.fault_tables import FaultKind, fits_digit, link_report
from lecombus.parameters import Code

# EDB2102EN 8.2, fault memory (P82XX): number, keypad, and a word the meaning must have in it.
TABLE_82XX = """
71 CCr system
61 CE0 communication
62 CE1 CAN-IN1
63 CE2 CAN-IN2
64 CE3 CAN-IN1
65 CE4 off
66 CE5 time-out
91 EEr external
105 H05 internal
140 Id1 identification
32 LP1 phase
1030 LU undervoltage
11 OC1 short
12 OC2 earth
13 OC3 accelerating
14 OC4 decelerating
15 OC5 overload
16 OC6 motor
50 OH sink
53 OH3 PTC
203 OH51 PTC
1020 OU overvoltage
75 Pr keypad
72 Pr1 1
73 Pr2 2
77 Pr3 3
78 Pr4 4
81 Pt5 transfer
76 rSt reset
85 Sd5 analog
"""

# The same section, P93XX: keypad, TRIP, warning, message as printed; - where the cell is empty.
TABLE_93XX = """
OC1 11 - -
OC2 12 - -
OC5 15 - -
OU - - 1020
LU - - 1030
OH 50 - -
OH3 53 - -
OH4 - 2054 -
OH7 - 2057 -
OH8 58 2058 -
CE0 61 2061 -
CE1 62 2062 -
CE2 63 2063 -
CE3 64 2064 -
U15 70 - -
CCr 71 - -
Pr0 75 - -
Pr1 72 - -
Pr2 73 - -
Pr3 77 - -
Pr4 78 - -
PEr 74 - -
PI 79 - -
Sd2 82 2082 -
Sd3 83 2083 -
Sd6 86 2086 -
EEr 91 2091 1091
P03 153 2153 -
P13 163 - -
NMAX 200 - -
H05 105 - -
H07 107 - -
H10 110 - -
H11 111 - -
"""

# CMVLC401A 9.1, in the order of the numbers from 1; 1 has no display.
DISPLAYS_SMVECTOR = (
    "- F.OF F.OF1 F.AF F.rF F.HF F.LF F.PF F.GF F.IL F.dbF F.SF F.EF F.CF F.UF F.cF F.F1 F.F2 F.F3 "
    "F.F5 F.F5 F.F6 F.F7 F.F8 F.F9 F.bF F.F12 F.JF F.AL F.F4 F.F0 F.FoL F.F11 F.ntF F.Fnr F.nF1"
)

# EDB2102EN 8.2, list of C1962: number and the classification's place in CLASSES.
CLASSES = (
    "internal", "application", "access", "limit", "module-to-controller", "controller-to-module",
)  # fmt: skip
EXTENDED = {
    1: 0, 2: 0, 3: 1, 4: 1, 5: 1, 6: 1, 7: 2, 8: 2, 9: 2, 10: 2, 11: 3, 12: 3, 13: 3, 14: 3, 17: 0,
    32: 4, 33: 4, 34: 4, 35: 4, 36: 4, 37: 4, 38: 4,
    208: 5, 209: 5, 210: 5, 211: 5, 212: 5, 213: 5, 214: 5,
}  # fmt: skip


@pytest.mark.parametrize("name", ["820x", "821x", "822x", "824x", "8200vector"])
def test_82xx_has_every_fault_of_the_manual_and_no_other(name: str) -> None:
    wanted = {int(row.split()[0]): row.split()[1:] for row in TABLE_82XX.strip().splitlines()}
    table = family(name).fault_table
    assert table is not None
    assert set(table.faults) == set(wanted)
    for number, (keypad, word) in wanted.items():
        fault = family(name).fault(number)
        assert fault is not None
        assert fault.keypad == keypad
        assert word in fault.meaning.en, number
    messages = {number for number, one in table.faults.items() if one.kind is FaultKind.MESSAGE}
    warnings = {number for number, one in table.faults.items() if one.kind is FaultKind.WARNING}
    assert (messages, warnings) == ({1020, 1030}, {203})


def test_93xx_has_every_fault_of_the_manual_with_its_reaction() -> None:
    wanted: dict[int, tuple[str, FaultKind]] = {}
    for row in TABLE_93XX.strip().splitlines():
        keypad, *cells = row.split()
        for cell, kind in zip(
            cells, (FaultKind.TRIP, FaultKind.WARNING, FaultKind.MESSAGE), strict=True
        ):
            if cell != "-":
                wanted[int(cell)] = (keypad, kind)
    table = family("93xx").fault_table
    assert table is not None
    assert {n: (one.keypad, one.kind) for n, one in table.faults.items()} == wanted


def test_93xx_knows_a_listed_fault_with_another_reaction_by_its_thousands() -> None:
    told = family("93xx").fault(2050)
    assert told is not None
    assert (told.number, told.keypad, told.kind) == (2050, "OH", FaultKind.WARNING)
    assert family("93xx").fault(3050) is None
    assert family("93xx").fault(99) is None
    assert family("8200vector").fault(2050) is None


def test_smvector_has_the_numbers_1_to_36_with_their_displays() -> None:
    table = family("smvector").fault_table
    assert table is not None
    shown = [table.faults[number].keypad or "-" for number in range(1, 37)]
    assert shown == DISPLAYS_SMVECTOR.split()
    assert set(table.faults) == set(range(1, 37))
    over, under = table.faults[20], table.faults[21]
    assert over.keypad == under.keypad == "F.F5"
    assert "overflow" in over.meaning.en
    assert "underflow" in under.meaning.en


def test_every_fault_says_in_both_languages_what_it_is_and_what_to_do() -> None:
    for name in FAMILY_NAMES:
        table = family(name).fault_table
        if table is None:
            continue
        for fault in table.faults.values():
            for text in (fault.meaning, fault.remedy):
                assert text.en
                assert text.de
            assert bool(fault.cause.en) == bool(fault.cause.de)
            assert fault.source.startswith(("EDB2102EN 8.2", "CMVLC401A 9.1"))


def test_the_counts_per_family(capsys: pytest.CaptureFixture[str]) -> None:
    counts = {}
    for name in FAMILY_NAMES:
        table = family(name).fault_table
        counts[name] = len(table.faults) if table is not None else 0
    told = ", ".join(f"{name} {count}" for name, count in counts.items())
    report = link_report()
    with capsys.disabled():
        sys.stdout.write(
            f"\nfaults described: {told}; C1962 {len(report.extended)}, "
            f"communication errors {len(report.communication)}\n"
        )
    assert counts == {
        "820x": 30, "821x": 30, "822x": 30, "824x": 30, "8200vector": 30,
        "93xx": 45, "smvector": 36, "generic": 0,
    }  # fmt: skip


def test_no_fault_is_no_fault_and_a_family_without_a_list_knows_none() -> None:
    for name in FAMILY_NAMES:
        assert family(name).fault(0) is None
    assert family("generic").fault(50) is None


def test_the_fault_memories_begin_with_the_active_or_newest_fault() -> None:
    first = {name: family(name).fault_table for name in ("820x", "93xx", "smvector")}
    assert {name: table.memories[0] for name, table in first.items() if table} == {
        "820x": Code(161), "93xx": Code(168, 1), "smvector": Code(1500),
    }  # fmt: skip
    for name in FAMILY_NAMES:
        table = family(name).fault_table
        if table is not None:
            assert family(name).info(table.memories[0]) is not None


def test_c1962_has_every_number_of_the_manual_with_its_classification() -> None:
    told = {number: one.classification for number, one in link_report().extended.items()}
    assert told == {number: CLASSES[place] for number, place in EXTENDED.items()}


def test_c0068_has_every_communication_error() -> None:
    words = {1: "checksum", 2: "frame", 4: "code", 5: "value", 6: "access", 7: "interrupted",
             15: "general"}  # fmt: skip
    told = {number: one.meaning.en for number, one in link_report().communication.items()}
    assert set(told) == set(words)
    assert all(words[number] in text for number, text in told.items())


@pytest.mark.parametrize(
    ("number", "digit", "fits"),
    [(50, 5, True), (53, 5, True), (50, 6, False), (2061, 6, True), (1020, 2, True),
     (105, 0, True), (105, 10, True), (105, 5, False), (8, 0, True), (8, 3, False),
     (200, 4, True), (200, 2, False)],
)  # fmt: skip
def test_the_tens_digit_tells_which_numbers_it_can_stand_for(
    number: int, digit: int, fits: bool
) -> None:
    assert fits_digit(number, digit) is fits
