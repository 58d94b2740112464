"""What a person sees on a terminal."""

from __future__ import annotations

import pytest

from lecombus.cli import document_rows, screen
from lecombus.cli.document_rows import show_reading
from lecombus.cli.screen import age, show_rows
from support.golden import Golden


@pytest.fixture(autouse=True)
def _terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screen, "on_terminal", lambda: True)
    monkeypatch.setattr(document_rows, "on_terminal", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")


def test_a_terminal_gets_headings_and_a_title(capsys: pytest.CaptureFixture[str]) -> None:
    show_rows(("drive", "state"), [("feeder", "online")], title="line hall-3: open")
    assert [line.rstrip() for line in capsys.readouterr().out.splitlines()] == [
        "line hall-3: open",
        "drive   state",
        "feeder  online",
    ]


def test_a_cell_is_shown_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    show_rows(("why",), [("[red]not markup[/red]",)])
    assert "[red]not markup[/red]" in capsys.readouterr().out


@pytest.mark.parametrize("person", [True, False])
def test_a_cell_does_not_steer_the_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, person: bool
) -> None:
    monkeypatch.setattr(screen, "on_terminal", lambda: person)
    show_rows(("why",), [("\x1b]0;title\x07\x9b2J",)])
    shown = capsys.readouterr().out
    assert "\\x1b]0;title\\x07\\x9b2J" in shown
    assert not {"\x1b", "\x07", "\x9b"} & set(shown)


@pytest.mark.parametrize(
    "document",
    [
        {"name": "frequency setpoint", "value": 35.4, "unit": "Hz", "quality": "good"},
        {"name": "", "value": 0, "unit": None, "quality": "good", "age_s": 200},
        {"value": 35.4, "quality": "stale", "reason": "drive offline"},
        {"value": 34424, "raw": "H8678", "format": "VH", "quality": "good"},
        {
            "value": 2000,
            "quality": "stale",
            "reason": "read 130.0 s ago, not read cyclically",
            "age_s": 130.0,
        },
        {"value": None, "quality": "bad", "reason": "not read yet"},
    ],
)
def test_a_reading_is_a_sentence(
    capsys: pytest.CaptureFixture[str], document: dict[str, object], golden: Golden
) -> None:
    show_reading({"drive": "feeder", "code": "C0039", "subcode": 1, **document})
    golden(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [(None, ""), (0.44, "0.4 s"), (119, "119.0 s"), (120, "2 min"), (7200, "2 h"), (2e5, "2 d")],
)
def test_an_age_is_told_in_the_unit_one_would_say(seconds: object, shown: str) -> None:
    assert age(seconds) == shown
