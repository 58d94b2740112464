"""Write counts outlive a process that is killed, and no disk holds up whoever counts."""

from __future__ import annotations

import os
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import anyio
import pytest

from lecombus.saved_state import Keeping, State, StateFile
from lecombus.saved_state.counts import Counts

COUNTING = """
import os, signal, sys, time
from pathlib import Path
from lecombus.saved_state import Keeping
keeping = Keeping(Path(sys.argv[1]))
for number in range(20):
    keeping.state.count("feeder", "C0012")
    keeping.state.count("belt", "C0013")
    time.sleep(0.02)
os.kill(os.getpid(), signal.SIGKILL)
"""
"""Counts as a line writes, a drive every 20 ms, and is killed."""


@pytest.mark.clock
def test_a_process_that_is_killed_loses_one_count_at_most(tmp_path: Path) -> None:
    path = tmp_path / "hall.json"
    for killed in (1, 2):
        subprocess.run([sys.executable, "-c", COUNTING, str(path)], check=False, timeout=60)
        state = Keeping(path).state
        for drive, code in (("feeder", "C0012"), ("belt", "C0013")):
            assert 20 * killed - killed <= state.drive(drive).writes[code] <= 20 * killed


def test_what_was_saved_is_not_counted_again_and_the_side_file_is_emptied(tmp_path: Path) -> None:
    path = tmp_path / "hall.json"
    keeping = Keeping(path)
    for _ in range(3):
        keeping.state.count("feeder", "C0012")
    assert keeping._counts is not None
    assert keeping._counts.flush(10.0)
    side = tmp_path / "hall.json.counts"
    assert side.read_text().splitlines()[-1] == '["feeder", "C0012", 3]'
    keeping.close()
    assert side.read_text() == ""
    assert StateFile(path).load().drive("feeder").writes == {"C0012": 3}
    again = Keeping(path)
    assert again.state.drive("feeder").writes == {"C0012": 3}
    assert again.state.changes == 0


def test_a_count_that_comes_while_the_state_is_saved_stays(tmp_path: Path) -> None:
    counts = Counts(tmp_path / "hall.json")
    counts.note("feeder", "C0012", 1)
    noted = counts.noted
    counts.note("feeder", "C0012", 2)
    assert counts.flush(10.0)
    counts.saved(noted)
    state = State()
    Counts(tmp_path / "hall.json").load(state)
    assert state.drive("feeder").writes == {"C0012": 2}


def test_a_side_file_that_somebody_removed_is_made_again(tmp_path: Path) -> None:
    counts = Counts(tmp_path / "hall.json")
    counts.note("feeder", "C0012", 1)
    assert counts.flush(10.0)
    counts.path.unlink()
    counts.note("feeder", "C0012", 2)
    assert counts.flush(10.0)
    assert counts.path.read_text() == '["feeder", "C0012", 2]\n'


@pytest.mark.parametrize(
    "junk",
    ['["feeder", "C00', "5", '["feeder"]', '["a", "b", "c"]', '["\\u001b", "C1", 5]', "[" * 5000,
     '["feeder", "C0012", true]', '["feeder", "C0012", -5]', "\xff"],
)  # fmt: skip
def test_lines_that_are_none_are_passed_over(tmp_path: Path, junk: str) -> None:
    side = tmp_path / "hall.json.counts"
    side.write_text(f'["feeder", "C0012", 7]\n{junk}\n["feeder", "C0013", 1]\n')
    state = State()
    Counts(tmp_path / "hall.json").load(state)
    assert state.drive("feeder").writes == {"C0012": 7, "C0013": 1}


# -- what is not a regular file -------------------------------------------------------------------


def make_device(path: Path) -> None:
    if os.getuid():
        pytest.skip("only root may make devices")
    os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 7))  # as /dev/full


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


NO_FILES: list[Callable[[Path], None]] = [os.mkfifo, make_device, make_socket, Path.mkdir]


@pytest.mark.clock
@pytest.mark.parametrize("make", NO_FILES)
@pytest.mark.parametrize("name", ["hall.json", ".hall.json.new", "hall.json.counts"])
def test_what_is_no_regular_file_is_neither_waited_for_nor_given_another_name(
    make: Callable[[Path], None], name: str
) -> None:
    with tempfile.TemporaryDirectory(prefix="lb-") as folder:  # a socket's path is short
        place = Path(folder) / name
        make(place)
        before = place.lstat()
        keeping = Keeping(Path(folder) / "hall.json")
        told: list[str | None] = []

        async def main() -> None:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(keeping.run, told.append)
                keeping.state.count("feeder", "C0012")
                keeping.state.touch()
                with anyio.fail_after(15):
                    while not any(told):  # noqa: ASYNC110 - a file has no event
                        await anyio.sleep(0.01)
                tasks.cancel_scope.cancel()

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("lecombus.saved_state.keeping.EVERY_S", 0.01)
            anyio.run(main)
        keeping.close()
        assert place.lstat() == before or stat.S_ISDIR(before.st_mode)
        assert stat.S_IFMT(place.lstat().st_mode) == stat.S_IFMT(before.st_mode)


def test_something_put_in_the_files_place_while_it_runs_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "hall.json"
    keeping = Keeping(path)
    os.mkfifo(path)
    keeping.state.touch()
    keeping.close()
    assert stat.S_ISFIFO(path.lstat().st_mode)
    assert "cannot be written: Not a regular file" in keeping._failure


# -- a disk that hangs -----------------------------------------------------------------------------


@pytest.fixture
def hung() -> Iterator[threading.Event]:
    """Set it to let the disk go on; it goes on at the end in any case."""
    goes_on = threading.Event()
    yield goes_on
    goes_on.set()


@pytest.mark.clock
def test_a_disk_that_hangs_while_saving_is_remarked_and_holds_up_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hung: threading.Event
) -> None:
    plain = os.fsync

    def fsync(descriptor: int) -> None:
        hung.wait()
        plain(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr("lecombus.saved_state.keeping.EVERY_S", 0.01)
    monkeypatch.setattr("lecombus.saved_state.keeping.HANGS_AFTER_S", 0.05)
    path = tmp_path / "hall.json"
    told: list[str | None] = [None]

    async def until(condition: Callable[[], bool]) -> None:
        with anyio.fail_after(15):
            while not condition():  # noqa: ASYNC110 - a disk has no event
                await anyio.sleep(0.005)

    async def main() -> None:
        keeping = Keeping(path)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(keeping.run, told.append)
            keeping.state.touch()
            await until(lambda: "its disk has not taken" in str(told[-1]))
            keeping.state.count("feeder", "C0012")  # goes on, and is in the side file
            assert keeping._counts is not None
            assert keeping._counts.flush(10.0)
            hung.set()
            await until(lambda: told[-1] is None)
            tasks.cancel_scope.cancel()

    anyio.run(main)


def test_the_end_does_not_wait_for_a_disk_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hung: threading.Event
) -> None:
    monkeypatch.setattr(os, "fsync", lambda descriptor: hung.wait())
    monkeypatch.setattr("lecombus.saved_state.keeping.END_S", 0.05)
    keeping = Keeping(tmp_path / "hall.json")
    keeping.state.touch()
    keeping.close()
    assert "could not be written within" in keeping._failure


HANGING = """
import os, sys, threading
from pathlib import Path
import anyio
from lecombus.saved_state import keeping as module

module.EVERY_S = module.END_S = 0.01
reached = threading.Event()

def fsync(descriptor):
    reached.set()
    threading.Event().wait()

os.fsync = fsync

async def main():
    keeping = module.Keeping(Path(sys.argv[1]))
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(keeping.run, lambda text: None)
        keeping.state.touch()
        while not reached.is_set():
            await anyio.sleep(0.005)
        tasks.cancel_scope.cancel()
    keeping.close()

anyio.run(main)
"""


@pytest.mark.clock
def test_the_process_ends_while_a_disk_hangs_that_has_been_written_to(tmp_path: Path) -> None:
    words = [sys.executable, "-c", HANGING, str(tmp_path / "hall.json")]
    done = subprocess.run(words, timeout=30, check=False)  # before, it never ended
    assert done.returncode == 0


@pytest.mark.clock
def test_a_disk_that_hangs_at_the_start_is_remarked_and_nothing_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hung: threading.Event
) -> None:
    plain = StateFile.load

    def load(file: StateFile) -> State:
        if file.path is not None:
            hung.wait()
        return plain(file)

    monkeypatch.setattr(StateFile, "load", load)
    monkeypatch.setattr("lecombus.saved_state.keeping.HANGS_AFTER_S", 0.05)
    told: list[str | None] = []

    async def main() -> None:
        keeping = await Keeping.opened(tmp_path / "hall.json")
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(keeping.run, told.append)
            while not told:  # noqa: ASYNC110 - it is told at once
                await anyio.sleep(0.001)
            tasks.cancel_scope.cancel()
        hung.set()

    anyio.run(main)
    assert "could not be read within" in str(told[0])


def test_whoever_counts_does_not_wait_for_a_disk_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hung: threading.Event
) -> None:
    counts = Counts(tmp_path / "hall.json")
    monkeypatch.setattr(Counts, "_append", lambda self, line: hung.wait())
    begun_s = time.thread_time()
    for number in range(1000):
        counts.note("feeder", "C0012", number)
    assert not counts.flush(0.01)
    assert time.thread_time() - begun_s < 1.0
