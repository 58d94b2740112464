"""Who moved a motor: one log event for each operation on a drive that a client asked for.

Strategy: who asks is found in a context variable (`ACTOR`), which the API sets for the task of a
request; without a request it is lecombus itself. An event is logged after the thing was done, so
nothing waits for it. Of one kind of thing that one user's program does to one drive `EACH` events
are logged in `WINDOW_S`; what is beyond is counted and logged as one sum after that. No more than
`LINES_PER_S` lines a second are logged in all, and as many of stops.

Texts that a client chose are cut, and what could pass for another field is removed.

`followers` get every operation whole, at its begin and at its end: the journal and the event
stream. An operation that is not a stop waits until they have it, and one of them may refuse it; a
stop that comes in that time ends it (`CAME_S`). A stop waits for nothing and is refused by nothing.
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
from typing import Final, Protocol, TypeVar

from lecombus.errors import LecombusError
from lecombus.operations.awaited_requests import CAME_S, HELD_FROM_S
from lecombus.operations.operation_reports import GroupReport, VerbReport, WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from lecombus.tokens.grants import EVERYTHING, NOTHING, Grant

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
        token: The name of its bearer token; empty without one.
        subject: Who its TLS certificate says it is; empty without one.
        grant: What it may do over HTTP; nothing, unless the door says more.
    """

    who: str = "lecombus"
    uid: int | None = None
    pid: int = 0
    client: str = ""
    token: str = ""
    subject: str = ""
    grant: Grant = NOTHING
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
        if self.uid is None:
            return f"{self.who} {self.token}" if self.token else self.who
        return f"{self.uid} {self.find_process()}"

    def fields(self) -> dict[str, str]:
        """Return what is logged of it."""
        found = {"who": self.who}
        if self.uid is not None:
            found |= {"uid": str(self.uid), "pid": str(self.pid), "process": self.find_process()}
        for key in ("token", "subject", "client"):
            if text := getattr(self, key):
                found[key] = clean(text)
        return found


ACTOR_FIELDS: Final = frozenset({"who", "uid", "pid", "process", "token", "subject", "client"})
"""What `Actor.fields` may hold."""

ACTOR: Final[ContextVar[Actor]] = ContextVar("ACTOR", default=Actor(grant=EVERYTHING))  # noqa: B039 - never changed


@dataclass(frozen=True, slots=True, eq=False)
class Act:
    """An operation that was asked for.

    Args:
        event: What: `write`, `group-write`, `verb`, `stop`, `readdress-asked` and the like.
        target: The drive or group.
        said: What was asked, in words; a password is masked.
        actor: Who asked.
        old: The value that was known before; empty where none was, or for a password.
        is_stop: It stops its drives: it must wait for nothing.
        is_setting: It writes a described parameter that neither moves a drive nor says who controls
            it: it is carried out also where control must be refused.
    """

    event: str
    target: str
    said: Mapping[str, str]
    actor: Actor
    old: str = ""
    is_stop: bool = False
    is_setting: bool = False


class ActionFollower(Protocol):
    """Gets every operation at its begin and at its end; neither call may take long or fail."""

    def begun(self, act: Act) -> Awaitable[None] | None:
        """Take an operation that is about to begin.

        Returns:
            What the operation waits for before anything is sent; None: nothing, as for a stop.

        Raises:
            OperationError: It must not be carried out; never for a stop. The awaitable may
                raise it too.
        """

    def ended(self, act: Act, outcome: str, fields: Mapping[str, str]) -> None:
        """Take the end of an operation; one that asks nothing of the line has no begin.

        Args:
            act: The operation.
            outcome: How it ended.
            fields: What was asked and what came of it, in words.
        """


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

    Attributes:
        followers: Who gets every operation, in this order.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._windows: dict[tuple[str, str, str], Window] = {}
        self._second = 0
        self._lines: Counter[bool] = Counter()
        self.followers: tuple[ActionFollower, ...] = ()

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
        self,
        event: str,
        target: str,
        said: Mapping[str, str],
        work: Callable[[float], Awaitable[R]],
        *,
        old: str = "",
        is_stop: bool = False,
        is_setting: bool = False,
    ) -> R:
        """Carry out an operation and log its end; when cancelled its outcome is unknown.

        Args:
            event: What, as in `Act`.
            target: The drive or group.
            said: What was asked, in words.
            work: Carries it out; given how long it has waited for the followers, seconds.
            old: The value that was known before.
            is_stop: It waits for no follower.
            is_setting: As in `Act`.
        """
        act = Act(event, target, said, ACTOR.get(), old, is_stop, is_setting)
        outcome, more = Outcome.UNKNOWN.value, dict(said)
        came, held = CAME_S.set(CAME_S.get()), HELD_FROM_S.set(None)
        try:
            report = await work(await self._begin(act))
            outcome = report.outcome.value
            more |= details(report)
            return report
        except LecombusError as exc:
            outcome, more["reason"] = Outcome.REFUSED.value, str(exc)
            raise
        finally:
            CAME_S.reset(came)
            HELD_FROM_S.reset(held)
            if more.get("value") == SECRET:
                more.pop("reason", None)  # it may quote the value
            self._end(act, outcome, more)

    @contextmanager
    def logged(self, event: str, target: str) -> Iterator[None]:
        """Log an operation that does not wait for the line, and for no follower."""
        act = Act(event, target, {}, ACTOR.get())
        try:
            yield
        except LecombusError as exc:
            self._end(act, Outcome.REFUSED.value, {"reason": str(exc)})
            raise
        self._end(act, Outcome.DONE.value, {})

    def wrote(self, drive: str, code: Code, raw: str, outcome: str) -> None:
        """Give the followers a write that lecombus made for itself; its log says why."""
        fields = {"code": str(code), "value": raw}
        act = Act("write", drive, fields, Actor())
        for follower in self.followers:
            follower.ended(act, outcome, fields)

    async def _begin(self, act: Act) -> float:
        """Give an operation to the followers; return how long it waited for them, seconds."""
        waits = [one for follower in self.followers if (one := follower.begun(act)) is not None]
        if not waits:
            return 0.0
        asked_s = self._clock()
        if CAME_S.get() is None:  # a stop that comes while it waits ends it
            CAME_S.set(asked_s)
        HELD_FROM_S.set(asked_s)
        for one in waits:
            await one
        return self._clock() - asked_s

    def _end(self, act: Act, outcome: str, fields: Mapping[str, str]) -> None:
        self.log(act.event, act.target, outcome, fields)
        for follower in self.followers:
            follower.ended(act, outcome, fields)

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
    """Return what is logged of a report besides its outcome.

    What a stop or a verb proved is said too: a verified quick stop whose command alone reads back
    does not say that the motor stands. That a written value reads back is what `verified` means.
    """
    found: dict[str, str] = {}
    members = report.members if isinstance(report, GroupReport) else (report,)
    shown = {one.proof.shows for one in members if one.proof is not None} - {"value"}
    if shown:
        found["shows"] = ",".join(clean(one) for one in sorted(shown))
    if isinstance(report, VerbReport) and report.written:
        found["written"] = ",".join(f"{code}:{raw}" for code, raw in report.written)
    if isinstance(report, GroupReport):
        found["how"] = report.how
        missing = [one for one in report.members if not one.outcome.is_good]
        found["not_done"] = ",".join(f"{one.drive}:{one.outcome.value}" for one in missing)
    if not report.outcome.is_good:
        found["reason"] = report.reason
    return found
