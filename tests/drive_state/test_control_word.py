"""The control word a quick stop changes one bit of: known only while it is certain."""

from __future__ import annotations

import pytest

from lecombus.drive_state.control_word import ControlWord, unknown_until_ended
from lecombus.drives import family
from lecombus.drives.stops import StopProof, inhibit_proofs
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome

WORD, INHIBIT = Code(135), Code(40)


def known() -> ControlWord:
    word = ControlWord(lambda: 0.0, WORD, moved_by=(INHIBIT,))
    word.seen(WORD, Value.parse("H0204"))
    return word


def test_a_word_read_is_known_until_it_is_forgotten() -> None:
    word = known()
    assert word.get() == 0x0204
    word.forget()
    assert word.get() is None


def test_other_codes_and_drives_without_a_word_say_nothing() -> None:
    word, none = known(), ControlWord(lambda: 0.0)
    word.seen(Code(150), Value.parse("H1111"))
    none.seen(WORD, Value.parse("H1111"))
    none.written(WORD, Value.parse("H1111"), heard=True)
    none.inhibiting()
    assert (word.get(), none.get(), none.last(), none.missing()) == (0x0204, None, None, None)
    assert (none.moves(WORD), none.inhibited()) == (False, False)


def test_a_value_that_is_no_word_is_no_word() -> None:
    word = ControlWord(lambda: 0.0, WORD)
    word.seen(WORD, Value.parse("Stext"))
    assert word.get() is None


def test_a_write_makes_the_word_uncertain_until_it_is_acknowledged_or_read() -> None:
    word = known()
    word.written(WORD, Value.parse("H0000"), heard=False)
    assert word.get() is None
    word.seen(WORD, Value.parse("H0008"))
    assert word.get() == 8


def test_a_write_to_a_code_that_moves_the_word_makes_it_uncertain() -> None:
    word = known()
    word.written(Code(46), Value.parse("1"), heard=False)
    assert word.get() == 0x0204
    word.written(INHIBIT, Value.parse("0"), heard=False)
    assert word.get() is None


def test_while_a_write_that_moves_the_word_has_not_ended_nothing_read_counts() -> None:
    word = known()
    ends: list[Outcome] = []
    settle = unknown_until_ended(
        (word, ControlWord(lambda: 0.0)), INHIBIT, lambda outcome, reason: ends.append(outcome)
    )
    assert word.get() is None
    word.seen(WORD, Value.parse("H0008"))
    assert word.get() is None, "it was read before the write took effect, perhaps"
    settle(Outcome.DONE, "")
    assert ends == [Outcome.DONE]
    assert word.get() is None
    word.seen(WORD, Value.parse("H0208"))
    assert word.get() == 0x0208


def test_a_word_of_eight_digits_is_no_control_word() -> None:
    word = ControlWord(lambda: 0.0, WORD)
    word.seen(WORD, Value.parse("HFFFF0000"))
    assert word.get() is None


def test_a_word_is_forgotten_when_a_status_word_begins_to_show_an_inhibit() -> None:
    status = Code(150)
    word = ControlWord(lambda: 0.0, WORD, inhibited_by={status: StopProof(0x0080, 0x0080)})
    word.seen(status, Value.parse("H0080"))
    word.seen(WORD, Value.parse("H0200"))
    word.seen(status, Value.parse("H0080"))
    assert word.get() == 0x0200, "it lasts: the word is younger"
    word.seen(status, Value.parse("H0000"))
    word.seen(WORD, Value.parse("H0000"))
    assert word.get() == 0
    word.seen(status, Value.parse("H0080"))
    assert word.get() is None, "something that is not the line has inhibited it"


def test_the_last_known_word_outlasts_a_loss_and_keeps_an_inhibit_in_it() -> None:
    now = [0.0]
    word = ControlWord(
        lambda: now[0], WORD, mask=0x0200, moved_by=[INHIBIT],
        inhibited_by=inhibit_proofs(family("8200vector")), watchdog_s=2.0, watchdog_inhibits=True,
    )  # fmt: skip
    assert word.last() is None, "nothing was ever known"
    word.heard(0.0)
    word.seen(WORD, Value.hexadecimal(0x0004, 4))
    assert word.last() == 0x0204, "whether it is inhibited is not known"
    word.seen(Code(150), Value.hexadecimal(0x0600, 4))
    word.forget()
    assert (word.word(), word.last()) == (None, 0x0004)
    now[0] = 3.0
    assert word.last() is None, "its watchdog may have inhibited it"


def test_that_there_is_no_inhibit_counts_from_its_telegram_not_from_when_it_was_looked_at() -> None:
    """A daemon that stood looks at the answer when the drive's watchdog has acted."""
    now = [10.0]
    word = ControlWord(
        lambda: now[0], WORD, mask=0x0200, moved_by=[INHIBIT],
        inhibited_by=inhibit_proofs(family("8200vector")), watchdog_s=2.0, watchdog_inhibits=True,
    )  # fmt: skip
    word.heard(10.0)
    word.seen(WORD, Value.hexadecimal(0x0004, 4), 10.0)
    now[0] = 14.0
    word.seen(Code(150), Value.hexadecimal(0x0600, 4), 10.1)
    word.heard(10.1)
    assert word.inhibited() is None
    word.written(WORD, Value.hexadecimal(0x0004, 4), heard=True, at_s=10.2)
    word.heard(10.2)
    assert word.inhibited() is None


def test_a_word_that_may_be_another_drives_is_kept_only_if_it_is_as_before() -> None:
    word = ControlWord(lambda: 0.0, WORD)
    word.seen(WORD, Value.parse("H0004"), may_be_anothers=True)
    assert (word.get(), word.last()) == (None, None)
    word.seen(WORD, Value.parse("H0000"))
    word.seen(WORD, Value.parse("H0004"), may_be_anothers=True)
    assert word.get() == 0
    word.inhibiting()
    word.seen(WORD, Value.parse("H0004"), may_be_anothers=True)
    assert word.word() is None
    word.seen(WORD, Value.parse("H0000"), may_be_anothers=True)
    assert word.word() == 0


@pytest.mark.parametrize(("read", "kept"), [("H0200", 0x0200), ("H0204", None), ("H0208", None)])
def test_the_bit_of_an_inhibit_that_is_known_may_have_come(read: str, kept: int | None) -> None:
    word = ControlWord(lambda: 0.0, WORD, mask=0x0200, inhibited_by={})
    word.seen(WORD, Value.parse("H0000"))
    word.inhibiting()
    word.seen(WORD, Value.parse(read), may_be_anothers=True)
    assert word.word() == kept


def test_a_write_repeats_what_was_said_last_unless_the_drive_does_not_hold_it() -> None:
    word, stop = ControlWord(lambda: 0.0, WORD, moved_by=[INHIBIT]), Value.parse("H0008")

    def said_again(code: Code = WORD, value: Value = stop) -> bool:
        return word.repeats(code, value)

    assert not said_again()
    word.written(WORD, stop, heard=True)
    assert said_again()
    assert not said_again(value=Value.parse("H0000"))
    word.seen(WORD, Value.parse("H0208"))
    assert said_again(), "it has an inhibit besides"
    word.begin_write()
    assert not said_again(), "another write may change it first"
    word.end_write()
    assert said_again()
    word.seen(WORD, Value.parse("H0000"))
    assert not said_again(), "it does not hold it any more"
    word.written(WORD, stop, heard=True)
    word.written(INHIBIT, Value.parse("1"), heard=True)
    assert not said_again()
    word.written(INHIBIT, Value.parse("0"), heard=True)
    assert said_again(INHIBIT, Value.parse("0"))
    word.seen(INHIBIT, Value.parse("1"))
    assert not said_again(INHIBIT, Value.parse("0"))
    word.written(WORD, stop, heard=False)
    assert not said_again()
    word.written(WORD, stop, heard=True)
    word.forget()
    assert not said_again()


def test_behind_a_write_that_was_not_heard_no_word_that_may_be_anothers_is_kept() -> None:
    word = ControlWord(lambda: 0.0, WORD)
    word.seen(WORD, Value.parse("H0008"))
    word.written(WORD, Value.parse("H0004"), heard=False)
    for raw in ("H0008", "H0004"):
        word.seen(WORD, Value.parse(raw), may_be_anothers=True)
        assert word.word() is None
    word.seen(WORD, Value.parse("H0004"))
    assert word.word() == 4
