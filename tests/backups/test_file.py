"""A backup's file: readable, stable line by line, and read back exactly or refused by its line."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from backups.backups import DRIVE, backup_of
from lecombus.backups import read_backup, wanted_codes, write_backup
from lecombus.drives import FAMILY_NAMES, family
from lecombus.errors import ConfigError
from lecombus.parameters import Code, Value
from support.golden import Golden

VECTOR = {
    "C0001": "3", "C0011": "50.00", "C2011": "060.10", "C0150": "H8678", "C1810": "S33S2102I_10000",
    "C0046": "-0.0", "C4711": "O01FF",
}  # fmt: skip
MISSING = {"C2001": "no-such-code"}


def test_the_file_reads_like_a_parameter_list() -> None:
    text = write_backup(
        backup_of(
            DRIVE,
            {
                "C0001": "3", "C0011": "50.00", "C2011": "060.10", "C0150": "H8678",
                "C1810": "S33S2102I_10000", "C0046": "-0.0", "C4711": "O01FF", "C1921": "0",
            },
            missing={"C0012": "no-such-code", "C2001": "no-answer"},
        )
    )  # fmt: skip
    head, _, rest = text.partition("lecombus-backup: 1\n")
    assert all(line.startswith("# ") for line in head.splitlines())
    assert (
        rest
        == """\
drive: feeder
line: hall-3
address: 11
family: test
taken: "2026-11-22T01:54:43Z"
lecombus: "0.1.0"

# What was at the other end.
identity:
  C1810: "S33S2102I_10000"  # software

# Settings that the drive keeps.
parameters:
  C0001: 3                  # mode = LECOM
  C0011: 50.00              # highest frequency, Hz
  # parameter set 2
  C2011: "060.10"           # highest frequency, Hz

# Settings of the fieldbus module, lost at power-off.
module:
  C1921: 0                  # early answer

# How the drive was just then: compared only with --all, never restored.
process:
  C0046: -0.0               # setpoint, Hz
  C0150: H8678              # status

# Codes that no description knows: compared, never restored.
undescribed:
  C4711: O01FF

# What could not be read.
not-read:
  C0012: no-such-code       # ramp: the drive does not know it
  # parameter set 2
  C2001: no-answer          # mode: the drive did not answer
"""
    )


def test_an_smvector_shows_the_names_of_its_keypad() -> None:
    text = write_backup(backup_of("smvector", {"P103": "60"}))
    assert "  C1103: 60                 # P103 " in text


def test_what_is_written_is_read_back_letter_by_letter() -> None:
    backup = backup_of("8200vector", VECTOR, missing=MISSING)
    read = read_backup(write_backup(backup), "b.yaml")
    assert read.head == backup.head
    assert read.family is backup.family
    assert [(e.code, e.value, e.missing) for e in read.entries.values()] == [
        (e.code, e.value, e.missing) for e in backup.entries.values()
    ]
    assert write_backup(read) == write_backup(backup)


def test_one_changed_value_is_one_changed_line() -> None:
    before = write_backup(backup_of(DRIVE, VECTOR)).splitlines()
    after = write_backup(backup_of(DRIVE, {**VECTOR, "C0011": "5"})).splitlines()
    assert [line for line in after if line not in before] == [
        "  C0011: 5                  # highest frequency, Hz"
    ]
    assert len(before) == len(after)


texts = st.one_of(
    st.decimals(-214748, 214748, places=4).map(lambda number: f"{number:f}"),
    st.from_regex(r"H([0-9A-F]{4}){1,2}", fullmatch=True),
    st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=40).map("S{}".format),
    st.from_regex(r"O([0-9A-F]{2}){1,9}", fullmatch=True),
    st.from_regex(r"0[0-7]{1,5}|-?0\.[0-9]{1,4}|[0-9]{1,5}", fullmatch=True),
)


@given(raw=texts)
@example(raw="OFF")
def test_any_value_survives_the_file_and_other_readers_of_yaml_get_along_with_it(raw: str) -> None:
    backup = backup_of("generic", {"C0007": Value.parse(raw).raw})
    text = write_backup(backup)
    entry = read_backup(text, "b.yaml").entries[Code(7)]
    assert entry.value == Value.parse(raw)
    seen = yaml.safe_load(text)["undescribed"]["C0007"]
    assert seen == raw or float(seen) == float(raw)


def test_a_long_value_keeps_its_distance_from_its_comment() -> None:
    text = write_backup(backup_of(DRIVE, {"C1810": "Sa label that is far longer than most"}))
    assert 'than most" # software\n' in text
    assert yaml.safe_load(text)["identity"]["C1810"] == "Sa label that is far longer than most"


GOOD = write_backup(backup_of("8200vector", {"C0001": "3", "C0011": "50"}))


@pytest.mark.parametrize(
    ("written", "word"), [("0x0208", "H0208"), ("0x8", "H08"), ('"0X00d0"', "H00d0")]
)
def test_a_word_may_be_written_as_on_the_command_line(written: str, word: str) -> None:
    text = GOOD.replace("C0011: 50", f"C0011: {written}")
    assert read_backup(text, "b.yaml").entries[Code(11)].value == Value.parse(word)


@pytest.mark.parametrize(
    ("right", "wrong", "line"),
    [
        ("lecombus-backup: 1", "lecombus-backup: 2", 3),
        ("lecombus-backup: 1\n", "", 3),
        ("family: 8200vector", "family: 8200", 7),
        ("address: 11", "address: 111", 6),
        ("C0011: 50", "C0011: 50,5", 14),
        ("C0011: 50", "C00a1: 50", 14),
        ("C0011: 50", "C1: 50", 14),
        ("C0011: 50", "C0011: [50]", 14),
        ("parameters:", "parameter:", 12),
        ("drive: feeder\n", "", 3),
        ("drive: feeder", 'drive: "\\e]0;x\\a"', 4),
        ("C0011: 50", "C0011: " + "[" * 50000, 14),
        ("C0011: 50", "C0011:\n    " + "- " * 50000, 15),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(
    right: str, wrong: str, line: int, golden: Golden
) -> None:
    assert right in GOOD
    with pytest.raises(ConfigError) as caught:
        read_backup(GOOD.replace(right, wrong), "b.yaml")
    golden(caught.value)
    assert str(caught.value).startswith(f"b.yaml:{line}:")


@pytest.mark.parametrize("text", ["", "{", "just words", "- a\n- b"])
def test_what_is_no_backup_at_all_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"b\.yaml"):
        read_backup(text, "b.yaml")


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_a_backup_holds_every_code_that_can_be_read_and_no_password(name: str) -> None:
    drive = family(name)
    wanted = wanted_codes(drive, (Code(4711),))
    assert list(wanted) == sorted(set(wanted))
    assert Code(4711) in wanted
    secrets = {info.code for info in drive.described() if info.secret}
    assert secrets.isdisjoint(wanted_codes(drive, secrets))
    for info in drive.described():
        assert (info.code in wanted) == (info.readable and not info.secret and not info.array), (
            info.code
        )
