"""One event is one line, whatever is in it."""

from __future__ import annotations

import json
import logging
import sys

import pytest

from lecombus.cli.logs import EventFormatter, set_up_logging


def record(message: str, level: int = logging.INFO) -> logging.LogRecord:
    made = logging.LogRecord("lecombus.line.worker", level, "x.py", 1, message, None, None)
    made.created = 1795255512.1139
    return made


def test_an_event_is_time_level_logger_and_what_it_says() -> None:
    said = "line=hall-3 event=port-lost reason=/dev/x: it's gone (url=a b)"
    assert EventFormatter("logfmt").format(record(said)) == (
        "time=2026-11-21T10:05:12.113Z level=info logger=line.worker "
        'line=hall-3 event=port-lost reason="/dev/x: it\'s gone (url=a b)"'
    )


def test_words_before_the_first_key_are_the_message() -> None:
    line = EventFormatter("logfmt").format(record("gone for good line=hall-3 code="))
    assert line.endswith('msg="gone for good" line=hall-3 code=""')


def test_fields_are_fields_in_json_too() -> None:
    event = json.loads(EventFormatter("json").format(record("line=hall-3 event=ready")))
    assert (event["line"], event["event"]) == ("hall-3", "ready")
    assert "msg" not in event


@pytest.mark.parametrize("style", ["logfmt", "json"])
def test_newlines_and_tracebacks_stay_on_the_line(style: str) -> None:
    try:
        raise ValueError("two\nlines")
    except ValueError:
        made = record("one\ntwo\r\x1b[31m")
        made.exc_info = sys.exc_info()
    line = EventFormatter(style).format(made)
    assert all(character.isprintable() for character in line)
    assert "Traceback" in line


def test_json_events_can_be_read_back() -> None:
    event = json.loads(EventFormatter("json").format(record('say "this"')))
    assert event["msg"] == 'say "this"'
    assert event["level"] == "info"


@pytest.mark.parametrize(
    ("level", "prefix"), [(logging.DEBUG, "<7>"), (logging.WARNING, "<4>"), (logging.ERROR, "<3>")]
)
def test_the_journal_gets_the_level_its_own_way_and_no_time(level: int, prefix: str) -> None:
    line = EventFormatter("logfmt", journal=True).format(record("x", level))
    assert line.startswith(f"{prefix}level=")


def test_only_lecombus_is_as_talkative_as_asked(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    root, ours = logging.getLogger(), logging.getLogger("lecombus")
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(root, "level", root.level)
    monkeypatch.setattr(ours, "level", ours.level)
    set_up_logging("debug", "logfmt")
    logging.getLogger("lecombus.line").debug("ours")
    logging.getLogger("somebody").info("theirs")
    said = capsys.readouterr().err
    assert "ours" in said
    assert "theirs" not in said
