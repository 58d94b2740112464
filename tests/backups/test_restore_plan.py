"""What a restore would do, before it does anything."""

from __future__ import annotations

from backups.backups import DRIVE, TEXT, answers, backup_of
from lecombus.backups import ReadAttempt, RestorePlan, make_plan
from lecombus.backups.restore_plan import codes_to_read
from lecombus.drives import family
from lecombus.drives.family_files import load_family
from lecombus.parameters import Code
from support.golden import Golden

FILE = {
    "C0001": "3", "C0009": "11", "C0011": "50.0", "C0012": "5", "C2001": "3", "C0046": "20",
    "C1921": "1", "C0502": "7", "C4711": "1", "C0094": "1234",
}  # fmt: skip
NOW = {
    "C0001": "0", "C0011": "50", "C0012": "7", "C2001": "0", "C1921": "0", "C0502": "7",
    "C1810": "Sx",
}  # fmt: skip


def plan(now: dict[str, str] | None = None, **more: object) -> RestorePlan:
    return make_plan(backup_of(DRIVE, FILE), DRIVE, answers(now or NOW), **more)  # type: ignore[arg-type]


def test_steps_stand_in_the_order_that_the_family_needs(golden: Golden) -> None:
    assert [str(step.code) for step in plan().steps] == ["C0001", "C2001", "C0012", "C1921"]
    first = plan().steps[0]
    assert (first.now_means, first.value_means) == ("keypad", "LECOM")
    golden(first.because)


def test_what_reads_the_wanted_value_already_is_not_written() -> None:
    assert [str(code) for code in plan().same] == ["C0011"]


def test_everything_left_out_says_why(golden: Golden) -> None:
    golden(*(f"{skip.code}: {skip.why}" for skip in plan().skips))
    assert {str(skip.code) for skip in plan().skips if skip.expected} == {"C0046", "C0502"}


def test_what_the_roster_sets_is_left_out() -> None:
    made = plan(owned=(Code(1921),))
    assert Code(1921) not in made.wanted
    assert Code(1921) not in codes_to_read(backup_of(DRIVE, FILE), (Code(1921),))


def test_what_the_drive_does_not_know_is_left_out(golden: Golden) -> None:
    now = {
        **answers(NOW),
        Code(12): ReadAttempt(Code(12), None, "no-such-code", "there is no C0012"),
    }
    made = make_plan(backup_of(DRIVE, FILE), DRIVE, now)
    golden(*(skip.why for skip in made.skips if skip.code == Code(12)))


def test_another_drive_must_be_asked_for(golden: Golden) -> None:
    other = {**NOW, "C0502": "8"}
    golden(*plan(other).blockers)
    made = plan(other, other_drive=True)
    assert (made.blockers, len(made.remarks)) == ((), 1)
    unread = {code: text for code, text in NOW.items() if code != "C0502"}
    golden(*plan(unread).blockers)


def test_blockers_and_remarks_name_codes_as_at_the_keypad() -> None:
    backup = backup_of("smvector", {"P502": "1", "P425": "65001"})
    now = answers({"P502": "2", "P425": "50"})
    made = make_plan(backup, family("smvector"), now)
    assert [one.partition(" was")[0] for one in made.blockers] == ["P502 (drive ID)"]
    assert made.remarks[0].startswith("P425 (network message time-out): 65001 is not among")


def test_another_family_is_never_restored() -> None:
    made = make_plan(
        backup_of("820x", {"C0011": "50"}), family("821x"), answers({"C0011": "60"}),
        other_drive=True,
    )  # fmt: skip
    assert made.steps == ()
    assert "the backup is of a 820x, the drive is a 821x" in made.blockers[0]


def test_a_value_the_manual_does_not_know_is_told_and_left_to_the_drive() -> None:
    made = make_plan(backup_of(DRIVE, {"C0011": "600"}), DRIVE, answers({"C0011": "50"}))
    assert len(made.steps) == 1
    assert "7.5 to 480 Hz; the drive may refuse it" in made.remarks[0]


def test_a_value_that_cannot_be_sent_to_its_code_blocks_the_restore() -> None:
    made = make_plan(backup_of(DRIVE, {"C0011": "Sfast"}), DRIVE, answers({"C0011": "50"}))
    assert "C0011" in made.blockers[0]


def test_digits_for_a_word_block_the_restore_with_both_readings() -> None:
    word = "{code: C0417, name: x, format: VH, hex_digits: 4, writable: true, source: x}"
    text = TEXT.replace("codes:", f"codes:\n  - {word}", 1)
    of = load_family("test", {"test.yaml": text}.__getitem__)
    now = answers({"C0417": "H0000"})
    made = make_plan(backup_of(of, {"C0417": "0208"}), of, now)
    assert "C0417: 0208 could be H0208 (520) or decimal 208 (H00D0)" in made.blockers[0]
    made = make_plan(backup_of(of, {"C0417": "H0208"}), of, now)
    assert [step.value.raw for step in made.steps] == ["H0208"]


def test_digits_for_a_word_that_is_never_restored_block_the_restore_too() -> None:
    for backup in (backup_of(DRIVE, {"C0150": "0208"}), backup_of("820x", {"C0135": "0208"})):
        made = make_plan(backup, backup.family, {})
        assert "0208 could be H0208 (520) or decimal 208 (H00D0)" in "".join(made.blockers)
    made = make_plan(backup_of("820x", {"C0135": "8"}), family("820x"), {})
    assert "8 does not say that it is hexadecimal; write H0008" in "".join(made.blockers)
    made = make_plan(backup_of("820x", {"C0135": "H0208"}), family("820x"), {})
    assert (made.blockers, [str(skip.code) for skip in made.skips]) == ((), ["C0135"])


def test_the_plan_ends_by_saving_where_the_family_needs_it() -> None:
    save = plan().save
    assert save is not None
    assert (str(save[0]), save[1].raw) == ("C0003", "1")
    assert make_plan(backup_of("820x", {}), family("820x"), {}).save is None
