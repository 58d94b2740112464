"""Every register of CMVLC401A, typed off the manual by hand and held against the data file.

A second reading of tables 5, 6 and 9 and of 9.1 to 9.4, in both editions; nothing here is made
from the data. Each row is walked both ways: nothing of the manual is missing, nothing is described
that it does not have. How many there are is said at the end of the run (`tests/conftest.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal

import pytest

from lecombus.drives import FaultKind, Storage, Text, WriteClass, family
from lecombus.parameters import Code, Format, Value

# Register, format, access (r, rw; -w: could be written, lecombus never does), values, default.
TABLE_9 = """
C0040 | VD | rw | 0 1           | 0
C0043 | VD | rw | 0 1           | 0
C0046 | VD | r  | 0..500        |
C0050 | VD | r  | 0..500        |
C0068 | VH | r  |               |
C0135 | VH | rw |               |
C0140 | VD | rw | 0..500        | 0
C0150 | VH | r  |               |
C0200 | VS | r  |               |
C0201 | VS | r  |               |
C1050 | VD | rw |               |
C1055 | VD | rw | 0..100        | 0
C1060 | VD | rw |               | 20
C1061 | VD | rw |               | 0
C1070 | VD | r  | -99.9..3100   | 0
C1071 | VD | r  | -99.9..3100   | 0
C1072 | VD | r  | -99.9..3100   | 0
C1073 | VD | r  | -99.9..3100   | 0
C1074 | VD | r  | -99.9..3100   | 0
C1080 | VD | rw | 0..400        | 100
C1081 | VD | rw | 0..400        | 0
C1099 | VD | r  |               |
"""

TABLES_5_AND_6 = """
P400  | VD | rw | 0 1 2 7           |
P401  | VD | r  |                   |
P402  | VD | r  | 0 1 2 3 4 5 6 7   | 0
P403  | VD | rw | 0 1               | 0
P404  | VD | rw | 0 1 2 3           | 3
P405  | VD | r  | 0 1               | 0
P406  | VD | r  | 16                |
P498  | VD | r  |                   |
P499  | VD | r  |                   |
P410  | VD | rw | 1..99             | 1
P411  | VD | rw | 0 1 2 3 4         | 0
P420  | VD | rw | 0 1 2 3 4         | 0
P424  | VD | rw | 0 1               | 0
P425  | VD | rw | 0..65000          | 50
P426  | VD | rw | 0 1 2 3           | 0
P427  | VD | r  | 0..9999           | 0
P494  | VD | r  |                   |
P495  | VD | r  |                   |
"""

CHAPTER_9 = """
P500      | VD | r |  |
P500/1..8 | VD | r |  |
P502      | VD | r | 8 12 13 14 21 23 24 25 26 28 29 30 31 32 42 44 45 46 47 49 50 51 52 53 54 55 \
69 71 72 74 75 76 77 78 79 80 91 92 94 |
P530      | VD | r |  |
P531      | VD | r |  |
"""

# In the text, or known from other manuals of the drive: P540, P541.
NAMED_ELSEWHERE = """
C0037 | VD | rw |        |
C0038 | VD | rw |        |
C0039 | VD | rw |        |
C0248 | VD | -w | 0..255 |
C0249 | VD | -w | 0..7   |
P100  | VD | rw | 2 5    |
P102  | VD | rw |        |
P103  | VD | rw |        |
P111  | VD | rw |        |
P121  | VD | rw | 9      |
P122  | VD | rw | 9      |
P123  | VD | rw | 9      |
P124  | VD | rw | 9      |
P140  | VD | rw | 25     |
P142  | VD | rw | 25     |
P150  | VD | rw | 9      |
P540  | VD | r  |        |
P541  | VD | r  |        |
"""

UNITS = {
    "Hz": "C0046 C0050 C0140 C1060 C1061 P102 P103",
    "%": "C1055 C1080 C1081",
    "ms": "P425",
    "messages": "P427",
    "h": "P540 P541",
}

STORED = (
    "C0037 C0038 C0039 P100 P102 P103 P111 P121 P122 P123 P124 P140 P142 P150 "
    "P400 P404 P410 P411 P420 P424 P425 P426"
)
MOVING = "C0037 C0038 C0039 C0040 C0043 C0135 C0140 C1060 C1061 C1080 C1081"

SMVECTOR = family("smvector")
Row = tuple[Code, str, str, str, str]


def rows_of(*tables: str) -> list[Row]:
    found = []
    for line in "\n".join(table.strip() for table in tables).splitlines():
        written, kind, access, values, default = (part.strip() for part in line.split("|"))
        number, _, subcodes = written.partition("/")
        first, _, last = (subcodes or "0..0").partition("..")
        for n in range(int(first), int(last) + 1):
            found.append((Code.parse(f"{number}/{n}"), kind, access, values, default))
    return found


EVERY = rows_of(TABLE_9, TABLES_5_AND_6, CHAPTER_9, NAMED_ELSEWHERE)


@pytest.mark.parametrize("row", EVERY, ids=lambda row: str(row[0]))
def test_every_register_is_described_as_the_manual_says(row: Row) -> None:
    code, kind, access, values, default = row
    info = SMVECTOR.info(code)
    assert info is not None
    assert info.format is Format(kind)
    assert (info.writable, info.readable) == (access == "rw", True)
    low, high = map(Decimal, values.split("..")) if ".." in values else (None, None)
    assert (info.low, info.high) == (low, high)
    chosen = [] if ".." in values else [int(value) for value in values.split()]
    assert sorted(info.selection) == chosen
    assert info.default == (default or None)
    assert info.source.startswith("CMVLC401A ")


def test_nothing_is_described_that_the_manual_does_not_have(
    record_property: Callable[[str, object], None],
) -> None:
    assert {info.code for info in SMVECTOR.described()} == {code for code, *_ in EVERY}
    counts = [
        f"{len(rows_of(table))} {what}"
        for table, what in (
            (TABLE_9, "registers of table 9"),
            (TABLES_5_AND_6, "of tables 5 and 6"),
            (CHAPTER_9, "of 9.1 to 9.4"),
            (NAMED_ELSEWHERE, "named elsewhere"),
        )
    ]
    record_property("counted", f"CMVLC401A smvector: {len(EVERY)} registers: {', '.join(counts)}")


def test_units() -> None:
    wanted = {Code.parse(code): unit for unit, codes in UNITS.items() for code in codes.split()}
    found = {info.code: info.unit for info in SMVECTOR.described() if info.unit is not None}
    assert found == wanted


def test_names_and_texts_are_there_in_both_languages() -> None:
    for info in SMVECTOR.described():
        assert info.name != info.name_de, info.code
        for text in (*info.selection.values(), *info.bits.values()):
            assert text.en
            assert text.de


@pytest.mark.parametrize(
    ("code", "value", "english", "german"),
    [
        ("C0040", "0", "controller inhibited", "Regler gesperrt"),
        ("C0043", "1", "reset fault", "Rückstellung des Fehlers"),
        ("P400", "7", "LECOM-B", "LECOM-B"),
        ("P402", "3", "online", "online"),
        ("P402", "6", "initialisation failed: module type mismatch (P401)",
         "Initialisierung fehlgeschlagen: Modultyp nicht korrekt (P401)"),
        ("P404", "3", "fault F.ntF", "Fehler F.ntF"),
        ("P405", "1", "network time-out F.nF1", "Netzwerk-Zeitsperre F.nF1"),
        ("P411", "4", "19200 baud", "19200 Baud"),
        ("P420", "2", "programming and setpoint control",
         "Programmierung und Sollwertsteuerung"),
        ("P424", "1", "controller inhibit", "Reglersperre"),
        ("P426", "3", "trip fault F.nF1", "Auslösefehler F.nF1"),
        ("P502", "8", "240 VAC single-phase, 0.33 HP (0.25 kW)",
         "240 VAC einphasig, 0,33 HP (0,25 kW)"),
        ("P502", "12", "240 VAC single or three-phase, 1.5 HP (1.1 kW)",
         "240 VAC ein- oder dreiphasig, 1,5 HP (1,1 kW)"),
        ("P502", "32", "240 VAC three-phase, 20 HP (15 kW)", "240 VAC dreiphasig, 20 HP (15 kW)"),
        ("P502", "54", "480 VAC three-phase, 25 HP (18.5 kW)",
         "480 VAC dreiphasig, 25 HP (18,5 kW)"),
        ("P502", "75", "600 VAC three-phase, 7.5 HP (5.5 kW)",
         "600 VAC dreiphasig, 7,5 HP (5,5 kW)"),
        ("P502", "94", "120 or 240 VAC single-phase, 1 HP (0.75 kW)",
         "120 oder 240 VAC einphasig, 1 HP (0,75 kW)"),
        ("C1050", "1536", "TB-14 energised, relay energised", "TB-14 erregt, Relais erregt"),
        ("P530", "64", "input TB-13A", "Eingang TB-13A"),
        ("P530", "H0804", "protection, charge relay", "Schutz, Laderelais"),
        ("P531", "48", "STOP on the drive, START on the drive",
         "STOPP-Taste am Antrieb, START-Taste am Antrieb"),
        ("P531", "16384", "CTRL on the remote keypad", "STRG-Taste am abgesetzten Tastenfeld"),
    ],
)  # fmt: skip
def test_what_values_mean(code: str, value: str, english: str, german: str) -> None:
    info = SMVECTOR.info(Code.parse(code))
    assert info is not None
    assert info.meaning(Value.parse(value)) == Text(english, german)


@pytest.mark.parametrize(
    ("code", "value"), [("P530", "0"), ("P530", "32802"), ("P531", "32896"), ("P502", "9")]
)
def test_reserved_bits_and_numbers_mean_nothing(code: str, value: str) -> None:
    info = SMVECTOR.info(Code.parse(code))
    assert info is not None
    assert info.meaning(Value.parse(value)) is None


def test_drive_ids_stand_for_the_powers_of_table_10() -> None:
    powers = {  # index: HP, as printed
        8: ".33", 12: "1.5", 13: "2", 14: "3", 21: ".5", 23: "1", 24: "1.5", 25: "2", 26: "3",
        28: "5", 29: "7.5", 30: "10", 31: "15", 32: "20", 42: ".5", 44: "1", 45: "1.5", 46: "2",
        47: "3", 49: "5", 50: "7.5", 51: "10", 52: "15", 53: "20", 54: "25", 55: "30", 69: "1",
        71: "2", 72: "3", 74: "5", 75: "7.5", 76: "10", 77: "15", 78: "20", 79: "25", 80: "30",
        91: ".33", 92: ".5", 94: "1",
    }  # fmt: skip
    kilowatts = {
        ".33": "0.25", ".5": "0.37", "1": "0.75", "1.5": "1.1", "2": "1.5", "3": "2.2", "5": "4",
        "7.5": "5.5", "10": "7.5", "15": "11", "20": "15", "25": "18.5", "30": "22",
    }  # fmt: skip
    info = SMVECTOR.info(Code.parse("P502"))
    assert info is not None
    for index, horses in powers.items():
        power = f"{horses} HP".replace(".", "0.") if horses[0] == "." else f"{horses} HP"
        assert info.selection[index].en.endswith(f", {power} ({kilowatts[horses]} kW)"), index
    assert set(info.selection) == set(powers)


def test_faults_of_9_1_are_all_there_with_their_displays() -> None:
    printed = (
        "- - F.OF F.OF1 F.AF F.rF F.HF F.LF F.PF F.GF F.IL F.dbF F.SF F.EF F.CF F.UF F.cF F.F1 "
        "F.F2 F.F3 F.F5 F.F5 F.F6 F.F7 F.F8 F.F9 F.bF F.F12 F.JF F.AL F.F4 F.F0 F.FoL F.F11 F.ntF "
        "F.Fnr F.nF1"
    )
    displays = printed.split()
    assert len(displays) == 37
    for number, display in enumerate(displays):
        fault = SMVECTOR.fault(number)
        if number == 0:
            assert fault is None
            continue
        assert fault is not None
        assert (fault.keypad or "-", fault.kind) == (display, FaultKind.TRIP), number
    assert SMVECTOR.fault(37) is None


def test_what_is_kept_and_what_is_delicate() -> None:
    stored = {info.code for info in SMVECTOR.described() if info.storage is Storage.STORED}
    assert stored == set(map(Code.parse, STORED.split()))
    delicate = {
        str(info.code): info.write_class
        for info in SMVECTOR.described()
        if info.write_class is not WriteClass.PLAIN
    }
    assert delicate == {
        "C0043": WriteClass.EDGE,
        "C0135": WriteClass.EDGE,
        "C1400": WriteClass.ADDRESS,
        "C1403": WriteClass.ADDRESS,
        "C1410": WriteClass.ADDRESS,
        "C1411": WriteClass.ADDRESS,
    }
    moving = {str(info.code) for info in SMVECTOR.described() if info.motion and info.writable}
    assert moving == set(MOVING.split())


def test_no_register_is_said_to_need_inhibit() -> None:
    assert not [info.code for info in SMVECTOR.described() if info.needs_inhibit]
