from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.controls import BAUDS, BITS_PER_CHAR
from lecombus.fieldbus.lecom.protocol.telegrams import (
    ACK_CHARS,
    MAX_ANSWER_CHARS,
    answer_chars,
    read_request_chars,
    read_telegram,
    write_request_chars,
    write_telegram,
)
from lecombus.parameters import Code, Value
from protocol.strategies import string
from protocol.vectors import load
from support.answers import ACK_ANSWER, transmission_error_answer, value_answer

TABLE = load("times.yaml")
NINE = 9


def write_s(baud: int, form: Form) -> float:
    return (write_request_chars(form, NINE) + ACK_CHARS) * BITS_PER_CHAR / baud


def read_s(baud: int, form: Form) -> float:
    return (read_request_chars(form) + answer_chars(form, NINE)) * BITS_PER_CHAR / baud


@pytest.mark.parametrize("row", TABLE, ids=lambda row: str(row["baud"]))
def test_telegram_times_are_those_of_the_manuals_table(row: dict[str, Any]) -> None:
    baud = row["baud"]
    # The table is rounded to its last digit, and cuts 41.67 to 41.6 and 2.604 to 2.6.
    close = pytest.approx
    send = write_s(baud, Form.STANDARD) * 1000
    receive = read_s(baud, Form.STANDARD) * 1000
    assert send == close(row["send_ms"], abs=0.051)
    assert receive == close(row["receive_ms"], abs=0.051)
    more_send = write_s(baud, Form.EXTENDED) * 1000 - send
    more_receive = read_s(baud, Form.EXTENDED) * 1000 - receive
    assert more_send == close(row["send_extended_ms"], abs=0.07)
    assert more_receive == close(row["receive_extended_ms"], abs=0.051)
    assert BITS_PER_CHAR / baud * 1000 == close(row["char_ms"], abs=0.07)


def test_the_table_counts_both_directions() -> None:
    assert write_request_chars(Form.STANDARD, NINE) + ACK_CHARS == 17 + 1
    assert read_request_chars(Form.STANDARD) == 6
    assert answer_chars(Form.STANDARD, NINE) == 14


def test_the_table_covers_every_baud_rate() -> None:
    assert tuple(row["baud"] for row in TABLE) == BAUDS


@given(st.sampled_from(Form), st.text("0123456789ABCDEF", max_size=240).map(string))
def test_counted_characters_are_the_telegrams_own(form: Form, value: Value) -> None:
    code = Code(46)
    field = encode_code(code, form)
    size = len(value.raw)
    assert read_request_chars(form) == len(read_telegram(1, code, form))
    assert answer_chars(form, size) == len(value_answer(field, value)) <= MAX_ANSWER_CHARS
    assert answer_chars(form, 1) == len(transmission_error_answer(field))
    assert len(ACK_ANSWER) == ACK_CHARS
    if size <= 21:
        assert write_request_chars(form, size) == len(write_telegram(1, code, value, form))


def test_the_longest_answer_is_extended_with_240_characters() -> None:
    assert MAX_ANSWER_CHARS == 1 + 7 + 241 + 2
    longest = value_answer(encode_code(Code(0), Form.EXTENDED), string("x" * 240))
    assert len(longest) == MAX_ANSWER_CHARS
