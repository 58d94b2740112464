"""Characters: the control characters, the block check, the parity bit, and how fast they are sent.

The lowest floor of the protocol: what single characters are worth, before anyone asks what they
mean together. A character has 7 data bits and even parity. lecombus usually runs its port 8N1 and
makes the parity itself in bit 7, which is the same on the wire, so parity is ordinary code here:
two translation tables and one set of good bytes, because every telegram passes through them.

No telegram, code or value is known here.
"""

from __future__ import annotations

from functools import reduce
from operator import xor
from typing import Final

__all__ = [
    "ACK",
    "BAUDS",
    "BITS_PER_CHAR",
    "ENQ",
    "EOT",
    "ETX",
    "NAK",
    "STX",
    "bcc",
    "strip_parity",
    "with_parity",
]

BAUDS: Final = (1200, 2400, 4800, 9600, 19200)
BITS_PER_CHAR: Final = 10
"""Start, 7 data, parity, stop."""
STX: Final = 0x02
"""Start of text."""
ETX: Final = 0x03
"""End of text; the next character is the BCC, any value."""
EOT: Final = 0x04
"""End of the previous transmission: opens every telegram of the host, and ends the answer to an
unknown code. The manuals' example "EOT = 02hex" is a misprint, as every telegram table shows."""
ENQ: Final = 0x05
"""Station request: ends a read."""
ACK: Final = 0x06
"""Positive acknowledgement of a write."""
NAK: Final = 0x15
"""Negative acknowledgement of a write: the value was not changed."""

_ADD_PARITY: Final = bytes(byte | (byte.bit_count() & 1) << 7 for byte in range(128)) * 2
_DROP_BIT_7: Final = bytes(byte & 0x7F for byte in range(256))
_EVEN: Final = bytes(byte for byte in range(256) if byte.bit_count() % 2 == 0)


def bcc(body: bytes | bytearray) -> int:
    """Return the block check character of a telegram's text.

    Args:
        body: Every character after STX up to and including ETX, 7 bits each.

    Returns:
        0..127: the XOR of all of them. The manuals print 00..FF, which 7 data bits cannot carry.

    Source: EDB2102EN 8.3.1 "Block-check character"; CMVLC401A 5.5.
    """
    return reduce(xor, body, 0)


def with_parity(data: bytes) -> bytes:
    """Return the characters with even parity in bit 7; a bit 7 that was set is ignored.

    Source: EDB2102EN 3.2 (7 data bits, even parity).
    """
    return data.translate(_ADD_PARITY)


def strip_parity(data: bytes) -> tuple[bytes, bool]:
    """Take the parity bit off.

    Returns:
        The 7-bit characters, and whether every one of them had even parity.
    """
    return data.translate(_DROP_BIT_7), not data.translate(None, _EVEN)
