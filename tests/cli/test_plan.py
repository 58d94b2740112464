"""`lecombus plan`, as typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lecombus.cli import main

ROSTER = """\
line: {name: l, port: "sim:"}
drives:
  - {name: a, address: 11, family: smvector, watchdog: {time: TIME, action: quick-stop}}
  - {name: b, address: 12, family: 8200vector, watchdog: {time: TIME, action: quick-stop}}
"""


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
    for word in ("stop\t", "control\t", "held, also when a drive goes away", "19200\t", "1\t"):
        assert word in out


def test_json_is_one_document(roster: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "-c", str(roster), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["baud"] == 9600


def test_the_picture_is_written(roster: Path, tmp_path: Path) -> None:
    file = tmp_path / "line.svg"
    assert main(["plan", "-c", str(roster), "--svg", str(file)]) == 0
    assert file.read_text().startswith("<svg ")


def test_a_picture_that_cannot_be_written_says_so(
    roster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", "-c", str(roster), "--svg", str(tmp_path / "no" / "x.svg")]) == 2
    assert "cannot be written: No such file or directory" in capsys.readouterr().err


def test_a_roster_that_cannot_be_held_is_refused_with_its_places(
    roster: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    roster.write_text(ROSTER.replace("TIME", "50ms"))
    assert main(["plan", "-c", str(roster)]) == 2
    err = capsys.readouterr().err
    assert f"{roster}:3:" in err
    assert f"{roster}:4:" in err
    assert "cannot be held at 9600 baud" in err
