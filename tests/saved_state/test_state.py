"""What must outlive the process: whole on the disk or as it was, and never in the line's way."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from typing import Any

import anyio
import anyio.lowlevel
import pytest

from lecombus.saved_state import DriveFacts, Keeping, LastEnable, Moved, State, StateFile, state
from lecombus.saved_state.state import FORMER_MOST, VERSION, NewerStateError, StateFormatError


def filled() -> State:
    state = State()
    facts = state.drive("feeder")
    facts.identity["C1810"] = "33S2102I_10000"
    facts.writes["C0012"] = 7
    facts.moved = Moved(12, "2026-11-22T00:00:00.000Z", confirmed=True)
    facts.last_enable = LastEnable(
        "2026-11-22T00:00:00.000Z", 11, "8200vector", "refused", taken_back=True, reason="C0135 ..",
        cause="probably the terminal", remedy="put that in order", by_drive=True,
    )  # fmt: skip
    state.touch()
    return state


def test_what_was_saved_is_read_again(tmp_path: Path) -> None:
    file = StateFile(tmp_path / "hall.json")
    file.save(filled().text())
    again = StateFile(tmp_path / "hall.json").load()
    assert again.drive("feeder") == filled().drive("feeder")
    assert [path.name for path in tmp_path.iterdir()] == ["hall.json"]
    assert (tmp_path / "hall.json").stat().st_mode & 0o007 == 0


def test_a_disk_that_fails_leaves_the_old_file_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = StateFile(tmp_path / "hall.json")
    file.save(filled().text())
    before = (tmp_path / "hall.json").read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        file.save(State().text())
    assert (tmp_path / "hall.json").read_bytes() == before


@pytest.mark.parametrize(
    "damage",
    [b"", b"{", b"\xff\xfe", b"[]", b'{"version": 1}', b'{"version": 0, "drives": {}}',
     b'{"version": 1, "drives": {"a": {"writes": {"C0012": -1}}}}',
     b'{"version": 1, "drives": {"a": {"identity": {"C0012": 5}}}}',
     b'{"version": 1, "drives": {"a": {"identity": {"C0012": "\\u001b[2J"}}}}',
     b'{"version": 1, "drives": {"a": {"last_enable": {"at": "today"}}}}',
     b'{"version": 1, "drives": {"a": {"moved": {"address": 999, "at": "", "confirmed": true}}}}',
     b"[" * 200_000],
)  # fmt: skip
def test_a_damaged_file_is_set_aside_and_said(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "hall.json"
    (tmp_path / "hall.json.damaged-1").write_bytes(b"an older one")
    path.write_bytes(damage)
    file = StateFile(path)
    assert file.load().drive("feeder") == DriveFacts()
    assert (tmp_path / "hall.json.damaged-2").read_bytes() == damage
    assert "hall.json.damaged-2" in file.trouble
    assert file.is_usable, "a new one is begun"
    assert not path.exists()


@pytest.mark.parametrize("exists", [True, False])
@pytest.mark.parametrize("leads", ["{}/real.json", "../far/real.json"])
def test_a_link_stays_a_link_and_the_file_it_leads_to_is_kept(
    tmp_path: Path, leads: str, exists: bool
) -> None:
    far, near = tmp_path / "far", tmp_path / "near"
    far.mkdir()
    near.mkdir()
    (near / "hall.json").symlink_to(leads.format(far))
    if exists:
        (far / "real.json").write_text(filled().text())
    file = StateFile(near / "hall.json")
    state = file.load()
    assert (file.trouble, file.is_usable) == ("", True)
    assert bool(state.drive("feeder").writes) == exists
    state.drive("feeder").writes["C0012"] = 8
    file.save(state.text())
    assert (near / "hall.json").is_symlink()
    assert [path.name for path in near.iterdir()] == ["hall.json"]
    assert [path.name for path in far.iterdir()] == ["real.json"]
    assert StateFile(near / "hall.json").load().drive("feeder").writes == {"C0012": 8}


def test_a_link_into_nowhere_says_where_it_leads(tmp_path: Path) -> None:
    path = tmp_path / "hall.json"
    path.symlink_to(tmp_path / "nowhere" / "real.json")
    file = StateFile(path)
    file.load()
    assert not file.is_usable
    assert f"{tmp_path}/nowhere, where {path} leads, does not exist" in file.trouble
    assert path.is_symlink()


def test_a_link_in_a_circle_is_said(tmp_path: Path) -> None:
    path = tmp_path / "hall.json"
    path.symlink_to(path)
    file = StateFile(path)
    file.load()
    assert not file.is_usable
    assert "cannot be read: Too many levels of symbolic links" in file.trouble


def test_a_damaged_file_behind_a_link_is_set_aside_where_it_is(tmp_path: Path) -> None:
    path, real = tmp_path / "hall.json", tmp_path / "real.json"
    path.symlink_to(real)
    real.write_text("{")
    file = StateFile(path)
    file.load()
    assert f"{path}, a link to {real}, was damaged" in file.trouble
    assert "real.json.damaged-1" in file.trouble
    assert (path.is_symlink(), real.exists(), file.is_usable) == (True, False, True)


def test_a_folder_that_a_link_leads_to_and_that_is_lost_later_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, far = tmp_path / "hall.json", tmp_path / "far"
    far.mkdir()
    path.symlink_to(far / "real.json")
    keeping = Keeping(path)
    far.rmdir()
    keeping.state.touch()
    with caplog.at_level(logging.WARNING):
        keeping.close()
    (record,) = caplog.records
    assert f"{path}, a link to {far}/real.json, cannot be written: No such" in record.getMessage()


def test_a_pipe_in_the_files_place_does_not_hold_up_the_start(tmp_path: Path) -> None:
    path = tmp_path / "hall.json"
    os.mkfifo(path)
    file = StateFile(path)
    assert file.load().drive("feeder") == DriveFacts()
    assert "cannot be read: Not a regular file" in file.trouble
    assert not file.is_usable


def test_a_file_of_a_later_version_is_neither_used_nor_touched(tmp_path: Path) -> None:
    path = tmp_path / "hall.json"
    later = json.dumps({"version": VERSION + 1, "drives": [], "more": 1})
    path.write_text(later)
    keeping = Keeping(path)
    keeping.state.drive("feeder").writes["C0012"] = 1
    keeping.state.touch()
    keeping.close()
    assert path.read_text() == later
    with pytest.raises(NewerStateError, match=f"version {VERSION + 1}"):
        State.parse(later.encode())
    with pytest.raises(StateFormatError):
        State.parse(b"7")


def renamed(document: dict[str, Any]) -> dict[str, Any]:
    """What a next version may do: version 1 called `drives` otherwise."""
    return {"version": 2, "drives": document["motors"]}


@pytest.fixture
def second_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(state, "VERSION", 2)
    monkeypatch.setattr(state, "STEPS", {1: renamed})


OLD = b'{"version": 1, "motors": {"feeder": {"writes": {"C0012": 7}}}}'


@pytest.mark.usefixtures("second_version")
def test_a_file_of_an_older_version_is_read_and_kept_beside_the_new_one(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "hall.json"
    path.write_bytes(OLD)
    with caplog.at_level(logging.INFO):
        keeping = Keeping(path)
    assert keeping.state.drive("feeder").writes == {"C0012": 7}
    assert path.read_bytes() == OLD
    assert "event=state-migrated" in caplog.text
    keeping.close()
    assert json.loads(path.read_bytes())["version"] == 2
    assert json.loads(path.read_bytes())["drives"]["feeder"]["writes"] == {"C0012": 7}
    assert (tmp_path / "hall.json.version-1").read_bytes() == OLD
    caplog.clear()
    assert Keeping(path).state.drive("feeder").writes == {"C0012": 7}
    assert "migrated" not in caplog.text


@pytest.mark.usefixtures("second_version")
def test_an_older_file_that_cannot_be_kept_is_neither_used_nor_changed(tmp_path: Path) -> None:
    path = tmp_path / "hall.json"
    path.write_bytes(OLD)
    os.mkfifo(tmp_path / ".hall.json.version-1.new")
    file = StateFile(path)
    file.load()
    assert not file.is_usable
    assert "cannot be read" in file.trouble
    assert path.read_bytes() == OLD


@pytest.mark.usefixtures("second_version")
@pytest.mark.parametrize("text", [
    b'{"version": 1}', b'{"version": 1, "motors": 5}', b'{"version": true, "motors": {}}',
    b'{"version": 0, "motors": {}}',
])  # fmt: skip
def test_a_damaged_file_of_an_older_version_is_set_aside(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "hall.json"
    path.write_bytes(text)
    file = StateFile(path)
    file.load()
    assert "was damaged" in file.trouble
    assert (tmp_path / "hall.json.damaged-1").read_bytes() == text


@pytest.mark.clock
def test_a_folder_that_is_not_there_fails_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    said: list[str | None] = []

    async def main() -> None:
        keeping = Keeping(tmp_path / "nowhere" / "hall.json")
        keeping.state.touch()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(keeping.run, said.append)
            await anyio.lowlevel.checkpoint()
            await anyio.lowlevel.checkpoint()
            tasks.cancel_scope.cancel()
        keeping.close()

    with caplog.at_level(logging.WARNING):
        anyio.run(main)
    assert said
    assert "does not exist" in str(said[0])
    assert [record.getMessage().split()[0] for record in caplog.records] == ["event=state-not-kept"]


@pytest.mark.clock
def test_changes_are_written_beside_the_line_and_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "hall.json"
    monkeypatch.setattr("lecombus.saved_state.keeping.EVERY_S", 0.01)

    async def main() -> None:
        keeping = Keeping(path)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(keeping.run, lambda text: None)
            keeping.state.drive("feeder").writes["C0012"] = 1
            keeping.state.touch()
            with anyio.fail_after(15):
                while not path.exists():  # noqa: ASYNC110 - a file has no event
                    await anyio.sleep(0.01)
            tasks.cancel_scope.cancel()
        keeping.state.drive("feeder").writes["C0012"] = 2
        keeping.state.touch()
        keeping.close()

    anyio.run(main)
    assert StateFile(path).load().drive("feeder").writes == {"C0012": 2}


def test_without_a_file_nothing_is_kept_and_nothing_said() -> None:
    keeping = Keeping(None)
    keeping.state.touch()
    keeping.close()
    assert StateFile(None).trouble == ""


def test_drives_that_left_the_roster_are_remembered_up_to_a_bound() -> None:
    state = State()
    for number in range(FORMER_MOST + 5):
        state.drive(f"old-{number}")
    state.drive("feeder").writes["C0012"] = 3
    state.bound(["feeder", "new"])
    kept = json.loads(state.text())["drives"]
    assert len(kept) == FORMER_MOST + 1
    assert kept["feeder"]["writes"] == {"C0012": 3}
    assert "old-4" not in kept
    assert "old-5" in kept
