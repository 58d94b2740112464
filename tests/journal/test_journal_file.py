"""What is added to a journal stays, what is changed is found, and what is not a journal stays."""

from __future__ import annotations

import hashlib
import os
import random
import sqlite3
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any

import apsw
import pytest

from lecombus.journal import journal_file, migration, reading
from lecombus.journal.chain import ASKED, Head, Row
from lecombus.journal.journal_file import (
    APPLICATION_ID,
    SETTLED,
    SETTLED_ROWS,
    JournalFile,
    JournalFileError,
)
from lecombus.journal.kept import Fact, KeyRow

MOST = 16 * 1024 * 1024


def row(number: int = 0, kind: str = "trip", **more: object) -> Row:
    return Row(kind, "feeder", {"number": str(number)}, 1000 + number, **more)  # type: ignore[arg-type]


def opened(path: Path, most: int = MOST) -> JournalFile:
    file = JournalFile(path, most)
    file.open(1)
    return file


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "hall.sqlite"


@pytest.fixture
def file(path: Path) -> Iterator[JournalFile]:
    file = opened(path)
    yield file
    file.close()


def columns(file: JournalFile, what: str) -> list[tuple[Any, ...]]:
    return file.ask(lambda db: reading.select(db, f"SELECT {what} FROM entries ORDER BY id"))


def problem(file: JournalFile) -> str:
    """Verify a file in small pieces."""
    at, doubts = file.ask(lambda db: reading.head_in(db, "anchor")), ""
    while True:
        found = file.ask(partial(reading.verify_rows, behind=at, end=file.head, most=3))
        doubts += "".join(found.doubts)
        if found.problem or found.is_end:
            return doubts + found.problem
        at = found.head


@contextmanager
def plain(path: Path) -> Iterator[sqlite3.Connection]:
    """The closed file in the hands of a person who changes it."""
    with closing(sqlite3.connect(path)) as db:
        yield db
        db.commit()


def test_rows_stand_in_their_order_with_the_documented_hash(file: JournalFile, path: Path) -> None:
    intent = Row("write", "feeder", {"code": "C0046", "value": "35.4", "old": ""}, 1000, ASKED)
    file.write([row(1), intent], (), 1)
    file.write([Row("write", "feeder", {"reason": "größer\n=x"}, 2000, "done", intent)], (), 1)
    assert columns(file, "id, time, kind, drive, intent, outcome, fields") == [
        (1, 1001, "trip", "feeder", None, "", '{"number":"1"}'),
        (2, 1000, "write", "feeder", None, "asked", '{"code":"C0046","value":"35.4"}'),
        (3, 2000, "write", "feeder", 2, "done", '{"reason":"gr\\u00f6\\u00dfer\\n=x"}'),
    ]
    before = "0" * 64
    for number, time, kind, drive, about, outcome, fields, digest in columns(file, "*"):
        lines = (before, number, time, kind, drive, "" if about is None else about, outcome, fields)
        text = "".join(f"{line}\n" for line in lines)
        before = hashlib.sha256(text.encode()).hexdigest()
        assert digest.hex() == before
    assert str(file.head) == f"3:{before}"
    assert problem(file) == ""


def test_rules_of_the_file_hold_at_each_open(file: JournalFile, path: Path) -> None:
    for _ in range(2):
        pragmas = {
            name: file.ask(methodcaller("pragma", name))
            for name in ("journal_mode", "synchronous", "mmap_size", "locking_mode", "cache_size")
        }
        assert pragmas == {
            "journal_mode": "wal", "synchronous": 2, "mmap_size": 0, "locking_mode": "exclusive",
            "cache_size": -512,
        }  # fmt: skip
        assert file.ask(lambda db: db.pragma("application_id")) == APPLICATION_ID
        file.close()
        file.open(1)
    assert path.stat().st_mode & 0o777 == 0o640


def test_what_was_written_does_not_stay_in_memory(file: JournalFile) -> None:
    before = apsw.status(apsw.SQLITE_STATUS_MEMORY_USED)[0]
    for at in range(0, 20_000, 400):
        assert file.write([row(at + number) for number in range(400)], [], 1)
    assert apsw.status(apsw.SQLITE_STATUS_MEMORY_USED)[0] - before < 1_000_000


def test_an_intent_without_an_end_is_unknown_after_the_next_start(path: Path) -> None:
    file = opened(path)
    ended, open_one = row(1, "write", outcome=ASKED), row(2, "write", outcome=ASKED)
    file.write([ended, open_one, Row("write", "feeder", {}, 5, "done", ended)], (), 1)
    file.close()
    for _ in range(2):
        file = opened(path)
        assert columns(file, "intent, outcome") == [
            (None, "asked"), (None, "asked"), (1, "done"), (2, "unknown"),
        ]  # fmt: skip
        assert problem(file) == ""
        file.close()


@pytest.mark.parametrize("seed", range(8))
def test_every_intent_without_an_end_is_found_though_few_rows_are_looked_at(
    path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    monkeypatch.setattr(journal_file, "SETTLED_ROWS", 7)
    chance, expected = random.Random(seed), set()
    for _ in range(4):
        file = opened(path)
        intents: list[Row] = []
        for number in range(chance.randrange(60)):
            if intents and chance.random() < 0.6:
                intent = intents.pop(chance.randrange(len(intents)))
                rows = [Row("write", "feeder", {}, number, "done", intent)]
            else:
                intents.append(row(number, "write", outcome=ASKED))
                rows = [intents[-1]]
            file.write(rows, [], number)
            if chance.random() < 0.02:
                file.close()  # as after a trouble: the next write opens it again
        expected |= {one.number for one in intents}
        file.close()
    with closing(opened(path)) as file:
        found = [intent for intent, outcome in columns(file, "intent, outcome")
                 if outcome == "unknown"]  # fmt: skip
        assert sorted(found) == sorted(expected)
        assert problem(file) == ""


def test_an_opening_looks_at_the_newest_rows_only(path: Path) -> None:
    file = opened(path)
    for number in range(30):
        intents = [row(number, "write", outcome=ASKED) for _ in range(SETTLED_ROWS // 20)]
        ends = [Row("write", "feeder", {}, number, "done", intent) for intent in intents]
        file.write(intents, [], number)
        file.write(ends, [], number)
    rows, kept = file.head.number, file.ask(lambda db: reading.fact(db, SETTLED))
    assert rows == 3 * SETTLED_ROWS
    assert rows - int(kept or 0) < 1.2 * SETTLED_ROWS
    file.close()


def test_an_opening_that_failed_half_way_is_made_good_later(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = opened(path)
    file.write([row(1, "write", outcome=ASKED)], (), 1)
    file.close()
    file = JournalFile(path, MOST)
    with monkeypatch.context() as full:

        def fail(*_: object, **__: object) -> None:
            raise apsw.FullError

        full.setattr(JournalFile, "_insert", fail)
        for _ in range(2):
            with pytest.raises(JournalFileError, match="no room"):
                file.open(1)
    file.open(1)
    assert columns(file, "intent, outcome") == [(None, "asked"), (1, "unknown")]
    assert problem(file) == ""
    file.close()


def test_a_row_that_finds_no_room_lets_vital_ones_through(
    file: JournalFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = JournalFile._insert

    def insert(self: JournalFile, db: Any, head: Head, row: Row, numbers: Any) -> Head:
        if not row.is_vital:
            raise apsw.FullError
        return usual(self, db, head, row, numbers)

    with monkeypatch.context() as full:
        full.setattr(JournalFile, "_insert", insert)
        rows = [row(1), row(2, "stop", is_vital=True)]
        with pytest.raises(JournalFileError, match="no room"):
            file.write(rows, (), 1)
        assert not file.write(rows, (), 1)
        assert columns(file, "kind") == [("stop",)]
    assert file.tidy().trouble == ""
    assert file.write(rows[:1], (), 1)
    assert columns(file, "kind") == [("stop",), ("trip",)]


def test_opening_again_in_one_run_ends_no_intent_that_is_under_way(file: JournalFile) -> None:
    under_way = row(1, "write", outcome=ASKED)
    file.write([under_way], (), 1)
    file.close()
    file.open(1)
    file.write([Row("write", "feeder", {}, 5, "done", under_way)], (), 1)
    assert columns(file, "intent, outcome") == [(None, "asked"), (1, "done")]


def test_an_end_whose_intent_is_not_there_has_its_fields(file: JournalFile) -> None:
    intent = row(7, "write", outcome=ASKED)
    file.write([Row("write", "feeder", {"reason": "x"}, 5, "refused", intent)], (), 1)
    file.write([intent], (), 1)
    assert columns(file, "intent, outcome, fields") == [
        (None, "refused", '{"number":"7","reason":"x"}')
    ]


@pytest.mark.parametrize("rows", [1, 5, 9])
def test_another_journal_in_the_place_of_this_one_is_doubted(path: Path, rows: int) -> None:
    other = opened(path.with_name("other.sqlite"))
    other.write([row(50 + number) for number in range(rows)], (), 1)
    intent = row(60, "write", outcome=ASKED)
    file = opened(path)
    file.write([*(row(number) for number in range(4)), intent], (), 1)
    other.close()
    path.with_name("other.sqlite").replace(path)
    with pytest.raises(JournalFileError, match="removed or replaced"):
        file.write([], (), 2)
    file.write([], (), 2)
    assert "it was replaced by another one while it was in use" in file.trouble
    kept = [(f'{{"number":"{50 + number}"}}',) for number in range(rows)]
    assert columns(file, "fields")[:rows] == kept  # nothing of the former file is written into it
    assert columns(file, "kind")[rows:] == [("doubt",)]
    file.close()


def test_a_file_that_is_moved_away_while_it_is_in_use_has_all_its_rows(path: Path) -> None:
    file = opened(path)
    file.write([row(1)], (), 1)
    file.tidy()
    file.write([row(2)], (), 1)  # in the WAL, which keeps the name that the file had
    moved = path.rename(path.with_name("moved.sqlite"))
    with pytest.raises(JournalFileError, match="removed or replaced"):
        file.write([], (), 1)
    file.close()
    archive = opened(moved)
    assert columns(archive, "id, fields") == [(1, '{"number":"1"}'), (2, '{"number":"2"}')]
    assert (problem(archive), archive.trouble) == ("", "")
    archive.close()


def test_an_intent_of_a_file_that_was_replaced_is_no_row_of_the_new_one(path: Path) -> None:
    file = opened(path)
    file.write([row(n) for n in range(5)], (), 1)
    intent = row(7, "write", outcome=ASKED)
    file.write([intent], (), 1)
    path.unlink()
    with pytest.raises(JournalFileError, match="removed or replaced"):
        file.write([row(8)], (), 1)
    file.write([row(8), Row("write", "feeder", {}, 5, "done", intent)], (), 1)
    kinds = columns(file, "id, kind, intent, outcome, fields")
    assert kinds[1:] == [
        (2, "trip", None, "", '{"number":"8"}'), (3, "write", None, "done", '{"number":"7"}'),
    ]  # fmt: skip
    assert "replaced" in str(kinds[0])
    assert "row 1 says" in problem(file)
    file.close()


CHANGES = {
    "a field": ("UPDATE entries SET fields = '{}' WHERE id = 4", "row 4 or the one before"),
    "a time": ("UPDATE entries SET time = 1 WHERE id = 4", "row 4 or the one before"),
    "a row in the middle": ("DELETE FROM entries WHERE id = 4", "row 5 stands behind row 3"),
    "the first rows": ("DELETE FROM entries WHERE id < 4", "row 4 stands behind row 0"),
    "the last rows": ("DELETE FROM entries WHERE id > 7", "row 10 stands behind row 7"),
    "all rows": ("DELETE FROM entries", "row 10 stands behind row 0"),
}


@pytest.mark.parametrize(("change", "found"), CHANGES.values(), ids=CHANGES)
def test_what_was_changed_in_a_closed_file_is_found(path: Path, change: str, found: str) -> None:
    file = opened(path)
    file.write([row(n) for n in range(9)], (), 1)
    file.close()
    with plain(path) as db:
        db.execute(change)
    file = opened(path)
    file.write([row(10)], (), 1)  # what is added later hides nothing
    assert found in problem(file)
    file.close()


def test_rows_taken_off_at_the_end_with_the_head_are_only_found_by_a_head_told(path: Path) -> None:
    file = opened(path)
    file.write([row(n) for n in range(9)], (), 1)
    told = file.head
    file.close()
    with plain(path) as db:
        db.execute("DELETE FROM entries WHERE id > 7")
        db.execute("UPDATE head SET (id, hash) = (SELECT id, hash FROM entries WHERE id = 7)")
    file = opened(path)
    assert problem(file) == ""
    assert file.ask(lambda db: reading.hash_at(db, told.number)) is None
    file.close()


def test_a_file_of_a_later_version_is_left_alone(path: Path) -> None:
    opened(path).close()
    with plain(path) as db:
        db.execute("PRAGMA user_version = 2")
    before = path.read_bytes()
    with pytest.raises(JournalFileError, match="of version 2"):
        opened(path)
    assert path.read_bytes() == before


@pytest.fixture
def second_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_file, "VERSION", 2)
    steps = {1: "CREATE TABLE marks (name TEXT PRIMARY KEY) STRICT"}
    monkeypatch.setattr(journal_file, "STEPS", steps)
    monkeypatch.setattr(migration, "STEPS", steps)


def first_version(path: Path) -> bytes:
    """Write a file of version 1 with two rows, and return what it holds."""
    file = opened(path)
    file.write([row(1), row(2)], (), 1)
    file.close()
    with plain(path) as db:
        db.execute("PRAGMA user_version = 1")
    return path.read_bytes()


def test_a_file_of_an_older_version_is_brought_to_this_one_and_kept(
    path: Path, request: pytest.FixtureRequest
) -> None:
    first_version(path)
    request.getfixturevalue("second_version")
    file = opened(path)
    assert file.kept == f"{path}.version-1"
    assert problem(file) == ""
    assert len(columns(file, "id")) == 2
    file.close()
    with plain(path) as db:
        assert db.execute("PRAGMA user_version").fetchone() == (2,)
        assert db.execute("SELECT count(*) FROM marks").fetchone() == (0,)
    with plain(Path(f"{path}.version-1")) as db:
        assert db.execute("PRAGMA user_version").fetchone() == (1,)
        assert db.execute("SELECT count(*) FROM entries").fetchone() == (2,)
    again = opened(path)
    assert (again.kept, problem(again)) == ("", "")
    again.close()


def test_the_kept_file_is_one_that_the_older_lecombus_opens(
    path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    first_version(path)
    request.getfixturevalue("second_version")
    opened(path).close()
    monkeypatch.undo()
    kept = opened(Path(f"{path}.version-1"))
    assert problem(kept) == ""
    assert len(columns(kept, "id")) == 2
    kept.close()


def test_a_file_whose_copy_cannot_be_written_stays_as_it_is(
    path: Path, request: pytest.FixtureRequest
) -> None:
    before = first_version(path)
    request.getfixturevalue("second_version")
    (path.parent / f".{path.name}.version-1.new").mkdir()
    with pytest.raises(JournalFileError):
        opened(path)
    assert path.read_bytes() == before


def test_a_step_that_fails_leaves_the_file_as_it_is(
    path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    first_version(path)
    request.getfixturevalue("second_version")
    monkeypatch.setattr(migration, "STEPS", {1: "CREATE TABLE marks (a); CREATE TABLE marks (b)"})
    with pytest.raises(JournalFileError):
        opened(path)
    with plain(path) as db:
        assert db.execute("PRAGMA user_version").fetchone() == (1,)
        assert db.execute("SELECT count(*) FROM sqlite_schema WHERE name = 'marks'").fetchone() == (
            0,
        )


def test_another_programs_database_is_left_alone(path: Path) -> None:
    with plain(path) as db:
        db.execute("CREATE TABLE pictures (name)")
    before = path.read_bytes()
    with pytest.raises(JournalFileError, match="not a journal of lecombus"):
        opened(path)
    assert path.read_bytes() == before


@pytest.mark.parametrize("content", [b"key: value\n" * 1000, b"\0" * 5000], ids=["text", "zeros"])
def test_a_file_that_is_none_of_ours_is_left_alone(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(JournalFileError, match="not a journal of lecombus"):
        opened(path)
    assert path.read_bytes() == content


def test_a_damaged_file_is_set_aside(path: Path) -> None:
    file = opened(path)
    file.write([row(n) for n in range(2000)], (), 1)
    file.close()
    whole = bytearray(path.read_bytes())
    whole[100:90_000] = b"\xa5" * (90_000 - 100)
    content = bytes(whole)
    path.write_bytes(content)
    file = opened(path)
    file.write([row(1)], (), 1)
    assert problem(file) == ""
    assert "hall.sqlite.damaged-1" in file.trouble
    assert path.with_name("hall.sqlite.damaged-1").read_bytes() == content
    file.close()


def test_a_file_that_breaks_while_it_is_in_use_is_set_aside_at_the_next_attempt(path: Path) -> None:
    file = opened(path)
    file.write([row(n) for n in range(2000)], (), 1)
    file.ask(lambda db: db.wal_checkpoint(mode=apsw.SQLITE_CHECKPOINT_RESTART))
    file.ask(lambda db: db.pragma("cache_size", 1))
    with path.open("r+b") as raw:
        raw.seek(4096)
        raw.write(b"\xa5" * (path.stat().st_size - 4096))
    with pytest.raises(JournalFileError, match="damaged"):
        file.ask(lambda db: db.execute("SELECT sum(length(fields)) FROM entries").fetchall())
    file.write([row(1)], (), 1)
    assert path.with_name("hall.sqlite.damaged-1").exists()
    assert columns(file, "fields")[-1] == ('{"number":"1"}',)
    file.close()


def test_what_is_no_file_is_not_opened(path: Path) -> None:
    os.mkfifo(path)
    with pytest.raises(JournalFileError, match="not a regular file"):
        opened(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(JournalFileError, match="not a regular file"):
        opened(path)
    with pytest.raises(JournalFileError, match="does not exist"):
        opened(path / "no" / "folder.sqlite")
    path.rmdir()
    opened(path).close()


def test_a_second_daemon_cannot_use_the_same_file(file: JournalFile, path: Path) -> None:
    second = "import sys, pathlib; from lecombus.journal.journal_file import *\n"
    second += "try: JournalFile(pathlib.Path(sys.argv[1]), 0).open(1)\n"
    second += "except JournalFileError as exc: print(exc)\n"
    done = subprocess.run(
        [sys.executable, "-c", second, str(path)], capture_output=True, text=True, check=True
    )
    assert "in use by another program" in done.stdout
    file.write([row(1)], (), 1)


def test_the_oldest_rows_make_room_for_new_ones_and_the_rest_still_verifies(path: Path) -> None:
    most = 4 * 1024 * 1024
    file = opened(path, most)
    for number in range(150):
        file.write([Row("trip", "a", {"x": "y" * 400}, number) for _ in range(100)], (), 1)
        assert file.tidy().size_bytes <= most
    anchor = file.ask(lambda db: reading.head_in(db, "anchor"))
    assert 1000 < anchor.number < file.head.number - 1000
    assert problem(file) == ""
    file.close()
    with plain(path) as db:  # who moves the anchor too hides nothing
        last = db.execute("SELECT id, hash FROM entries ORDER BY id LIMIT 1 OFFSET 50").fetchone()
        db.execute("DELETE FROM entries WHERE id <= ?", last[:1])
        db.execute("UPDATE anchor SET id = ?, hash = ?", last)
    file = opened(path, most)
    assert "no row says that they were deleted" in problem(file)
    file.close()


def test_a_file_shrinks_to_a_smaller_limit(path: Path) -> None:
    file = opened(path)
    for _ in range(20):
        file.write([Row("trip", "a", {"x": "y" * 400}, 1) for _ in range(1000)], (), 1)
        file.tidy()
    file.close()
    large = path.stat().st_size
    file = opened(path, 4 * 1024 * 1024)
    for _ in range(200):
        file.tidy()
    file.write([row(1)], (), 1)
    assert problem(file) == ""
    file.close()
    assert path.stat().st_size < 4 * 1024 * 1024 < large


def test_keys_and_facts_are_kept_and_forgotten(path: Path) -> None:
    file = opened(path)
    file.write([], [KeyRow("a", b"1"), KeyRow("b", b"2"), Fact("roster", "x")], 1)
    file.write([], [KeyRow("a", b"1", 200, "application/json", b"{}"), KeyRow("b")], 1)
    file.close()
    file = opened(path)
    keys = file.ask(lambda db: reading.select(db, "SELECT * FROM keys"))
    assert keys == [("a", b"1", 200, "application/json", b"{}")]
    assert file.ask(lambda db: reading.fact(db, "roster")) == "x"
    file.close()


def test_a_full_disk_is_noticed_before_a_row_is_lost_and_has_room_for_stops(tmp_path: Path) -> None:
    """The limit on the size of files stands for the disk: it needs no rights."""
    script = textwrap.dedent("""
        import resource, signal, sys
        from pathlib import Path
        from lecombus.journal.chain import Row
        from lecombus.journal.journal_file import JournalFile
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        path = Path(sys.argv[1])
        file = JournalFile(path, 64 << 20)
        file.open(1)
        file.tidy()

        def rows(count, vital):
            return [Row("stop" if vital else "trip", "a", {"x": "y" * 200}, 1, is_vital=vital)
                    for _ in range(count)]

        unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
        largest = max(path.stat().st_size, path.with_name(path.name + "-wal").stat().st_size)
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, unlimited[1]))
        given = 0
        while not (trouble := file.tidy().trouble):
            assert file.write(rows(250, False), (), 1)
            given += 250
        stops = 0
        for _ in range(300):
            assert not file.write(rows(1, False) + rows(1, True), (), 1)
            stops += 1
            file.tidy()
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
        room = file.tidy()
        assert file.write(rows(1, False), (), 1)
        kinds = file.ask(lambda db: db.execute(
            "SELECT kind, count(*) FROM entries GROUP BY kind ORDER BY kind").fetchall())
        file.close()
        assert kinds == [("stop", stops), ("trip", given + 1)], kinds
        print(trouble, "|", room.trouble)
    """)
    path = tmp_path / "hall.sqlite"
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    trouble, after = done.stdout.split("|")
    assert "there is no room" in trouble
    assert not after.strip()
    file = opened(path)
    assert problem(file) == ""
    file.close()


def test_a_later_page_looks_at_no_row_of_the_pages_before(file: JournalFile) -> None:
    count = 4000
    file.write([Row("trip", "a", {}, 1) for _ in range(count)], (), 1)
    file.write([Row("trip", "a", {}, 10) for _ in range(20)], (), 1)
    steps = 0

    def step() -> bool:
        nonlocal steps
        steps += 1
        return False

    def page(db: apsw.Connection) -> list[int]:
        db.set_progress_handler(step, 1)
        found = reading.rows_after(db, after=count + 10, since_ms=5, drives=[], most=5)
        db.set_progress_handler(None)
        return [row.number for row in found[0]]

    assert file.ask(page) == list(range(count + 11, count + 16))
    assert steps < count


def test_a_head_is_written_as_verify_takes_it() -> None:
    assert str(Head(17, bytes.fromhex("ab" * 32))) == "17:" + "ab" * 32
