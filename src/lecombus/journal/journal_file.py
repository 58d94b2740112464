"""The file of a journal: SQLite, one connection, used by one thread at a time.

Rules. WAL with `synchronous=FULL`, set at each open because the file does not keep the latter; no
mmap; the file is locked for this process, so no other one writes to it. Rows are only added, but
for the oldest, which are deleted when the file is as large as it may be: a row of kind `cut` and
the table `anchor` say up to where and with which hash, so that the rest can still be verified.

Room. `RESERVE_PAGES` of the file are always free, and so is as much of the WAL: what is written
uses these pages, so a full disk is noticed when the file cannot grow to replace them, before a row
is lost. From then on only vital rows are written, into that reserve: stops, ends, outcomes.

Everything here blocks for as long as the disk takes.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import apsw

from lecombus.journal.chain import ASKED, FIRST_HASH, Head, Row, hash_of, json_of, one_line
from lecombus.journal.kept import Fact, KeyRow, keep
from lecombus.journal.migration import STEPS, bring_to_disk, migrate
from lecombus.journal.reading import DOUBT, fact, hash_at, head_in, select

__all__ = ["FileSpace", "JournalFile", "JournalFileError"]

APPLICATION_ID: Final = 0x4C434A4C
"""`LCJL`, in the file's header."""
VERSION: Final = 1
MODE: Final = 0o640

PAGE_BYTES: Final = 4096
CACHE_KIB: Final = 512  # the usual 2 MiB fill for half an hour with pages that nobody reads again
RESERVE_PAGES: Final = 256  # 1 MiB
CHECKPOINT_FRAMES: Final = 96
"""The WAL was made `RESERVE_PAGES` long, and starts again behind each checkpoint."""
CUT_ROWS: Final = 400
SETTLED: Final = "begun"
"""Under this name the file keeps up to which row no intent is without an end."""
SETTLED_ROWS: Final = 1000
"""How many new rows until it is kept behind which row intents may have no end: the next opening
looks there only. Looking at 800,000 rows takes a second, and far longer from a slow SD card."""
LEAST_BYTES: Final = 4 * 1024 * 1024
SET_ASIDE_MOST: Final = 9

NOT_OURS: Final = "is not a journal of lecombus, and is left alone"

SCHEMA: Final = """
CREATE TABLE entries (
    id INTEGER PRIMARY KEY, time INTEGER NOT NULL, kind TEXT NOT NULL, drive TEXT NOT NULL,
    intent INTEGER, outcome TEXT NOT NULL, fields TEXT NOT NULL, hash BLOB NOT NULL
) STRICT;
CREATE INDEX outcomes ON entries (intent) WHERE intent IS NOT NULL;
CREATE INDEX times ON entries (time);
CREATE TABLE head (id INTEGER NOT NULL, hash BLOB NOT NULL) STRICT;
CREATE TABLE anchor (id INTEGER NOT NULL, hash BLOB NOT NULL) STRICT;
CREATE TABLE keys (
    name TEXT PRIMARY KEY, content BLOB NOT NULL, status INTEGER, type TEXT, body BLOB
) STRICT, WITHOUT ROWID;
CREATE TABLE facts (name TEXT PRIMARY KEY, text TEXT NOT NULL) STRICT, WITHOUT ROWID;
CREATE TABLE reserve (space BLOB NOT NULL) STRICT;
"""


T = TypeVar("T")


class JournalFileError(Exception):
    """The file cannot be used now; the text says why."""


@dataclass(frozen=True, slots=True)
class FileSpace:
    """How large a file is.

    Args:
        size_bytes: Of the file and its WAL.
        trouble: Why only vital rows can be written now; empty: all can.
    """

    size_bytes: int
    trouble: str


class JournalFile:
    """One journal's file.

    Args:
        path: Where it is.
        most_bytes: How large it may become, with its WAL.

    Attributes:
        head: The newest row.
        rows: How many rows were written since lecombus started, also into files of before.
        trouble: What was found wrong when it was opened, and was dealt with.
        kept: The copy of the file of an older version that was opened; empty: it was not.
    """

    def __init__(self, path: Path, most_bytes: int) -> None:
        self._path = path
        self._most_pages = max(most_bytes, LEAST_BYTES) // PAGE_BYTES - 2 * RESERVE_PAGES
        self._db: apsw.Connection | None = None
        self._is_open = False
        self._descriptor = -1
        self._inode = (0, 0)
        self._names: tuple[Path, ...] = ()
        self._files = 0
        self._open_intents: dict[int, None] = {}  # without an end, the oldest first
        self._settled = 0  # what the file keeps: no intent up to this row is without an end
        self._is_damaged = False
        self._room_trouble = ""
        self._has_reserve = False
        self._frames = 0
        self.head = Head()
        self.rows = 0
        self.trouble = ""
        self.kept = ""

    @property
    def path(self) -> Path:
        """The file itself, where a link leads now."""
        return Path(os.path.realpath(self._path))

    @property
    def is_open(self) -> bool:
        """Whether it was opened to the end; it may be full or broken all the same."""
        return self._is_open

    # ---- opening -----------------------------------------------------------------------------

    def open(self, now_ms: int) -> None:
        """Open it, or do nothing where it is open; make it where there is none.

        Intents without an end are given the outcome `unknown`.

        Raises:
            JournalFileError: It cannot be used.
        """
        if self._db is not None:
            self._check_place(self._db)
            return
        self._check_regular()
        known, files = self.head, self._files
        try:
            with self._in_words():
                self._open_or_set_aside(now_ms)
        except JournalFileError:
            self.close()
            self.head, self._files = known, files
            raise
        self._is_open = True

    def close(self) -> None:
        """Close it; it may be opened again."""
        db, self._db, self._is_open = self._db, None, False
        if db is not None:
            with contextlib.suppress(apsw.Error):
                db.close()
        if self._descriptor >= 0:  # not before: closing any descriptor of a file ends its locks
            os.close(self._descriptor)
            self._descriptor = -1

    def _open_or_set_aside(self, now_ms: int) -> None:
        try:
            if self._is_damaged:
                raise apsw.CorruptError
            self._open(now_ms)
        except apsw.NotADBError:
            self._refuse(NOT_OURS)
        except apsw.CorruptError:
            self.close()
            self._set_aside()
            self._open(now_ms)

    def _open(self, now_ms: int) -> None:
        is_new = not self.path.exists()
        self._descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, MODE)
        self._names = (self.path, self.path.with_name(f"{self.path.name}-wal"))
        db = self._db = apsw.Connection(str(self.path))
        db.pragma("locking_mode", "EXCLUSIVE")
        db.pragma("mmap_size", 0)
        db.pragma("cache_size", -CACHE_KIB)
        kind, version = db.pragma("application_id"), db.pragma("user_version")
        has_tables = db.execute("SELECT count(*) FROM sqlite_schema").get
        if has_tables and kind != APPLICATION_ID:
            self._refuse(NOT_OURS)
        if version > VERSION:
            self._refuse(
                f"is of version {version}, this lecombus knows {VERSION}: it is left alone; "
                "install the lecombus that wrote it, or name another file by `journal:`"
            )
        if not has_tables:
            db.pragma("page_size", PAGE_BYTES)
            db.pragma("auto_vacuum", 2)
        db.pragma("journal_mode", "wal")
        db.pragma("synchronous", 2)
        db.set_wal_hook(self._note_frames)  # in place of automatic checkpoints
        if not has_tables:
            self._make(db)
        elif version < VERSION:
            if version not in STEPS:
                self._refuse(f"is of version {version}, which no lecombus wrote")
            self.kept = str(migrate(db, self.path, version, VERSION))
        if is_new:
            bring_to_disk(self.path.parent)
        found = self.path.stat()
        self._inode = (found.st_dev, found.st_ino)
        self._take_up(db, now_ms, is_new=is_new)
        self._has_reserve = False

    def _make(self, db: apsw.Connection) -> None:
        with db:
            db.execute(SCHEMA)
            db.execute("INSERT INTO head VALUES (0, ?1)", (FIRST_HASH,))
            db.execute("INSERT INTO anchor VALUES (0, ?1)", (FIRST_HASH,))
            db.pragma("application_id", APPLICATION_ID)
            db.pragma("user_version", VERSION)

    def _take_up(self, db: apsw.Connection, now_ms: int, *, is_new: bool) -> None:
        """Find the end of the chain, and end what has no end."""
        known, is_first = self.head, not self._files
        said, anchor = head_in(db, "head"), head_in(db, "anchor")
        last = select(db, "SELECT id, hash FROM entries ORDER BY id DESC LIMIT 1")
        found, why = Head(*last[0]) if last else anchor, ""
        if found != said:
            why = f"it ends at row {found.number}, and its end was row {said.number}"
        elif not is_first and hash_at(db, known.number) != known.hash:
            why = f"it was replaced by another one while it was in use; its end was {known}"
        self.head = Head(max(found.number, said.number), found.hash)
        if is_first or is_new or why:
            self._files += 1
            self._open_intents.clear()
            self._settled = self.head.number
        rows = self._without_end(db, known.number, now_ms)
        if why:
            rows.insert(0, Row(DOUBT, "", {"reason": why}, now_ms))
            self.trouble = why
        self._commit(rows, (Fact(SETTLED, str(self._settled)),) if is_first else ())

    def _without_end(self, db: apsw.Connection, after: int, now_ms: int) -> list[Row]:
        """Return the ends of intents that have none, behind a row that was known before."""
        after = min(max(after, int(fact(db, SETTLED) or 0)), self.head.number)
        open_ones: list[tuple[Any, ...]] = db.execute(
            "SELECT id, kind, drive FROM entries AS asked WHERE id > ?1 AND outcome = ?2 "
            "AND NOT EXISTS (SELECT 1 FROM entries WHERE intent = asked.id) ORDER BY id",
            (after, ASKED),
        ).fetchall()
        rows = []
        for number, kind, drive in open_ones:
            intent = Row(kind, drive, {}, 0)
            intent.number, intent.file = number, self._files
            why = {"reason": "lecombus ended before the outcome was recorded"}
            rows.append(Row(kind, drive, why, now_ms, "unknown", intent, is_vital=True))
        return rows

    def _check_regular(self) -> None:
        """Refuse what is not a regular file: opening alone does something to some devices."""
        try:
            mode = self.path.stat().st_mode
        except FileNotFoundError:
            if self.path.parent.is_dir():
                return
            raise JournalFileError(f"{self.path.parent} does not exist") from None
        except OSError as exc:
            raise JournalFileError(f"{self._path} cannot be opened: {exc.strerror}") from exc
        if not stat.S_ISREG(mode):
            raise JournalFileError(f"{self._path} is not a regular file")

    def _check_place(self, db: apsw.Connection) -> None:
        """See that the file has not been removed or replaced since it was opened."""
        there = (0, 0)
        with contextlib.suppress(OSError):
            found = self._path.stat()
            there = found.st_dev, found.st_ino
        if there != self._inode:
            # SQLite leaves the WAL of a moved file under the old name: its rows would be missing
            # there, and be written over another file that has the name now.
            with contextlib.suppress(apsw.Error):
                db.wal_checkpoint(mode=apsw.SQLITE_CHECKPOINT_TRUNCATE)
            self.close()
            raise JournalFileError(f"{self._path} was removed or replaced while it was in use")

    def _refuse(self, why: str) -> None:
        self.close()
        raise JournalFileError(f"{self._path} {why}")

    def _set_aside(self) -> None:
        """Give a damaged file, and its WAL, another name."""
        path = self.path
        names = [path.with_name(f"{path.name}.damaged-{n}") for n in range(1, SET_ASIDE_MOST + 1)]
        aside = next((name for name in names if not name.exists()), names[-1])
        try:
            path.replace(aside)
            with contextlib.suppress(FileNotFoundError):
                path.with_name(f"{path.name}-wal").replace(f"{aside}-wal")
        except OSError as exc:
            text = f"{self._path} is damaged and cannot be set aside: {exc.strerror}"
            raise JournalFileError(text) from exc
        self._is_damaged = False
        self.trouble = f"it was damaged and is {aside.name} now; a new one was begun"

    # ---- writing -----------------------------------------------------------------------------

    def write(self, rows: Sequence[Row], others: Sequence[KeyRow | Fact], now_ms: int) -> bool:
        """Add rows in their order, all or none; bring them to the disk.

        Returns:
            Whether all were written; otherwise only the vital rows were.

        Raises:
            JournalFileError: None was written.
        """
        self.open(now_ms)
        wanted = [row for row in rows if not row.is_withdrawn]
        if self._room_trouble:
            chosen, others = [row for row in wanted if row.is_vital], ()
        else:
            chosen = wanted
        with self._in_words():
            try:
                self._commit(chosen, others)
            except apsw.FullError:
                self._room_trouble = self._room_trouble or f"there is no room for {self._path}"
                raise
        return not self._room_trouble

    def tidy(self) -> FileSpace:
        """Empty the WAL where it is long, and see to it that there is room.

        After each opening the WAL is made as long as it will ever be.

        Raises:
            JournalFileError: The disk fails.
        """
        db = self._db
        if db is None:
            return FileSpace(self.size(), self._room_trouble)
        with self._in_words():
            if self._frames >= CHECKPOINT_FRAMES:
                self._checkpoint(db)
            self._make_room(db)
        return FileSpace(self.size(), self._room_trouble)

    def size(self) -> int:
        """Return the size of the file and its WAL, bytes."""
        total = 0
        for name in self._names:
            with contextlib.suppress(OSError):
                total += name.stat().st_size
        return total

    def _commit(
        self, rows: Sequence[Row], others: Sequence[KeyRow | Fact], *, cut: Head | None = None
    ) -> None:
        """Add rows, and delete those up to `cut`, in one transaction."""
        assert self._db is not None
        db, head = self._db, self.head
        numbers: dict[Row, Head] = {}
        with db:
            if cut is not None:
                db.execute("DELETE FROM entries WHERE id <= ?1", (cut.number,))
                db.execute("UPDATE anchor SET id = ?1, hash = ?2", (cut.number, cut.hash))
            for row in rows:
                head = numbers[row] = self._insert(db, head, row, numbers)
            if rows:
                db.execute("UPDATE head SET id = ?1, hash = ?2", (head.number, head.hash))
            for other in others:
                keep(db, other)
            if (settled := self._settles()) is not None:
                keep(db, Fact(SETTLED, str(settled)))
        self.head, self._settled = head, self._settled if settled is None else settled
        self.rows += len(rows)
        for row, its in numbers.items():
            row.number, row.file = its.number, self._files
            if row.outcome == ASKED:
                self._open_intents[row.number] = None
            elif row.intent is not None and row.intent.file == self._files:
                self._open_intents.pop(row.intent.number, None)
            if row.intent is not None and not row.intent.number:
                row.intent.is_withdrawn = True  # its end has its fields

    def _settles(self) -> int | None:
        """Return a row up to which no intent is without an end, when it is time to keep that."""
        settled = next(iter(self._open_intents), self.head.number + 1) - 1
        return settled if settled - self._settled >= SETTLED_ROWS else None

    def _insert(self, db: apsw.Connection, head: Head, row: Row, numbers: dict[Row, Head]) -> Head:
        """Add a row behind the newest one."""
        intent: int | None = None
        if row.intent in numbers:
            intent = numbers[row.intent].number
        elif row.intent is not None and row.intent.file == self._files:
            intent = row.intent.number or None
        fields = row.fields if intent is not None or row.intent is None else {
            **row.intent.fields, **row.fields
        }  # fmt: skip
        number, kind, drive = head.number + 1, one_line(row.kind), one_line(row.drive)
        outcome, text = one_line(row.outcome), json_of(fields)
        columns = (number, row.time_ms, kind, drive, intent, outcome, text)
        digest = hash_of(head.hash, *columns)
        db.execute("INSERT INTO entries VALUES (?, ?, ?, ?, ?, ?, ?, ?)", (*columns, digest))
        return Head(number, digest)

    def _make_room(self, db: apsw.Connection) -> None:
        free, pages = db.pragma("freelist_count"), db.pragma("page_count")
        if pages - free > self._most_pages - RESERVE_PAGES:
            self._cut(db)
        elif free < RESERVE_PAGES or self._room_trouble or not self._has_reserve:
            self._try_to_grow(db)
        elif pages > self._most_pages and free > 2 * RESERVE_PAGES:
            db.execute(f"PRAGMA incremental_vacuum({RESERVE_PAGES})").fetchall()

    def _try_to_grow(self, db: apsw.Connection) -> None:
        """Give the file more free pages, where the disk has room for them."""
        try:
            self._grow(db)
        except (apsw.FullError, apsw.IOError, OSError) as exc:
            why = exc.strerror if isinstance(exc, OSError) else exc
            self._room_trouble = f"there is no room for {self._path}: {why}"
        else:
            self._room_trouble = ""

    def _grow(self, db: apsw.Connection) -> None:
        """Use pages and free them, so that file and WAL have them from then on.

        The space for them is taken from the disk before: a WAL that cannot be emptied into the
        file could take no further row.
        """
        self._checkpoint(db)
        size = RESERVE_PAGES * PAGE_BYTES
        wanted = (db.pragma("page_count") + RESERVE_PAGES) * PAGE_BYTES + size // 16
        os.posix_fallocate(self._descriptor, 0, wanted)
        with db:
            db.execute("DELETE FROM reserve")  # it may be there from a run that was killed
            db.execute("INSERT INTO reserve VALUES (zeroblob(?1))", (size,))
        self._checkpoint(db)
        with db:
            db.execute("DELETE FROM reserve")
        self._checkpoint(db)
        self._has_reserve = True

    def _checkpoint(self, db: apsw.Connection) -> None:
        db.wal_checkpoint(mode=apsw.SQLITE_CHECKPOINT_PASSIVE)
        self._frames = 0

    def _cut(self, db: apsw.Connection) -> None:
        """Delete the oldest rows, and say so in the chain."""
        found: list[tuple[Any, ...]] = db.execute(
            "SELECT id, hash, time FROM entries ORDER BY id LIMIT ?1", (CUT_ROWS,)
        ).fetchall()
        if len(found) < CUT_ROWS:
            return  # so few rows are not what the room is needed for
        number, digest, time_ms = found[-1]
        now_ms = int(db.execute("SELECT max(time) FROM entries").get or 0)
        fields = {"to": str(Head(number, digest)), "rows": str(len(found)), "time_ms": str(time_ms)}
        row = Row("cut", "", fields, now_ms, is_vital=True)
        self._commit([row], (), cut=Head(number, digest))

    def _note_frames(self, _: apsw.Connection, __: str, frames: int) -> int:
        self._frames = frames
        return apsw.SQLITE_OK

    def ask(self, question: Callable[[apsw.Connection], T]) -> T:
        """Read from the file.

        Raises:
            JournalFileError: It cannot be read.
        """
        if self._db is None:
            raise JournalFileError(f"{self._path} is not open")
        with self._in_words():
            return question(self._db)

    @contextlib.contextmanager
    def _in_words(self) -> Iterator[None]:
        """Say in words what SQLite or the system refuse; the file is opened again then."""
        try:
            yield
        except apsw.CorruptError as exc:
            self._is_damaged = True
            self.close()
            raise JournalFileError(f"{self._path} is damaged: {exc}") from exc
        except apsw.BusyError as exc:
            self.close()
            raise JournalFileError(f"{self._path} is in use by another program") from exc
        except apsw.FullError as exc:
            raise JournalFileError(f"there is no room for {self._path}: {exc}") from exc
        except apsw.Error as exc:
            self.close()
            raise JournalFileError(f"{self._path} cannot be used: {exc}") from exc
        except OSError as exc:
            self.close()
            raise JournalFileError(f"{self._path} cannot be used: {exc.strerror}") from exc
