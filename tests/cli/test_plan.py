"""`lecombus plan`, as typed."""

from __future__ import annotations

import errno
import json
import os
import re
from pathlib import Path
from typing import Any

import pytest

from cli.conftest import Run
from cli.daemon_stub import DaemonStub
from lecombus.api.decimal_json import encode
from lecombus.capacity.facts import answers_of, facts_of
from lecombus.cli import main
from lecombus.config import load_roster
from lecombus.drives.measured import AnswerRow, SlowAnswers
from lecombus.metrics.rolling_window import RollingWindow
from lecombus.parameters import Code
from lecombus.schedule.request import Priority
from support.rosters import roster_text

pytestmark = pytest.mark.clock

ROSTER = roster_text(
    [("a", 11, "smvector"), ("b", 12, "8200vector")],
    name="l", baud=None, watchdog="{time: TIME, action: quick-stop}",
)  # fmt: skip


@pytest.fixture
def roster(tmp_path: Path) -> Path:
    file = tmp_path / "r.yaml"
    file.write_text(ROSTER.replace("TIME", "2s"))
    return file


def test_it_says_load_waits_watchdogs_and_what_would_change_them(
    roster: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", "-c", str(roster)]) == 0
    out = capsys.readouterr().out
    assert "line l at 9600 baud: 13% of it is asked for" in out
    assert "while drives that do not answer are being stopped, no class but the stops of" in out
    for word in ("stop\t", "control\t", "held, also when a drive goes away", "19200\t", "1\t"):
        assert word in out


def test_on_a_terminal_a_code_of_an_smvector_is_named_as_at_its_keypad(
    roster: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    cyclic = "cyclic: [{code: C1527, every: 1s}, {code: C0150, every: 1s}]"
    roster.write_text(roster.read_text().replace("family: smvector", f"family: smvector, {cyclic}"))
    assert main(["plan", "-c", str(roster)]) == 0
    assert "a\tC1527\t" in capsys.readouterr().out
    monkeypatch.setattr("lecombus.cli.document_rows.on_terminal", lambda: True)
    assert main(["plan", "-c", str(roster)]) == 0
    out = capsys.readouterr().out
    assert "a\tP527\t" in out
    assert "a\tC0150\t" in out
    assert "C1527" not in out


def test_json_is_one_document(roster: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "-c", str(roster), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["baud"] == 9600


def test_in_a_pipe_too_every_table_says_what_it_is(
    roster: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", "-c", str(roster)]) == 0
    tables = dict(
        table.split("\n", 1) for table in capsys.readouterr().out.strip().split("\n\n")[1:]
    )
    assert list(tables) == [
        "how long one request waits at most",
        "how long the first request of a class waits at most, whatever others ask for",
        "watchdogs", "exchanges", "at other baud rates", "with drives away",
    ]  # fmt: skip
    for rows in tables.values():
        assert len({row.count("\t") for row in rows.splitlines()}) == 1
    assert tables["watchdogs"].startswith("drive\twatchdog\ta feed\tleast held\t")


def test_what_the_schedule_and_a_slow_adapter_make_of_it_is_said(
    roster: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", "-c", str(roster)]) == 0
    out = capsys.readouterr().out
    assert "run by the schedule: 13% of it is taken (reads 13%, feeds 0%;" in out
    assert "if the adapter adds its 5ms to every answer: 15% is asked for, every watchdog" in out
    slow = roster.read_text().replace("'sim:'", "'sim:', adapter_latency: 1s")
    roster.write_text(slow)
    assert main(["plan", "-c", str(roster)]) == 0
    assert "not every watchdog is held: a time of" in capsys.readouterr().out
    assert main(["check", "-c", str(roster)]) == 0
    assert "watchdogs act if the adapter adds its 1s to every answer" in capsys.readouterr().out


def test_the_roster_is_not_drawn_over(roster: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = roster.read_text()
    assert main(["plan", "-c", str(roster), "--svg", str(roster)]) == 2
    assert "is the roster" in capsys.readouterr().err
    assert roster.read_text() == before


def test_every_name_in_the_json_is_documented(daemon: DaemonStub, run: Run, roster: Path) -> None:
    """Names stay: what is there stands in docs/timing.md, and what stands there is there."""
    facts = too_slow(roster)
    facts["roster"]["drives"][0]["lease"]["required"] = True
    daemon.answers["GET /v1/plan"] = (200, json.dumps(facts))
    found: set[str] = set()
    for words in (("--from-daemon",), ("--live",)):
        found |= names_in(json.loads(run("plan", *words, "--json").out))
    text = (Path(__file__).parents[2] / "docs" / "timing.md").read_text()
    section = text.partition("## With --json\n")[2].partition("\n## ")[0]
    told = set(re.findall(r"`([a-z_]+)(?:\[\])?`", section))
    assert found - told == set()
    assert told - found - {"null", "feed", "_s"} == set()


def names_in(document: Any) -> set[str]:
    if isinstance(document, list):
        return set().union(*(names_in(one) for one in document))
    if isinstance(document, dict):
        drives = {"a", "b"}  # under `answers` the names are those of drives
        return (set(document) - drives).union(*(names_in(one) for one in document.values()))
    return set()


def test_the_picture_is_written(roster: Path, tmp_path: Path) -> None:
    file = tmp_path / "line.svg"
    assert main(["plan", "-c", str(roster), "--svg", str(file)]) == 0
    assert file.read_text().startswith("<svg ")


def test_a_picture_that_cannot_be_written_says_so(
    roster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", "-c", str(roster), "--svg", str(tmp_path / "no" / "x.svg")]) == 2
    assert "x.svg: no such file or directory" in capsys.readouterr().err


def test_a_full_disk_spoils_no_drawing(
    roster: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "line.svg"
    file.write_text("drawn before")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    assert main(["plan", "-c", str(roster), "--svg", str(file)]) == 1
    assert f"{file}: no space left on device" in capsys.readouterr().err
    assert file.read_text() == "drawn before"


def test_a_roster_that_cannot_be_held_is_refused_with_its_places(
    roster: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    roster.write_text(ROSTER.replace("TIME", "50ms"))
    assert main(["plan", "-c", str(roster)]) == 2
    err = capsys.readouterr().err
    assert f"{roster}:3:" in err
    assert f"{roster}:4:" in err
    assert "cannot be held at 9600 baud" in err


def test_live_says_what_is_beyond_the_promise(daemon: DaemonStub, run: Run, roster: Path) -> None:
    daemon.answers["GET /v1/plan"] = (200, json.dumps(document(roster)))
    ran = run("plan", "--live")
    assert (ran.status, ran.err) == (0, "")
    assert "the last 120 s" in ran.out
    assert "that is since its start" in ran.out
    assert "beyond the promise: watchdog of b: fed too late: the drive may have acted" in ran.out
    assert "beyond the promise: class control: waited longer than promised" in ran.out
    assert "watchdog of a" not in ran.out
    told = json.loads(run("plan", "--live", "--json").out)
    assert len(told["beyond"]) == 2
    assert {one["name"] for one in told["classes"]} >= {"stop", "background"}


def test_live_names_a_code_of_an_smvector_as_its_keypad_does(
    daemon: DaemonStub, run: Run, roster: Path
) -> None:
    cyclic = "cyclic: [{code: C1527, every: 1s}, {code: C0150, every: 1s}]"
    roster.write_text(roster.read_text().replace("family: smvector", f"family: smvector, {cyclic}"))
    found = document(roster)
    minutes = RollingWindow(0.0)
    minutes.expect("a", (Code(1527),))
    for at_s in (1.0, 119.0):
        minutes.value("a", Code(1527), at_s)
    found["measured"] = json.loads(encode(minutes.as_json(120.0)))
    daemon.answers["GET /v1/plan"] = (200, json.dumps(found))
    assert "beyond the promise: P527 of a: seldomer than promised" in run("plan", "--live").out
    told = json.loads(run("plan", "--live", "--json").out)
    assert "C1527 of a: seldomer than promised" in told["beyond"]


def test_from_daemon_plans_with_what_was_measured(
    daemon: DaemonStub, run: Run, roster: Path
) -> None:
    daemon.answers["GET /v1/plan"] = (200, json.dumps(document(roster)))
    ran = run("plan", "--from-daemon")
    assert ran.status == 0
    assert "b\tC0150\t20 ms\t61 ms" in ran.out
    assert "a\tC0150\t" not in ran.out.partition("b\tC0150\t20 ms")[2]
    measured = json.loads(run("plan", "--from-daemon", "--json").out)
    usual = json.loads(run("plan", "-c", str(roster), "--json").out)
    assert read_s(measured, "b") == pytest.approx(read_s(usual, "b") + 0.08 - 0.02, abs=0.015)
    assert read_s(measured, "a") == read_s(usual, "a")
    assert json.loads(run("plan", "--from-daemon", "-c", str(roster), "--json").out) == measured
    moved = roster.with_name("moved.yaml")
    moved.write_text(roster.read_text().replace("address: 12", "address: 13"))
    other = json.loads(run("plan", "--from-daemon", "-c", str(moved), "--json").out)
    assert read_s(other, "b") == read_s(usual, "b")
    assert list(other["answers"]) == ["a"]
    moved.write_text(moved.read_text().replace("address: 1", "address: 2"))
    none = run("plan", "--from-daemon", "-c", str(moved))
    assert "no drive of the roster is on the daemon's line" in none.out


def test_from_daemon_says_what_cannot_be_held_with_what_was_measured(
    daemon: DaemonStub, run: Run, roster: Path
) -> None:
    daemon.answers["GET /v1/plan"] = (200, json.dumps(too_slow(roster)))
    ran = run("plan", "--from-daemon")
    assert ran.status == 0
    assert "b: a watchdog of 450ms cannot be held at 9600 baud: within 405ms" in ran.out
    told = json.loads(run("plan", "--from-daemon", "--json").out)
    assert [one["drive"] for one in told["unheld"]] == ["a", "b"]
    assert "a time of" in told["unheld"][0]["right"]


def test_live_says_that_the_line_is_not_open(daemon: DaemonStub, run: Run, roster: Path) -> None:
    found = document(roster) | {"state": "lost", "away": ["a", "b"]}
    daemon.answers["GET /v1/plan"] = (200, json.dumps(found))
    ran = run("plan", "--live")
    assert "beyond the promise: line l: is lost, no drive can be asked" in ran.out
    assert "drive a: does not answer" not in ran.out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "-c ROSTER is missing"),
        (("--live", "--from-daemon"), "give one"),
        (("--live", "-c", "r.yaml"), "leave out -c"),
        (("-c", "r.yaml", "--socket", "/tmp/x.sock"), "need --live or --from-daemon"),
    ],
)
def test_what_contradicts_itself_is_refused(run: Run, words: tuple[str, ...], said: str) -> None:
    ran = run("plan", *words)
    assert ran.status == 2
    assert said in ran.err


def test_another_version_s_document_is_no_traceback(daemon: DaemonStub, run: Run) -> None:
    daemon.answers["GET /v1/plan"] = (200, '{"roster": {"line": 5}}')
    for word in ("--live", "--from-daemon"):
        ran = run("plan", word)
        assert ran.status == 1
        assert "does not know" in ran.err


def read_s(plan: dict[str, Any], drive: str) -> float:
    rows = {(one["drive"], one["what"]): one for one in plan["exchanges"]}
    usual_s = rows[drive, "C0150" if drive == "b" else "feed"]["times"]["usual_s"]
    assert isinstance(usual_s, float)
    return usual_s


def too_slow(roster: Path) -> dict[str, Any]:
    """What a daemon gives whose drives take eight times as long as their manual says."""
    roster.write_text(ROSTER.replace("TIME", "450ms"))
    found = document(roster)
    for one in found["roster"]["drives"]:
        one["slow"]["ratio"] = 8.0
    return found


def document(roster: Path) -> dict[str, Any]:
    """What a daemon of the roster gives: b is slow, and was fed too late."""
    minutes = RollingWindow(0.0)
    minutes.exchange(Priority.CONTROL, 0.03, 9.0, 119.0, good=True)
    minutes.margin("a", 0.9, 119.0)
    minutes.margin("b", -0.1, 119.0)
    slow = {"a": SlowAnswers(), "b": SlowAnswers({Code(150): 0.08})}
    row = AnswerRow(Code(150), False, 0.02, 0.061, True)
    facts: dict[str, Any] = {
        "roster": facts_of(load_roster(roster), slow),
        "measured": minutes.as_json(120.0),
        "answers": answers_of({"a": [], "b": [row]}),
        "away": [],
        "state": "open",
    }
    found = json.loads(encode(facts))
    assert isinstance(found, dict)
    return found
