"""What a restore leaves alone, and the order of the rest, by the families' own data."""

from __future__ import annotations

import pytest

from lecombus.drives import (
    FAMILY_NAMES,
    family,
    is_last,
    must_be_same,
    not_restored,
    restore_rank,
    restore_rule,
    saving_rule,
)
from lecombus.drives.family_files import load_family
from lecombus.drives.restore_rules import RestoreWord
from lecombus.errors import DescriptionError
from lecombus.parameters import Code


@pytest.mark.parametrize(
    ("name", "code", "why"),
    [
        ("8200vector", "C0009", "place on the line"),
        ("8200vector", "C0046", "a process value"),
        ("8200vector", "C0043", "a command"),
        ("8200vector", "C0150", "read only"),
        ("8200vector", "C4711", "no description"),
        ("93xx", "C0003", "saves"),
        ("820x", "C0040", "restarts the drive"),
        ("smvector", "P410", "place on the line"),
        ("generic", "C0011", "no description"),
    ],
)
def test_what_is_no_setting_of_the_drive_is_left_out_and_why(
    name: str, code: str, why: str
) -> None:
    assert why in (not_restored(family(name), Code.parse(code)) or "")


def test_what_the_roster_sets_is_left_to_it() -> None:
    drive, code = family("smvector"), Code.parse("P425")
    assert not_restored(drive, code) is None
    assert "roster" in (not_restored(drive, code, {code}) or "")


def in_order(name: str, *codes: str) -> list[str]:
    drive = family(name)
    return [
        str(code) for code in sorted(map(Code.parse, codes), key=lambda c: restore_rank(drive, c))
    ]


def test_codes_that_others_follow_from_come_first_in_every_parameter_set() -> None:
    mixed = ("C1922", "C2011", "C6001", "C1921", "C0011", "C0001", "C1923", "C4711")
    assert in_order("8200vector", *mixed) == [
        "C0001", "C6001", "C0011", "C2011", "C4711", "C1923", "C1922", "C1921",
    ]  # fmt: skip


def test_what_shuts_the_door_comes_last() -> None:
    assert in_order("smvector", "P420", "P100", "P426", "P103", "P425") == [
        "C1103", "C1425", "C1426", "C1100", "C1420",
    ]  # fmt: skip
    assert is_last(family("smvector"), Code.parse("P420"))
    assert not is_last(family("smvector"), Code.parse("P103"))


def test_a_93xx_is_saved_at_the_end_into_the_set_it_starts_with() -> None:
    rule = saving_rule(family("93xx"))
    assert rule is not None
    assert (rule.codes, rule.value) == ((Code(3),), 1)
    assert rule.codes == (family("93xx").saved_by,)
    assert [name for name in FAMILY_NAMES if saving_rule(family(name))] == ["93xx"]


def test_drives_are_told_apart_by_what_the_manual_says() -> None:
    assert set(map(str, must_be_same(family("smvector")))) == {"C1099", "C1494", "C1502"}
    assert must_be_same(family("generic")) == ()


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_every_rule_has_its_source_and_names_what_is_described(name: str) -> None:
    drive = family(name)
    for rule in drive.restore:
        assert rule.because
        assert rule.source.split()[0] in ("EDB2102EN", "CMVLC401A")
        for code in rule.codes:
            assert drive.info(code) is not None
            found = restore_rule(drive, code)
            assert found is not None
            if rule.word in (RestoreWord.FIRST, RestoreWord.LAST):
                assert not_restored(drive, code) is None, code


BASE = """\
family: test
title: t
manual: M
addressing: [standard]
set_offsets: [0, 2000]
codes:
  - {code: C0011, name: a, format: VD, writable: true, sets: true, source: "1"}
answer_times: [{codes: others, read_ms: 20, write_ms: 20, source: "2"}]
hold_after_write_ms: 0
feed: C0011
identity: []
status: []
writable: []
protocol: lecom
restore:
  - %s
"""


@pytest.mark.parametrize(
    ("rule", "wrong"),
    [
        ('{rule: first, codes: [C0012], because: x, source: "1"}', "C0012 is not described"),
        ('{rule: first, codes: [C2011], because: x, source: "1"}', "parameter set 1"),
        ('{rule: save, codes: [C0011], because: x, value: 1, source: "1"}', "does not save"),
        ('{rule: first, codes: [C0011], because: x, value: 1, source: "1"}', "value belongs"),
        ('{rule: sometimes, codes: [C0011], because: x, source: "1"}', "first, last, never"),
        ("{rule: first, codes: [C0011], because: x}", "source is missing"),
    ],
)
def test_a_rule_that_cannot_be_is_refused_with_its_line(rule: str, wrong: str) -> None:
    files = {"test.yaml": BASE % rule}
    with pytest.raises(DescriptionError, match=wrong) as caught:
        load_family("test", files.__getitem__)
    assert caught.value.where.startswith("16:")
