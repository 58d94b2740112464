"""What the file of a journal keeps besides its rows: requests with a key, and facts by name."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass

import apsw

__all__ = ["NOT_KNOWN", "Fact", "KeyRow", "keep"]

NOT_KNOWN: ContextVar[str] = ContextVar("NOT_KNOWN", default="")
"""Why it is not known whether the request under way was carried out by the run before; empty: it
is known, or it has no key."""


@dataclass(frozen=True, slots=True, eq=False)
class KeyRow:
    """What is kept of a request with an `Idempotency-Key`.

    Args:
        name: The key.
        content: A digest of the request; empty: the key is forgotten.
        status: The HTTP status of its answer; None: there is none yet.
        type: The media type of the answer.
        body: The answer.
    """

    name: str
    content: bytes = b""
    status: int | None = None
    type: str = ""
    body: bytes = b""


@dataclass(frozen=True, slots=True, eq=False)
class Fact:
    """A text kept under a name, such as the roster that was last used."""

    name: str
    text: str


def keep(db: apsw.Connection, other: KeyRow | Fact) -> None:
    """Write what is not a row of the chain."""
    if isinstance(other, Fact):
        db.execute("INSERT OR REPLACE INTO facts VALUES (?1, ?2)", (other.name, other.text))
    elif not other.content:
        db.execute("DELETE FROM keys WHERE name = ?1", (other.name,))
    else:
        values = (other.name, other.content, other.status, other.type, other.body)
        db.execute("INSERT OR REPLACE INTO keys VALUES (?1, ?2, ?3, ?4, ?5)", values)
