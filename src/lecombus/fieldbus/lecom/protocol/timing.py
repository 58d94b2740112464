"""How long telegrams take on the wire, from baud rate, addressing form and value length.

Everything is counted in characters of ten bits (start, 7 data, parity, stop); seconds come last.
The manual's table gives request and answer together for a value of 9 characters: SEND 17 + 1
characters (150 ms at 1200 bit/s), RECEIVE 6 + 14 (166.7 ms). It heads them "t2" and "= t4", which
would be one direction each; the figures are those of both. Extended addressing adds 5 characters
to each telegram that carries the code: once for SEND (41.6 ms), twice for RECEIVE (83.3 ms).

Source: EDB2102EN 3.5. The time the drive thinks (t3) depends on the drive: see `drives`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from lecombus.errors import CodeValueError
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.parameters import HIGHEST_VALUE_CHARS, AddressForm

__all__ = [
    "ACK_CHARS",
    "BAUDS",
    "BITS_PER_CHAR",
    "MAX_ANSWER_CHARS",
    "answer_chars",
    "char_time_s",
    "read_request_chars",
    "read_wire_s",
    "unknown_code_chars",
    "write_request_chars",
    "write_wire_s",
]

BAUDS: Final = (1200, 2400, 4800, 9600, 19200)
BITS_PER_CHAR: Final = 10
ACK_CHARS: Final = 1
"""ACK and NAK."""

_FIELD_CHARS: Final[Mapping[AddressForm, int]] = {Form.STANDARD: 2, Form.EXTENDED: 7}


def char_time_s(baud: int) -> float:
    """Return the seconds one character takes.

    Args:
        baud: 1200, 2400, 4800, 9600 or 19200 bit/s.

    Raises:
        CodeValueError: Drives know no such baud rate.

    Source: EDB2102EN 3.2, 3.5.
    """
    if baud not in BAUDS:
        raise CodeValueError(
            f"drives know no {baud} bit/s: {', '.join(map(str, BAUDS))} are right",
            value=baud, low=BAUDS[0], high=BAUDS[-1],
        )  # fmt: skip
    return BITS_PER_CHAR / baud


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


def unknown_code_chars(form: AddressForm) -> int:
    """Return the characters of `STX C1 C2 EOT`: 4, extended 9."""
    return 2 + _FIELD_CHARS[form]


MAX_ANSWER_CHARS: Final = answer_chars(Form.EXTENDED, HIGHEST_VALUE_CHARS)
"""The longest answer there can be: 1 + 7 + 241 + 2 characters."""


def read_wire_s(baud: int, form: AddressForm, value_chars: int) -> float:
    """Return the seconds a read keeps the wire busy, question and value together."""
    return (read_request_chars(form) + answer_chars(form, value_chars)) * char_time_s(baud)


def write_wire_s(
    baud: int, form: AddressForm, value_chars: int, *, acknowledged: bool = True
) -> float:
    """Return the seconds a write keeps the wire busy, with its ACK unless it is a multicast."""
    chars = write_request_chars(form, value_chars) + (ACK_CHARS if acknowledged else 0)
    return chars * char_time_s(baud)
