"""Bytes between exchanges: never values, but a late answer tells that a doubt is over."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.drives import family
from lecombus.drives.measured import MeasuredTimes
from lecombus.fieldbus.lecom.exchanges.idle_receive import UnsolicitedBytes
from lecombus.fieldbus.lecom.exchanges.late_answers import (
    Duplicates,
    PendingLateAnswers,
    UnansweredRead,
)
from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.exchange import ACK_FIELD
from lecombus.fieldbus.lecom.protocol.parser import with_parity
from lecombus.fieldbus.requests import Station
from lecombus.parameters import Code, Value
from support.answers import ACK_ANSWER, unknown_code_answer, value_answer

FIELD = encode_code(Code(150), Form.STANDARD)
OTHER = encode_code(Code(150), Form.EXTENDED)
LATE = with_parity(value_answer(FIELD, Value.parse("H0900")))


def doubtful(*fields: bytes) -> tuple[PendingLateAnswers, UnsolicitedBytes]:
    late_answers = PendingLateAnswers(0.5)
    for field in fields:
        late_answers.add(field, 0.0)
    return late_answers, UnsolicitedBytes(late_answers, Duplicates())


def test_a_late_answer_ends_its_own_doubt_and_no_other() -> None:
    late_answers, strays = doubtful(FIELD, OTHER, ACK_FIELD)
    assert strays.feed(LATE, 0.0)
    assert late_answers.blocked_until_s(FIELD, 0.1) <= 0.1
    assert late_answers.blocked_until_s(OTHER, 0.1) == 0.5
    assert late_answers.blocked_until_s(ACK_FIELD, 0.1) == 0.5
    assert strays.bytes_total == len(LATE)


def test_so_does_a_late_no_such_code() -> None:
    late_answers, strays = doubtful(FIELD)
    assert strays.feed(with_parity(unknown_code_answer(FIELD)), 0.0)
    assert not late_answers.any(0.1)


def test_an_acknowledgement_ends_no_doubt_because_noise_makes_one_too_easily() -> None:
    late_answers, strays = doubtful(ACK_FIELD)
    assert strays.feed(with_parity(ACK_ANSWER), 0.0)
    assert late_answers.blocked_until_s(ACK_FIELD, 0.1) == 0.5


@pytest.mark.parametrize("place", range(len(LATE)))
def test_a_damaged_late_answer_ends_no_doubt(place: int) -> None:
    late_answers, strays = doubtful(FIELD)
    strays.feed(LATE[:place] + bytes((LATE[place] ^ 0x80,)) + LATE[place + 1 :], 0.0)
    assert late_answers.any(0.1)


@given(st.integers(1, len(LATE) - 1))
def test_it_may_come_in_pieces(cut: int) -> None:
    late_answers, strays = doubtful(FIELD)
    assert not strays.feed(LATE[:cut], 0.0)
    assert strays.feed(LATE[cut:], 0.0)
    assert not late_answers.any(0.1)


def test_listening_begins_anew_with_every_exchange_given_up() -> None:
    late_answers, strays = doubtful(FIELD)
    strays.feed(LATE[:4], 0.0)
    strays.begin()
    assert strays.feed(LATE, 0.0)
    assert not late_answers.any(0.1)


@given(st.lists(st.binary(max_size=20), max_size=10))
def test_whatever_comes_is_only_counted(pieces: list[bytes]) -> None:
    _, strays = doubtful(FIELD)
    for piece in pieces:
        strays.feed(piece, 0.0)
    assert strays.bytes_total == sum(map(len, pieces))


def test_doubts_end_by_themselves_and_are_forgotten() -> None:
    late_answers, _ = doubtful(FIELD, OTHER)
    assert late_answers.any(0.4)
    assert not late_answers.any(0.5)
    assert len(late_answers) == 0


def test_without_a_window_there_are_no_doubts() -> None:
    late_answers = PendingLateAnswers(0.0)
    late_answers.add(FIELD, 0.0)
    assert not late_answers.any(0.0)


STATION = Station("a", 1, family("8200vector"), family("8200vector").forms)


def asked(said_s: float) -> UnansweredRead:
    station = replace(STATION, measured=MeasuredTimes())
    return UnansweredRead(station, Code(150), said_s)


def late_twice(
    late_answers: PendingLateAnswers, field: bytes, one: UnansweredRead, *others: bytes
) -> None:
    """Let an answer come 0.3 s after the request, two times, others being in doubt too."""
    strays = UnsolicitedBytes(late_answers, Duplicates())
    for _ in range(2):
        for other in others:
            late_answers.add(other, one.said_s + 0.1)
        late_answers.add(field, one.said_s + 0.1, one)
        strays.feed(LATE, one.said_s + 0.3)


def test_a_late_answer_tells_how_slow_its_drive_is() -> None:
    one = asked(5.0)
    late_twice(PendingLateAnswers(0.5), FIELD, one)
    assert [(row.code, row.slow) for row in one.station.measured.rows()] == [(Code(150), True)]
    assert one.station.measured.rows()[0].measured_s == pytest.approx(0.3)


@pytest.mark.parametrize("other", [OTHER, ACK_FIELD, encode_code(Code(50), Form.STANDARD)])
def test_it_tells_nothing_where_another_may_still_come(other: bytes) -> None:
    one = asked(5.0)
    late_twice(PendingLateAnswers(0.5), FIELD, one, other)
    assert one.station.measured.rows() == []


def test_it_tells_nothing_when_it_answers_something_else() -> None:
    one = asked(5.0)
    late_twice(PendingLateAnswers(0.5), OTHER, one)
    assert one.station.measured.rows() == []


def test_it_tells_nothing_when_two_were_asked_the_same() -> None:
    late_answers = PendingLateAnswers(0.5)
    strays = UnsolicitedBytes(late_answers, Duplicates())
    one, two = asked(5.0), asked(5.2)
    for _ in range(2):
        late_answers.add(FIELD, 5.1, one)
        late_answers.add(FIELD, 5.3, two)
        assert strays.feed(LATE, 5.4)
    assert one.station.measured.rows() == two.station.measured.rows() == []


def test_it_tells_nothing_after_its_time() -> None:
    late_answers = PendingLateAnswers(0.5)
    strays, one = UnsolicitedBytes(late_answers, Duplicates()), asked(5.0)
    for _ in range(2):
        late_answers.add(FIELD, 5.1, one)
        strays.feed(LATE, 5.7)
    assert one.station.measured.rows() == []
