"""Logs of the daemon: one event a line on standard error, as logfmt or as JSON.

The only place where handlers and levels are set. An event is never more than one line: newlines,
other control characters and tracebacks are escaped. Messages say `key=value` themselves; those
become fields of the event, quoted where they need it. Under systemd the journal already keeps the
time, so it is left out and the line begins with the level in the form the journal reads.
"""

from __future__ import annotations

import json
import logging
import os
import re
import sys
import time
from collections.abc import Mapping

__all__ = ["FORMATS", "LEVELS", "EventFormatter", "set_up_logging"]

LEVELS = ("debug", "info", "warning", "error")
FORMATS = ("logfmt", "json")

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


def set_up_logging(level: str, style: str) -> None:
    """Send the logs of the whole process to standard error.

    Args:
        level: One of `LEVELS`.
        style: One of `FORMATS`.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(EventFormatter(style, journal=_stderr_is_journal()))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    logging.getLogger("lecombus").setLevel(level.upper())


def _fields_of(message: str) -> dict[str, str]:
    """Take a message such as `line=hall-3 event=port-lost reason=it is gone` apart.

    A value goes on to the next key or to the end; what stands before the first key is the message.
    """
    starts = list(_KEY.finditer(message))
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
    """Return whether standard error leads to the journal, as systemd's JOURNAL_STREAM tells."""
    named = os.environ.get("JOURNAL_STREAM", "")
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return named == f"{status.st_dev}:{status.st_ino}"
