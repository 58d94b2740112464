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

from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.parameters import HIGHEST_VALUE_CHARS, AddressForm

__all__ = [
    "ACK_CHARS",
    "BAUDS",
    "BITS_PER_CHAR",
    "MAX_ANSWER_CHARS",
    "answer_chars",
    "read_request_chars",
    "write_request_chars",
]

BAUDS: Final = (1200, 2400, 4800, 9600, 19200)
BITS_PER_CHAR: Final = 10
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
