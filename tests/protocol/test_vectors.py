"""Every vector whole, in every two pieces, byte by byte, with a tail, with parity, and back."""

from __future__ import annotations

from typing import Any

import pytest

from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.controls import with_parity
from lecombus.fieldbus.lecom.protocol.host_parser import RequestParser
from lecombus.fieldbus.lecom.protocol.parser import AnswerParser
from lecombus.fieldbus.lecom.protocol.telegrams import (
    AckAnswer,
    Answer,
    BadAnswer,
    HostRequest,
    NakAnswer,
    ReadRequest,
    TelegramFault,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
    WriteRequest,
    read_telegram,
    write_telegram,
)
from lecombus.parameters import Code, Format, Value
from protocol.vectors import feed_all, load, named, splits, wire
from support.answers import encode_answer

ANSWERS = named("answers.yaml")
BAD_ANSWERS = named("bad_answers.yaml")
REQUESTS = named("requests.yaml")
TAIL = b"\x02\x06?3"
every_answer = pytest.mark.parametrize("vector", ANSWERS)
every_bad_answer = pytest.mark.parametrize("vector", BAD_ANSWERS)
every_request = pytest.mark.parametrize("vector", REQUESTS)
either_parity = pytest.mark.parametrize("parity", [False, True], ids=["7-bit", "parity"])


def field_of(vector: dict[str, Any]) -> bytes:
    return encode_code(Code.parse(vector["code"]), Form(vector["form"]))


def answer_of(vector: dict[str, Any]) -> Answer:
    match vector["kind"]:
        case "value":
            value = Value(Format(vector["format"]), vector["text"])
            return ValueAnswer(field_of(vector), value)
        case "transmission-error":
            return TransmissionErrorAnswer(field_of(vector))
        case "unknown-code":
            return UnknownCodeAnswer(field_of(vector))
        case "ack":
            return AckAnswer()
        case kind:
            assert kind == "nak"
            return NakAnswer()


def request_of(vector: dict[str, Any]) -> HostRequest:
    if vector["kind"] == "read":
        return ReadRequest(vector["address"], field_of(vector))
    return WriteRequest(vector["address"], field_of(vector), Value.parse(vector["text"]))


def on_wire(data: bytes, parity: bool) -> bytes:
    return with_parity(data) if parity else data


@either_parity
@every_answer
def test_an_answer_is_read_in_every_split(vector: dict[str, Any], parity: bool) -> None:
    parser = AnswerParser(parity=parity)
    for pieces in splits(on_wire(wire(vector), parity)):
        parser.reset()
        assert feed_all(parser, pieces) == answer_of(vector), pieces
        assert parser.tail == b""
        assert parser.pending == b""


@either_parity
@every_answer
def test_what_follows_an_answer_is_its_tail(vector: dict[str, Any], parity: bool) -> None:
    parser = AnswerParser(parity=parity)
    tail = on_wire(TAIL, parity)
    for pieces in splits(on_wire(wire(vector), parity) + tail):
        parser.reset()
        assert feed_all(parser, pieces) == answer_of(vector), pieces
        assert parser.tail == tail


@either_parity
@every_answer
def test_an_answer_needs_its_last_character(vector: dict[str, Any], parity: bool) -> None:
    parser = AnswerParser(parity=parity)
    data = on_wire(wire(vector), parity)[:-1]
    assert parser.feed(data) is None
    assert parser.pending == data


@every_answer
def test_an_answer_is_written_as_it_was_read(vector: dict[str, Any]) -> None:
    assert encode_answer(answer_of(vector)) == wire(vector)


@pytest.mark.parametrize("vector", [v for v in load("answers.yaml") if v["kind"] == "value"],
                         ids=lambda v: v["name"])  # fmt: skip
def test_a_value_means_its_number(vector: dict[str, Any]) -> None:
    number = Value.parse(vector["text"]).number
    assert (number.hex().upper() if isinstance(number, bytes) else str(number)) == vector["number"]


@either_parity
@every_bad_answer
def test_a_bad_answer_says_why_in_every_split(vector: dict[str, Any], parity: bool) -> None:
    parser = AnswerParser(parity=parity)
    data = on_wire(wire(vector), parity)
    tail = on_wire(bytes.fromhex(vector["tail"]), parity)
    for pieces in splits(data):
        parser.reset()
        answer = feed_all(parser, pieces)
        assert isinstance(answer, BadAnswer), pieces
        assert answer.fault is TelegramFault(vector["fault"])
        assert answer.received + tail == data
        assert parser.tail == tail
        assert answer.reason


@either_parity
@every_request
def test_a_request_is_read_in_every_split(vector: dict[str, Any], parity: bool) -> None:
    for pieces in splits(on_wire(wire(vector), parity)):
        parser = RequestParser(parity=parity)
        assert [event for piece in pieces for event in parser.feed(piece)] == [request_of(vector)]
        assert parser.pending == b""


@either_parity
def test_all_requests_in_a_row_are_read_in_order(parity: bool) -> None:
    vectors = load("requests.yaml")
    stream = on_wire(b"".join(map(wire, vectors)), parity)
    expected = [request_of(vector) for vector in vectors]
    for size in (1, 2, 3, 7, len(stream)):
        parser = RequestParser(parity=parity)
        pieces = (stream[at : at + size] for at in range(0, len(stream), size))
        assert [event for piece in pieces for event in parser.feed(piece)] == expected


@every_request
def test_a_request_is_written_as_it_was_read(vector: dict[str, Any]) -> None:
    code, form = Code.parse(vector["code"]), Form(vector["form"])
    if vector["kind"] == "read":
        assert read_telegram(vector["address"], code, form) == wire(vector)
    else:
        value = Value.parse(vector["text"])
        assert write_telegram(vector["address"], code, value, form) == wire(vector)


@every_request
def test_no_request_passes_for_an_answer(vector: dict[str, Any]) -> None:
    answer = AnswerParser().feed(wire(vector))
    assert isinstance(answer, BadAnswer)
    assert answer.fault is TelegramFault.UNEXPECTED
    assert answer.received == b"\x04"
