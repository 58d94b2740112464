"""`lecombus run` and `lecombus demo`: the daemon, for a roster or for simulated drives.

Its log is set up here, the only place where handlers and levels are set: one event a line on
standard error, as logfmt or as JSON. An event is never more than one line: newlines,
other control characters and tracebacks are escaped. Messages say `key=value` themselves; those
become fields of the event, quoted where they need it. Under systemd the journal already keeps the
time, so it is left out and the line begins with the level in the form the journal reads.

Code that logs never waits: a thread writes (`BackgroundHandler`), because a standard error that no
process reads would otherwise stop the line, and every motor whose watchdog it feeds. What does
not fit is dropped and counted; libraries that a client can make log without end are bounded.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import re
import select
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import SimpleQueue
from typing import Final, TextIO

import click

from lecombus.cli.arguments import DURATION, roster_option

__all__ = [
    "FORMATS",
    "LEVELS",
    "BackgroundHandler",
    "EventFormatter",
    "RateLimit",
    "demo_command",
    "run_command",
    "set_up_logging",
]

LEVELS = ("debug", "info", "warning", "error")
FORMATS = ("logfmt", "json")

QUEUE_LIMIT: Final = 1000
"""Events that wait for standard error; more are dropped and counted."""

FLUSH_S: Final = 0.5
"""How long the end of the process waits for what is not written yet."""

_KEY = re.compile(r"(?:^|(?<= ))([a-z][a-z_]*)=")

_JOURNAL_LEVELS: Mapping[str, str] = {
    "debug": "<7>", "info": "<6>", "warning": "<4>", "error": "<3>", "critical": "<2>",
}  # fmt: skip


class EventFormatter(logging.Formatter):
    """Makes one line of an event.

    Args:
        style: `logfmt` or `json`.
        journal: Whether the systemd journal reads it.
    """

    def __init__(self, style: str, *, journal: bool = False) -> None:
        super().__init__()
        self._json = style == "json"
        self._journal = journal

    def format(self, record: logging.LogRecord) -> str:
        """Return the event as one line, without its newline."""
        level = record.levelname.lower()
        fields = {"level": level, "logger": record.name.removeprefix("lecombus.")}
        if not self._journal:
            fields = {"time": _time_text(record.created), **fields}
        fields.update(_fields_of(record.getMessage()))
        if record.exc_info:
            fields["exc"] = self.formatException(record.exc_info)
        line = json.dumps(fields) if self._json else " ".join(map(_pair, fields.items()))
        return _JOURNAL_LEVELS.get(level, "<6>") + line if self._journal else line


class BackgroundHandler(logging.Handler):
    """Hands events to a thread that writes them, and never waits for it.

    The queue is a `SimpleQueue`, because an object that logs while it is collected may come upon
    its own thread in the middle of `put`.

    Args:
        stream: Where events go; by its descriptor where it has one, so that a write that hangs
            holds no lock of the interpreter when the process ends.
    """

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self.dropped = 0
        self._reported = 0
        self._write = _writer_to(stream)
        self._queue: SimpleQueue[str | threading.Event] = SimpleQueue()
        threading.Thread(target=self._run, name="log-writer", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue an event, or drop it when too many wait."""
        if self._queue.qsize() >= QUEUE_LIMIT:
            self.dropped += 1
            return
        try:
            text = self.format(record)
        except (TypeError, ValueError, KeyError):  # logging's own remedy writes and may hang
            text = self.format(_malformed(record))
        self._queue.put(f"{text}\n")

    def flush(self) -> None:
        """Wait until everything queued is written, at most `FLUSH_S`."""
        written = threading.Event()
        self._queue.put(written)
        written.wait(FLUSH_S)

    def _run(self) -> None:
        while True:
            items = [self._queue.get()]
            while len(items) < QUEUE_LIMIT and not self._queue.empty():
                items.append(self._queue.get())
            self._write_out([one for one in items if isinstance(one, str)])
            for one in items:
                if isinstance(one, threading.Event):
                    one.set()

    def _write_out(self, lines: list[str]) -> None:
        """Write events, and how many were dropped once writing works again."""
        try:
            if lines:
                self._write("".join(lines).encode(errors="backslashreplace"))
            if (dropped := self.dropped) != self._reported:
                self._write(f"{self.format(_dropped(dropped - self._reported))}\n".encode())
                self._reported = dropped
        except (OSError, ValueError):
            self.dropped += len(lines)  # closed, or the disk is full: it cannot be reported


class RateLimit(logging.Filter):
    """Lets so many events of a logger through in a while, and says how many it kept back.

    Args:
        events: How many in one period.
        period_s: Seconds.
        clock: A monotonic clock, seconds.
    """

    def __init__(
        self, events: int, period_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__()
        self._events, self._period_s, self._clock = events, period_s, clock
        self._begun_s = clock()
        self._seen = 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether an event is let through."""
        now_s = self._clock()
        if now_s - self._begun_s >= self._period_s:
            kept_back = max(0, self._seen - self._events)
            self._begun_s, self._seen = now_s, 0
            if kept_back:
                record.msg = f"{record.getMessage()} kept_back={kept_back}"
                record.args = None
        self._seen += 1
        return self._seen <= self._events


def set_up_logging(level: str, style: str) -> None:
    """Send the logs of the whole process to standard error.

    Args:
        level: One of `LEVELS`.
        style: One of `FORMATS`.
    """
    handler = BackgroundHandler(sys.stderr)
    handler.setFormatter(EventFormatter(style, journal=_stderr_is_journal()))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    logging.getLogger("lecombus").setLevel(level.upper())
    for name in ("asyncio", "uvicorn.error"):  # a client can cause messages of these two
        theirs = logging.getLogger(name)
        theirs.setLevel(logging.ERROR)
        theirs.filters[:] = [RateLimit(events=10, period_s=60.0)]


def _writer_to(stream: TextIO) -> Callable[[bytes], None]:
    """Return what writes bytes to a stream, whole."""
    try:
        descriptor = stream.fileno()
    except (OSError, ValueError):

        def to_stream(data: bytes) -> None:
            stream.write(data.decode())

        return to_stream

    def to_descriptor(data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            try:
                rest = rest[os.write(descriptor, rest) :]
            except BlockingIOError:  # the pipe was made non-blocking by another process
                select.select([], [descriptor], [])

    return to_descriptor


def _malformed(record: logging.LogRecord) -> logging.LogRecord:
    said = f"event=malformed-log reason={record.msg!r} does not fit its arguments"
    return logging.LogRecord(record.name, logging.ERROR, "", 0, said, None, None)


def _dropped(count: int) -> logging.LogRecord:
    said = f"event=log-dropped count={count} reason=standard error was not read fast enough"
    return logging.LogRecord("lecombus.cli.run", logging.WARNING, "", 0, said, None, None)


def _fields_of(message: str) -> dict[str, str]:
    """Take a message such as `line=hall-3 event=port-lost reason=it is gone` apart.

    A value goes on to the next key or to the end; what stands before the first key is the message.
    A key that stands twice is part of a value, such as what a drive says of itself: no text forges
    another event.
    """
    starts: list[re.Match[str]] = []
    known = {"time", "level", "logger", "msg", "exc"}
    for one in _KEY.finditer(message):
        if one[1] not in known:
            known.add(one[1])
            starts.append(one)
    ends = [*(match.start() for match in starts), len(message)][1:]
    text = message[: starts[0].start()] if starts else message
    fields = {"msg": text.strip()} if text.strip() else {}
    for match, end in zip(starts, ends, strict=True):
        fields[match[1]] = message[match.end() : end].strip()
    return fields


def _pair(item: tuple[str, str]) -> str:
    key, text = item
    if text and all(character.isalnum() or character in "._:+/-" for character in text):
        return f"{key}={text}"
    return f"{key}={json.dumps(text, ensure_ascii=False)}"


def _time_text(unix_s: float) -> str:
    ms = int(unix_s * 1000)
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(ms // 1000))}.{ms % 1000:03d}Z"


def _stderr_is_journal() -> bool:
    """Return whether standard error leads to the journal, by systemd's JOURNAL_STREAM."""
    named = os.environ.get("JOURNAL_STREAM", "")
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return named == f"{status.st_dev}:{status.st_ino}"


@click.command("run")
@roster_option
@click.option(
    "--log-level",
    type=click.Choice(LEVELS, case_sensitive=False),
    envvar="LECOMBUS_LOG_LEVEL",
    default="info",
    show_default=True,
    help="debug shows every telegram, decoded.",
)
@click.option(
    "--log-format",
    type=click.Choice(FORMATS),
    envvar="LECOMBUS_LOG_FORMAT",
    default="logfmt",
    show_default=True,
)
def run_command(roster: Path, log_level: str, log_format: str) -> int:
    """Run the line that a roster describes, until SIGTERM or Ctrl-C.

    Logs go to standard error, one event a line; nothing goes to standard output. SIGHUP reads the
    roster again, as `lecombus reload` does.
    """
    set_up_logging(log_level, log_format)
    gc.disable()  # next to nothing that is made at the start is garbage; the daemon enables it
    try:
        from lecombus.daemon import run

        return run(roster, log_format=log_format)
    finally:
        gc.enable()


@click.command("demo")
@click.option(
    "--for", "seconds", type=DURATION, help="End after this time, such as 30s; default: at Ctrl-C."
)
@click.option(
    "--http",
    default=None,
    metavar="HOST:PORT",
    help="Where the API and /metrics are served; default: 127.0.0.1:9740, or another "
    "port where that is in use.",
)
def demo_command(seconds: float | None, http: str | None) -> int:
    """Watch simulated drives of five families, without any hardware.

    Values are live and go through the whole daemon, from the serial line to HTTP. On a terminal
    they stand in a table that is redrawn; in a pipe each round is a few plain lines.
    """
    from lecombus.demo import run_demo

    return run_demo(seconds, http)
