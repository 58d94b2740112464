"""Telegrams byte for byte as the manuals print them (EDB2102EN 8.3, CMVLC401A 6)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.fieldbus.lecom.simulator import Faults, SimDrive, SimLine
from lecombus.fieldbus.lecom.simulator.wire import decimal_text, read_code_field, read_decimal
from support.sim_host import Host, code_field, read_telegram, write_telegram


def plain(*drives: SimDrive, faults: Faults | None = None) -> Host:
    return Host(SimLine(drives, baud=9600, parity=False, faults=faults))


def test_reading_c46_gives_35_4() -> None:
    host = plain(SimDrive(1, "821x", overrides={46: "35.4"}))
    assert host.ask(bytes.fromhex("04 30 31 34 36 05")) == bytes.fromhex(
        "02 34 36 33 35 2E 34 03 1D"
    )


def test_a_damaged_code_character_of_a_read_gives_the_question_mark() -> None:
    host = plain(SimDrive(1, "821x"))
    assert host.ask(bytes.fromhex("04 30 31 B4 36 05")) == bytes.fromhex("02 34 36 3F 03 3E")


def test_an_unknown_code_gives_eot() -> None:
    host = plain(SimDrive(1, "93xx"))
    assert host.ask(read_telegram(1, 16)) == bytes.fromhex("02 31 36 04")


def test_reading_c68_of_an_enabled_drive_gives_0900() -> None:
    # Enabled, pulses free, above Qmin, not yet at its setpoint: as the manual's example.
    host = plain(SimDrive(25, "821x", overrides={135: "H0000", 46: "50"}))
    host.read(25, 50)
    host.wait(0.5)
    assert host.ask(bytes.fromhex("04 32 35 36 38 05")) == bytes.fromhex(
        "02 36 38 48 30 39 30 30 03 4C"
    )


def test_writing_c11_whose_bcc_is_xoff_is_acknowledged() -> None:
    host = plain(SimDrive(34, "821x"))
    assert host.ask(bytes.fromhex("04 33 34 02 31 31 39 35 2E 32 03 13")) == b"\x06"
    assert host.read(34, 11) == "95.2"


def test_broadcast_c40_stops_every_drive_and_is_not_answered() -> None:
    drives = [SimDrive(n, "822x", overrides={135: "H0000"}) for n in (1, 12, 99)]
    host = plain(*drives)
    assert host.ask(bytes.fromhex("04 30 30 02 34 30 30 03 37")) == b""
    assert [drive.text(40) for drive in drives] == ["0", "0", "0"]


def test_smvector_takes_c1103_as_o_equals() -> None:
    host = plain(SimDrive(34, "smvector"))
    assert code_field(1103) == b"O="
    assert host.write(34, 1103, "95.2") == "ACK"
    assert host.read(34, 1103) == "95.2"


@pytest.mark.parametrize(
    ("number", "field"),
    [(1002, b"E<"), (46, b"46"), (150, b"?0"), (1103, b"O="), (1923, b"RG"), (6229, b"u\x7f")],
)
def test_code_fields_of_the_manual(number: int, field: bytes) -> None:
    assert code_field(number) == field
    assert read_code_field(field) == (number, 0, False)


@given(st.integers(0, 6229))
def test_standard_code_fields_come_back(number: int) -> None:
    assert read_code_field(code_field(number)) == (number, 0, False)


@given(st.integers(0, 65535), st.integers(0, 255))
def test_extended_code_fields_come_back(number: int, subcode: int) -> None:
    assert read_code_field(code_field(number, subcode, extended=True)) == (number, subcode, True)


@given(st.integers(-(2**31), 2**31 - 1))
def test_decimals_come_back_without_a_needless_point(count: int) -> None:
    from decimal import Decimal

    value = Decimal(count) / 10000
    text = decimal_text(value)
    assert read_decimal(text) == value
    assert not text.endswith((".", "0")) or "." not in text


@pytest.mark.parametrize("text", ["", "-", "1.", ".5", "1.23456", "1234567", "214748.3648", "1e3"])
def test_what_is_no_decimal_is_refused(text: str) -> None:
    assert read_decimal(text) is None


def test_extended_addressing_is_answered_in_kind() -> None:
    host = plain(SimDrive(11, "93xx"))
    assert host.write(11, 39, "12.5", 1, extended=True) == "ACK"
    assert host.read(11, 39, 1, extended=True) == "12.5"
    assert host.read(11, 39, 99, extended=True) == "EOT"


def test_code_bank_and_input_selection_move_standard_addressing_only() -> None:
    host = plain(SimDrive(11, "93xx", overrides={(39, 1): "7"}))
    assert host.write(11, 248, "1") == "ACK"
    assert host.read(11, 39) == "7"
    assert host.read(11, 11) == "EOT"
    assert host.read(11, 11, extended=True) == "3000"
    assert host.write(11, 248, "0") == "ACK"
    assert host.write(11, 249, "7") == "ACK"
    assert host.read(11, 173) == "3000"  # C1923
    assert host.read(11, 249) == "7"


def test_a_wrong_block_check_is_refused_and_reported() -> None:
    drive = SimDrive(1, "821x")
    host = plain(drive)
    telegram = write_telegram(1, 11, "60")
    assert host.ask(telegram[:-1] + bytes((telegram[-1] ^ 1,))) == b"\x15"
    assert host.read(1, 11) == "50"


def test_an_eot_where_the_block_check_stands_is_the_block_check() -> None:
    host = plain(SimDrive(1, "generic"))
    # 0 0 v v .. ETX gives BCC 04h for this value.
    texts = [str(n) for n in range(10000) if write_telegram(1, 0, str(n))[-1] == 4]
    assert texts
    assert host.write(1, 0, texts[0]) == "ACK"
    assert host.read(1, 0) == texts[0]


def test_values_outside_their_limits_or_format_are_refused() -> None:
    host = plain(SimDrive(1, "821x"))
    assert host.write(1, 11, "481") == "NAK"
    assert host.word(1, 68) >> 4 & 0xF == 5
    assert host.read(1, 1962) == "13"
    assert host.write(1, 11, "H0032") == "NAK"
    assert host.write(1, 135, "H08") == "NAK"
    assert host.write(1, 200, "Sx") == "NAK"
    assert host.word(1, 68) >> 4 & 0xF == 6
    assert host.write(1, 777, "1") == "NAK"
    assert host.word(1, 68) >> 4 & 0xF == 4


def test_damaged_address_or_enq_is_answered_by_nobody() -> None:
    host = plain(SimDrive(1, "821x"))
    assert host.ask(bytes.fromhex("04 30 B1 34 36 05")) == b""
    assert host.ask(bytes.fromhex("04 30 31 34 36 85")) == b""
    assert host.read(1, 46) == "0"


def test_with_parity_every_byte_of_an_answer_is_even() -> None:
    host = Host(SimLine([SimDrive(1, "821x")], baud=9600))
    host.say(read_telegram(1, 200))
    answer = host.hear()
    assert answer
    assert all(byte.bit_count() % 2 == 0 for byte in answer)


@given(st.lists(st.binary(max_size=40), max_size=6), st.booleans())
def test_bytes_of_every_kind_raise_nothing_and_the_line_still_works(
    pieces: list[bytes], parity: bool
) -> None:
    drives = [SimDrive(11, "820x"), SimDrive(12, "smvector"), SimDrive(13, "generic")]
    host = Host(SimLine(drives, baud=19200, parity=parity))
    for piece in pieces:
        host.say(piece, raw=True)
        host.hear()
    host.say(b"\x04")
    host.wait(3)
    assert host.read(12, 1494) == "1.20"
