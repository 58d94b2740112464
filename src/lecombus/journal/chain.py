"""The rows of a journal and the chain of hashes over them. Pure.

Each row's hash is the SHA-256 of eight lines of UTF-8 text, each ended by one line feed:

1. the hash of the row before it, in hexadecimal; of the first row: 64 zeros
2. its number
3. its time, Unix milliseconds
4. its kind
5. its drive or group; empty where it concerns none
6. the number of the row that it is the end of; empty where it is none
7. its outcome; empty where it has none
8. its fields: a JSON object in ASCII, as it is stored

So no row can be changed, taken out or put in without changing the hash of every later row. Rows at
the end can be taken off unseen: the newest hash must be kept elsewhere (`Head`).
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Final

__all__ = ["ASKED", "FIRST_HASH", "Head", "Row", "hash_of", "one_line"]

ASKED: Final = "asked"
"""The outcome of a row that says what was about to be done; a later row has its end."""

FIRST_HASH: Final = bytes(32)

BREAKS: Final = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


@dataclass(frozen=True, slots=True)
class Head:
    """The newest row of a journal: its number and its hash.

    Written as `NUMBER:HASH`, the hash in hexadecimal.
    """

    number: int = 0
    hash: bytes = FIRST_HASH

    def __str__(self) -> str:
        """Return it as it is logged, and as `lecombus journal verify --head` takes it."""
        return f"{self.number}:{self.hash.hex()}"


@dataclass(slots=True, eq=False)
class Row:
    """One row that is to be written, or was.

    Args:
        kind: What happened: `write`, `stop`, `trip`, `start` and the like.
        drive: The drive or group; empty where none is concerned.
        fields: What is to be known of it, as texts.
        time_ms: When it happened, Unix milliseconds.
        outcome: `ASKED` for an intent; how it ended; empty where that says nothing.
        intent: The row that it is the end of.
        is_vital: It may use the reserve of a full disk: a stop, an end.

    Attributes:
        number: Its number in the file; 0 until it is there.
        file: Which of the files opened in turn it is in.
        is_withdrawn: It must not be written any more.
    """

    kind: str
    drive: str
    fields: Mapping[str, str]
    time_ms: int
    outcome: str = ""
    intent: Row | None = None
    is_vital: bool = False
    number: int = field(default=0, init=False)
    file: int = field(default=0, init=False)
    is_withdrawn: bool = field(default=False, init=False)


def hash_of(
    before: bytes,
    number: int,
    time_ms: int,
    kind: str,
    drive: str,
    intent: int | None,
    outcome: str,
    fields: str,
) -> bytes:
    """Return the hash of a row; the arguments are the columns of the file in their order."""
    text = (
        f"{before.hex()}\n{number}\n{time_ms}\n{kind}\n{drive}\n"
        f"{'' if intent is None else intent}\n{outcome}\n{fields}\n"
    )
    return sha256(text.encode()).digest()


def one_line(text: str) -> str:
    """Return a text without line breaks and control characters."""
    return BREAKS.sub(" ", text)


def json_of(fields: Mapping[str, str]) -> str:
    """Return fields as they are stored; empty ones are left out."""
    return json.dumps({key: text for key, text in fields.items() if text}, separators=(",", ":"))
