"""Every telegram of both directions: how it is written, its length, what it is called once read.

The functions return 7-bit characters without parity (`controls.with_parity` adds it). The frozen
classes are the events that the parsers yield: `Answer` for what a drive says, `HostRequest` for
what a host says. An answer carries no address, and an acknowledgement nothing at all: whose it is
follows only from when it comes, which is the business of the line, not of this room.

::

    read      EOT AD1 AD2 C1 C2 ENQ                          value    STX C1 C2 V1..Vn ETX BCC
    write     EOT AD1 AD2 STX C1 C2 V1..Vn ETX BCC           error    STX C1 C2 ? ETX BCC
    multicast a write to an address ending in 0              unknown  STX C1 C2 EOT
                                                             written  ACK  or  NAK

Telegrams take ten bits a character (start, 7 data, parity, stop). The manual's table of times gives
request and answer together for a value of 9 characters: SEND 17 + 1 characters (150 ms at 1200
bit/s), RECEIVE 6 + 14 (166.7 ms). It heads them "t2" and "= t4", which would be one direction each;
the figures are those of both. Extended addressing adds 5 characters to each telegram that carries
the code: once for SEND (41.6 ms), twice for RECEIVE (83.3 ms).

Source: EDB2102EN 3.5, 8.3.2 to 8.3.4; CMVLC401A 6.1 to 6.4. No bytes are searched here: see
`parser`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import ClassVar, Final

from lecombus.errors import CodeValueError
from lecombus.fieldbus.lecom.protocol.addressing import (
    Form,
    encode_address,
    encode_code,
    field_length,
    fits_field,
)
from lecombus.fieldbus.lecom.protocol.controls import ENQ, EOT, ETX, STX, bcc
from lecombus.fieldbus.loop_interface import AnswerKind
from lecombus.parameters import (
    HIGHEST_VALUE_CHARS,
    SENDABLE_STRING_CHARS,
    AddressForm,
    Code,
    Format,
    Value,
)

__all__ = [
    "ACK_CHARS",
    "MAX_ANSWER_CHARS",
    "AckAnswer",
    "Answer",
    "BadAnswer",
    "BadRequest",
    "HostRequest",
    "NakAnswer",
    "ReadRequest",
    "TelegramFault",
    "TelegramText",
    "TransmissionErrorAnswer",
    "UnknownCodeAnswer",
    "ValueAnswer",
    "WriteRequest",
    "answer_chars",
    "read_request_chars",
    "read_telegram",
    "write_request_chars",
    "write_telegram",
]


class TelegramFault(StrEnum):
    """Why a telegram is bad."""

    BCC = "bcc"
    """The block check character is not that of the text."""
    PARITY = "parity"
    """A character has odd parity, or its bit 7 is set where the port frames 7 bits."""
    FORMAT = "format"
    """The telegram is whole and its BCC right, but its value is in no known format."""
    UNEXPECTED = "unexpected"
    """A character stands where it cannot."""
    TOO_LONG = "too-long"
    """No value is that long."""
    INTERRUPTED = "interrupted"
    """A request was cut by a new EOT; answers never have this fault."""


@dataclass(frozen=True, slots=True)
class ValueAnswer:
    """A drive's value for the code in the field."""

    field: bytes
    value: Value

    kind: ClassVar[AnswerKind] = AnswerKind.VALUE
    text: ClassVar[str] = ""


@dataclass(frozen=True, slots=True)
class UnknownCodeAnswer:
    """The drive has no such code."""

    field: bytes

    kind: ClassVar[AnswerKind] = AnswerKind.NO_SUCH_CODE
    value: ClassVar[None] = None
    text: ClassVar[str] = ""


@dataclass(frozen=True, slots=True)
class TransmissionErrorAnswer:
    """The drive saw a transmission error in the question."""

    field: bytes

    kind: ClassVar[AnswerKind] = AnswerKind.OTHER
    value: ClassVar[None] = None
    text: ClassVar[str] = ""


@dataclass(frozen=True, slots=True)
class AckAnswer:
    """A write was done."""

    kind: ClassVar[AnswerKind] = AnswerKind.ACKNOWLEDGED
    value: ClassVar[None] = None
    text: ClassVar[str] = ""


@dataclass(frozen=True, slots=True)
class NakAnswer:
    """A write changed nothing."""

    kind: ClassVar[AnswerKind] = AnswerKind.REFUSED
    value: ClassVar[None] = None
    text: ClassVar[str] = "the drive refused the read (NAK)"


@dataclass(frozen=True, slots=True)
class BadAnswer:
    """Something came that is no answer.

    Args:
        fault: Why.
        received: The bytes as they came, parity included, up to the one that showed the fault.
        expected_bcc: For a BCC fault: what it had to be.
        got_bcc: For a BCC fault: what came.
    """

    fault: TelegramFault
    received: bytes
    expected_bcc: int | None = None
    got_bcc: int | None = None

    kind: ClassVar[AnswerKind] = AnswerKind.OTHER
    value: ClassVar[None] = None
    text: ClassVar[str] = ""

    @property
    def reason(self) -> str:
        """Say why in words, for logs and errors."""
        if self.fault is TelegramFault.BCC:
            return f"BCC is {self.got_bcc:02X}h, {self.expected_bcc:02X}h was due"
        return _REASONS[self.fault].format(self.received[-1:].hex().upper())


_REASONS: Final = {
    TelegramFault.PARITY: "character {}h has wrong parity",
    TelegramFault.FORMAT: "the value is in no known format",
    TelegramFault.UNEXPECTED: "character {}h was not to be expected there",
    TelegramFault.TOO_LONG: "longer than any value",
    TelegramFault.INTERRUPTED: "interrupted by a new telegram",
}

Answer = (
    ValueAnswer | UnknownCodeAnswer | TransmissionErrorAnswer | AckAnswer | NakAnswer | BadAnswer
)


@dataclass(frozen=True, slots=True)
class ReadRequest:
    """A host asks a drive for a code."""

    address: int
    field: bytes


@dataclass(frozen=True, slots=True)
class WriteRequest:
    """A host writes a code of a drive, or of a group if the address ends in 0."""

    address: int
    field: bytes
    value: Value


@dataclass(frozen=True, slots=True)
class BadRequest:
    """Something came that is not a request.

    Args:
        fault: Why.
        received: The bytes as they came, parity included, up to the one that showed the fault.
        address: Whom it was for, when that was received.
    """

    fault: TelegramFault
    received: bytes
    address: int | None = None


HostRequest = ReadRequest | WriteRequest | BadRequest


def read_telegram(address: int, code: Code, form: AddressForm) -> bytes:
    """Return the RECEIVE telegram: ask one drive for a code.

    Raises:
        CodeValueError: No such address, or the form cannot carry the code.

    Source: EDB2102EN 8.3.2; CMVLC401A 6.2.
    """
    return _read_telegram(address, code, form)


@lru_cache(maxsize=8192)
def _read_telegram(address: int, code: Code, form: AddressForm) -> bytes:
    return b"%c%b%b%c" % (EOT, encode_address(address), encode_code(code, form), ENQ)


def write_telegram(address: int, code: Code, value: Value, form: AddressForm) -> bytes:
    """Return the SEND telegram: write a code of one drive, or of a group (address ending in 0).

    Raises:
        CodeValueError: No such address, the form cannot carry the code, or the value is a string
            of more than 20 characters.

    Source: EDB2102EN 8.3.3, 8.3.4; CMVLC401A 6.4.
    """
    if value.format is Format.VS and len(value.raw) > 1 + SENDABLE_STRING_CHARS:
        raise CodeValueError(
            f"a string of {len(value.raw) - 1} characters cannot be sent: "
            f"at most {SENDABLE_STRING_CHARS} can",
            code=str(code), value=value.raw, high=SENDABLE_STRING_CHARS,
        )  # fmt: skip
    text = _text(encode_code(code, form), value.raw.encode("ascii"))
    return b"%c%b%b" % (EOT, encode_address(address), text)


def _text(field: bytes, value: bytes) -> bytes:
    body = b"%b%b%c" % (field, value, ETX)
    return b"%c%b%c" % (STX, body, bcc(body))


class TelegramText:
    """What stands after STX in the telegram under way: code field, value, ETX.

    It is the same in both directions. The rules which character may stand where in a text are here
    and nowhere else; `parser` (what drives say) and `host_parser` (what hosts say) feed it one
    character at a time. The code field's length is known from its first character, so nothing is
    ever searched for. The BCC is not part of the text: it may be any character, and the parsers
    compare it. Bounded: a text ends, or has a fault, after a code field, 241 characters and one
    more.

    Attributes:
        body: Every character after STX so far; with ETX, what the BCC is taken of.
        field_chars: How long the code field is; 0 before its first character.
        ended: ETX has come, so that the next character is the BCC.
    """

    __slots__ = ("body", "ended", "field_chars")

    def __init__(self) -> None:
        self.body = bytearray()
        self.field_chars = 0
        self.ended = False

    def clear(self) -> None:
        """Begin a new text."""
        self.body.clear()
        self.field_chars = 0
        self.ended = False

    def take(self, char: int) -> TelegramFault | None:
        """Take the next character before the BCC; return what is wrong with it."""
        body = self.body
        body.append(char)
        if len(body) == 1:
            self.field_chars = field_length(char)
        if len(body) <= self.field_chars:
            return None if fits_field(body) else TelegramFault.UNEXPECTED
        if char == ETX:
            self.ended = True
            return None
        if not 0x20 <= char < 0x7F:
            return TelegramFault.UNEXPECTED
        return (
            TelegramFault.TOO_LONG if len(body) - self.field_chars > HIGHEST_VALUE_CHARS else None
        )

    def at_value(self) -> bool:
        """Return whether the code field is complete and no value has begun."""
        return len(self.body) == self.field_chars > 0

    @property
    def field(self) -> bytes:
        """The code field."""
        return bytes(self.body[: self.field_chars])

    @property
    def value(self) -> bytes:
        """The text between code field and ETX."""
        return bytes(self.body[self.field_chars : -1])


ACK_CHARS: Final = 1
"""ACK and NAK."""

_FIELD_CHARS: Final[Mapping[AddressForm, int]] = {Form.STANDARD: 2, Form.EXTENDED: 7}


def read_request_chars(form: AddressForm) -> int:
    """Return the characters of `EOT AD1 AD2 C1 C2 ENQ`: 6, extended 11."""
    return 4 + _FIELD_CHARS[form]


def write_request_chars(form: AddressForm, value_chars: int) -> int:
    """Return the characters of `EOT AD1 AD2 STX C1 C2 V1..Vn ETX BCC`: 8 + n, extended 13 + n."""
    return 6 + _FIELD_CHARS[form] + value_chars


def answer_chars(form: AddressForm, value_chars: int) -> int:
    """Return the characters of `STX C1 C2 V1..Vn ETX BCC`: 5 + n, extended 10 + n.

    A `?` answer is one with a value of 1 character.
    """
    return 3 + _FIELD_CHARS[form] + value_chars


MAX_ANSWER_CHARS: Final = answer_chars(Form.EXTENDED, HIGHEST_VALUE_CHARS)
"""The longest answer there can be: 1 + 7 + 241 + 2 characters."""
