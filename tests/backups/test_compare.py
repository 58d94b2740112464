"""What two backups differ in, and what is not a difference."""

from __future__ import annotations

import pytest

from backups.backups import DRIVE, backup_of
from lecombus.backups import compare
from support.golden import Golden

BASE = {"C0001": "3", "C0011": "50", "C0046": "20", "C0009": "11", "C0502": "7"}


def differing(one: dict[str, str], other: dict[str, str], *, everything: bool = False) -> list[str]:
    found = compare(backup_of(DRIVE, one), backup_of(DRIVE, other), everything=everything)
    return [str(difference.code) for difference in found.differences]


@pytest.mark.parametrize(
    ("one", "other"), [("35.0", "35"), ("035", "35"), ("-0.0", "0"), ("H0008", "8")]
)
def test_numbers_are_compared_as_numbers(one: str, other: str) -> None:
    assert differing({"C0011": one}, {"C0011": other}) == []


@pytest.mark.parametrize(("one", "other"), [("35", "35.0001"), ("Sa", "Sb"), ("O01", "O0100")])
def test_what_is_not_the_same_is_a_difference(one: str, other: str) -> None:
    assert differing({"C4711": one}, {"C4711": other}) == ["C4711"]


def test_process_values_addresses_and_identities_are_left_out_unless_all_is_asked_for() -> None:
    other = {**BASE, "C0046": "30", "C0009": "12", "C0502": "8"}
    assert differing(BASE, other) == []
    assert differing(BASE, other, everything=True) == ["C0009", "C0046", "C0502"]


def test_another_identity_is_told_all_the_same(golden: Golden) -> None:
    found = compare(backup_of(DRIVE, BASE), backup_of(DRIVE, {**BASE, "C0502": "8"}))
    assert found.equal
    golden(*found.remarks)


def test_a_remark_names_a_code_as_at_the_keypad() -> None:
    found = compare(backup_of("smvector", {"P502": "1"}), backup_of("smvector", {"P502": "2"}))
    assert found.remarks == ("P502 (drive ID) is 1 and 2",)


def test_digits_for_a_word_are_remarked() -> None:
    found = compare(backup_of("820x", {"C0135": "0208"}), backup_of("820x", {"C0135": "H0208"}))
    (remark,) = found.remarks
    assert "C0135: 0208 " in remark
    assert "H0208" in remark
    assert "H00D0" in remark


def test_a_difference_says_what_both_values_mean() -> None:
    found = compare(backup_of(DRIVE, BASE), backup_of(DRIVE, {**BASE, "C2001": "0", "C0001": "0"}))
    (first, second) = found.differences
    assert (first.name, first.meaning_one, first.meaning_other) == ("mode", "LECOM", "keypad")
    assert (str(second.code), second.one) == ("C2001", None)
    assert (found.same, found.left_out, found.equal) == (1, 3, False)


def test_what_one_side_could_not_read_is_not_equal() -> None:
    read = backup_of(DRIVE, {"C0001": "3"})
    unread = backup_of(DRIVE, {}, missing={"C0001": "no-answer"})
    assert not compare(read, unread).equal
    assert compare(unread, unread).equal
    assert not compare(unread, backup_of(DRIVE, {}, missing={"C0001": "no-such-code"})).equal


def test_different_families_are_told() -> None:
    found = compare(backup_of("820x", {"C0011": "50"}), backup_of("821x", {"C0011": "50"}))
    assert found.equal
    assert "different families, 820x and 821x" in found.remarks[0]
