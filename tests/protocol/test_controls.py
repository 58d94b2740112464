from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from lecombus.fieldbus.lecom.protocol.controls import (
    ACK,
    ENQ,
    EOT,
    ETX,
    NAK,
    STX,
    bcc,
    strip_parity,
    with_parity,
)

seven_bit = st.binary(max_size=64).map(lambda data: bytes(byte & 0x7F for byte in data))


def test_control_characters_are_those_of_ascii_and_eot_is_not_02() -> None:
    assert (STX, ETX, EOT, ENQ, ACK, NAK) == (0x02, 0x03, 0x04, 0x05, 0x06, 0x15)


def test_bcc_of_the_manuals_examples() -> None:
    assert bcc(b"4635.4\x03") == 0x1D
    assert bcc(b"68H0900\x03") == 0x4C
    assert bcc(b"1195.2\x03") == 0x13
    assert bcc(b"400\x03") == 0x37
    assert bcc(b"46?\x03") == 0x3E


@given(seven_bit, st.integers(0, 127))
def test_bcc_closes_a_text_to_zero_and_stays_within_seven_bits(body: bytes, char: int) -> None:
    assert 0 <= bcc(body) <= 0x7F
    assert bcc(body + bytes((bcc(body),))) == 0
    assert bcc(body + bytes((char,))) == bcc(body) ^ char


@given(seven_bit)
def test_parity_is_even_and_comes_off_again(data: bytes) -> None:
    sent = with_parity(data)
    assert all(byte.bit_count() % 2 == 0 for byte in sent)
    assert strip_parity(sent) == (data, True)


def test_parity_of_known_characters() -> None:
    assert with_parity(bytes((STX, ETX, EOT, ENQ, ACK, NAK))) == b"\x82\x03\x84\x05\x06\x95"


@given(seven_bit.filter(bool), st.data())
def test_every_single_flipped_bit_is_seen(data: bytes, draw: st.DataObject) -> None:
    at = draw.draw(st.integers(0, len(data) - 1))
    bit = draw.draw(st.integers(0, 7))
    sent = bytearray(with_parity(data))
    sent[at] ^= 1 << bit
    stripped, sound = strip_parity(bytes(sent))
    assert not sound
    assert len(stripped) == len(data)


def test_adding_parity_twice_is_adding_it_once() -> None:
    every = bytes(range(128))
    assert with_parity(with_parity(every)) == with_parity(every)
