from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.controls import with_parity
from lecombus.fieldbus.lecom.protocol.host_parser import RequestParser
from lecombus.fieldbus.lecom.protocol.telegrams import (
    MAX_ANSWER_CHARS,
    BadRequest,
    HostRequest,
    ReadRequest,
    TelegramFault,
    WriteRequest,
    read_telegram,
    write_telegram,
)
from lecombus.parameters import Code, Value
from protocol.strategies import addressed, cut, sendable

C46 = encode_code(Code(46), Form.STANDARD)


@given(
    st.lists(
        st.tuples(st.integers(0, 99), addressed, st.none() | sendable), min_size=1, max_size=5
    ),
    st.booleans(),
    st.lists(st.integers(0, 500), max_size=6),
)
def test_every_request_comes_back_from_the_wire(
    asked: list[tuple[int, tuple[Code, Form], Value | None]], parity: bool, places: list[int]
) -> None:
    stream = b""
    expected: list[HostRequest] = []
    for address, (code, form), value in asked:
        field = encode_code(code, form)
        if value is None:
            stream += read_telegram(address, code, form)
            expected.append(ReadRequest(address, field))
        else:
            stream += write_telegram(address, code, value, form)
            expected.append(WriteRequest(address, field, value))
    sent = with_parity(stream) if parity else stream
    parser = RequestParser(parity=parity)
    assert [event for piece in cut(sent, places) for event in parser.feed(piece)] == expected


@given(st.lists(st.binary(max_size=600), max_size=8), st.booleans())
def test_the_request_parser_never_raises_and_never_grows(pieces: list[bytes], parity: bool) -> None:
    parser = RequestParser(parity=parity)
    for piece in pieces:
        for event in parser.feed(piece):
            if isinstance(event, BadRequest):
                assert len(event.received) <= 3 + MAX_ANSWER_CHARS
        assert len(parser.pending) <= 3 + MAX_ANSWER_CHARS


@given(st.binary(max_size=60), st.booleans(), st.lists(st.integers(0, 60), max_size=4))
def test_requests_do_not_depend_on_the_split(data: bytes, parity: bool, places: list[int]) -> None:
    whole = RequestParser(parity=parity).feed(data)
    parser = RequestParser(parity=parity)
    assert [event for piece in cut(data, places) for event in parser.feed(piece)] == whole


@given(st.binary(max_size=60).map(lambda data: bytes(byte & 0x7F for byte in data)))
def test_a_request_after_any_noise_is_read(data: bytes) -> None:
    """Two, in fact: after an ETX in the noise the first EOT may have been its BCC."""
    parser = RequestParser()
    parser.feed(data)
    read = read_telegram(1, Code(46), Form.STANDARD)
    assert parser.feed(read + read)[-1] == ReadRequest(1, C46)


WRITE = write_telegram(34, Code(11), Value.decimal("95.2"), Form.STANDARD)
C11 = encode_code(Code(11), Form.STANDARD)


@pytest.mark.parametrize("size", range(2, len(WRITE)))
def test_an_eot_interrupts_at_any_place_and_begins_anew(size: int) -> None:
    events = RequestParser().feed(WRITE[:size] + WRITE)
    address = 34 if size >= 3 else None
    # Cut after ETX, the EOT stands where the BCC was due: the text had its wrong BCC.
    fault = TelegramFault.BCC if size == len(WRITE) - 1 else TelegramFault.INTERRUPTED
    assert events == [
        BadRequest(fault, WRITE[:size], address),
        WriteRequest(34, C11, Value.parse("95.2")),
    ]


def test_a_bare_eot_is_no_telegram_and_interrupts_none() -> None:
    parser = RequestParser()
    assert parser.feed(b"\x04\x04\x04") == []
    assert parser.feed(read_telegram(1, Code(46), Form.STANDARD)) == [ReadRequest(1, C46)]


@pytest.mark.parametrize(
    ("data", "fault", "address", "received"),
    [
        (b"46", TelegramFault.UNEXPECTED, None, b"4"),
        (b"\x04x146\x05", TelegramFault.UNEXPECTED, None, b"\x04x"),
        (b"\x040:46\x05", TelegramFault.UNEXPECTED, None, b"\x040:"),
        (b"\x040146\x06", TelegramFault.UNEXPECTED, 1, b"\x040146\x06"),
        (b"\x040146\x02", TelegramFault.UNEXPECTED, 1, b"\x040146\x02"),
        (b"\x0401\x05", TelegramFault.UNEXPECTED, 1, b"\x0401\x05"),
        (b"\x0401\x02\x02", TelegramFault.UNEXPECTED, 1, b"\x0401\x02\x02"),
        (b"\x0401!00g", TelegramFault.UNEXPECTED, 1, b"\x0401!00g"),
        (WRITE[:-1] + b"\x14", TelegramFault.BCC, 34, WRITE[:-1] + b"\x14"),
        (b"\x0434\x0211\x03\x03", TelegramFault.FORMAT, 34, b"\x0434\x0211\x03\x03"),
        (b"\x0434\x0211?\x03\x3c", TelegramFault.FORMAT, 34, b"\x0434\x0211?\x03\x3c"),
        (b"\x04\xb3", TelegramFault.PARITY, None, b"\x04\xb3"),
    ],
)
def test_a_bad_request_says_why_and_is_reported_once(
    data: bytes, fault: TelegramFault, address: int | None, received: bytes
) -> None:
    parser = RequestParser()
    assert parser.feed(data + b"more of it\x05") == [BadRequest(fault, received, address)]
    assert parser.feed(WRITE) == [WriteRequest(34, C11, Value.parse("95.2"))]


def test_a_write_that_is_too_long_is_bad() -> None:
    events = RequestParser().feed(b"\x0401\x0246" + b"1" * 1000)
    assert [(e.fault, e.address) for e in events if isinstance(e, BadRequest)] == [
        (TelegramFault.TOO_LONG, 1)
    ]


@pytest.mark.parametrize("char", [b"\x04", b"\x84"])
def test_an_eot_with_bad_parity_begins_nothing(char: bytes) -> None:
    parity = char == b"\x04"  # 04h is odd: with parity an EOT is 84h
    read = read_telegram(1, Code(46), Form.STANDARD)
    sent = char + (with_parity(read[1:]) if parity else read[1:])
    assert RequestParser(parity=parity).feed(sent) == [BadRequest(TelegramFault.PARITY, char)]
