"""Who moved a motor: one log event for each operation on a drive that a client asked for.

Strategy: who asks is found in a context variable (`ACTOR`), which the API sets for the task of a
request; without a request it is lecombus itself. An event is logged after the thing was done, so
nothing waits for it. Of one kind of thing that one user's program does to one drive `EACH` events
are logged in `WINDOW_S`; what is beyond is counted and logged as one sum after that. No more than
`LINES_PER_S` lines a second are logged in all, and as many of stops.

Texts that a client chose are cut, and what could pass for another field is removed.
"""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeVar

from lecombus.errors import LecombusError
from lecombus.operations.operation_reports import GroupReport, VerbReport, WriteReport
from lecombus.schedule import Outcome

__all__ = ["ACTOR", "SECRET", "Actions", "Actor"]

logger = logging.getLogger(__name__)

WINDOW_S: Final = 10.0
EACH: Final = 5
LINES_PER_S: Final = 20
WINDOWS_LIMIT: Final = 256
TEXT_CHARS: Final = 60
LONG_CHARS: Final = 300
LONG: Final = ("written", "not_done")
"""Fields made of codes and names of the roster."""

ODD: Final = re.compile(r"[^\w.:/+%*,@-]", re.ASCII)
OTHERS: Final = "others"
STOP: Final = "stop"

SECRET: Final = "***"
"""What is logged in place of a password."""

R = TypeVar("R", WriteReport, VerbReport, GroupReport)


@dataclass(slots=True)
class Actor:
    """Who asks for something.

    Args:
        who: `lecombus` itself, `socket` (the Unix socket) or `tcp`.
        uid: Of the process at the other end of the socket.
        pid: Of the same process; 0: it is in another container.
        client: Address and port of a TCP client.
    """

    who: str = "lecombus"
    uid: int | None = None
    pid: int = 0
    client: str = ""
    _process: str = ""

    def find_process(self) -> str:
        """Return the name of the process while it is there; `?`: it is gone, or hidden."""
        if not self._process:
            try:
                name = (
                    Path(f"/proc/{self.pid}/comm").read_text(errors="replace") if self.pid else ""
                )
            except OSError:
                name = ""
            self._process = clean(name.strip()) or "?"
        return self._process

    def kind(self) -> str:
        """Return what it has in common with others like it: a script starts many processes."""
        return self.who if self.uid is None else f"{self.uid} {self.find_process()}"

    def fields(self) -> dict[str, str]:
        """Return what is logged of it."""
        found = {"who": self.who}
        if self.uid is not None:
            found |= {"uid": str(self.uid), "pid": str(self.pid), "process": self.find_process()}
        if self.client:
            found["client"] = clean(self.client)
        return found


ACTOR: Final[ContextVar[Actor]] = ContextVar("ACTOR", default=Actor())  # noqa: B039 - never changed


@dataclass(slots=True)
class Window:
    """What one client did to one drive lately."""

    begun_s: float
    actor: Actor
    logged: int = 0
    kept_back: Counter[str] = field(default_factory=Counter)
    last: str = ""


class Actions:
    """Logs what was done to drives, and by whom.

    Args:
        clock: A monotonic clock, seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._windows: dict[tuple[str, str, str], Window] = {}
        self._second = 0
        self._lines: Counter[bool] = Counter()

    def log(self, event: str, target: str, outcome: str, fields: Mapping[str, str]) -> None:
        """Log that something was done, or count it.

        Args:
            event: What: `write`, `group-write`, `verb`, `stop`, `readdress-asked` and the like.
            target: The drive or group.
            outcome: How it ended.
            fields: More to log, in order.
        """
        now_s, actor, target = self._clock(), ACTOR.get(), clean(target)
        window = self._window((event, target, actor.kind()), actor)
        place = {"drive": target}
        for key, text in fields.items():
            place[key] = clean(text, LONG_CHARS if key in LONG else TEXT_CHARS)
        if "reason" in fields:  # the last field, in words
            place["reason"] = fields["reason"].replace("=", ":")[:LONG_CHARS]
        if window.logged < EACH and self._has_room(now_s, event):
            window.logged += 1
            self._log({"event": event, **actor.fields(), "outcome": outcome, **place})
        else:
            window.actor = actor
            window.kept_back[outcome] += 1
            window.last = place.get("value", "")

    async def log_end(
        self, event: str, target: str, said: Mapping[str, str], work: Awaitable[R]
    ) -> R:
        """Wait for the end of an operation and log it; when cancelled its outcome is unknown."""
        outcome, more = Outcome.UNKNOWN.value, dict(said)
        try:
            report = await work
            outcome = report.outcome.value
            more |= details(report)
            return report
        except LecombusError as exc:
            outcome, more["reason"] = Outcome.REFUSED.value, str(exc)
            raise
        finally:
            if more.get("value") == SECRET:
                more.pop("reason", None)  # it may quote the value
            self.log(event, target, outcome, more)

    @contextmanager
    def logged(self, event: str, target: str) -> Iterator[None]:
        """Log an operation that does not wait for the line."""
        try:
            yield
        except LecombusError as exc:
            self.log(event, target, Outcome.REFUSED.value, {"reason": str(exc)})
            raise
        self.log(event, target, Outcome.DONE.value, {})

    def look(self, *, at_end: bool = False) -> None:
        """Log the sums of what was kept back; once a second, and at the end."""
        now_s = self._clock()
        for key, window in list(self._windows.items()):
            if not at_end and now_s - window.begun_s < WINDOW_S:
                continue
            if window.kept_back and not self._has_room(now_s, key[0]):
                continue
            del self._windows[key]
            self._log_sum(key, window)

    def _window(self, key: tuple[str, str, str], actor: Actor) -> Window:
        window = self._windows.get(key)
        if window is None and len(self._windows) >= WINDOWS_LIMIT:
            key, actor = (key[0], OTHERS, ""), Actor(OTHERS)
            window = self._windows.get(key)
        if window is None:
            window = self._windows[key] = Window(self._clock(), actor)
        return window

    def _has_room(self, now_s: float, event: str) -> bool:
        """Whether another line may be logged in this second; stops have lines of their own."""
        if int(now_s) != self._second:
            self._second = int(now_s)
            self._lines.clear()
        self._lines[event == STOP] += 1
        return self._lines[event == STOP] <= LINES_PER_S

    def _log_sum(self, key: tuple[str, str, str], window: Window) -> None:
        if not window.kept_back:
            return
        outcomes = ",".join(f"{name}:{count}" for name, count in window.kept_back.most_common())
        self._log(
            {
                "event": "kept-back",
                **window.actor.fields(),
                "what": key[0],
                "count": str(window.kept_back.total()),
                "outcomes": outcomes,
                "drive": key[1],
                "last": window.last,
            }
        )

    def _log(self, fields: Mapping[str, str]) -> None:
        text = " ".join(f"{key}={value}" for key, value in fields.items() if value)
        level = logging.WARNING if fields["event"] == STOP else logging.INFO
        logger.log(level, "%s", text)


def clean(text: str, chars: int = TEXT_CHARS) -> str:
    """Return a text without anything that could pass for another field, cut short."""
    return ODD.sub("_", text[:chars])


def details(report: WriteReport | VerbReport | GroupReport) -> dict[str, str]:
    """Return what is logged of a report besides its outcome."""
    found: dict[str, str] = {}
    if isinstance(report, VerbReport) and report.written:
        found["written"] = ",".join(f"{code}:{raw}" for code, raw in report.written)
    if isinstance(report, GroupReport):
        found["how"] = report.how
        missing = [one for one in report.members if not one.outcome.is_good]
        found["not_done"] = ",".join(f"{one.drive}:{one.outcome.value}" for one in missing)
    if not report.outcome.is_good:
        found["reason"] = report.reason
    return found
