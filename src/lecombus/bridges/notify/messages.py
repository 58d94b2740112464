"""What is told in one message: what happened since the last one, in words and as JSON.

`Pending` keeps one entry for each event and drive, however often it came and went; so its size is
bounded by the roster, and a drive that trips a thousand times in a minute is one line of a message.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Final

from lecombus.bridges.notify.conditions import Happening

__all__ = ["Limiter", "MessageEntry", "Notification", "Pending", "message_of", "trial_message"]

MOST_ENTRIES: Final = 1000
"""Six kinds of event for 90 drives, and as much for drives that left the roster."""

MOST_LINES: Final = 100

WORDS: Final[Mapping[str, tuple[str, str, str]]] = {
    "daemon-lost": (
        "daemon lost", "daemons lost",
        "systemctl status of its lecombus@ unit says why; motors may run on",
    ),
    "line-lost": (
        "line lost", "lines lost",
        "see the adapter and its plug; lecombus status says why; motors may run on",
    ),
    "watchdog-missed": (
        "watchdog missed", "watchdogs missed", "see whether the drive stopped; lecombus plan",
    ),
    "trip": (
        "drive tripped", "drives tripped",
        "lecombus why names cause and remedy; then lecombus reset-fault",
    ),
    "lease-lapse": (
        "lease lapsed", "leases lapsed", "see the controlling program; lecombus leases",
    ),
    "drive-lost": (
        "drive lost", "drives lost", "see its supply and its plug on the line; lecombus status",
    ),
}  # fmt: skip
"""By event, the worst first: one, many, and what to do."""


@dataclass(frozen=True, slots=True)
class MessageEntry:
    """What happened of one event at one drive since the last message.

    Args:
        event: One of `NotifyEvent`.
        drive: The drive; empty: the line.
        text: What it is.
        begun: How often it began.
        active: Whether it stands at the end.
        first_s: When it first began or ended, Unix seconds.
        last_s: When it last did.
        fault: The fault of a trip.
    """

    event: str
    drive: str
    text: str
    begun: int
    active: bool
    first_s: float
    last_s: float
    fault: Mapping[str, Any] | None = None

    def followed_by(self, later: MessageEntry) -> MessageEntry:
        """Return both in one."""
        newest = later if later.active else self
        return replace(
            newest, begun=self.begun + later.begun, active=later.active, first_s=self.first_s,
            last_s=later.last_s,
        )  # fmt: skip

    def as_json(self) -> dict[str, Any]:
        """Return its JSON form."""
        return {
            "event": self.event, "drive": self.drive or None, "active": self.active,
            "count": self.begun, "text": self.text, "since": rfc3339(self.first_s),
            "time": rfc3339(self.last_s), "fault": None if self.fault is None else dict(self.fault),
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class Notification:
    """One message.

    Args:
        line: The line's name.
        subject: What it is about, on one line.
        text: All of it, in words.
        entries: What happened, the worst first.
        made_s: When it was made, Unix seconds.
        dropped: Entries that did not fit.
        is_test: Whether it was only asked for to see whether it arrives.
    """

    line: str
    subject: str
    text: str
    entries: tuple[MessageEntry, ...]
    made_s: float
    dropped: int = 0
    is_test: bool = False

    def as_json(self) -> dict[str, Any]:
        """Return its JSON form, as commands get it."""
        return {
            "version": 1, "line": self.line, "test": self.is_test, "time": rfc3339(self.made_s),
            "subject": self.subject, "text": self.text, "dropped": self.dropped,
            "events": [entry.as_json() for entry in self.entries],
        }  # fmt: skip


class Pending:
    """What happened since the last message.

    Args:
        ends: Whether a message is also sent of what only ended.
    """

    def __init__(self, *, ends: bool) -> None:
        self._ends = ends
        self._entries: dict[tuple[str, str], MessageEntry] = {}
        self._dropped = 0

    def __bool__(self) -> bool:
        """Whether there is something to say."""
        return bool(self._entries)

    def add(self, happening: Happening) -> None:
        """Take what happened; an update, or an end, of what was sent already may say nothing."""
        one, key = happening, (happening.event, happening.drive)
        if key not in self._entries and (one.is_update or not (one.active or self._ends)):
            return
        begun = int(one.active and not one.is_update)
        self._put(
            MessageEntry(
                one.event, one.drive, one.text, begun, one.active, one.at_s, one.at_s, one.fault
            )
        )

    def take(self) -> tuple[tuple[MessageEntry, ...], int]:
        """Give all of it, the worst first, with how many did not fit, and forget it."""
        order = list(WORDS)
        found = sorted(
            self._entries.values(), key=lambda one: (order.index(one.event), one.first_s)
        )
        dropped, self._dropped = self._dropped, 0
        self._entries = {}
        return tuple(found), dropped

    def put_back(self, entries: Iterable[MessageEntry], dropped: int) -> None:
        """Take back what could not be sent; what happened since then is later."""
        later, self._entries = self._entries, {}
        self._dropped += dropped
        for entry in (*entries, *later.values()):
            self._put(entry)

    def _put(self, entry: MessageEntry) -> None:
        key = (entry.event, entry.drive)
        before = self._entries.get(key)
        if before is not None:
            self._entries[key] = before.followed_by(entry)
        elif len(self._entries) < MOST_ENTRIES:
            self._entries[key] = entry
        else:
            self._dropped += 1


class Limiter:
    """How often messages may be sent: `burst` at a time, then one in each `every_s`.

    Args:
        burst: Messages that may follow each other.
        every_s: Seconds until one more may follow.
    """

    def __init__(self, burst: int, every_s: float) -> None:
        self._burst = burst
        self._every_s = every_s
        self._left = float(burst)
        self._at_s: float | None = None

    def wait_s(self, now_s: float) -> float:
        """Return how long to wait until a message may be sent; 0: now."""
        if self._at_s is not None:
            gained = (now_s - self._at_s) / self._every_s
            self._left = min(float(self._burst), self._left + gained)
        self._at_s = now_s
        return max(0.0, (1.0 - self._left) * self._every_s) if self._left < 1.0 - 1e-9 else 0.0

    def sent(self) -> None:
        """Count a message."""
        self._left -= 1.0


def message_of(
    line: str, entries: tuple[MessageEntry, ...], dropped: int, made_s: float
) -> Notification:
    """Return the message of what happened on a line."""
    subject = f"{line}: {headline(entries)}"
    lines = [f"Line {line}, {local(made_s):%Y-%m-%d %H:%M:%S %z}", ""]
    for entry in entries[:MOST_LINES]:
        lines += lines_of(entry)
    more = len(entries) - MOST_LINES + dropped if len(entries) > MOST_LINES else dropped
    if more:
        lines.append(f".. and {more} more")
    advice = {entry.event: WORDS[entry.event] for entry in entries if entry.active}
    if advice:
        lines += ["", "What to do:"]
        lines += [f"- {one}: {what}" for one, _, what in advice.values()]
    text = "\n".join(map(clean, lines)) + "\n"
    return Notification(line, clean(subject)[:200], text, entries, made_s, dropped)


def trial_message(line: str, made_s: float) -> Notification:
    """Return a message that only shows that messages arrive."""
    text = f"This is a test of the messages of line {line}. Nothing has happened.\n"
    return Notification(line, f"{line}: test message", text, (), made_s, is_test=True)


def headline(entries: tuple[MessageEntry, ...]) -> str:
    """Return what happened, in a few words: `2 drives tripped, 1 drive lost`."""
    if len(entries) == 1:
        entry = entries[0]
        name = f"{entry.drive}: " if entry.drive else ""
        return name + (entry.text if entry.active else f"{WORDS[entry.event][0]}, over")
    parts = []
    for active, after in ((True, ""), (False, ", over")):
        counts: dict[str, int] = {}
        for entry in entries:
            if entry.active is active:
                counts[entry.event] = counts.get(entry.event, 0) + 1
        parts += [
            f"{count} {WORDS[event][count > 1]}{after}" for event, count in counts.items()
        ]  # fmt: skip
    return "; ".join(parts)


def lines_of(entry: MessageEntry) -> list[str]:
    """Return an entry as lines of a text."""
    name = f"{entry.drive}: " if entry.drive else ""
    times = f" ({entry.begun} times)" if entry.begun > 1 else ""
    if not entry.begun:
        found = [
            f"{local(entry.last_s):%H:%M:%S}  {name}{WORDS[entry.event][0]}, over: {entry.text}"
        ]
    else:
        found = [f"{local(entry.first_s):%H:%M:%S}  {name}{entry.text}{times}"]
        if not entry.active:
            found[0] += f"; over at {local(entry.last_s):%H:%M:%S}"
    if entry.fault is not None and entry.active:
        for key in ("cause", "remedy"):
            if entry.fault.get(key):
                found.append(f"          {key}: {entry.fault[key]}")
    return found


def clean(text: str) -> str:
    """Return a text without control characters."""
    return "".join(one if one.isprintable() else " " for one in text)


def local(at_s: float) -> datetime:
    """Return a time in the time zone of this computer."""
    return datetime.fromtimestamp(at_s).astimezone()


def rfc3339(at_s: float) -> str:
    """Return a time as JSON has it."""
    text = datetime.fromtimestamp(at_s, UTC).isoformat(timespec="milliseconds")
    return text.replace("+00:00", "Z")
