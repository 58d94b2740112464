"""The form of a token: `lcb_`, 256 random bits, check characters.

`lcb_` lets scanners for leaked secrets find it. The bits and the check characters (a CRC-32) are
written with letters and digits only, so that a double click takes the whole token. The check
characters find a token that was mistyped or cut; they protect nothing.
"""

from __future__ import annotations

import re
import secrets
import zlib
from hashlib import sha256
from typing import Final

__all__ = ["PREFIX", "digest_of", "is_well_formed", "new_secret"]

PREFIX: Final = "lcb_"
DIGITS: Final = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
BITS: Final = 256
BITS_CHARS: Final = 43
"""62**43 is more than 2**256."""
CHECK_CHARS: Final = 6
"""62**6 is more than 2**32."""
FORM: Final = re.compile(rf"{PREFIX}[0-9A-Za-z]{{{BITS_CHARS + CHECK_CHARS}}}", re.ASCII)


def new_secret() -> str:
    """Return a new token."""
    body = PREFIX + written(secrets.randbits(BITS), BITS_CHARS)
    return body + check_characters(body)


def is_well_formed(text: str) -> bool:
    """Return whether a text has the form of a token, check characters included."""
    if FORM.fullmatch(text) is None:
        return False
    return check_characters(text[:-CHECK_CHARS]) == text[-CHECK_CHARS:]


def digest_of(secret: str) -> str:
    """Return what is stored of a token: its SHA-256, in hexadecimal.

    No slow hash: the secret is random, so there is nothing to guess.
    """
    return sha256(secret.encode()).hexdigest()


def check_characters(text: str) -> str:
    """Return the characters that end a token which begins with `text`."""
    return written(zlib.crc32(text.encode()), CHECK_CHARS)


def written(number: int, chars: int) -> str:
    """Return a number in base 62, with leading zeros."""
    found = ""
    for _ in range(chars):
        number, digit = divmod(number, len(DIGITS))
        found = DIGITS[digit] + found
    return found
