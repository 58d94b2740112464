"""The control word a quick stop changes one bit of: known only while it is certain."""

from __future__ import annotations

from lecombus.drives import family
from lecombus.drives.stops import StopProof, inhibit_proofs
from lecombus.operations.control_words import ControlWords
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.schedule import Outcome

WORD, INHIBIT = Code(135), Code(40)


def known() -> ControlWords:
    words = ControlWords(lambda: 0.0)
    words.watch("a", WORD, moved_by=(INHIBIT,))
    words.seen("a", WORD, Value.parse("H0204"))
    return words


def test_a_word_read_is_known_until_it_is_forgotten() -> None:
    words = known()
    assert words.get("a") == 0x0204
    words.forget("a")
    assert words.get("a") is None


def test_other_codes_and_drives_without_a_word_say_nothing() -> None:
    words = known()
    words.seen("a", Code(150), Value.parse("H1111"))
    words.seen("b", WORD, Value.parse("H1111"))
    assert (words.get("a"), words.get("b")) == (0x0204, None)


def test_a_value_that_is_no_word_is_no_word() -> None:
    words = ControlWords(lambda: 0.0)
    words.watch("a", WORD)
    words.seen("a", WORD, Value.parse("Stext"))
    assert words.get("a") is None


def test_a_write_makes_the_word_uncertain_until_it_is_acknowledged_or_read() -> None:
    words = known()
    words.written("a", WORD, Value.parse("H0000"), heard=False)
    assert words.get("a") is None
    words.seen("a", WORD, Value.parse("H0008"))
    assert words.get("a") == 8


def test_a_write_to_a_code_that_moves_the_word_makes_it_uncertain() -> None:
    words = known()
    words.written("a", Code(46), Value.parse("1"), heard=False)
    assert words.get("a") == 0x0204
    words.written("a", INHIBIT, Value.parse("0"), heard=False)
    assert words.get("a") is None


def test_while_a_write_that_moves_the_word_has_not_ended_nothing_read_counts() -> None:
    words = known()
    ends: list[Outcome] = []
    settle = words.guard(("a", "b"), INHIBIT, lambda outcome, reason: ends.append(outcome))
    assert words.get("a") is None
    words.seen("a", WORD, Value.parse("H0008"))
    assert words.get("a") is None, "it was read before the write took effect, perhaps"
    settle(Outcome.DONE, "")
    assert ends == [Outcome.DONE]
    assert words.get("a") is None
    words.seen("a", WORD, Value.parse("H0208"))
    assert words.get("a") == 0x0208


def test_a_word_of_eight_digits_is_no_control_word() -> None:
    words = ControlWords(lambda: 0.0)
    words.watch("a", WORD)
    words.seen("a", WORD, Value.parse("HFFFF0000"))
    assert words.get("a") is None


def test_a_word_is_forgotten_when_a_status_word_begins_to_show_an_inhibit() -> None:
    status = Code(150)
    words = ControlWords(lambda: 0.0)
    words.watch("a", WORD, inhibited_by={status: StopProof(0x0080, 0x0080)})
    words.seen("a", status, Value.parse("H0080"))
    words.seen("a", WORD, Value.parse("H0200"))
    words.seen("a", status, Value.parse("H0080"))
    assert words.get("a") == 0x0200, "it lasts: the word is younger"
    words.seen("a", status, Value.parse("H0000"))
    words.seen("a", WORD, Value.parse("H0000"))
    assert words.get("a") == 0
    words.seen("a", status, Value.parse("H0080"))
    assert words.get("a") is None, "something that is not the line has inhibited it"


def test_the_last_known_word_outlasts_a_loss_and_keeps_an_inhibit_in_it() -> None:
    now = [0.0]
    words = ControlWords(lambda: now[0])
    words.watch(
        "hoist", WORD, mask=0x0200, moved_by=[INHIBIT],
        inhibited_by=inhibit_proofs(family("8200vector")), watchdog_s=2.0, watchdog_inhibits=True,
    )  # fmt: skip
    assert words.last("hoist") is None, "nothing was ever known"
    words.heard("hoist", 0.0)
    words.seen("hoist", WORD, Value.hexadecimal(0x0004, 4))
    assert words.last("hoist") == 0x0204, "whether it is inhibited is not known"
    words.seen("hoist", Code(150), Value.hexadecimal(0x0600, 4))
    words.forget("hoist")
    assert (words.word("hoist"), words.last("hoist")) == (None, 0x0004)
    now[0] = 3.0
    assert words.last("hoist") is None, "its watchdog may have inhibited it"
