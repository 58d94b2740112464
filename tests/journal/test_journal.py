"""What goes into a journal waits for no disk, and what waits for it does not wait for ever."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sqlite3
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from lecombus.journal import journal as module
from lecombus.journal.chain import Head, Row
from lecombus.journal.journal import Journal
from lecombus.journal.journal_file import JournalFile, JournalFileError
from lecombus.journal.kept import KeyRow

pytestmark = pytest.mark.clock

MOST = 16_000_000


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RETRY_S", 0.05)
    monkeypatch.setattr(module, "TICK_S", 0.02)


class Disk:
    """The file's thread stops in each write until it is let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.works = threading.Event()
        self.works.set()
        self.batches: list[int] = []
        usual = JournalFile.write

        def write(file: JournalFile, rows: list[Row], *rest: Any) -> bool:
            self.batches.append(len(rows))
            self.works.wait(30)
            return usual(file, rows, *rest)

        monkeypatch.setattr(JournalFile, "write", write)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


Scenario = Callable[[Journal], Awaitable[None]]


def with_journal(path: Path, scenario: Scenario) -> list[str | None]:
    """Run a scenario with an open journal; return what was said of it."""
    said: list[str | None] = []

    async def main() -> None:
        journal = await Journal.opened(path, MOST, time.time)
        running = asyncio.create_task(journal.run(said.append))
        await scenario(journal)
        running.cancel()
        await journal.close()

    asyncio.run(main())
    return said


async def until(what: Callable[[], object]) -> None:
    async with asyncio.timeout(30):
        while not what():  # noqa: ASYNC110 - a thread's work
            await asyncio.sleep(0.005)


async def kinds(journal: Journal) -> list[str]:
    rows, _ = await journal.rows_after(after=0, since_ms=0, drives=[], most=500)
    return [row.kind for row in rows]


def test_an_intent_is_on_the_disk_once_it_was_waited_for(tmp_path: Path) -> None:
    async def scenario(journal: Journal) -> None:
        intent = journal.intend("write", "feeder", {"code": "C0046"})
        assert intent.number == 0
        await journal.committed(intent)
        assert await kinds(journal) == ["write"]
        journal.conclude(intent, "done", {"reason": "x"})
        await until(lambda: journal.head.number == 2)
        (row,) = await journal.last_rows(drives=["feeder"], most=1)
        assert (row.intent, row.outcome, row.whole()) == (
            1,
            "done",
            {"code": "C0046", "reason": "x"},
        )

    with_journal(tmp_path / "j", scenario)


def test_equal_refusals_have_one_row_with_their_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "COUNT_S", 0.2)

    async def scenario(journal: Journal) -> None:
        for number in range(40):
            journal.count("write", "ab"[number % 4 == 0], {"code": f"C00{number}"}, "plc")
        await until(lambda: journal.head.number == 2)
        rows, _ = await journal.rows_after(after=0, since_ms=0, drives=[], most=500)
        assert [(one.drive, one.outcome, json.loads(one.fields)) for one in rows] == [
            ("b", "refused", {"count": "10", "code": "C0036"}),
            ("a", "refused", {"count": "30", "code": "C0039"}),
        ]
        journal.count("write", "a", {}, "plc")  # the end of lecombus loses none

    with_journal(tmp_path / "j", scenario)
    again: list[int] = []

    async def look(journal: Journal) -> None:
        again.append(journal.head.number)

    with_journal(tmp_path / "j", look)
    assert again == [3]


def test_what_comes_during_a_transaction_shares_the_next(tmp_path: Path, disk: Disk) -> None:
    async def scenario(journal: Journal) -> None:
        disk.works.clear()
        first = asyncio.create_task(journal.committed(journal.intend("write", "a", {})))
        await until(lambda: disk.batches)
        others = [journal.intend("write", "a", {"n": str(n)}) for n in range(100)]
        waits = [asyncio.create_task(journal.committed(one)) for one in others]
        await asyncio.sleep(0)
        disk.works.set()
        await asyncio.gather(first, *waits)
        assert disk.batches == [1, 100]
        assert [one.number for one in others] == list(range(2, 102))

    with_journal(tmp_path / "j", scenario)


def test_a_disk_that_hangs_counts_as_failing_and_comes_back(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "HANGS_AFTER_S", 0.1)

    async def scenario(journal: Journal) -> None:
        await until(lambda: not journal.trouble)
        disk.works.clear()
        intent = journal.intend("write", "a", {})
        with pytest.raises(JournalFileError, match="has not taken"):
            await journal.committed(intent)
        later = journal.intend("write", "b", {})
        with pytest.raises(JournalFileError):  # waits no more
            await journal.committed(later)
        journal.withdraw(later)
        journal.conclude(later, "refused", {"reason": "y"})
        stop = journal.intend("stop", "a", {}, is_vital=True)
        journal.conclude(stop, "verified", {})
        assert not journal.figures().works
        disk.works.set()
        await until(lambda: not journal.trouble)
        await until(lambda: journal.head.number >= 6)
        rows, _ = await journal.rows_after(after=0, since_ms=0, drives=[], most=500)
        told = [(row.kind, row.drive, row.outcome) for row in rows]
        assert told[:2] == [("write", "a", "asked"), ("journal-failing", "", "")]
        assert ("write", "b", "refused") in told
        assert ("write", "b", "asked") not in told
        assert [one[2] for one in told if one[0] == "stop"] == ["asked", "verified"]
        assert (await journal.verify()).problem == ""
        assert journal.figures().failures == 1

    said = with_journal(tmp_path / "j", scenario)
    assert said[-1] is None
    assert any("has not taken" in (text or "") for text in said)


def test_a_journal_that_cannot_be_opened_is_tried_again(tmp_path: Path) -> None:
    path = tmp_path / "missing" / "j"

    async def scenario(journal: Journal) -> None:
        assert "does not exist" in journal.trouble
        journal.record("start")
        with pytest.raises(JournalFileError):
            await journal.committed(journal.intend("write", "a", {}))
        with pytest.raises(JournalFileError):
            await journal.last_rows(drives=[], most=1)
        path.parent.mkdir()
        await until(lambda: not journal.trouble)
        await until(lambda: journal.head.number == 4)
        assert await kinds(journal) == ["journal-failing", "start", "write", "journal-works"]

    with_journal(path, scenario)


def test_the_count_of_rows_never_falls_also_when_the_file_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "j"

    async def scenario(journal: Journal) -> None:
        for number in range(20):
            journal.record("trip", "a", {"number": str(number)})
        await until(lambda: journal.head.number == 20)
        assert journal.figures().rows == 20
        path.unlink()
        for name in ("j-wal", "j-shm"):
            (tmp_path / name).unlink(missing_ok=True)
        journal.record("trip-ended", "a")
        await until(lambda: journal.trouble)
        await until(lambda: not journal.trouble and journal.head.number >= 3)
        assert journal.head.number < 20
        assert journal.figures().rows == 20 + journal.head.number

    with_journal(path, scenario)


def test_a_list_that_grows_too_long_loses_rows_and_counts_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PENDING_MOST", 10)
    path = tmp_path / "missing" / "j"

    async def scenario(journal: Journal) -> None:
        stop = journal.intend("stop", "a", {}, is_vital=True)
        for number in range(30):
            journal.record("trip", "a", {"number": str(number)})
        journal.conclude(stop, "verified", {})
        assert journal.figures().missed == 23
        path.parent.mkdir()
        await until(lambda: "journal-works" in journal_kinds)
        rows, _ = await journal.rows_after(after=0, since_ms=0, drives=[], most=500)
        assert [row.outcome for row in rows if row.kind == "stop"] == ["asked", "verified"]
        assert [row.whole()["number"] for row in rows if row.kind == "trip"] == [
            str(number) for number in range(22, 30)
        ]
        assert rows[-1].whole() == {"missed": "23"}

    journal_kinds: list[str] = []
    usual = Journal._add

    def add(journal: Journal, row: Row) -> None:
        usual(journal, row)
        journal_kinds.append(row.kind)

    monkeypatch.setattr(Journal, "_add", add)
    with_journal(path, scenario)


def test_a_full_disk_takes_what_is_vital_and_the_rest_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = threading.Event()
    usual = JournalFile._try_to_grow

    def grow(file: JournalFile, db: Any) -> None:
        usual(file, db)
        if full.is_set():
            file._room_trouble = "there is no room"

    monkeypatch.setattr(JournalFile, "_try_to_grow", grow)

    async def scenario(journal: Journal) -> None:
        intent = journal.intend("write", "a", {})
        await journal.committed(intent)
        full.set()
        journal._file._has_reserve = False
        journal._thread.submit(journal._file.tidy, journal._tidied)
        await until(lambda: "no room" in journal.trouble)
        journal.record("trip", "a")
        journal.conclude(intent, "done", {})
        journal.record("stop", "a", is_vital=True)
        await until(lambda: journal.head.number == 3)
        assert await kinds(journal) == ["write", "write", "stop"]
        full.clear()
        await until(lambda: not journal.trouble)
        await until(lambda: journal.head.number == 6)
        assert (await kinds(journal))[3:] == ["journal-failing", "trip", "journal-works"]
        assert (await journal.verify()).problem == ""

    with_journal(tmp_path / "j", scenario)


def test_on_a_full_disk_no_stop_waits_behind_what_is_not_vital(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = threading.Event()
    usual = JournalFile._try_to_grow

    def grow(file: JournalFile, db: Any) -> None:
        usual(file, db)
        if full.is_set():
            file._room_trouble = "there is no room"

    monkeypatch.setattr(JournalFile, "_try_to_grow", grow)
    others = 2 * module.BATCH_ROWS

    async def scenario(journal: Journal) -> None:
        full.set()
        journal._file._has_reserve = False
        journal._thread.submit(journal._file.tidy, journal._tidied)
        await until(lambda: "no room" in journal.trouble)
        for number in range(others):
            journal.record("trip", "a", {"number": str(number)})
        stop = journal.intend("stop", "a", {}, is_vital=True)
        journal.conclude(stop, "verified", {})
        await until(lambda: journal.head.number == 2)
        full.clear()
        await until(lambda: journal.head.number == 4 + others)
        rows, _ = await journal.rows_after(after=0, since_ms=0, drives=[], most=others + 4)
        assert [row.outcome for row in rows[:2]] == ["asked", "verified"]
        trips = [row.whole()["number"] for row in rows if row.kind == "trip"]
        assert trips == [str(number) for number in range(others)]
        assert (await journal.verify()).problem == ""

    with_journal(tmp_path / "j", scenario)


def test_the_end_is_written_on_a_full_disk_behind_what_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "j"

    async def scenario(journal: Journal) -> None:
        journal.record("start")
        await until(lambda: journal.head.number == 1)
        for number in range(2 * module.BATCH_ROWS):
            journal.record("trip", "a", {"number": str(number)})
        journal._file._room_trouble = "there is no room"
        journal._fail("there is no room")
        monkeypatch.setattr(JournalFile, "_try_to_grow", lambda file, db: None)
        journal.record("end", is_vital=True)

    with_journal(path, scenario)
    monkeypatch.undo()

    async def look(journal: Journal) -> None:
        assert (await kinds(journal))[:2] == ["start", "end"]

    with_journal(path, look)


def test_what_is_kept_is_not_waited_for_while_the_file_is_being_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "HANGS_AFTER_S", 0.1)
    works, usual = threading.Event(), JournalFile._take_up

    def take_up(file: JournalFile, *given: Any, **named: Any) -> None:
        works.wait(30)
        usual(file, *given, **named)

    monkeypatch.setattr(JournalFile, "_take_up", take_up)

    async def scenario(journal: Journal) -> None:
        for question in (journal.fact("roster"), journal.keys()):
            with pytest.raises(JournalFileError, match="could not be opened within"):
                await question
        works.set()
        await until(lambda: not journal.trouble)
        assert await journal.fact("roster") is None

    with_journal(tmp_path / "j", scenario)


def test_verifying_looks_for_a_head_that_was_logged(tmp_path: Path) -> None:
    async def scenario(journal: Journal) -> None:
        for number in range(450):
            journal.record("trip", "a", {"number": str(number)})
        await until(lambda: journal.head.number == 450)
        found = await journal.verify(journal.head)
        assert (found.rows, found.problem, found.head) == (450, "", journal.head)
        other = Head(300, bytes(32))
        assert "row 300 is not the one" in (await journal.verify(other)).problem
        assert "row 451 is missing" in (await journal.verify(Head(451, bytes(32)))).problem

    with_journal(tmp_path / "j", scenario)


@pytest.mark.parametrize("tampered", [False, True])
def test_a_file_is_verified_behind_its_doubts_too(tmp_path: Path, tampered: bool) -> None:
    """A file that was removed once must not hide for years what is done to the next one."""
    path = tmp_path / "j"

    async def lose(journal: Journal) -> None:
        for number in range(30):
            journal.record("trip", "a", {"number": str(number)})
        await until(lambda: journal.head.number == 30)
        path.unlink()
        journal.record("trip", "a")
        await until(lambda: journal.trouble)
        await until(lambda: not journal.trouble)
        for number in range(300):
            journal.record("trip", "a", {"number": str(number)})
        await until(lambda: journal.head.number > 300)

    with_journal(path, lose)
    if tampered:
        with contextlib.closing(sqlite3.connect(path)) as db, db:
            db.execute("UPDATE entries SET drive = 'b' WHERE id = 250")

    async def look(journal: Journal) -> None:
        found = await journal.verify(journal.head)
        assert found.problem.startswith("row 1 says: it was replaced by another one")
        if tampered:
            assert found.problem.endswith("; row 250 or the one before it was changed")
            assert found.head.number == 249
        else:
            assert found.problem.endswith("; no other row is wrong")
            assert found.head == journal.head
        assert "row 999 is missing" in (await journal.verify(Head(999, b"x"))).problem or tampered

    with_journal(path, look)


def test_rows_are_given_in_pages_by_time_and_by_drive(tmp_path: Path) -> None:
    async def scenario(journal: Journal) -> None:
        for number in range(30):
            journal.record("trip", "ab"[number % 2], {"number": str(number)})
        await until(lambda: journal.head.number == 30)
        rows, behind = await journal.rows_after(after=0, since_ms=0, drives=["b"], most=10)
        assert [row.number for row in rows] == list(range(2, 22, 2))
        rows, behind = await journal.rows_after(
            after=behind or 0, since_ms=0, drives=["b"], most=10
        )
        assert ([row.number for row in rows], behind) == ([22, 24, 26, 28, 30], None)
        later = rows[-1].time_ms + 1
        assert await journal.rows_after(after=0, since_ms=later, drives=[], most=9) == ([], None)
        newest = await journal.last_rows(drives=["a"], most=2)
        assert [row.number for row in newest] == [27, 29]

    with_journal(tmp_path / "j", scenario)


def test_keys_are_on_the_disk_before_their_answer_is_sent(tmp_path: Path) -> None:
    async def scenario(journal: Journal) -> None:
        journal.keep(KeyRow("k", b"1"))
        await journal.committed(journal.intend("write", "a", {}))
        (kept,) = await journal.keys()
        assert (kept.name, kept.status) == ("k", None)
        await journal.keep_now(KeyRow("k", b"1", 200, "application/json", b"{}"))
        (kept,) = await journal.keys()
        assert (kept.status, kept.body) == (200, b"{}")

    with_journal(tmp_path / "j", scenario)


def test_the_head_is_logged_at_the_start_hourly_and_at_the_end(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "HEAD_S", 0.05)
    caplog.set_level("INFO")

    heads: list[str] = []

    async def scenario(journal: Journal) -> None:
        journal.head_logged = heads.append
        journal.record("start")
        await until(lambda: caplog.text.count("event=journal-head head=1:") >= 2)
        journal.record("end")

    with_journal(tmp_path / "j", scenario)
    assert "event=journal-head head=2:" in caplog.messages[-1]
    assert heads[-1].startswith("2:")


def test_no_head_is_logged_of_a_file_that_could_not_be_opened_yet(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would say that the file is empty."""
    monkeypatch.setattr(module, "RETRY_S", 0.05)
    caplog.set_level("INFO")
    path, works, usual = tmp_path / "j", threading.Event(), JournalFile.open
    works.set()

    def opening(file: JournalFile, now_ms: int) -> None:
        if not works.is_set():
            raise JournalFileError("it is in use by another program")
        usual(file, now_ms)

    monkeypatch.setattr(JournalFile, "open", opening)

    async def begin(journal: Journal) -> None:
        journal.record("start")
        journal.keep(KeyRow("k", b"1", 200))
        await journal.committed(journal.intend("write", "a", {}))

    async def scenario(journal: Journal) -> None:
        caplog.clear()
        with pytest.raises(JournalFileError, match="in use by another program"):
            await journal.keys()
        await asyncio.sleep(0.3)
        assert "event=journal-head" not in caplog.text
        works.set()
        await until(lambda: "event=journal-head" in caplog.text)
        assert "event=journal-head head=0:" not in caplog.text
        assert [one.name for one in await journal.keys()] == ["k"]

    with_journal(path, begin)
    works.clear()
    with_journal(path, scenario)


def test_keys_are_read_while_nothing_can_be_written(tmp_path: Path) -> None:
    async def scenario(journal: Journal) -> None:
        await journal.keep_now(KeyRow("k", b"1", 200))
        journal._fail("there is no room")
        assert [one.name for one in await journal.keys()] == ["k"]

    with_journal(tmp_path / "j", scenario)


def test_the_end_writes_all_that_waits_and_logs_the_last_row(
    tmp_path: Path, disk: Disk, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")

    async def scenario(journal: Journal) -> None:
        disk.works.clear()
        for number in range(1000):
            journal.record("trip", "a", {"number": str(number)})
        journal.record("end", is_vital=True)
        asyncio.get_running_loop().call_later(0.1, disk.works.set)

    with_journal(tmp_path / "j", scenario)
    assert "event=journal-head head=1001:" in caplog.messages[-1]

    async def look(journal: Journal) -> None:
        (last,) = await journal.last_rows(drives=[], most=1)
        assert (last.number, last.kind) == (1001, "end")

    with_journal(tmp_path / "j", look)


def test_the_end_does_not_wait_for_a_disk_that_hangs(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(module, "END_S", 0.1)

    async def scenario(journal: Journal) -> None:
        disk.works.clear()
        journal.record("end")

    with_journal(tmp_path / "j", scenario)
    assert "event=journal-not-closed" in caplog.text
    disk.works.set()


def test_the_size_is_told(tmp_path: Path) -> None:
    async def scenario(journal: Journal) -> None:
        await until(lambda: journal.figures().size_bytes > 1_000_000)

    with_journal(tmp_path / "j", scenario)
