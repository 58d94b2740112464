from __future__ import annotations

import sys

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.controls import bcc, with_parity
from lecombus.fieldbus.lecom.protocol.parser import TAIL_LIMIT, AnswerParser, _whole
from lecombus.fieldbus.lecom.protocol.telegrams import (
    MAX_ANSWER_CHARS,
    AckAnswer,
    Answer,
    BadAnswer,
    NakAnswer,
    TelegramFault,
    ValueAnswer,
)
from lecombus.parameters import Code, Value
from protocol.strategies import answers, cut, fields, values
from protocol.vectors import feed_all, load, splits, wire
from support.answers import encode_answer, value_answer

C46 = encode_code(Code(46), Form.STANDARD)
GOOD = value_answer(C46, Value.decimal("35.4"))

texts = st.text("0123456789.-HSO?! A", max_size=12).map(str.encode)


@st.composite
def near_answers(draw: st.DrawFn) -> bytes:
    """Bytes near an answer: right or wrong value text, BCC, framing, and something after it."""
    body = draw(fields) + draw(texts) + b"\x03"
    check = draw(st.sampled_from((bcc(body), bcc(body) ^ 1, 0x13)))
    return b"\x02" + body + bytes((check,)) + draw(st.binary(max_size=3))


noise = st.one_of(
    st.binary(max_size=40),
    near_answers(),
    near_answers().map(with_parity),
    st.lists(st.sampled_from(b"\x02\x03\x04\x05\x06\x15\x8246!0H?S"), max_size=30).map(bytes),
)


def outcome(data: bytes, pieces: list[bytes], parity: bool) -> tuple[Answer | None, bytes, bytes]:
    parser = AnswerParser(parity=parity)
    answer = feed_all(parser, pieces)
    assert b"".join(pieces) == data
    return answer, parser.tail, parser.pending


def one_by_one(data: bytes) -> list[bytes]:
    return [data[at : at + 1] for at in range(len(data))]


@given(answers, st.booleans(), st.lists(st.integers(0, 300), max_size=4))
def test_every_answer_comes_back_from_the_wire(
    answer: Answer, parity: bool, places: list[int]
) -> None:
    data = encode_answer(answer)
    sent = with_parity(data) if parity else data
    assert outcome(sent, cut(sent, places), parity) == (answer, b"", b"")


@settings(max_examples=400)
@given(noise, st.booleans(), st.lists(st.integers(0, 50), max_size=3))
@example(b"", False, [])
@example(b"\x82463\x03\xb2", True, [])
def test_the_fast_path_and_every_split_say_the_same_as_byte_by_byte(
    data: bytes, parity: bool, places: list[int]
) -> None:
    slow = outcome(data, one_by_one(data), parity)
    assert outcome(data, [data], parity) == slow
    assert outcome(data, cut(data, places), parity) == slow


@given(answers, st.booleans(), st.integers(0, 300), st.integers(0, 255))
def test_a_changed_answer_is_the_same_for_the_fast_path_and_byte_by_byte(
    answer: Answer, parity: bool, at: int, byte: int
) -> None:
    data = bytearray(with_parity(encode_answer(answer)) if parity else encode_answer(answer))
    data[at % len(data)] = byte
    changed = bytes(data)
    assert outcome(changed, [changed], parity) == outcome(changed, one_by_one(changed), parity)


@pytest.mark.parametrize("vector", load("answers.yaml"), ids=lambda v: v["name"])
def test_the_fast_path_is_taken_for_every_whole_value_and_acknowledgement(
    vector: dict[str, str],
) -> None:
    quick = _whole(wire(vector), False)
    assert (quick is not None) == (vector["kind"] in ("value", "ack", "nak"))


@given(noise)
def test_no_byte_is_lost_or_made_up(data: bytes) -> None:
    answer, tail, pending = outcome(data, [data], False)
    if answer is None:
        assert (pending, tail) == (data, b"")
    else:
        assert encode_answer(answer) + tail == data


@given(st.lists(st.binary(max_size=600), max_size=12), st.booleans())
def test_memory_is_bounded_whatever_comes(pieces: list[bytes], parity: bool) -> None:
    parser = AnswerParser(parity=parity)
    for piece in pieces:
        parser.feed(piece)
        assert len(parser.pending) <= MAX_ANSWER_CHARS
        assert len(parser.tail) <= TAIL_LIMIT


def test_a_jabbering_drive_fills_the_tail_and_no_more() -> None:
    parser = AnswerParser()
    parser.feed(GOOD)
    for _ in range(100):
        assert parser.feed(b"x" * 1000) is None
    parser.feed(b"")
    assert parser.tail == b"x" * TAIL_LIMIT
    assert sys.getsizeof(parser._tail) < 4 * TAIL_LIMIT


@pytest.mark.parametrize("begin", [GOOD, b"x"], ids=["good", "bad"])
def test_the_tail_is_bounded_within_one_call_too(begin: bytes) -> None:
    parser = AnswerParser()
    assert parser.feed(begin + b"y" * 1000) is not None
    assert parser.tail == b"y" * TAIL_LIMIT


@pytest.mark.parametrize("size", [240, 241])
def test_the_longest_value_is_read_and_one_character_more_is_too_long(size: int) -> None:
    for form in Form:
        body = encode_code(Code(200), form) + b"S" + b"x" * size + b"\x03"
        data = b"\x02" + body + bytes((bcc(body),))
        for pieces in splits(data):
            answer = feed_all(parser := AnswerParser(), pieces)
            if size == 240:
                assert isinstance(answer, ValueAnswer)
            else:
                assert isinstance(answer, BadAnswer)
                assert answer.fault is TelegramFault.TOO_LONG
                assert answer.received + parser.tail == data


def test_a_value_without_end_is_given_up_when_it_is_too_long() -> None:
    answer = AnswerParser().feed(b"\x0246" + b"1" * 10_000)
    assert isinstance(answer, BadAnswer)
    assert answer.fault is TelegramFault.TOO_LONG
    assert len(answer.received) == 1 + 2 + 242


def every_corruption(data: bytes) -> list[tuple[int, bytes]]:
    """Every change of one 7-bit character inside STX..BCC."""
    return [
        (at, data[:at] + bytes((char,)) + data[at + 1 :])
        for at in range(len(data))
        for char in range(128)
        if char != data[at]
    ]


CORRUPTED = ["c46-is-35.4", "c68-is-h0900", "c1002-extended", "c150-field-begins-like-a-value",
             "bcc-looks-like-etx", "bcc-looks-like-eot", "nine-characters", "string"]  # fmt: skip


@pytest.mark.parametrize("name", CORRUPTED)
def test_no_single_wrong_character_gives_a_clean_value(name: str) -> None:
    """A wrong character gives no value, or one with bytes left over.

    The leftover case: a character turned into ETX (two bits or more, so parity alone may miss it)
    where the next one happens to be the BCC of what came before. The rest of the answer is then
    in the tail, which is why a value with a tail is not to be trusted.
    """
    data = next(wire(vector) for vector in load("answers.yaml") if vector["name"] == name)
    for at, changed in every_corruption(data):
        answer, tail, _ = outcome(changed, [changed], False)
        if isinstance(answer, ValueAnswer):
            assert tail, (at, changed)
            assert changed[at] == 0x03


def test_an_early_etx_that_fits_its_bcc_leaves_a_tail() -> None:
    data = bytearray(value_answer(C46, Value.parse("3.25")))
    data[4] = 0x03
    answer, tail, _ = outcome(bytes(data), [bytes(data)], False)
    assert answer == ValueAnswer(C46, Value.parse("3"))
    assert tail == bytes(data[6:])


@given(st.builds(ValueAnswer, fields, values), st.data())
def test_with_parity_a_single_wrong_bit_never_gives_a_value(
    answer: ValueAnswer, data: st.DataObject
) -> None:
    sent = bytearray(with_parity(encode_answer(answer)))
    sent[data.draw(st.integers(0, len(sent) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    got, _, _ = outcome(bytes(sent), [bytes(sent)], True)
    assert isinstance(got, BadAnswer)
    assert got.fault is TelegramFault.PARITY


def test_a_parity_fault_ends_at_the_bad_byte() -> None:
    sent = with_parity(GOOD)
    bad = sent[:4] + bytes((sent[4] ^ 0x80,)) + sent[5:]
    parser = AnswerParser(parity=True)
    answer = parser.feed(bad)
    assert answer == BadAnswer(TelegramFault.PARITY, bad[:5])
    assert parser.tail == bad[5:]


def test_bit_7_is_a_parity_fault_where_the_port_frames_7_bits() -> None:
    for at in range(len(GOOD)):
        bad = GOOD[:at] + bytes((GOOD[at] | 0x80,)) + GOOD[at + 1 :]
        assert AnswerParser().feed(bad) == BadAnswer(TelegramFault.PARITY, bad[: at + 1])
    assert AnswerParser().feed(b"\x86") == BadAnswer(TelegramFault.PARITY, b"\x86")


def test_an_acknowledgement_with_odd_parity_is_none() -> None:
    assert AnswerParser(parity=True).feed(b"\x06") == AckAnswer()
    assert AnswerParser(parity=True).feed(b"\x95") == NakAnswer()
    assert AnswerParser(parity=True).feed(b"\x15") == BadAnswer(TelegramFault.PARITY, b"\x15")
    assert AnswerParser(parity=True).feed(b"\x86") == BadAnswer(TelegramFault.PARITY, b"\x86")


def test_a_bad_bcc_says_which_was_due() -> None:
    answer = AnswerParser().feed(GOOD[:-1] + b"\x1c")
    assert answer == BadAnswer(
        TelegramFault.BCC, GOOD[:-1] + b"\x1c", expected_bcc=0x1D, got_bcc=0x1C
    )
    assert isinstance(answer, BadAnswer)
    assert answer.reason == "BCC is 1Ch, 1Dh was due"


def test_after_an_answer_nothing_more_is_answered_until_reset() -> None:
    parser = AnswerParser()
    assert parser.feed(b"x") == BadAnswer(TelegramFault.UNEXPECTED, b"x")
    assert parser.feed(GOOD) is None
    assert parser.feed(b"\x06") is None
    assert parser.tail == GOOD + b"\x06"
    parser.reset()
    assert (parser.tail, parser.pending) == (b"", b"")
    assert parser.feed(GOOD) == ValueAnswer(C46, Value.parse("35.4"))


def test_reset_forgets_half_an_answer() -> None:
    parser = AnswerParser()
    for size in range(len(GOOD)):
        assert parser.feed(GOOD[:size]) is None
        parser.reset()
    assert parser.feed(GOOD) == ValueAnswer(C46, Value.parse("35.4"))


def test_every_first_character_but_three_is_unexpected() -> None:
    for char in range(128):
        answer = AnswerParser().feed(bytes((char,)))
        expected = {0x02: None, 0x06: AckAnswer(), 0x15: NakAnswer()}
        assert answer == expected.get(char, BadAnswer(TelegramFault.UNEXPECTED, bytes((char,))))
