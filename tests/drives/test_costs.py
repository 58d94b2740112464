"""Costs and deadlines against numbers worked out by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.drives import FAMILY_NAMES, family
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.protocol.controls import BAUDS
from lecombus.fieldbus.lecom.telegram_costs import read_cost, write_cost
from lecombus.parameters import Code, Value

STANDARD, EXTENDED = Form.STANDARD, Form.EXTENDED
AT_9600 = LineTiming(9600, adapter_latency_s=0.016, quarantine_s=0.5)
CHAR_S = 10 / 9600
VECTOR = family("8200vector")


def near(seconds: float) -> object:
    return pytest.approx(seconds, abs=1e-9)


def test_status_read_of_a_vector_takes_37_ms_at_9600() -> None:
    cost = read_cost(AT_9600, VECTOR, Code(150), STANDARD)
    assert cost.expected_s == near(6 * CHAR_S + 0.020 + 10 * CHAR_S)
    assert round(cost.expected_s * 1000, 1) == 36.7
    assert cost.request_s == near(6 * CHAR_S)
    assert cost.first_byte_s == near(6 * CHAR_S + 2 * 0.020 + 0.016 + 0.020)
    assert cost.whole_s == near(cost.first_byte_s + 2 * 10 * CHAR_S)
    assert cost.worst_s == near(cost.whole_s + 0.5)


def test_extended_addressing_adds_ten_characters_to_a_read() -> None:
    plain = read_cost(AT_9600, VECTOR, Code(150), STANDARD)
    extended = read_cost(AT_9600, VECTOR, Code(150), EXTENDED)
    assert extended.expected_s - plain.expected_s == near(10 * CHAR_S)
    assert extended.request_s == near(11 * CHAR_S)


def test_write_of_a_control_word_takes_its_telegram_the_drive_and_an_ack() -> None:
    cost = write_cost(AT_9600, VECTOR, Code(135), Value.parse("H0008"), STANDARD)
    assert cost.request_s == near(13 * CHAR_S)
    assert cost.expected_s == near(13 * CHAR_S + 0.020 + CHAR_S)
    assert cost.whole_s == near(cost.first_byte_s + 2 * CHAR_S)


def test_deadlines_follow_the_longest_thinking_time_and_the_cost_the_usual_one() -> None:
    cost = write_cost(AT_9600, VECTOR, Code(11), Value.parse("95.2"), STANDARD)
    assert cost.expected_s == near(12 * CHAR_S + 0.020 + CHAR_S)
    assert cost.first_byte_s == near(12 * CHAR_S + 2 * 0.050 + 0.016 + 0.020)


def test_module_settings_of_82xx_are_given_half_a_second() -> None:
    cost = read_cost(AT_9600, VECTOR, Code(1923), STANDARD)
    assert cost.expected_s == near((6 + 10) * CHAR_S + 0.5)
    assert 0.6 < cost.first_byte_s - cost.request_s < 0.65, "the manual's limit and a fifth more"


def test_roster_may_say_how_long_a_drive_thinks() -> None:
    cost = read_cost(AT_9600, VECTOR, Code(150), STANDARD, answer_time_s=0.1)
    assert cost.expected_s == near(16 * CHAR_S + 0.1)
    assert cost.first_byte_s == near(6 * CHAR_S + 0.2 + 0.036)


def test_answer_of_unknown_length_is_not_cut_short() -> None:
    cost = read_cost(AT_9600, family("generic"), Code(7), STANDARD)
    assert cost.expected_s == near((6 + 14) * CHAR_S + 0.050)
    assert cost.whole_s - cost.first_byte_s == near((5 + 241 + 14) * CHAR_S)


def test_described_number_is_not_waited_for_as_long_as_a_string() -> None:
    cost = read_cost(AT_9600, VECTOR, Code(50), STANDARD)
    assert cost.whole_s - cost.first_byte_s == near((10 + 17) * CHAR_S)


def test_unpaced_line_costs_only_the_drives_time() -> None:
    timing = LineTiming(9600, adapter_latency_s=0.005, paced=False)
    cost = read_cost(timing, VECTOR, Code(150), STANDARD)
    assert timing.char_s == 0.0
    assert cost.expected_s == near(0.020)
    assert cost.request_s == 0.0
    assert cost.whole_s == near(2 * 0.020 + 0.005 + 0.020)


def test_adapter_latency_moves_deadlines_and_not_the_cost() -> None:
    slow = LineTiming(9600, adapter_latency_s=0.050)
    quick, patient = (read_cost(one, VECTOR, Code(150), STANDARD) for one in (AT_9600, slow))
    assert patient.expected_s == quick.expected_s
    assert patient.first_byte_s - quick.first_byte_s == near(0.034)
    assert patient.gap_s - quick.gap_s == near(0.034)


def test_costs_asked_for_again_are_the_same_object() -> None:
    first = read_cost(LineTiming(19200), VECTOR, Code(150), STANDARD)
    assert read_cost(LineTiming(19200), VECTOR, Code(150), STANDARD) is first
    assert read_cost(LineTiming(19200), VECTOR, Code(150), EXTENDED) is not first


@given(
    baud=st.sampled_from(BAUDS),
    name=st.sampled_from(FAMILY_NAMES),
    number=st.integers(0, 6229),
    form=st.sampled_from(Form),
    latency_s=st.floats(0, 0.2),
)
def test_deadlines_always_leave_room_for_the_longest_answer(
    baud: int, name: str, number: int, form: Form, latency_s: float
) -> None:
    timing = LineTiming(baud, adapter_latency_s=latency_s)
    drive, code = family(name), Code(number)
    for cost, write in (
        (read_cost(timing, drive, code, form), False),
        (write_cost(timing, drive, code, Value.parse("1"), form), True),
    ):
        thinking_s = drive.longest_answer_time_s(code, write=write)
        assert cost.request_s + thinking_s + latency_s < cost.first_byte_s
        assert cost.expected_s < cost.whole_s < cost.worst_s
        assert cost.gap_s > latency_s + timing.char_s
