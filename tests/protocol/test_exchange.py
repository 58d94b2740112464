"""What may be made of the bytes after a telegram, and until when."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.exchange import ACK_FIELD, Ask, Exchange, Result
from lecombus.fieldbus.lecom.protocol.telegrams import (
    AckAnswer,
    NakAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
    read_telegram,
)
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.parameters import Code, Value
from support.answers import ACK_ANSWER, NAK_ANSWER, unknown_code_answer, value_answer

CODE, OTHER = Code(46), Code(50)


def field_of(code: Code, form: Form = Form.STANDARD) -> bytes:
    return encode_code(code, form)


SENT = read_telegram(1, CODE, Form.STANDARD)
ANSWER = value_answer(field_of(CODE), Value.parse("35.4"))
LATE = value_answer(field_of(OTHER), Value.parse("7"))
ACK, NAK = ACK_ANSWER, NAK_ANSWER
T0 = 100.0
ASKED_S = 0.006


def ask(field: bytes = field_of(CODE), sent: bytes = SENT) -> Ask:
    return Ask(
        sent, field, request_s=ASKED_S, first_byte_s=0.060, whole_s=0.080, gap_s=0.010,
        char_s=0.001,
    )  # fmt: skip


def begun(what: Ask | None = None, *, echo: bool | None = False) -> Exchange:
    exchange = Exchange(parity=False, echo=echo)
    exchange.begin(what or ask(), T0)
    return exchange


def trickle(exchange: Exchange, data: bytes, from_s: float) -> Result | None:
    """Feed bytes one by one, a character time apart."""
    for place, byte in enumerate(data):
        result = exchange.feed(bytes((byte,)), T0 + from_s + place * 0.001)
        if result is not None:
            assert place == len(data) - 1, "it must end with the last byte"
            return result
    return None


def given_up(exchange: Exchange) -> Result:
    """Wait for the deadline as the worker does."""
    for _ in range(1000):
        result = exchange.expire(exchange.deadline_s())
        if result is not None:
            return result
    raise AssertionError("the deadline moves for ever")


def test_the_answer_asked_for_ends_the_exchange_at_its_last_byte() -> None:
    result = trickle(begun(), ANSWER, 0.02)
    assert result is not None
    assert result.kind is ResultKind.ANSWERED
    assert isinstance(result.answer, ValueAnswer)
    assert result.answer.value == Value.parse("35.4")
    assert result.clean
    assert result.ended_s == pytest.approx(T0 + 0.02 + (len(ANSWER) - 1) * 0.001)


@pytest.mark.parametrize(("data", "kind"), [(ACK, AckAnswer), (NAK, NakAnswer)])
def test_an_acknowledgement_is_the_answer_to_a_write(data: bytes, kind: type) -> None:
    result = begun(ask(ACK_FIELD)).feed(data, T0 + 0.03)
    assert result is not None
    assert type(result.answer) is kind


def test_no_such_code_is_an_answer_to_a_read() -> None:
    result = trickle(begun(), unknown_code_answer(field_of(CODE)), 0.02)
    assert result is not None
    assert type(result.answer) is UnknownCodeAnswer


@pytest.mark.parametrize(
    ("field", "data"),
    [
        (field_of(CODE), ACK),
        (field_of(CODE), LATE),
        (field_of(CODE), value_answer(field_of(CODE, Form.EXTENDED), Value.parse("1"))),
        (field_of(CODE), unknown_code_answer(field_of(OTHER))),
        (ACK_FIELD, ANSWER),
    ],
    ids=["ack to a read", "other code", "other form", "other unknown code", "value to a write"],
)
def test_a_whole_answer_to_something_else_is_counted_and_never_used(
    field: bytes, data: bytes
) -> None:
    exchange = begun(ask(field))
    assert trickle(exchange, data, 0.02) is None
    result = given_up(exchange)
    assert (result.kind, result.answer, result.late) == (ResultKind.NO_REPLY, None, 1)
    assert not result.clean


def test_the_right_answer_may_still_come_after_a_late_one() -> None:
    exchange = begun()
    assert trickle(exchange, LATE, 0.010) is None
    result = trickle(exchange, ANSWER, 0.030)
    assert result is not None
    assert (result.kind, result.late) == (ResultKind.ANSWERED, 1)


def test_it_may_come_in_the_same_gulp() -> None:
    result = begun().feed(LATE + ANSWER, T0 + 0.04)
    assert result is not None
    assert (result.kind, result.late) == (ResultKind.ANSWERED, 1)


@pytest.mark.parametrize("field", [field_of(CODE), ACK_FIELD])
def test_what_begins_before_the_question_can_have_arrived_is_no_answer(field: bytes) -> None:
    exchange = begun(ask(field))
    data = ACK if field == ACK_FIELD else ANSWER
    assert exchange.feed(data, T0 + 0.5 * ASKED_S) is None
    assert given_up(exchange).kind is ResultKind.GARBLED


def test_after_a_pause_the_exchange_listens_anew() -> None:
    exchange = begun()
    exchange.feed(b"xx", T0 + 0.010)
    result = trickle(exchange, ANSWER, 0.040)
    assert result is not None
    assert result.kind is ResultKind.ANSWERED
    assert not result.clean


def test_without_a_pause_what_follows_rubbish_is_rubbish() -> None:
    exchange = begun()
    exchange.feed(b"xx", T0 + 0.010)
    assert trickle(exchange, ANSWER, 0.012) is None
    assert given_up(exchange).kind is ResultKind.GARBLED


@pytest.mark.parametrize("data", [b"x" + ACK, ACK + b"x", ACK + ACK])
def test_an_acknowledgement_among_other_bytes_proves_nothing(data: bytes) -> None:
    exchange = begun(ask(ACK_FIELD))
    assert exchange.feed(data, T0 + 0.030) is None
    assert given_up(exchange).kind is ResultKind.GARBLED


def test_an_acknowledgement_after_rubbish_proves_nothing_even_after_a_pause() -> None:
    exchange = begun(ask(ACK_FIELD))
    exchange.feed(b"x", T0 + 0.010)
    assert exchange.feed(ACK, T0 + 0.040) is None
    assert given_up(exchange).kind is ResultKind.GARBLED


def test_a_value_with_bytes_behind_it_is_not_believed() -> None:
    exchange = begun()
    assert exchange.feed(ANSWER + b"9", T0 + 0.030) is None
    assert given_up(exchange).kind is ResultKind.GARBLED


def test_an_answer_that_breaks_off_is_given_up_after_a_gap_not_at_the_last_deadline() -> None:
    exchange = begun()
    exchange.feed(ANSWER[:4], T0 + 0.055)
    result = given_up(exchange)
    assert result.kind is ResultKind.GARBLED
    assert result.ended_s == pytest.approx(T0 + 0.065)
    assert result.received == ANSWER[:4]


def test_an_answer_that_drips_in_is_given_up_when_the_whole_of_it_is_overdue() -> None:
    exchange = begun()
    for place, byte in enumerate(ANSWER[:4]):
        assert exchange.feed(bytes((byte,)), T0 + 0.046 + place * 0.009) is None
    assert exchange.deadline_s() == pytest.approx(T0 + 0.080)
    assert exchange.expire(T0 + 0.0799) is None
    result = exchange.expire(T0 + 0.0801)
    assert result is not None
    assert result.kind is ResultKind.GARBLED


def test_an_answer_that_comes_in_is_waited_for_beyond_the_first_deadline() -> None:
    exchange = begun()
    assert trickle(exchange, ANSWER[:-1], 0.058) is None
    assert exchange.expire(T0 + 0.061) is None
    result = exchange.feed(ANSWER[-1:], T0 + 0.066)
    assert result is not None
    assert result.kind is ResultKind.ANSWERED


def test_after_an_answer_that_broke_off_the_whole_one_may_still_come() -> None:
    exchange = begun()
    assert exchange.feed(ANSWER[:4], T0 + 0.020) is None
    result = trickle(exchange, ANSWER, 0.040)
    assert result is not None
    assert isinstance(result.answer, ValueAnswer)
    assert (result.received, result.clean) == (ANSWER[:4], False)


@pytest.mark.parametrize(
    ("before", "fault"),
    [(b"", "the answer broke off"), (b"x", "the answer is bad: unexpected")],
    ids=["alone", "after rubbish"],
)
def test_an_acknowledgement_after_half_an_answer_proves_nothing(before: bytes, fault: str) -> None:
    exchange = begun(ask(ACK_FIELD))
    if before:
        assert exchange.feed(before, T0 + 0.010) is None
    assert exchange.feed(ANSWER[:4], T0 + 0.025) is None
    assert exchange.feed(ACK, T0 + 0.040) is None
    result = given_up(exchange)
    assert (result.kind, result.fault) == (ResultKind.GARBLED, fault)
    assert result.received == before + ANSWER[:4]


def test_a_line_that_never_falls_silent_does_not_hold_the_exchange_for_ever() -> None:
    exchange = begun()
    exchange.feed(b"\x02", T0 + 0.050)
    for step in range(2000):
        now_s = T0 + 0.055 + step * 0.005
        exchange.feed(b"4", now_s)
        if exchange.expire(now_s) is not None:
            break
    assert now_s < T0 + 0.5


def test_a_nak_to_a_read_is_its_answer_once_a_pause_follows_it() -> None:
    exchange = begun(echo=None)
    assert exchange.feed(NAK, T0 + 0.020) is None
    assert exchange.disturbed
    assert exchange.deadline_s() == pytest.approx(T0 + 0.020 + 0.010), "a pause, no time-out"
    assert exchange.expire(T0 + 0.029) is None
    result = exchange.expire(T0 + 0.030)
    assert result is not None
    assert (result.kind, type(result.answer)) == (ResultKind.ANSWERED, NakAnswer)
    assert (result.fault, result.clean, exchange.echo) == ("", True, False)


def test_a_nak_before_the_value_is_noise() -> None:
    exchange = begun()
    assert exchange.feed(NAK, T0 + 0.012) is None
    result = trickle(exchange, ANSWER, 0.020)
    assert result is not None
    assert isinstance(result.answer, ValueAnswer)
    assert (result.late, result.clean) == (1, False)


@pytest.mark.parametrize("data", [NAK + NAK, NAK + LATE, b"x" + NAK, LATE + NAK, NAK + ANSWER[:4]])
def test_a_nak_among_other_bytes_proves_nothing(data: bytes) -> None:
    exchange = begun()
    assert trickle(exchange, data, 0.02) is None
    assert given_up(exchange).answer is None


def test_a_nak_after_rubbish_proves_nothing_even_after_a_pause() -> None:
    exchange = begun()
    assert exchange.feed(b"x", T0 + 0.010) is None
    assert exchange.feed(NAK, T0 + 0.040) is None
    result = given_up(exchange)
    assert (result.kind, result.answer) == (ResultKind.GARBLED, None)
    assert (result.late, result.others) == (1, (ACK_FIELD,))


def test_a_nak_that_may_be_an_old_one_is_not_taken_for_a_reads_answer() -> None:
    exchange = Exchange(parity=False, echo=False)
    exchange.begin(ask(), T0, takes_nak=False)
    assert exchange.feed(NAK, T0 + 0.02) is None
    result = given_up(exchange)
    assert (result.kind, result.late) == (ResultKind.NO_REPLY, 1)
    assert result.ended_s == pytest.approx(T0 + 0.060)


def test_nothing_at_all_is_no_reply() -> None:
    result = given_up(begun())
    assert (result.kind, result.ended_s, result.clean) == (ResultKind.NO_REPLY, T0 + 0.060, True)


def test_a_multicast_is_sent_when_its_time_is_over_and_nothing_answers_it() -> None:
    exchange = begun(ask(b""))
    assert exchange.feed(ACK, T0 + 0.03) is None
    result = given_up(exchange)
    assert (result.kind, result.ended_s, result.answer) == (ResultKind.SENT, T0 + 0.080, None)


def test_a_lost_line_ends_the_exchange_at_once() -> None:
    result = begun().lost(T0 + 0.01)
    assert (result.kind, result.ended_s) == (ResultKind.LOST, T0 + 0.01)
    assert result.fault == "the line was lost during the exchange"


def test_an_exchange_forgets_the_bytes_of_the_one_before() -> None:
    exchange = begun()
    assert trickle(exchange, LATE, 0.02) is None
    assert exchange.feed(b"x", T0 + 0.045) is None
    first = given_up(exchange)
    assert (first.late, first.received, first.others) == (1, b"x", (field_of(OTHER),))
    exchange.begin(ask(), T0 + 1.0)
    second = given_up(exchange)
    assert (second.kind, second.late, second.received, second.others) == (
        ResultKind.NO_REPLY, 0, b"", (),
    )  # fmt: skip


def test_a_silence_is_looked_for_before_the_deadline_where_it_counts() -> None:
    exchange = begun(replace(ask(), late_s=0.040))
    assert exchange.look_s() == pytest.approx(T0 + 0.040), "late from then on"
    assert exchange.expire(T0 + 0.041) is None
    assert exchange.look_s() == exchange.deadline_s()
    exchange = begun()
    assert exchange.look_s() == exchange.deadline_s(), "nothing counts as late"
    exchange.feed(b"x", T0 + 0.020)
    assert exchange.look_s() == pytest.approx(T0 + 0.030), "a pause ends what is foreign"


def test_less_may_be_waited_for_unless_the_answer_is_coming_in() -> None:
    short = replace(ask(), first_byte_s=0.030)
    exchange = begun()
    exchange.hasten(short)
    assert exchange.deadline_s() == pytest.approx(T0 + 0.030)
    exchange = begun()
    exchange.feed(ANSWER[:1], T0 + 0.020)
    exchange.hasten(short)
    assert exchange.deadline_s() == pytest.approx(T0 + 0.060)


@pytest.mark.parametrize("known", [True, False])
def test_a_refusal_leaves_a_known_echo_as_it_is(known: bool) -> None:
    exchange = begun(echo=True if known else None)
    assert exchange.feed((SENT if known else b"") + NAK, T0 + 0.020) is None
    result = given_up(exchange)
    assert type(result.answer) is NakAnswer
    assert exchange.echo is known


@pytest.mark.parametrize(("looked_s", "thought_s"), [(0.050, 0.050 - ASKED_S), (0.030, None)])
def test_an_answer_that_may_have_waited_unread_shows_no_time_of_its_own(
    looked_s: float, thought_s: float | None
) -> None:
    exchange = begun(replace(ask(), late_s=0.040))
    result = exchange.feed(ANSWER, T0 + 0.050, T0 + looked_s)
    assert result is not None
    assert result.thought_s == (None if thought_s is None else pytest.approx(thought_s))


def test_an_end_after_a_pause_of_the_process_says_by_how_much() -> None:
    result = begun().expire(T0 + 0.5)
    assert result is not None
    assert result.older_by_s == pytest.approx(0.44)
    assert given_up(begun()).older_by_s == 0.0


# ---- echo -----------------------------------------------------------------------------------


@pytest.mark.parametrize("echo", [True, None])
@pytest.mark.parametrize("whole", [True, False])
def test_an_echo_is_taken_away_however_it_comes(echo: bool | None, whole: bool) -> None:
    exchange = begun(echo=echo)
    if whole:
        assert exchange.feed(SENT, T0 + 0.006) is None
    else:
        assert trickle(exchange, SENT, 0.001) is None
    result = trickle(exchange, ANSWER, 0.03)
    assert result is not None
    assert (result.kind, result.clean) == (ResultKind.ANSWERED, True)
    assert exchange.echo is True


def test_echo_and_answer_may_come_in_one_gulp() -> None:
    result = begun(echo=None).feed(SENT + ANSWER, T0 + 0.04)
    assert result is not None
    assert result.kind is ResultKind.ANSWERED


def test_an_answer_without_an_echo_settles_that_there_is_none() -> None:
    exchange = begun(echo=None)
    assert trickle(exchange, ANSWER, 0.02) is not None
    assert exchange.echo is False


def test_part_of_an_echo_settles_nothing() -> None:
    exchange = begun(echo=None)
    exchange.feed(SENT[:1], T0 + 0.02)
    result = given_up(exchange)
    assert result.kind is ResultKind.ECHO
    assert exchange.echo is None


@pytest.mark.parametrize("place", range(len(SENT)))
def test_a_damaged_echo_is_a_fault_of_its_own_and_its_answer_is_not_used(place: int) -> None:
    exchange = begun(echo=True)
    damaged = SENT[:place] + bytes((SENT[place] ^ 1,)) + SENT[place + 1 :]
    assert trickle(exchange, damaged + ANSWER, 0.001) is None
    result = given_up(exchange)
    assert result.kind is ResultKind.ECHO
    assert "differs" in result.fault
    assert result.received == damaged[place:] + ANSWER


@pytest.mark.parametrize("count", range(len(SENT)))
def test_a_missing_echo_says_how_much_came(count: int) -> None:
    exchange = begun(echo=True)
    if count:
        exchange.feed(SENT[:count], T0 + 0.01)
    result = given_up(exchange)
    assert result.kind is ResultKind.ECHO
    assert (f"only {count} of 6" if count else "no echo") in result.fault


# ---- whatever comes -------------------------------------------------------------------------

PIECES = st.lists(
    st.tuples(
        st.one_of(
            st.binary(min_size=1, max_size=12),
            st.sampled_from([SENT, ANSWER, ANSWER[:5], ANSWER[5:], LATE, ACK, NAK]),
        ),
        st.floats(0.0, 0.03),
    ),
    max_size=8,
)


@settings(max_examples=300, deadline=None)
@given(
    PIECES,
    st.sampled_from([ask(), ask(ACK_FIELD), ask(b"")]),
    st.sampled_from([True, False, None]),
    st.booleans(),
)
def test_whatever_comes_an_exchange_ends_in_time_with_what_was_asked_for_or_nothing(
    pieces: list[tuple[bytes, float]], asked: Ask, echo: bool | None, parity: bool
) -> None:
    exchange = Exchange(parity=parity, echo=echo)
    exchange.begin(asked, T0)
    now_s, result = T0, None
    for data, pause_s in pieces:
        now_s += pause_s
        if now_s >= exchange.deadline_s() and (result := exchange.expire(now_s)):
            break
        if (result := exchange.feed(data, now_s)) is not None:
            break
    result = result or given_up(exchange)
    assert result.started_s == T0
    assert result.ended_s <= T0 + 0.080 + 0.26 + 0.03
    assert len(result.received) <= 64
    assert (result.answer is not None) == (result.kind is ResultKind.ANSWERED)
    if isinstance(result.answer, ValueAnswer | UnknownCodeAnswer):
        assert result.answer.field == asked.field
    elif result.answer is not None:
        assert asked.field == ACK_FIELD or isinstance(result.answer, NakAnswer)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(1, len(ANSWER) - 1), max_size=4))
def test_the_answer_is_the_same_however_it_is_cut(cuts: list[int]) -> None:
    exchange = begun()
    places = [0, *sorted(set(cuts)), len(ANSWER)]
    result = None
    for a, b in itertools.pairwise(places):
        result = exchange.feed(ANSWER[a:b], T0 + 0.02 + a * 0.001)
    assert result is not None
    assert result.kind is ResultKind.ANSWERED
