"""The journal as the event loop sees it: rows go in without waiting for a disk.

Strategy: `record` and `conclude` put a row into a list, and a thread (`file_thread`) writes what is
in the list, as one transaction. `intend` has it written now, and `committed` waits for that; what
comes during a transaction goes into the next one. One transaction is under way at a time, so rows
stand in the order in which they came, and one flush of the disk serves all that wait.

A failing disk: rows stay in the list, `PENDING_MOST` of them; those beyond are counted. Everything
that waits gets the reason then and waits no more until a later attempt succeeds. An attempt is
made every `RETRY_S`; a transaction that takes longer than `HANGS_AFTER_S` counts as failing.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

import apsw

from lecombus.journal import reading
from lecombus.journal.chain import ASKED, Head, Row
from lecombus.journal.file_thread import FileThread
from lecombus.journal.journal_file import FileSpace, JournalFile, JournalFileError
from lecombus.journal.kept import Fact, KeyRow
from lecombus.journal.reading import StoredRow, Verified

__all__ = ["Journal", "JournalFigures", "Verification"]

logger = logging.getLogger(__name__)

FLUSH_S: Final = 0.05
"""How long a row that nothing waits for may stay in the list, seconds."""
RETRY_S: Final = 2.0
HANGS_AFTER_S: Final = 2.0
"""A transaction of a slow SD card takes 0.2 s; the slowest that was measured took 1 s."""
END_S: Final = 3.0
HEAD_S: Final = 3600.0
TICK_S: Final = 0.5

COUNT_S: Final = 60.0
"""Over so long equal things are counted, seconds."""
COUNTED_MOST: Final = 500

PENDING_MOST: Final = 5000
BATCH_ROWS: Final = 250
VERIFY_ROWS: Final = 200
"""Rows verified before other tasks and other rows have their turn: about a millisecond."""

NOT_OPEN: Final = "it is not open yet"

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class JournalFigures:
    """What the metrics show of a journal.

    Args:
        size_bytes: Of the file and its WAL.
        rows: Rows written since the start, also into a file that was removed since.
        works: Everything can be written.
        failures: How often it began to fail.
        missed: Rows that were lost because it failed for long.
    """

    size_bytes: int
    rows: int
    works: bool
    failures: int
    missed: int


@dataclass(frozen=True, slots=True)
class Verification:
    """Whether a journal is whole.

    Args:
        rows: How many rows were followed.
        first: The last row that was deleted because of the size: the chain begins behind it.
        head: The last row that is right.
        problem: What is wrong behind it; empty: nothing.
    """

    rows: int
    first: Head
    head: Head
    problem: str


@dataclass(slots=True)
class _Counted:
    """Things that one row stands for."""

    begun_s: float
    count: int
    fields: Mapping[str, str]


class Journal:
    """One line's journal.

    Args:
        path: Its file.
        most_bytes: How large the file may become.
        wall: The time of day, Unix seconds.

    Attributes:
        trouble: Why rows cannot be written now; empty: they can.
        head_logged: Given the newest row each time it is logged.
    """

    def __init__(
        self,
        path: Path,
        most_bytes: int,
        wall: Callable[[], float],
    ) -> None:
        self._path = path
        self._file = JournalFile(path, most_bytes)
        self._clock = asyncio.get_running_loop().time
        self._wall = wall
        self._thread = FileThread()
        self._pending: deque[Row] = deque()
        self._others: deque[KeyRow | Fact] = deque()
        self._waiting: dict[Row | KeyRow | Fact, asyncio.Future[None]] = {}
        self._in_flight_since_s: float | None = None
        self._idle = asyncio.Event()
        self._idle.set()
        self._timer: asyncio.TimerHandle | None = None
        self._try_at_s = 0.0
        self._failures = self._missed = self._size = 0
        self._counted: dict[tuple[str, str, str], _Counted] = {}
        self._found = ""
        self._say: Callable[[str | None], None] = lambda text: None
        self.trouble = NOT_OPEN
        self.head_logged: Callable[[str], None] = lambda head: None

    @classmethod
    async def opened(
        cls,
        path: Path,
        most_bytes: int,
        wall: Callable[[], float],
    ) -> Journal:
        """Return a journal; where its file cannot be opened, one that tries again later."""
        journal = cls(path, most_bytes, wall)
        opening = journal._thread.ask(partial(journal._file.open, journal._now_ms()))
        try:
            await asyncio.wait_for(asyncio.shield(opening), HANGS_AFTER_S)
        except TimeoutError:
            journal._fail(f"{path} could not be opened within {HANGS_AFTER_S:.0f} s")
        except JournalFileError as exc:
            journal._fail(str(exc))
        else:
            journal.trouble = ""
            journal._look_at_file()
            journal._thread.submit(journal._file.tidy, journal._tidied)
        return journal

    # ---- what happens ------------------------------------------------------------------------

    def record(
        self,
        kind: str,
        drive: str = "",
        fields: Mapping[str, str] | None = None,
        *,
        outcome: str = "",
        is_vital: bool = False,
    ) -> None:
        """Add a row soon; waits for nothing.

        Args:
            kind: What happened.
            drive: The drive or group; empty where none is concerned.
            fields: What is to be known of it.
            outcome: How it ended; empty where that says nothing.
            is_vital: It is written into the reserve where the disk is full.
        """
        self._add(Row(kind, drive, fields or {}, self._now_ms(), outcome, None, is_vital))

    def count(self, kind: str, drive: str, fields: Mapping[str, str], who: str) -> None:
        """Count a refusal of which there are many; one row a minute says how many there were.

        Args:
            kind: What was refused.
            drive: The drive or group.
            fields: What is to be known of it; those of the last one are kept.
            who: Of whom; others are counted apart.
        """
        key = kind, drive, who
        if key not in self._counted and len(self._counted) >= COUNTED_MOST:
            self._record_counted(0.0)
        counted = self._counted.setdefault(key, _Counted(self._clock(), 0, fields))
        counted.count, counted.fields = counted.count + 1, fields

    def _record_counted(self, after_s: float) -> None:
        """Record what was counted for so long."""
        now_s = self._clock()
        for key, counted in list(self._counted.items()):
            if now_s - counted.begun_s >= after_s:
                del self._counted[key]
                fields = {"count": str(counted.count), **counted.fields}
                self.record(key[0], key[1], fields, outcome="refused")

    def intend(
        self, kind: str, drive: str, fields: Mapping[str, str], *, is_vital: bool = False
    ) -> Row:
        """Add a row about something that is about to be done; see `committed` and `conclude`."""
        row = Row(kind, drive, fields, self._now_ms(), ASKED, None, is_vital)
        self._add(row)
        return row

    async def committed(self, intent: Row) -> None:
        """Wait until an intent is on the disk.

        Raises:
            JournalFileError: It is not, and waiting longer has no purpose. The row is written
                later, unless it is withdrawn.
        """
        if not intent.number:
            await self._written_once(intent)

    def withdraw(self, intent: Row) -> None:
        """Do not write an intent that is not written yet: its end says all of it."""
        intent.is_withdrawn = True

    def conclude(self, intent: Row, outcome: str, fields: Mapping[str, str]) -> None:
        """Add how an intent ended; waits for nothing."""
        is_vital = intent.is_vital or intent.number > 0
        self._add(Row(intent.kind, intent.drive, fields, self._now_ms(), outcome, intent, is_vital))

    def keep(self, other: KeyRow | Fact) -> None:
        """Keep what is not a row; waits for nothing, and is written no later than the next row."""
        self._others.append(other)
        if len(self._others) > PENDING_MOST:
            self._others.popleft()
        self._flush_soon()

    async def keep_now(self, other: KeyRow) -> None:
        """Keep what is not a row, and wait until it is on the disk.

        Raises:
            JournalFileError: It is not, and waiting longer has no purpose.
        """
        self.keep(other)
        await self._written_once(other)

    # ---- reading -----------------------------------------------------------------------------

    async def rows_after(
        self, *, after: int, since_ms: int, drives: Sequence[str], most: int
    ) -> tuple[list[StoredRow], int | None]:
        """Return rows in their order (`reading.rows_after`)."""
        return await self._ask(
            lambda db: reading.rows_after(
                db, after=after, since_ms=since_ms, drives=drives, most=most
            )
        )

    async def last_rows(self, *, drives: Sequence[str], most: int) -> list[StoredRow]:
        """Return the newest rows in their order (`reading.last_rows`)."""
        return await self._ask(lambda db: reading.last_rows(db, drives=drives, most=most))

    async def keys(self) -> list[KeyRow]:
        """Return the requests with an `Idempotency-Key` that are kept.

        Raises:
            JournalFileError: They cannot be read now.
        """
        return await self._ask_if_open(
            lambda db: [KeyRow(*row) for row in reading.select(db, "SELECT * FROM keys")]
        )

    async def fact(self, name: str) -> str | None:
        """Return the text kept under a name.

        Raises:
            JournalFileError: It cannot be read now.
        """
        return await self._ask_if_open(lambda db: reading.fact(db, name))

    async def verify(self, logged: Head | None = None) -> Verification:
        """Follow the whole chain, a little at a time.

        Args:
            logged: A head that was logged before: it must be in the chain.

        Raises:
            JournalFileError: It cannot be read.
        """
        first = at = await self._ask(lambda db: reading.head_in(db, "anchor"))
        rows, doubts = 0, list[str]()
        while True:
            found = await self._ask(partial(self._verified, at))
            rows, at, problem = rows + found.rows, found.head, found.problem
            doubts += found.doubts
            if problem and (anchor := await self._anchor()).number > first.number:
                first, at, rows = anchor, anchor, 0  # it was cut during this: begin again
                doubts.clear()
                continue
            if problem or found.is_end:
                break
            await asyncio.sleep(0.002)
        if logged is not None and not problem:
            problem = await self._mistake_at_head(logged, first)
        if doubts and not problem:
            problem = "no other row is wrong"
        return Verification(rows, first, at, "; ".join(filter(None, (*doubts, problem))))

    @property
    def head(self) -> Head:
        """The newest row."""
        return self._file.head

    @property
    def remark(self) -> str | None:
        """What a person must know of the journal; None: all is well."""
        parts = dict.fromkeys(part for part in (self._found, self.trouble) if part)
        return f"the journal: {'; '.join(parts)}" if parts else None

    def figures(self) -> JournalFigures:
        """Return what the metrics show."""
        return JournalFigures(
            self._size, self._file.rows, not self.trouble, self._failures, self._missed
        )

    # ---- running -----------------------------------------------------------------------------

    async def run(self, say: Callable[[str | None], None]) -> None:
        """Try again after a failure, and log the newest row hourly, until cancelled.

        Args:
            say: Given what a person must know of the journal, or None when there is nothing.
        """
        self._say = say
        self._say(self.remark)
        head_at_s = self._clock()
        while True:
            now_s = self._clock()
            since_s = self._in_flight_since_s
            if since_s is not None and now_s - since_s > HANGS_AFTER_S and not self.trouble:
                self._fail(f"the disk has not taken {self._path} for {HANGS_AFTER_S:.0f} s")
            if self.trouble and since_s is None and now_s >= self._try_at_s:
                self._flush()
            self._record_counted(COUNT_S)
            if now_s >= head_at_s and self._knows_head:
                head_at_s = now_s + HEAD_S
                self.log_head()
            await asyncio.sleep(TICK_S)

    @property
    def _knows_head(self) -> bool:
        """Whether the file was open; else its newest row is not known, and none must be logged."""
        return not self.trouble or self.head.number > 0

    def log_head(self) -> None:
        """Log the newest row: with it, `verify` shows whether rows were taken off at the end."""
        logger.info("event=journal-head head=%s file=%s", self.head, self._path)
        self.head_logged(str(self.head))

    async def close(self) -> None:
        """Write what is left and close the file; a disk that hangs is not waited for."""
        try:
            self._record_counted(0.0)
            async with asyncio.timeout(END_S):
                self._flush()
                while self._in_flight_since_s is not None:  # each transaction begins the next one
                    await self._idle.wait()
                if self._knows_head:
                    self.log_head()
                await self._thread.ask(self._file.close)
        except TimeoutError:
            logger.warning("event=journal-not-closed file=%s reason=its disk hangs", self._path)

    # ---- inside ------------------------------------------------------------------------------

    async def _written_once(self, item: Row | KeyRow) -> None:
        """Have what is in the list written now, and wait until an item of it is."""
        if self.trouble:
            raise JournalFileError(self.trouble)
        future = self._waiting[item] = asyncio.get_running_loop().create_future()
        self._flush()
        try:
            await future
        finally:
            self._waiting.pop(item, None)

    def _now_ms(self) -> int:
        return round(self._wall() * 1000)

    def _add(self, row: Row) -> None:
        self._pending.append(row)
        if len(self._pending) > PENDING_MOST:
            lost = next((one for one in self._pending if not one.is_vital), self._pending[0])
            self._pending.remove(lost)
            self._missed += 1
        self._flush_soon()

    def _flush_soon(self) -> None:
        if self._timer is None and not self.trouble:
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(FLUSH_S, self._flush)

    def _flush(self) -> None:
        """Have the thread write what is in the list, unless it is writing."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._in_flight_since_s is not None or not (self._pending or self._others):
            return
        rows = self._next_rows()
        others, self._others = list(self._others), deque()  # a key before the intent of its request
        self._in_flight_since_s = self._clock()
        self._idle.clear()
        self._thread.submit(
            partial(self._file.write, rows, others, self._now_ms()),
            partial(self._written, rows, others),
        )

    def _next_rows(self) -> list[Row]:
        """Take from the list what is written next, in its order.

        A full disk takes vital rows alone, and the others stay in the list: so while the journal
        fails, the vital rows behind them are taken too.
        """
        rows = [self._pending.popleft() for _ in range(min(BATCH_ROWS, len(self._pending)))]
        if self.trouble and len(self._pending):
            vital = [row for row in self._pending if row.is_vital][:BATCH_ROWS]
            taken = set(vital)
            self._pending = deque(row for row in self._pending if row not in taken)
            rows += vital
        return rows

    def _written(
        self,
        rows: list[Row],
        others: list[KeyRow | Fact],
        complete: bool | None,
        error: Exception | None,
    ) -> None:
        """Take the end of a transaction, and begin the next one."""
        self._in_flight_since_s = None
        self._idle.set()
        if not complete:
            self._pending.extendleft(
                row for row in reversed(rows) if not row.number and not row.is_withdrawn
            )
            self._others.extendleft(reversed(others))
        for item in (*(row for row in rows if row.number), *(others if complete else ())):
            future = self._waiting.get(item)
            if future is not None and not future.done():
                future.set_result(None)
        if error is not None:
            if not isinstance(error, JournalFileError):
                logger.error("event=journal-mistake reason=%s", error, exc_info=error)
            self._fail(str(error))
            return
        self._thread.submit(self._file.tidy, self._tidied)
        if complete:
            self._works()
            self._flush()

    def _tidied(self, room: FileSpace | None, error: Exception | None) -> None:
        if room is not None:
            self._size = room.size_bytes
        reason = str(error) if error is not None else "" if room is None else room.trouble
        if reason:
            self._fail(reason)

    def _fail(self, reason: str) -> None:
        """Take that rows cannot be written now."""
        self._try_at_s = self._clock() + RETRY_S
        is_new = self.trouble in ("", NOT_OPEN)
        if reason != self.trouble:
            logger.warning("event=journal-failing reason=%s", reason)
        self.trouble = reason
        if is_new:
            self._failures += 1
            self._add(Row("journal-failing", "", {"reason": reason}, self._now_ms()))
        for future in self._waiting.values():
            if not future.done():
                future.set_exception(JournalFileError(reason))
        self._say(self.remark)

    def _works(self) -> None:
        """Take that everything in a transaction was written."""
        if not self.trouble:
            return
        self.trouble = ""
        logger.info("event=journal-works file=%s missed=%d", self._path, self._missed)
        fields = {"missed": str(self._missed)} if self._missed else {}
        self._add(Row("journal-works", "", fields, self._now_ms()))
        self._look_at_file()

    def _look_at_file(self) -> None:
        """Take what was found when the file was opened."""
        if self._file.trouble and self._file.trouble != self._found:
            self._found = self._file.trouble
            logger.warning("event=journal-doubt file=%s reason=%s", self._path, self._found)
        if self._file.kept:
            logger.info("event=journal-migrated file=%s kept=%s", self._path, self._file.kept)
            self._file.kept = ""
        self._say(self.remark)

    async def _ask(self, question: Callable[[apsw.Connection], T]) -> T:
        async with asyncio.timeout(HANGS_AFTER_S * 5):
            return await self._thread.ask(partial(self._file.ask, question))

    async def _ask_if_open(self, question: Callable[[apsw.Connection], T]) -> T:
        """Read from the file, where the thread does not hang in opening it.

        Raises:
            JournalFileError: It cannot be read now.
        """
        if not self._file.is_open:
            raise JournalFileError(self.trouble)
        try:
            return await self._ask(question)
        except TimeoutError:
            raise JournalFileError(f"{self._path} does not answer") from None

    def _verified(self, behind: Head, db: apsw.Connection) -> Verified:
        """Verify some rows; runs in the thread, where no row is added."""
        return reading.verify_rows(db, behind=behind, end=self._file.head, most=VERIFY_ROWS)

    async def _anchor(self) -> Head:
        return await self._ask(lambda db: reading.head_in(db, "anchor"))

    async def _mistake_at_head(self, logged: Head, first: Head) -> str:
        """Return what is wrong where a head was logged once; empty: it is in the chain."""
        if logged.number < first.number:
            return f"row {logged.number} was deleted because of the size: it cannot be compared"
        found = await self._ask(lambda db: reading.hash_at(db, logged.number))
        if found is None:
            return f"row {logged.number} is missing: rows at the end were removed"
        return "" if found == logged.hash else f"row {logged.number} is not the one that was logged"
