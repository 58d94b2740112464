"""Reading a journal: rows, and whether their chain is whole.

Each function looks at a bounded number of rows, so that what is to be written need not wait long.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import apsw

from lecombus.journal.chain import Head, hash_of

__all__ = [
    "DOUBT",
    "StoredRow",
    "Verified",
    "fact",
    "hash_at",
    "head_in",
    "last_rows",
    "rows_after",
    "select",
    "verify_rows",
]

SCAN_ROWS: Final = 20_000
"""Rows that one question looks at: some 10 ms."""

ROWS: Final = (
    "SELECT e.id, e.time, e.kind, e.drive, e.intent, e.outcome, e.fields, e.hash, asked.fields, "
    "EXISTS (SELECT 1 FROM entries WHERE intent = e.id) "
    "FROM entries AS e LEFT JOIN entries AS asked ON asked.id = e.intent"
)

DOUBT: Final = "doubt"
"""The kind of a row that says that the file did not end where lecombus had ended it."""
KIND, FIELDS = 2, 6  # places among the columns that are hashed

OF_DRIVES: Final = "({0} = '[]' OR e.drive IN (SELECT value FROM json_each({0})))"


@dataclass(frozen=True, slots=True)
class StoredRow:
    """One row as it stands in the file.

    Args:
        number: Its number.
        time_ms: Unix milliseconds.
        kind: What happened.
        drive: The drive or group; empty where none is concerned.
        intent: The number of the row that it is the end of.
        outcome: `asked`, how it ended, or empty.
        fields: A JSON object.
        hash: Its hash.
        asked: The fields of its intent, where that is there.
        is_ended: A later row has its end.
    """

    number: int
    time_ms: int
    kind: str
    drive: str
    intent: int | None
    outcome: str
    fields: str
    hash: bytes
    asked: str | None
    is_ended: bool

    def whole(self) -> dict[str, str]:
        """Return its fields behind those of its intent."""
        return {**json.loads(self.asked or "{}"), **json.loads(self.fields)}


@dataclass(frozen=True, slots=True)
class Verified:
    """How far a chain was followed.

    Args:
        head: The last row that was looked at.
        rows: How many rows were looked at.
        problem: What is wrong behind that row; empty: nothing.
        is_end: There are no more rows.
        doubts: What rows of kind `doubt` say; the chain goes on behind them.
    """

    head: Head
    rows: int
    problem: str = ""
    is_end: bool = False
    doubts: tuple[str, ...] = ()


def fact(db: apsw.Connection, name: str) -> str | None:
    """Return the text kept under a name."""
    found = select(db, "SELECT text FROM facts WHERE name = ?1", (name,))
    return found[0][0] if found else None


def head_in(db: apsw.Connection, table: str) -> Head:
    """Return the newest row (table `head`), or the last one that was deleted (`anchor`)."""
    return Head(*select(db, f"SELECT id, hash FROM {table}")[0])


def rows_after(
    db: apsw.Connection, *, after: int, since_ms: int, drives: Sequence[str], most: int
) -> tuple[list[StoredRow], int | None]:
    """Return rows in their order, and behind which row there may be more.

    Args:
        db: The file.
        after: Only rows with a larger number.
        since_ms: Only rows of that time or later, Unix milliseconds.
        drives: Only rows of these drives or groups; empty: of any.
        most: How many.
    """
    # Times can go back, so every row is looked at once; the next pages begin behind the one before.
    later = "SELECT min(id) FROM entries WHERE id > ?1 AND time >= ?2"
    first = select(db, later, (after, since_ms))[0][0]
    if first is None:
        return [], None
    after = max(after, first - 1)
    to = after + SCAN_ROWS
    found = select(
        db,
        f"{ROWS} WHERE e.id > ?1 AND e.id <= ?2 AND {OF_DRIVES.format('?3')} AND e.time >= ?4 "
        "ORDER BY e.id LIMIT ?5",
        (after, to, json.dumps(drives), since_ms, most),
    )
    rows = [stored(row) for row in found]
    if len(rows) == most:
        to = rows[-1].number
    return rows, to if to < head_in(db, "head").number else None


def last_rows(db: apsw.Connection, *, drives: Sequence[str], most: int) -> list[StoredRow]:
    """Return the newest rows in their order; of drives those among the newest `SCAN_ROWS`."""
    after = head_in(db, "head").number - SCAN_ROWS
    found = select(
        db,
        f"{ROWS} WHERE e.id > ?1 AND {OF_DRIVES.format('?2')} ORDER BY e.id DESC LIMIT ?3",
        (after, json.dumps(drives), most),
    )
    return [stored(row) for row in reversed(found)]


def verify_rows(db: apsw.Connection, *, behind: Head, end: Head, most: int) -> Verified:
    """Follow the chain from a row on.

    Args:
        db: The file.
        behind: The row behind which to begin.
        end: The newest row, as it was written.
        most: How many rows to look at.
    """
    found = select(
        db,
        "SELECT id, time, kind, drive, intent, outcome, fields, hash FROM entries "
        "WHERE id > ?1 ORDER BY id LIMIT ?2",
        (behind.number, most),
    )
    head, doubts = behind, list[str]()
    for place, (*columns, digest) in enumerate(found):
        problem = mistake_in_row(head, columns, digest)
        if problem:
            return Verified(head, place, problem, doubts=tuple(doubts))
        if columns[KIND] == DOUBT:
            doubts += doubts_of(head, columns)
        head = Head(columns[0], digest)
    if len(found) == most:
        return Verified(head, most, doubts=tuple(doubts))
    problem = mistake_at_ends(db, head, end)
    return Verified(head, len(found), problem, is_end=True, doubts=tuple(doubts))


def hash_at(db: apsw.Connection, number: int) -> bytes | None:
    """Return the hash of a row, or of the last that was deleted; None: there is no such row."""
    sql = "SELECT hash FROM entries WHERE id = ?1 UNION ALL SELECT hash FROM anchor WHERE id = ?1"
    found = select(db, sql, (number,))
    return found[0][0] if found else None


def mistake_in_row(before: Head, columns: Sequence[Any], digest: bytes) -> str:
    """Return what is wrong with a row behind another; empty: nothing."""
    number, _, kind, _, intent, *_ = columns
    if number != before.number + 1 and (kind != DOUBT or number <= before.number):
        return missing(before, number)
    if hash_of(before.hash, *columns) != digest:
        return f"row {number} or the one before it was changed"
    if intent is not None and intent >= number:
        return f"row {number} is the end of a later row"
    return ""


def doubts_of(before: Head, columns: Sequence[Any]) -> list[str]:
    """Return what a row of kind `doubt` means; numbers of rows taken off are not used again."""
    number, said = columns[0], json.loads(columns[FIELDS])["reason"]
    gap = [missing(before, number)] if number != before.number + 1 else []
    return [*gap, f"row {number} says: {said}"]


def missing(before: Head, number: int) -> str:
    """Return what is wrong with a row that does not stand behind the one before it."""
    return f"row {number} stands behind row {before.number}: rows are missing between them"


def mistake_at_ends(db: apsw.Connection, head: Head, end: Head) -> str:
    """Return what is wrong with where the chain begins and ends; empty: nothing."""
    anchor = head_in(db, "anchor")
    cut = select(db, "SELECT fields FROM entries WHERE kind = 'cut' ORDER BY id DESC LIMIT 1")
    if head != end or head != head_in(db, "head"):
        return f"it ends at row {head.number}, and its end was row {end.number}"
    if anchor.number and (not cut or json.loads(cut[0][0])["to"] != str(anchor)):
        return f"rows up to {anchor.number} are missing, and no row says that they were deleted"
    return ""


def stored(row: Sequence[Any]) -> StoredRow:
    """Return a row of `ROWS`."""
    return StoredRow(*(*row[:-1], bool(row[-1])))


def select(db: apsw.Connection, sql: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
    """Return what a statement finds."""
    return db.execute(sql, tuple(values)).fetchall()
