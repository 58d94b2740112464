"""One event is one line, whatever is in it."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from lecombus.cli.run import (
    QUEUE_LIMIT,
    BackgroundHandler,
    EventFormatter,
    RateLimit,
    set_up_logging,
)

pytestmark = pytest.mark.clock


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


@pytest.mark.parametrize("forged", ["event=ready", "level=info", "drive=b"])
def test_what_a_drive_says_forges_no_event(forged: str) -> None:
    said = f"drive=a event=drive-swapped reason=C0200 reads X {forged} now"
    event = json.loads(EventFormatter("json").format(record(said)))
    assert (event["drive"], event["event"]) == ("a", "drive-swapped")
    assert event["reason"] == f"C0200 reads X {forged} now"


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


@pytest.fixture
def kept_loggers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the loggers of the whole process back after the test."""
    for name in ("", "lecombus", "asyncio", "uvicorn.error"):
        one = logging.getLogger(name)
        monkeypatch.setattr(one, "handlers", list(one.handlers))
        monkeypatch.setattr(one, "filters", list(one.filters))
        monkeypatch.setattr(one, "level", one.level)


@pytest.mark.usefixtures("kept_loggers")
def test_only_lecombus_is_as_talkative_as_asked(capsys: pytest.CaptureFixture[str]) -> None:
    set_up_logging("debug", "logfmt")
    logging.getLogger("lecombus.line").debug("ours")
    logging.getLogger("somebody").info("theirs")
    logging.getLogger("uvicorn.error").warning("Invalid HTTP request received.")
    logging.getLogger().handlers[0].flush()
    said = capsys.readouterr().err
    assert "Invalid HTTP" not in said
    assert "ours" in said
    assert "theirs" not in said


TALKS_WITHOUT_END = """
import logging
from lecombus.cli.run import set_up_logging
set_up_logging("info", "logfmt")
for number in range(5000):
    logging.getLogger("lecombus.x").info("event=%s", "x" * 200)
print("through", flush=True)
"""


def test_a_standard_error_that_nobody_reads_holds_up_neither_work_nor_end() -> None:
    unread, written = os.pipe()
    try:
        ran = subprocess.run(
            [sys.executable, "-c", TALKS_WITHOUT_END],
            stdout=subprocess.PIPE,
            stderr=written,
            timeout=30,
            check=True,
        )
    finally:
        os.close(unread)
        os.close(written)
    assert ran.stdout == b"through\n"


@contextmanager
def handler_to_a_pipe() -> Iterator[tuple[BackgroundHandler, int]]:
    unread, written = os.pipe()
    with os.fdopen(unread, "rb") as reader, os.fdopen(written, "w") as stream:
        handler = BackgroundHandler(stream)
        handler.setFormatter(EventFormatter("logfmt"))
        yield handler, reader.fileno()


def test_what_was_dropped_is_counted_and_told_once_it_flows_again() -> None:
    sent = 4 * QUEUE_LIMIT
    with handler_to_a_pipe() as (handler, unread):
        for _ in range(sent):
            handler.handle(record("event=" + "x" * 200))
        said, told, came = b"", 0, 0
        while told + came < sent:  # it may be told in several parts
            said += os.read(unread, 65536)
            whole = said[: said.rfind(b"\n") + 1].decode().splitlines()
            drops = [line for line in whole if "event=log-dropped" in line]
            told = sum(int(line.partition(" count=")[2].split()[0]) for line in drops)
            came = len(whole) - len(drops)
        assert 0 < told == handler.dropped < sent
        assert told + came == sent


def test_flushing_waits_for_what_was_logged() -> None:
    with handler_to_a_pipe() as (handler, unread):
        handler.handle(record("event=last"))
        handler.flush()
        os.set_blocking(unread, False)
        assert b"event=last" in os.read(unread, 65536)


def test_a_pipe_closed_by_its_reader_raises_nothing() -> None:
    with handler_to_a_pipe() as (handler, unread):
        os.dup2(os.open(os.devnull, os.O_RDONLY), unread)  # the pipe's only reader is gone
        handler.handle(record("event=unheard"))
        handler.flush()
        assert handler.dropped == 1


def test_a_talkative_library_is_bounded_and_its_silence_told() -> None:
    now_s = 0.0
    limit = RateLimit(events=2, period_s=60.0, clock=lambda: now_s)
    assert [limit.filter(record("event=x")) for _ in range(5)] == [True, True, False, False, False]
    now_s = 61.0
    later = record("event=x")
    assert limit.filter(later)
    assert later.getMessage() == "event=x kept_back=3"


def test_a_message_that_does_not_fit_its_arguments_is_told_as_such() -> None:
    with handler_to_a_pipe() as (handler, unread):
        wrong = record("event=%d")
        wrong.args = ("text",)
        handler.handle(wrong)
        handler.flush()
        os.set_blocking(unread, False)
        assert b"event=malformed-log" in os.read(unread, 65536)
