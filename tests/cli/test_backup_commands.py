"""backup, diff and restore as their user types them, against a daemon reduced to its answers."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import anyio
import pytest

from backups.backups import answers, backup_of
from cli.conftest import Run
from cli.daemon_stub import DaemonStub
from lecombus.backups import (
    Progress,
    Restored,
    WriteAttempt,
    make_plan,
    read_progress,
    wanted_codes,
)
from lecombus.cli.backup import Notes, digest_of
from lecombus.cli.drive_access import HttpDrive
from lecombus.cli.restore import result_json, show_plan, show_result
from lecombus.drives import family
from lecombus.parameters import Code, Format, Value
from support.golden import Golden

pytestmark = pytest.mark.clock

DRIVE = "/v1/drives/feeder"
READ = "?fresh=true&priority=background"


def problem(kind: str, status: int, detail: str) -> tuple[int, str]:
    told = {"type": f"urn:lecombus:problem:{kind}", "detail": detail, "remedy": "", "outcome": None}
    return status, json.dumps(told)


class Drive:
    """Answers for one drive, whose codes a test sets."""

    def __init__(self, stub: DaemonStub, kind: str = "8200vector", name: str = "feeder") -> None:
        self.stub = stub
        self.path = f"/v1/drives/{name}"
        self.kind = family(kind)
        self.set_line("open")
        self.state("online")
        self.rights()
        for info in self.kind.described():
            zero = f"H{0:0{info.hex_digits}X}" if info.format is Format.VH else "0"
            self.code(str(info.code), "H0080" if info.code == Code(150) else zero)

    def set_line(self, state: str) -> None:
        document = {"line": "hall-3", "state": state, "reason": "unplugged"}
        self.stub.answers["GET /v1/line"] = (200, json.dumps(document))

    def state(self, state: str) -> None:
        document = {"address": 11, "family": self.kind.name, "state": state, "reason": None}
        self.stub.answers[f"GET {self.path}"] = (200, json.dumps(document))

    def rights(self, reason: str | None = None, stops: str = "") -> None:
        document = {
            "permitted": reason is None, "owned": [], "reason": reason, "remedy": "do something",
            "stops": stops,
        }  # fmt: skip
        self.stub.answers[f"GET {self.path}/restore"] = (200, json.dumps(document))

    def code(self, code: str, raw: str | None) -> None:
        answer = (200, json.dumps({"raw": raw}))
        if raw is None:
            answer = problem("no-such-code", 404, f"there is no {code}")
        self.stub.answers[f"GET {self.path}/codes/{code}{READ}"] = answer

    def takes(self, code: str, outcome: str = "verified") -> None:
        self.stub.answers[f"PUT {self.path}/codes/{code}"] = (200, json.dumps({"outcome": outcome}))


@pytest.fixture
def drive(daemon: DaemonStub) -> Drive:
    return Drive(daemon)


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    yield
    left = tmp_path / "state" / "lecombus"
    assert not left.exists() or list(left.iterdir()) == [] or (tmp_path / "expected").exists()


def backed_up(run: Run, path: Path) -> Path:
    ran = run("backup", "feeder", "-o", str(path))
    assert ran.status == 0, ran.err
    return path


def test_a_backup_goes_to_its_file_and_says_how_much(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    drive.code("C0011", "50.5")
    drive.code("C2011", None)
    path = tmp_path / "f.yaml"
    ran = run("backup", "feeder", "-o", str(path))
    count = len(wanted_codes(drive.kind))
    assert (ran.status, ran.out) == (0, "")
    assert ran.err == f"feeder: {count - 1} codes read, 1 not readable, written to {path}\n"
    text = path.read_text()
    assert "  C0011: 50.5 " in text
    assert "  C2011: no-such-code" in text.partition("not-read:")[2]
    assert list(tmp_path.glob(".*")) == []


def test_without_a_file_the_backup_is_what_is_printed(run: Run, drive: Drive) -> None:
    ran = run("backup", "feeder")
    assert (ran.status, ran.err) == (0, "")
    assert "lecombus-backup: 1\n" in ran.out


def test_a_backup_as_json_has_every_code(run: Run, drive: Drive, tmp_path: Path) -> None:
    drive.code("C0011", "50.50")
    document = json.loads(run("backup", "feeder", "--json").out)
    (entry,) = [one for one in document["codes"] if one["code"] == "C0011"]
    assert (entry["raw"], entry["section"], entry["unit"]) == ("50.50", "parameters", "Hz")
    assert (document["complete"], document["file"]) == (True, None)


def test_further_codes_are_read_where_the_drive_knows_them(run: Run, drive: Drive) -> None:
    for number in range(4710, 4713):
        drive.code(f"C{number}", "7" if number == 4711 else None)
    ran = run("backup", "feeder", "--also", "C4710-C4712")
    assert "undescribed:\n  C4711: 7\n" in ran.out
    assert "C4712" not in ran.out


@pytest.mark.parametrize("written", ["C5-C4", "C0-C9999", "x", "C1-", "C0039/1-C40"])
def test_ranges_that_are_none_are_refused(run: Run, written: str) -> None:
    ran = run("backup", "feeder", "--also", written)
    assert ran.status == 2
    assert written.partition("-")[0] in ran.err


def test_what_is_incomplete_is_not_written_and_the_old_backup_stays(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    path = backed_up(run, tmp_path / "f.yaml")
    before = path.read_text()
    silent = problem("no-answer", 504, "feeder did not answer")
    drive.stub.answers[f"GET {DRIVE}/codes/C0011{READ}"] = silent
    ran = run("backup", "feeder", "-o", str(path))
    assert (ran.status, path.read_text()) == (1, before)
    assert "1 code of feeder could not be read, the first C0011" in ran.err
    assert "is as it was" in ran.err
    ran = run("backup", "feeder", "-o", str(path), "--partial")
    assert (ran.status, "C0011: no-answer" in path.read_text()) == (1, True)


def test_a_line_that_stays_away_is_waited_for_as_long_as_told(run: Run, drive: Drive) -> None:
    drive.set_line("lost")
    ran = run("backup", "feeder", "--wait", "10ms")
    assert ran.status == 1
    assert "waiting: line hall-3 is lost: unplugged" in ran.err
    assert not any("/codes/" in asked for asked, _ in drive.stub.asked)


def test_a_backup_never_replaces_something_else(run: Run, drive: Drive, tmp_path: Path) -> None:
    path = tmp_path / "roster.yaml"
    path.write_text("line: {name: hall-3}\n")
    ran = run("backup", "feeder", "-o", str(path))
    assert (ran.status, path.read_text()) == (2, "line: {name: hall-3}\n")
    assert "is not a backup; name another file" in ran.err
    assert run("backup", "feeder", "-o", str(tmp_path / "no" / "f.yaml")).status == 2
    assert drive.stub.asked == []


@pytest.mark.timeout(20)
def test_a_backup_does_not_wait_for_what_a_pipe_says(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    """Such as `-o /dev/stdout` in a pipe."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for place in (pipe, tmp_path, Path("/dev/null")):
        ran = run("backup", "feeder", "-o", str(place))
        assert (ran.status, drive.stub.asked) == (2, [])
        assert f"{place} is not a file; name one, or leave -o out" in ran.err


def test_a_drive_that_is_not_there_is_said_before_anything_is_read(run: Run, drive: Drive) -> None:
    drive.stub.answers[f"GET {DRIVE}"] = problem("no-such-drive", 404, "there is no drive feeder")
    ran = run("backup", "feeder")
    assert (ran.status, "there is no drive feeder" in ran.err) == (2, True)


@pytest.fixture
def two(daemon: DaemonStub) -> dict[str, Drive]:
    """A line of two drives."""
    names = ("feeder", "belt")
    listed = {"drives": [{"drive": name} for name in names]}
    daemon.answers["GET /v1/drives"] = (200, json.dumps(listed))
    return {name: Drive(daemon, name=name) for name in names}


def drives_in(folder: Path) -> list[str]:
    """Whose files are there, by the form of their names."""
    names = [path.name for path in folder.iterdir()]
    found = [re.fullmatch(r"(\w+)\.\d{4}-\d\d-\d\dT\d{6}Z\.yaml", name) for name in names]
    assert None not in found, names
    return sorted(one[1] for one in found if one is not None)


def test_all_drives_go_into_a_folder_a_file_each(
    run: Run, two: dict[str, Drive], tmp_path: Path
) -> None:
    ran = run("backup", "--all", "-o", str(tmp_path))
    assert (ran.status, ran.out) == (0, "")
    assert drives_in(tmp_path) == ["belt", "feeder"]
    for path, line in zip(sorted(tmp_path.iterdir()), reversed(ran.err.splitlines()), strict=True):
        assert line.endswith(f"codes read, written to {path}")
        assert path.name.partition(".")[2][:13] in path.read_text().partition("identity:")[0]
    (one, other) = sorted(map(str, tmp_path.iterdir()))
    assert run("diff", one, other).status == 0
    document = json.loads(run("backup", "--all", "-o", str(tmp_path), "--json").out)
    assert [(one["drive"], one["complete"]) for one in document["drives"]] == [
        ("feeder", True), ("belt", True),
    ]  # fmt: skip


@pytest.mark.parametrize("how", ["silent", "offline", "gone"])
def test_a_drive_that_cannot_be_read_is_named_and_the_others_are_backed_up(
    run: Run, two: dict[str, Drive], tmp_path: Path, how: str
) -> None:
    feeder = two["feeder"]
    if how == "silent":
        silent = problem("no-answer", 504, "no answer")
        feeder.stub.answers[f"GET {feeder.path}/codes/C0011{READ}"] = silent
    elif how == "offline":
        feeder.state("offline")
    else:
        gone = problem("no-such-drive", 404, "there is no such drive")
        feeder.stub.answers[f"GET {feeder.path}"] = gone
    ran = run("backup", "--all", "-o", str(tmp_path), "--wait", "0s")
    assert (ran.status, drives_in(tmp_path)) == (1, ["belt"])
    assert "feeder" in ran.err.splitlines()[-1]
    ran = run("backup", "--all", "-o", str(tmp_path), "--wait", "0s", "--json")
    assert [one["drive"] for one in json.loads(ran.out)["drives"]] == ["belt"]
    told = json.loads(ran.err)
    assert (told["status"], told["drive"]) == (1, "feeder")


def test_drives_that_are_offline_are_passed_over_without_a_wait_and_named_with_the_reason(
    run: Run, two: dict[str, Drive], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def no_wait(drive: HttpDrive, for_s: float) -> None:
        raise AssertionError("a drive that is offline was waited for")

    monkeypatch.setattr(HttpDrive, "pause", no_wait)
    two["feeder"].state("offline")
    ran = run("backup", "--all", "-o", str(tmp_path), "--partial")  # and no file of nothing
    assert (ran.status, drives_in(tmp_path)) == (1, ["belt"])
    said = ran.err.splitlines()
    assert said[0].startswith("belt: ")
    assert said[1:] == ["feeder was not backed up: feeder is offline"]
    ran = run("backup", "--all", "-o", str(tmp_path), "--json")
    assert json.loads(ran.err)["kind"] == "offline"


def test_a_lost_line_is_waited_for_once_and_not_for_each_drive(
    run: Run, two: dict[str, Drive], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0

    async def wait(drive: HttpDrive, for_s: float) -> None:
        nonlocal now_s
        now_s += for_s
        drive.waited_s += for_s

    monkeypatch.setattr(HttpDrive, "pause", wait)
    monkeypatch.setattr(HttpDrive, "now_s", lambda drive: now_s)
    two["feeder"].set_line("lost")
    ran = run("backup", "--all", "-o", str(tmp_path))
    assert (ran.status, now_s, drives_in(tmp_path)) == (1, 60.0, [])
    assert [line for line in ran.err.splitlines() if "not backed up" in line] == [
        f"{name} was not backed up: line hall-3 is lost: unplugged" for name in ("feeder", "belt")
    ]


def test_what_is_incomplete_is_written_if_wanted_and_takes_the_place_of_nothing(
    run: Run, two: dict[str, Drive], tmp_path: Path
) -> None:
    whole = tmp_path / "feeder.2020-01-01T000000Z.yaml"
    whole.write_text("from another day")
    feeder = two["feeder"]
    feeder.stub.answers[f"GET {feeder.path}/codes/C0011{READ}"] = problem("no-answer", 504, "no")
    ran = run("backup", "--all", "-o", str(tmp_path), "--partial", "--keep", "1")
    assert (ran.status, drives_in(tmp_path)) == (1, ["belt", "feeder", "feeder"])
    assert "1 not readable" in ran.err
    assert whole.exists()


def test_a_disk_that_takes_nothing_is_said_of_each_drive(
    run: Run, two: dict[str, Drive], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, text: str, **_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr("lecombus.cli.backup.write_whole", full)
    ran = run("backup", "--all", "-o", str(tmp_path))
    assert (ran.status, list(tmp_path.iterdir())) == (1, [])
    assert [line.partition(":")[0] for line in ran.err.splitlines()] == ["feeder", "belt"]
    assert ran.err.count("No space left on device") == 2


def test_the_oldest_files_of_a_drive_are_deleted_and_nothing_else(
    run: Run, two: dict[str, Drive], tmp_path: Path
) -> None:
    days = ("2020-01-01T000000Z", "2020-01-02T000000Z", "2098-01-01T000000Z", "2099-01-01T000000Z")
    for name in ("feeder", "left-the-roster"):
        for day in days:
            (tmp_path / f"{name}.{day}.yaml").write_text("old")
    mine = ("feeder.yaml", "feeder.2020-01-01T000000Z.yaml.mine", "notes.txt")
    for name in mine:
        (tmp_path / name).write_text("mine")
    assert run("backup", "--all", "-o", str(tmp_path), "--keep", "3").status == 0
    left = sorted(path.name for path in tmp_path.iterdir())
    assert [name for name in left if name.startswith("left-the-roster.")] == [
        f"left-the-roster.{day}.yaml" for day in days
    ]
    assert set(mine) <= set(left)
    # Files of the future: the clock was wrong then, or is now. What was just read stays.
    of_feeder = [name for name in left if name.startswith("feeder.2") and name not in mine]
    assert len(of_feeder) == 3
    assert of_feeder[1:] == [f"feeder.{day}.yaml" for day in days[2:]]
    assert "old" not in (tmp_path / of_feeder[0]).read_text()
    assert sum(name.startswith("belt.") for name in left) == 1


@pytest.mark.parametrize(
    "words",
    [
        ("--all",), ("--all", "feeder", "-o", "."), ("--all", "-o", "/no/folder"), (),
        ("feeder", "--keep", "3"), ("--all", "-o", ".", "--keep", "0"),
    ],
)  # fmt: skip
def test_words_that_do_not_go_together_are_refused_before_anything_is_read(
    run: Run, two: dict[str, Drive], words: tuple[str, ...]
) -> None:
    ran = run("backup", *words)
    assert (ran.status, len(ran.err.splitlines())) == (2, 1)
    assert two["feeder"].stub.asked == []


def test_without_a_daemon_no_drive_is_named(run: Run, tmp_path: Path) -> None:
    ran = run("backup", "--all", "-o", str(tmp_path), "--socket", str(tmp_path / "none"))
    assert (ran.status, len(ran.err.splitlines())) == (3, 1)


def test_diff_shows_what_differs_between_file_and_drive(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    path = backed_up(run, tmp_path / "f.yaml")
    assert (run("diff", str(path), "feeder").status, run("diff", "feeder", str(path)).out) == (
        0,
        "",
    )
    drive.code("C2011", "60.50")
    drive.code("C0046", "10")
    ran = run("diff", str(path), "feeder")
    assert ran.status == 1
    (line,) = ran.out.splitlines()
    assert line.split("\t")[0] == "C2011"
    assert line.split("\t")[2:] == ["0", "60.50", "Hz"]
    assert len(run("diff", str(path), "feeder", "--all").out.splitlines()) == 2
    document = json.loads(run("diff", str(path), "feeder", "--json").out)
    assert document["equal"] is False
    assert [(one["one"], one["other"]) for one in document["differences"]] == [("0", "60.50")]


def test_on_a_terminal_codes_are_named_as_at_the_keypad(
    run: Run, daemon: DaemonStub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = Drive(daemon, "smvector")
    drive.code("C1122", "9")
    path = backed_up(run, tmp_path / "f.yaml")
    drive.code("C1122", "1")
    piped = run("diff", str(path), "feeder").out.split("\t")[:2]
    assert piped == ["C1122", "P122 function of terminal TB-13B"]
    words = ("restore", str(path), "feeder", "--dry-run")
    rows = [line.split("\t") for line in run(*words).out.splitlines()]
    assert rows[0][:3] == ["write", *piped]
    assert ["skip", "C1410"] in [row[:2] for row in rows]
    monkeypatch.setattr("lecombus.cli.document_rows.on_terminal", lambda: True)
    shown = run("diff", str(path), "feeder").out.split("\t")[:2]
    assert shown == ["P122", "function of terminal TB-13B"]
    rows = [line.split("\t") for line in run(*words).out.splitlines()]
    assert rows[0][:3] == ["write", *shown]
    assert ["skip", "P410"] in [row[:2] for row in rows]
    drive.stub.answers[f"GET {DRIVE}/codes/C1122{READ}"] = problem("no-answer", 504, "silent")
    for command in (("backup", "feeder"), ("diff", str(path), "feeder"), words):
        assert "could not be read, the first P122: " in run(*command).err


def test_two_files_are_compared_without_a_daemon(
    run: Run, drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = backed_up(run, tmp_path / "one.yaml")
    drive.code("C0011", "60")
    other = backed_up(run, tmp_path / "other.yaml")
    monkeypatch.setenv("LECOMBUS_SOCKET", str(tmp_path / "nobody"))
    assert run("diff", str(one), str(one)).status == 0
    assert run("diff", str(one), str(other)).status == 1


def test_a_name_that_is_a_file_and_may_be_a_drive_is_not_guessed(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "feeder").write_text("")
    monkeypatch.chdir(tmp_path)
    ran = run("diff", "feeder", "x.yaml")
    assert (ran.status, "write ./feeder for it" in ran.err) == (2, True)


def test_a_damaged_file_is_refused_with_its_line(run: Run, drive: Drive, tmp_path: Path) -> None:
    path = backed_up(run, tmp_path / "f.yaml")
    path.write_text(re.sub("C0011: 0 ", "C0011: x ", path.read_text()))
    line = 1 + path.read_text().splitlines().index(
        next(one for one in path.read_text().splitlines() if "C0011: x" in one)
    )
    for words in (("diff", str(path), "feeder"), ("restore", str(path), "feeder")):
        ran = run(*words)
        assert (ran.status, f"{path}:{line}:" in ran.err) == (2, True)
    path.write_bytes(b"\xff\xfe")
    assert run("restore", str(path), "feeder").status == 2


def to_restore(run: Run, drive: Drive, tmp_path: Path) -> Path:
    """A file whose C0011 and C2011 differ from what the drive reads."""
    drive.code("C0011", "60")
    drive.code("C2011", "70")
    path = backed_up(run, tmp_path / "f.yaml")
    drive.code("C0011", "50")
    drive.code("C2011", "50")
    drive.stub.asked.clear()
    return path


def writes(drive: Drive) -> list[str]:
    return [asked for asked, _ in drive.stub.asked if not asked.startswith("GET")]


def test_a_dry_run_shows_the_plan_and_writes_nothing(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    path = to_restore(run, drive, tmp_path)
    ran = run("restore", str(path), "feeder", "--dry-run")
    assert ran.status == 0
    rows = [line.split("\t") for line in ran.out.splitlines()]
    assert [(row[1], row[3], row[4]) for row in rows if row[0] == "write"] == [
        ("C0011", "50", "60"), ("C2011", "50", "70"),
    ]  # fmt: skip
    assert [row[1] for row in rows if row[0] == "skip"] == ["C0009", "C0125"]
    assert writes(drive) == []
    document = json.loads(run("restore", str(path), "feeder", "--dry-run", "--json").out)
    assert [one["then"] for one in document["write"]] == ["60", "70"]


def test_nothing_is_written_where_nobody_can_say_yes(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    path = to_restore(run, drive, tmp_path)
    ran = run("restore", str(path), "feeder")
    assert (ran.status, "repeat it with --yes" in ran.err, writes(drive)) == (2, True, [])


def test_without_the_rosters_permission_nothing_is_written(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    path = to_restore(run, drive, tmp_path)
    drive.rights("the roster does not let feeder be restored")
    ran = run("restore", str(path), "feeder", "--yes")
    assert (ran.status, writes(drive)) == (4, [])
    assert "does not let feeder be restored; do something" in ran.err


def test_each_write_says_that_it_is_part_of_a_restore_and_has_time(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    (tmp_path / "expected").touch()  # the stub reads as before: the restore is not complete
    path = to_restore(run, drive, tmp_path)
    drive.takes("C0011")
    drive.takes("C2011")
    ran = run("restore", str(path), "feeder", "--yes", "--json")
    bodies = [json.loads(body) for asked, body in drive.stub.asked if asked.startswith("PUT")]
    assert bodies[0] == {
        "value": "60", "verify": True, "priority": "background", "restore": True,
        "expires": "45s",
    }  # fmt: skip
    document = json.loads(ran.out)
    assert (ran.status, document["complete"], document["written"]) == (1, False, ["C0011", "C2011"])
    assert [(one["code"], one["wanted"], one["reads"]) for one in document["changed"]] == [
        ("C0011", "60", "50"), ("C2011", "70", "50"),
    ]  # fmt: skip


def test_an_interrupted_restore_is_told_and_gone_on_with(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    path = to_restore(run, drive, tmp_path)
    drive.takes("C0011")
    ran = run("restore", str(path), "feeder", "--yes")  # C2011 is not taken
    assert ran.status == 1
    assert "run it again" in ran.err
    (notes,) = (tmp_path / "state" / "lecombus").iterdir()
    assert notes.name == "restore-hall-3-feeder.jsonl"
    drive.code("C0011", "60")
    drive.code("C2011", "70")
    ran = run("restore", str(path), "feeder", "--yes")
    assert (ran.status, ": 1 code written then" in ran.out) == (0, True)
    assert not notes.exists()


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_during_a_restore_says_what_was_written_and_how_to_go_on(
    run: Run, drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals, as_json: bool,
) -> None:  # fmt: skip
    (tmp_path / "expected").touch()
    path = to_restore(run, drive, tmp_path)
    drive.takes("C0011")
    drive.takes("C2011")
    plain = Notes.done

    def done(notes: Notes, code: Code, value: Value) -> None:
        plain(notes, code, value)
        os.kill(os.getpid(), number)

    monkeypatch.setattr(Notes, "done", done)
    # These tests may run in the background themselves, deaf to Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        ran = run("restore", str(path), "feeder", "--yes", *(["--json"] if as_json else []))
    finally:
        signal.signal(signal.SIGINT, before)
    assert ran.status == 130
    if as_json:
        document = json.loads(ran.out)
        assert (document["written"], document["stopped"]) == (["C0011"], "interrupted")
    else:
        assert "interrupted: 1 of 2 codes written to feeder and read back" in ran.err
        assert "Run the same command again: it goes on with what is missing" in ran.err


@pytest.mark.parametrize("as_json", [False, True])
def test_a_drive_that_leaves_the_roster_during_a_restore_says_what_was_written(
    run: Run, drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    (tmp_path / "expected").touch()
    path = to_restore(run, drive, tmp_path)
    drive.takes("C0011")
    plain = Notes.done

    def done(notes: Notes, code: Code, value: Value) -> None:
        plain(notes, code, value)
        gone = problem("no-such-drive", 404, "there is no drive feeder")
        drive.stub.answers.update(dict.fromkeys(drive.stub.answers, gone))
        drive.stub.answers[f"PUT {drive.path}/codes/C2011"] = gone

    monkeypatch.setattr(Notes, "done", done)
    ran = run("restore", str(path), "feeder", "--yes", *(["--json"] if as_json else []))
    assert ran.status == 2
    assert "there is no drive feeder" in ran.err
    if as_json:
        document = json.loads(ran.out)
        assert document["written"] == ["C0011"]
        assert "there is no drive feeder" in document["stopped"]
    else:
        assert "interrupted: 1 of 2 codes written to feeder and read back" in ran.err


def test_a_ctrl_c_before_anything_is_written_says_so(
    run: Run, drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = to_restore(run, drive, tmp_path)

    async def interrupted(*_args: object, **_more: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        await anyio.sleep(5)

    monkeypatch.setattr("lecombus.cli.restore.take", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        ran = run("restore", str(path), "feeder", "--yes")
    finally:
        signal.signal(signal.SIGINT, before)
    assert (ran.status, ran.err.strip()) == (130, "interrupted: nothing was written")


@pytest.mark.parametrize("stopped", [False, True])
def test_what_was_stopped_since_is_not_enabled_by_going_on(
    run: Run, drive: Drive, tmp_path: Path, stopped: bool
) -> None:
    (tmp_path / "expected").touch()  # the stub reads as before: the restore is not complete
    path = to_restore(run, drive, tmp_path)
    drive.rights(stops="r-feeder-1")
    drive.code("C0150", "H0000")
    drive.stub.answers["POST /v1/stop"] = (200, json.dumps({"outcome": "verified"}))
    words = ("restore", str(path), "feeder", "--yes", "--enable")
    ran = run(*words)  # it stays enabled, whatever is said
    assert (ran.status, "its inhibit was lifted from elsewhere" in ran.err) == (1, True)
    assert "is not inhibited any more" not in ran.out, "no enable was sent"
    drive.code("C0150", "H0080")
    if stopped:
        drive.rights(stops="r-feeder-2")
    drive.takes("C0011")
    ran = run(*words)
    (notes,) = (tmp_path / "state" / "lecombus").iterdir()
    head = json.loads(notes.read_text().splitlines()[0])
    assert (ran.status, head["enabled"]) == (1, not stopped)
    if stopped:
        assert "it was stopped since, or lecombus was started again: it stays inhibited" in ran.err
    else:
        assert "the inhibit is lifted at the end: the motor may turn" in ran.err


@pytest.mark.parametrize("stopped", [False, True])
def test_a_restore_that_was_killed_before_its_enable_enables_when_it_is_run_again(
    run: Run, drive: Drive, tmp_path: Path, stopped: bool
) -> None:
    path = to_restore(run, drive, tmp_path)
    drive.code("C0011", "60")
    drive.code("C2011", "70")
    drive.rights(stops="r-feeder-3" if stopped else "r-feeder-2")
    drive.takes("C0040")
    digest = digest_of(path.read_text())
    with Notes.opened("hall-3", "feeder") as notes:
        notes.begin(Progress(str(path), digest, "2026-11-23T12:00:00Z", True, stops="r-feeder-2"))
        notes.done(Code(11), Value.parse("60"))
    ran = run("restore", str(path), "feeder", "--yes", "--enable")
    assert ran.status == 0
    lifted = [] if stopped else [f"PUT {DRIVE}/codes/C0040"]
    assert writes(drive) == lifted
    assert ("feeder is not inhibited any more" in ran.out) is not stopped
    assert ("stays inhibited" in ran.err) is stopped


def test_our_own_inhibit_is_no_stop_since(run: Run, drive: Drive, tmp_path: Path) -> None:
    (tmp_path / "expected").touch()
    path = to_restore(run, drive, tmp_path)
    drive.takes("C0011")
    drive.rights(stops="r-feeder-1")
    plain = HttpDrive.write

    async def write(to: HttpDrive, code: Code, value: Value, *, verify: bool) -> WriteAttempt:
        to.stops = "r-feeder-2"  # as our own inhibit sets it
        return await plain(to, code, value, verify=verify)

    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(HttpDrive, "write", write)
        assert run("restore", str(path), "feeder", "--yes").status == 1
    (notes,) = (tmp_path / "state" / "lecombus").iterdir()
    found = read_progress(notes.read_text())
    assert found is not None
    assert (found.stops, list(found.done)) == ("r-feeder-2", [Code(11)])


@pytest.mark.parametrize(
    ("mark", "goes_on"),
    [("r-feeder-2", True), ("r-feeder-3", False), ("s-feeder-9", True), ("", True)],
)
def test_a_stop_by_another_one_beside_our_inhibit_ends_the_restore(
    run: Run,
    drive: Drive,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    mark: str,
    goes_on: bool,
) -> None:
    (tmp_path / "expected").touch()
    path = to_restore(run, drive, tmp_path)
    drive.rights(stops="r-feeder-1")
    drive.code("C0150", "H0000")
    plain = HttpDrive._act

    async def act(to: HttpDrive, method: str, path: str, document: Any) -> WriteAttempt:
        if path == "/v1/stop":
            drive.rights(stops=mark)  # ours, and perhaps another one
            drive.code("C0150", "H0080")
            return WriteAttempt(True)
        return await plain(to, method, path, document)

    monkeypatch.setattr(HttpDrive, "_act", act)
    ran = run("restore", str(path), "feeder", "--yes", "--enable")
    assert ran.status == 1
    assert any("C0011" in asked for asked in writes(drive)) is goes_on
    assert ("also stopped by another client" in ran.err) is not goes_on


def test_a_stop_while_the_user_is_asked_ends_the_restore(
    run: Run, drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "expected").touch()
    path = to_restore(run, drive, tmp_path)
    drive.rights(stops="r-feeder-1")

    def make_sure(question: str, *, as_json: bool) -> None:
        drive.rights(stops="r-feeder-2")

    monkeypatch.setattr("lecombus.cli.restore.make_sure", make_sure)
    run("restore", str(path), "feeder")
    bodies = [json.loads(body) for asked, body in drive.stub.asked if asked.startswith("PUT")]
    assert {body["stops"] for body in bodies} == {"r-feeder-1"}


def test_what_a_restore_of_another_file_left_unsaved_is_saved(
    run: Run, daemon: DaemonStub, tmp_path: Path
) -> None:
    drive = Drive(daemon, "93xx")
    drive.code("C0012", "6")
    path = backed_up(run, tmp_path / "f.yaml")
    drive.takes("C0003", "done")
    with Notes.opened("hall-3", "feeder") as notes:
        notes.begin(Progress("other.yaml", "0123", "2026-11-23T12:00:00Z", enabled=False))
        notes.done(Code(12), Value.parse("6"))
    ran = run("restore", str(path), "feeder", "--yes")
    assert (ran.status, writes(drive)) == (0, [f"PUT {DRIVE}/codes/C0003"]), ran.err


def test_another_files_unfinished_restore_is_told(run: Run, drive: Drive, tmp_path: Path) -> None:
    (tmp_path / "expected").touch()
    path = to_restore(run, drive, tmp_path)
    run("restore", str(path), "feeder", "--yes")
    other = tmp_path / "other.yaml"
    other.write_text(path.read_text().replace("C0011: 60", "C0011: 61"))
    ran = run("restore", str(other), "feeder", "--yes")
    assert "may hold a part of it" in ran.out


def test_a_drive_that_reads_as_the_file_is_left_alone(
    run: Run, drive: Drive, tmp_path: Path
) -> None:
    path = backed_up(run, tmp_path / "f.yaml")
    ran = run("restore", str(path), "feeder", "--yes")
    assert (ran.status, writes(drive)) == (0, [])


def test_another_drive_needs_its_own_word(run: Run, drive: Drive, tmp_path: Path) -> None:
    path = to_restore(run, drive, tmp_path)
    drive.code("C1810", "Sanother")
    ran = run("restore", str(path), "feeder", "--yes")
    assert (ran.status, writes(drive)) == (2, [])
    assert "add --to-other-drive if the backup is meant for this drive" in ran.err
    ran = run("restore", str(path), "feeder", "--dry-run", "--to-other-drive")
    assert (ran.status, "C1810" in ran.err) == (0, True)


@pytest.mark.parametrize("other", [False, True])
def test_a_wrong_value_is_to_be_corrected_also_for_another_drive(
    run: Run, drive: Drive, tmp_path: Path, other: bool
) -> None:
    path = to_restore(run, drive, tmp_path)
    path.write_text(re.sub("C0135: [^ ]+", "C0135: 0208", path.read_text()))
    if other:
        drive.code("C1810", "Sanother")
    for words in ((), ("--to-other-drive",)):
        ran = run("restore", str(path), "feeder", "--dry-run", *words)
        (wrong,) = [line for line in ran.err.splitlines() if "C0135: 0208" in line]
        assert (ran.status, wrong.endswith("; correct the file")) == (2, True)
        assert "--to-other-drive" not in ran.err


def test_another_family_is_refused_whatever_is_said(run: Run, drive: Drive, tmp_path: Path) -> None:
    path = to_restore(run, drive, tmp_path)
    drive.kind = family("821x")
    drive.state("online")
    ran = run("restore", str(path), "feeder", "--yes", "--to-other-drive")
    assert (ran.status, writes(drive)) == (2, [])
    assert "the backup is of a 8200vector, the drive is a 821x" in ran.err
    assert "--to-other-drive" not in ran.err


@pytest.mark.parametrize("inhibited", [True, False, None])
def test_a_restore_says_of_the_inhibit_what_the_drive_shows_in_the_end(
    capsys: pytest.CaptureFixture[str], inhibited: bool | None, golden: Golden
) -> None:
    result = Restored(inhibited_here=True, inhibited_now=inhibited)
    plan = make_plan(backup_of("8200vector", {}), family("8200vector"), {})
    show_result(plan, result, "feeder", enabled=False)
    shown = capsys.readouterr()
    golden(shown.out + shown.err)
    assert result_json(plan, result, "feeder")["inhibited"] is (inhibited is True)


def test_what_a_restore_could_not_write_is_named_as_at_the_keypad(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now, file = answers({"P122": "1"}), backup_of("smvector", {"P122": "9"})
    plan = make_plan(file, family("smvector"), now)
    result = Restored(
        refused={Code(1122): "NAK"}, stopped="it is away", written={Code(1425): Value.parse("1")}
    )
    show_result(plan, result, "fan", enabled=False)
    assert capsys.readouterr().out.startswith("C1122\trefused\t9")
    monkeypatch.setattr("lecombus.cli.document_rows.on_terminal", lambda: True)
    show_result(plan, result, "fan", enabled=False)
    shown = capsys.readouterr()
    assert shown.out.startswith("P122\trefused\t9")
    assert "written: P425" in shown.err


@pytest.mark.parametrize("enable", [False, True])
def test_a_drive_that_is_not_inhibited_is_not_called_enabled(
    capsys: pytest.CaptureFixture[str], enable: bool
) -> None:
    """A quick stop may hold it: the plan rests on its inhibit alone."""
    was = answers({"C0011": "50"})
    plan = make_plan(backup_of("8200vector", {"C0011": "60"}), family("8200vector"), was)
    show_plan(plan, "feeder", enabled=True, enable=enable)
    after = "the inhibit is lifted at the end: the motor may turn" if enable else "stays so"
    said = f"feeder is not inhibited: it will be inhibited, and {after}"
    assert said in capsys.readouterr().err.splitlines()
