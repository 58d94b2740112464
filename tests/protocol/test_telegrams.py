from __future__ import annotations

import pytest

from lecombus.errors import CodeValueError
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.protocol.telegrams import (
    BadAnswer,
    TelegramFault,
    read_telegram,
    write_telegram,
)
from lecombus.parameters import Code, Value
from protocol.strategies import octets, string
from support.answers import (
    ACK_ANSWER,
    NAK_ANSWER,
    encode_answer,
    transmission_error_answer,
    unknown_code_answer,
    value_answer,
)

C46 = Code(46)


def test_a_read_is_eot_address_field_enq() -> None:
    assert read_telegram(1, C46, Form.STANDARD) == b"\x040146\x05"
    assert read_telegram(99, Code(39, 1), Form.EXTENDED) == b"\x0499!002701\x05"


def test_a_write_carries_text_and_bcc() -> None:
    telegram = write_telegram(34, Code(11), Value.decimal("95.2"), Form.STANDARD)
    assert telegram == b"\x0434\x021195.2\x03\x13"


def test_the_five_answers_of_a_drive() -> None:
    assert value_answer(b"46", Value.parse("35.4")) == b"\x024635.4\x03\x1d"
    assert transmission_error_answer(b"46") == b"\x0246?\x03\x3e"
    assert unknown_code_answer(b"!002701") == b"\x02!002701\x04"
    assert (ACK_ANSWER, NAK_ANSWER) == (b"\x06", b"\x15")


def test_no_telegram_has_bit_7_set_whatever_it_says() -> None:
    for number in range(6230):
        value = Value.decimal(number)
        assert read_telegram(1, Code(number), Form.STANDARD).isascii()
        assert write_telegram(1, Code(number), value, Form.STANDARD).isascii()


@pytest.mark.parametrize("address", [-1, 100])
def test_no_telegram_goes_to_an_address_that_is_none(address: int) -> None:
    with pytest.raises(CodeValueError):
        read_telegram(address, C46, Form.STANDARD)
    with pytest.raises(CodeValueError):
        write_telegram(address, C46, Value.decimal(0), Form.STANDARD)


def test_no_telegram_goes_out_in_a_form_that_loses_the_subcode() -> None:
    with pytest.raises(CodeValueError):
        read_telegram(1, Code(39, 1), Form.STANDARD)
    with pytest.raises(CodeValueError):
        write_telegram(1, Code(39, 1), Value.decimal(0), Form.STANDARD)


def test_strings_of_20_characters_are_sent_and_of_21_are_not() -> None:
    telegram = write_telegram(1, Code(200), string("x" * 20), Form.STANDARD)
    assert telegram[6:27] == b"S" + b"x" * 20
    with pytest.raises(CodeValueError, match="at most 20") as caught:
        write_telegram(1, Code(200), string("x" * 21), Form.STANDARD)
    assert caught.value.code == "C0200"


def test_octets_are_sent_in_full_length() -> None:
    telegram = write_telegram(1, C46, octets(bytes(120)), Form.STANDARD)
    assert len(telegram) == 3 + 1 + 2 + 241 + 2


@pytest.mark.parametrize(
    "fault", [fault for fault in TelegramFault if fault is not TelegramFault.BCC]
)
def test_every_fault_says_something_of_its_own(fault: TelegramFault) -> None:
    reasons = {
        BadAnswer(other, b"\x0f").reason
        for other in TelegramFault
        if other is not TelegramFault.BCC
    }
    assert len(reasons) == len(TelegramFault) - 1
    assert BadAnswer(fault, b"\x0f").reason in reasons


def test_the_character_that_was_wrong_is_named() -> None:
    assert BadAnswer(TelegramFault.UNEXPECTED, b"\x02\x0f").reason.startswith("character 0Fh")
    assert BadAnswer(TelegramFault.PARITY, b"\x02\x8f").reason.startswith("character 8Fh")


def test_a_bad_answer_is_written_as_it_came() -> None:
    assert encode_answer(BadAnswer(TelegramFault.UNEXPECTED, b"\xff\x00")) == b"\xff\x00"
