"""Answers of drives as 7-bit characters, and code fields read back: what only tests need."""

from __future__ import annotations

from typing import Final

from lecombus.fieldbus.lecom.protocol.addressing import EXTENDED_MARK, Form, is_code_field
from lecombus.fieldbus.lecom.protocol.controls import ACK, EOT, ETX, NAK, STX, bcc
from lecombus.fieldbus.lecom.protocol.telegrams import (
    AckAnswer,
    Answer,
    BadAnswer,
    NakAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from lecombus.parameters import Code, Value

__all__ = [
    "ACK_ANSWER",
    "NAK_ANSWER",
    "decode_code",
    "encode_answer",
    "transmission_error_answer",
    "unknown_code_answer",
    "value_answer",
]

ACK_ANSWER: Final = bytes((ACK,))
NAK_ANSWER: Final = bytes((NAK,))


def value_answer(field: bytes, value: Value) -> bytes:
    """Return a drive's value answer; the field repeats that of the question."""
    return _text(field, value.raw.encode("ascii"))


def transmission_error_answer(field: bytes) -> bytes:
    """Return a drive's `?` answer: it saw a transmission error in the question."""
    return _text(field, b"?")


def unknown_code_answer(field: bytes) -> bytes:
    """Return a drive's answer to a code it does not have."""
    return b"%c%b%c" % (STX, field, EOT)


def encode_answer(answer: Answer) -> bytes:
    """Return the characters an answer was read from; a bad one as it came."""
    match answer:
        case ValueAnswer(field, value):
            return value_answer(field, value)
        case TransmissionErrorAnswer(field):
            return transmission_error_answer(field)
        case UnknownCodeAnswer(field):
            return unknown_code_answer(field)
        case AckAnswer():
            return ACK_ANSWER
        case NakAnswer():
            return NAK_ANSWER
        case BadAnswer():
            return answer.received


def _text(field: bytes, value: bytes) -> bytes:
    body = b"%b%b%c" % (field, value, ETX)
    return b"%c%b%c" % (STX, body, bcc(body))


def decode_code(field: bytes) -> tuple[Code, Form]:
    """Return the code that a code field names, and the form it is written in."""
    assert is_code_field(field)
    if field[0] == EXTENDED_MARK:
        return Code(int(field[1:5], 16), int(field[5:7], 16)), Form.EXTENDED
    page, unit = divmod(field[1] - 48, 10)
    return Code(page * 790 + (field[0] - 48) * 10 + unit), Form.STANDARD
