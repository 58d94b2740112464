"""A line as a bridge sees it: the newest of everything, and for how long it may be believed.

    follower = LineFollower("/run/lecombus/hall-3.sock")
    follower.listeners.append(take)                  # take(event: lecombus.client.Event)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(follower.run)               # for ever, also while there is no daemon
        ..
        value = follower.value("feeder", "C0050")    # None: never read
        if value is not None and value.is_good(anyio.current_time()): ..

- `is_connected` says whether the daemon answers. While it does not, `why_away` says why, the state
  of every drive is `unknown`, no value is good, and `line` is None. Nothing else is fresh then.
- `drives` has every drive by name: `state`, `reason`, `states`, `doing`, `fault`, `remarks`,
  `values` by code (`C0050`, `C0039/1`). `leases` is the document of `GET /v1/leases`.
- A value carries when it was read (`read_at_s`) and until when it is good (`good_until_s`), both by
  `anyio.current_time`. Ask `is_good(now)`, not `reading.quality`: that was the quality when the
  daemon last said something of it.
- Each change is given to every listener once, as an event of the kinds of `GET /v1/events`, after
  it was taken into the picture. An event that was missed is made from what changed (its `id` is
  empty). Further kinds: `connected`, `away` (`data["reason"]`), `looked` (the whole picture was
  compared, about once a second while the daemon answers) and the daemon's `gap`.
- Writes are not made here: use `lecombus.client.connect(follower.socket)`.
- Passwords (codes that the family's description calls secret) are not taken over.

Strategy: events bring changes when they happen; a look at `/v1/drives` each second brings the age
of every value, since events repeat an unchanged value only every 30 s, and shows that the daemon
still works. What an event said while a look was under way is newer than what the look brings. A
look that is not answered within `AWAY_AFTER_S`, or a stream of events that ends, means that the
daemon is away; then the follower connects again, ever more seldom, and asks for what it missed.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager, aclosing
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import inf
from typing import Any, Final, NoReturn

import anyio

from lecombus.client import ClientError, Event, Line, LineStatus, Quality, Reading, connect
from lecombus.client.documents import doing_of
from lecombus.drives import family
from lecombus.errors import LecombusError
from lecombus.parameters import Code
from lecombus.roster import good_for_s

__all__ = ["AWAY_AFTER_S", "FollowedDrive", "FollowedValue", "LineFollower"]

AWAY_AFTER_S: Final = 5.0
"""A daemon that does not answer for so long is away."""

LOOK_EVERY_S: Final = 1.0

PERIODS_EVERY_S: Final = 60.0
"""How often periods and leases are asked for: a reload changes both without an event."""

PAGE_AGE_S: Final = 0.1
"""Ages in `/v1/drives` may be too small by this."""

CLOCKS_DIFFER_S: Final = 0.25
"""How far apart the times of one reading may be, by an event and by a look."""

FIRST_PAUSE_S: Final = 0.1
LONGEST_PAUSE_S: Final = 5.0

UNKNOWN: Final = "unknown"
NOT_ASKED: Final = "not asked yet"

logger = logging.getLogger(__name__)

Listener = Callable[[Event], None]
Connect = Callable[[str], AbstractAsyncContextManager[Line]]


@dataclass(frozen=True, slots=True)
class FollowedValue:
    """A value of a drive with the time until which it may be believed.

    Args:
        reading: What the daemon said of it last.
        read_at_s: When it was read, or earlier, by `anyio.current_time`; -inf: never.
        good_until_s: When it is stale unless it is read again; -inf: it is not good now.
        heard_s: When an event brought it; -inf: a look did.
    """

    reading: Reading
    read_at_s: float
    good_until_s: float
    heard_s: float = -inf

    def is_good(self, now_s: float) -> bool:
        """Whether it may be shown as the value of now."""
        return now_s < self.good_until_s

    def left_s(self, now_s: float) -> float:
        """How long it stays good without being read again, seconds; 0: it is not good."""
        return max(0.0, self.good_until_s - now_s)

    def age_s(self, now_s: float) -> float:
        """How long ago it was read, seconds; inf: never."""
        return now_s - self.read_at_s

    def quality(self, now_s: float) -> Quality:
        """Its quality now."""
        if self.is_good(now_s):
            return Quality.GOOD
        found = self.reading.quality
        return Quality.STALE if found is Quality.GOOD else found


@dataclass(slots=True)
class FollowedDrive:
    """A drive, as last heard of.

    Args:
        name: Its name in the roster.
        address: 1..99.
        family: Such as `8200vector`.
        state: `starting`, `online`, `degraded`, `offline`; `unknown`: the daemon is away.
        reason: Why; empty where nothing needs saying.
        states: What its status words show; None: not known well enough.
        doing: `running`, `stopping`, `stopped`, `enabled` or `unknown`; up to a second behind.
        motion: The whole summary `motion` of docs/api.md, also what is `stale`; None: daemon away.
        fault: The fault that it shows; None: none that is known.
        remarks: What stands to be said about it, by subject.
        values: By code, `C0050` or `C0039/1`.
        heard_s: When the last event about it came.
    """

    name: str
    address: int = 0
    family: str = ""
    state: str = UNKNOWN
    reason: str = ""
    states: tuple[str, ...] | None = None
    doing: str = UNKNOWN
    motion: Mapping[str, Any] | None = None
    fault: Mapping[str, Any] | None = None
    remarks: dict[str, str] = field(default_factory=dict)
    values: dict[str, FollowedValue] = field(default_factory=dict)
    heard_s: float = -inf


class LineFollower:
    """Follows one line through its daemon; see the module's docstring.

    Args:
        socket: The path of the daemon's Unix socket.
        after: The id of the last event that an earlier follower had; empty: begin now.
        look_every_s: How often the whole picture is compared, seconds.
        wall: The time of day, Unix seconds.
        connect_to: Connects to the daemon.

    Attributes:
        listeners: Called with each event; they must not block, nor raise.
        is_connected: Whether the daemon answers.
        why_away: Why it does not.
        line: How the line is doing; None: the daemon is away.
        drives: The drives, by name.
        leases: `GET /v1/leases`; empty while the daemon is away.
        silenced: The drives that are sent nothing but stops, on purpose; empty while it is away.
        last_id: The id of the last event, for `after`.
    """

    def __init__(
        self,
        socket: str,
        *,
        after: str = "",
        look_every_s: float = LOOK_EVERY_S,
        wall: Callable[[], float] = time.time,
        connect_to: Connect = connect,
    ) -> None:
        self.socket = socket
        self.listeners: list[Listener] = []
        self.is_connected = False
        self.why_away = NOT_ASKED
        self.line: LineStatus | None = None
        self.drives: dict[str, FollowedDrive] = {}
        self.leases: Mapping[str, Any] = {}
        self.silenced: set[str] = set()
        self.last_id = after
        self._look_every_s = look_every_s
        self._wall = wall
        self._connect = connect_to
        self._states_before: dict[str, tuple[str, str, tuple[str, ...] | None]] = {}
        self._periods: dict[tuple[str, str], float] = {}
        self._periods_due_s = -inf
        self._leases_due = True
        self._line_heard_s = -inf

    def value(self, drive: str, code: str) -> FollowedValue | None:
        """Return a value by the drive's name and the code (`C0050`, `C0039/1`); None: none."""
        found = self.drives.get(drive)
        return None if found is None else found.values.get(code)

    @property
    def stretch(self) -> float:
        """By how much the periods are longer by plan than the roster says, 1 or more."""
        return float((self.line.document if self.line else {}).get("planned_stretch") or 1)

    def period_s(self, drive: str, code: str) -> float | None:
        """Return how often a code is read, seconds; None: not cyclically, or not known."""
        return self._periods.get((drive, code))

    async def run(self) -> NoReturn:
        """Follow the line until cancelled, also across ends and starts of the daemon."""
        pause_s = FIRST_PAUSE_S
        while True:
            try:
                async with self._connect(self.socket) as line:
                    why = await self._follow(line)
            except ClientError as exc:
                why = exc.problem
            pause_s = FIRST_PAUSE_S if self.is_connected else min(2 * pause_s, LONGEST_PAUSE_S)
            self._lose(why)
            await anyio.sleep(pause_s)

    # -- one connection --------------------------------------------------------------------------

    async def _follow(self, line: Line) -> str:
        """Follow the line over one connection until that breaks; returns why."""
        why: list[str] = []
        self._periods_due_s, self._leases_due = -inf, True

        async def ended(work: Callable[[Line], Any]) -> None:
            try:
                await work(line)
            except ClientError as exc:
                why.append(exc.problem)
            except TimeoutError:
                why.append(f"it did not answer within {AWAY_AFTER_S:g} s")
            tasks.cancel_scope.cancel()

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(ended, self._look)
            tasks.start_soon(ended, self._hear)
        return why[0]

    async def _hear(self, line: Line) -> NoReturn:
        """Take events as they come."""
        async with aclosing(line.events(after=self.last_id, patience_s=0)) as events:
            async for event in events:
                self.last_id = event.id
                self._take_event(event)
        raise ClientError("its events ended")

    async def _look(self, line: Line) -> NoReturn:
        """Compare the whole picture, again and again."""
        while True:
            asked_s = anyio.current_time()
            with anyio.fail_after(AWAY_AFTER_S):
                if asked_s >= self._periods_due_s:
                    self._take_periods((await line.ask("/v1/plan")).data)
                    self._periods_due_s, self._leases_due = asked_s + PERIODS_EVERY_S, True
                if self._leases_due:
                    self._leases_due = False
                    self._take_leases((await line.ask("/v1/leases")).data)
                asked_s = anyio.current_time()
                status = await line.status()
                drives = (await line.ask("/v1/drives")).data["drives"]
            self._take_look(status, drives, asked_s)
            await anyio.sleep_until(asked_s + self._look_every_s)

    def _lose(self, why: str) -> None:
        """The daemon is away: nothing is known any more as it is now."""
        is_loss = self.is_connected or self.why_away == NOT_ASKED
        is_new = self.why_away != why
        self.is_connected, self.why_away = False, why
        self.line, self.leases, self.silenced = None, {}, set()
        for drive in self.drives.values():
            if drive.state != UNKNOWN:
                self._states_before[drive.name] = state_of(drive)
            drive.state, drive.reason, drive.states = UNKNOWN, why, None
            drive.doing, drive.motion = UNKNOWN, None
            for code, value in drive.values.items():
                drive.values[code] = replace(value, good_until_s=-inf)
        if is_new:
            logger.warning("event=daemon-away socket=%s reason=%s", self.socket, why)
        if is_loss:
            self._give("away", "", {"reason": why})

    # -- what events say -------------------------------------------------------------------------

    def _take_event(self, event: Event) -> None:
        """Take an event into the picture, then give it to the listeners."""
        now_s, data = anyio.current_time(), event.data
        if event.kind == "lease" or (event.kind == "remark" and data.get("subject") == "lease"):
            self._leases_due = True
        if event.kind == "lease":
            self._take_silence(data)
        elif event.kind == "line":
            self._line_heard_s = now_s
            if self.line is not None and "state" in data:
                self.line = replace(
                    self.line, state=str(data["state"]), reason=str(data.get("reason") or "")
                )
        elif (
            event.kind in ("value", "state", "trip", "remark")
            and event.drive
            and not self._take_drive_event(event, now_s)
        ):
            return
        for listener in self.listeners:
            listener(event)

    def _take_silence(self, data: Mapping[str, Any]) -> None:
        """Take whether drives are silenced before the event that says what state they have."""
        drives = map(str, data.get("drives") or ())
        if data.get("what") == "silenced":
            self.silenced.update(drives)
        elif data.get("what") == "silence-ended":
            self.silenced.difference_update(drives)

    def _take_drive_event(self, event: Event, now_s: float) -> bool:
        """Take an event about a drive; returns whether the listeners may have it."""
        data = event.data
        if event.kind == "state" and data.get("state") is None:
            self._states_before.pop(event.drive, None)
            self.silenced.discard(event.drive)
            return self.drives.pop(event.drive, None) is not None
        drive = self.drives.get(event.drive)
        if drive is None:
            drive = self.drives[event.drive] = FollowedDrive(event.drive)
            self._periods_due_s = -inf
        if event.kind == "value":  # before the first look it is not known how long it is good
            return self.is_connected and self._take_value(drive, event.reading, now_s)
        drive.heard_s = now_s
        if event.kind == "state":
            said = (str(data["state"]), str(data.get("reason") or ""), states_of(data))
            was = self._states_before.pop(drive.name, state_of(drive))
            drive.state, drive.reason, drive.states = said
            return said != was
        if event.kind == "trip":
            had, drive.fault = drive.fault, data.get("fault") if data.get("active") else None
            return fault_key(had) != fault_key(drive.fault)
        subject, text = str(data["subject"]), data.get("text")
        before = drive.remarks.pop(subject, None)
        if text is not None:
            drive.remarks[subject] = str(text)
        return before != text

    def _take_value(self, drive: FollowedDrive, reading: Reading, now_s: float) -> bool:
        """Take a value that an event brings, which may have waited on its way."""
        read_at_s = -inf
        if reading.age_s is not None and reading.time is not None:
            by_wall_s = self._wall() - reading.time.timestamp()
            read_at_s = now_s - max(reading.age_s, by_wall_s)
        key = key_of(reading)
        known = drive.values.get(key)
        if is_secret(drive.family, reading) or (
            known is not None and known.read_at_s > read_at_s + CLOCKS_DIFFER_S
        ):
            return False
        drive.values[key] = self._value(reading, read_at_s, now_s)
        return True

    # -- what a look shows -----------------------------------------------------------------------

    def _take_periods(self, plan: Mapping[str, Any]) -> None:
        self._periods = {
            (str(drive["name"]), str(one["code"])): float(one["every_s"])
            for drive in plan["roster"]["drives"]
            for one in drive["cyclic"]
        }

    def _take_leases(self, leases: Mapping[str, Any]) -> None:
        self.leases = leases
        if not self._leases_due:  # no event came while it was asked
            rows = leases.get("drives") or ()
            self.silenced = {str(one["drive"]) for one in rows if one.get("silenced")}

    def _take_look(
        self, status: LineStatus, documents: Iterable[Mapping[str, Any]], asked_s: float
    ) -> None:
        """Compare the picture with what the daemon says now, and give what changed."""
        before = self.line
        if before is not None and self._line_heard_s >= asked_s:
            status = replace(status, state=before.state, reason=before.reason)
        self.line = status
        if not self.is_connected:
            self.is_connected, self.why_away = True, ""
            logger.info("event=daemon-connected socket=%s line=%s", self.socket, status.name)
            self._give("connected", "", {"line": status.name})
        elif before is not None and before.state != status.state:
            self._give("line", "", {"line": status.name, "state": status.state,
                                    "reason": status.reason or None})  # fmt: skip
        seen, known = set(), set(self.drives)
        for document in documents:
            seen.add(str(document["drive"]))
            self._take_drive(document, asked_s)
        if before is not None and not seen <= known:
            self._periods_due_s = -inf
        for name in [name for name in self.drives if name not in seen]:
            if self.drives[name].heard_s < asked_s:
                del self.drives[name]
                self._states_before.pop(name, None)
                self.silenced.discard(name)
                self._give("state", name, {"drive": name, "state": None,
                                           "reason": "taken out of the roster"})  # fmt: skip
        self._give("looked", "", {})

    def _take_drive(self, document: Mapping[str, Any], asked_s: float) -> None:
        name = str(document["drive"])
        is_new = name not in self.drives
        drive = self.drives.setdefault(name, FollowedDrive(name))
        drive.address, drive.family = int(document["address"]), str(document["family"])
        drive.motion = document.get("motion") or {}
        drive.doing = doing_of(drive.motion)
        for one in document.get("values") or ():
            reading = Reading.of(one)
            key = key_of(reading)
            if is_secret(drive.family, reading):
                continue
            read_at_s = -inf if reading.age_s is None else asked_s - reading.age_s - PAGE_AGE_S
            known = drive.values.get(key)
            if known is None or known.heard_s < asked_s - PAGE_AGE_S:
                drive.values[key] = self._value(reading, read_at_s)
        if drive.heard_s < asked_s:
            self._compare_drive(drive, document, is_new=is_new)

    def _compare_drive(
        self, drive: FollowedDrive, document: Mapping[str, Any], *, is_new: bool
    ) -> None:
        """Take state, fault and remarks of a drive, and give what no event said."""
        was = self._states_before.pop(drive.name, state_of(drive))
        drive.state = str(document["state"])
        drive.reason = str(document.get("reason") or "")
        drive.states = states_of(document)
        if is_new or was != state_of(drive):
            data = {key: document.get(key) for key in ("drive", "state", "reason", "since")}
            self._give("state", drive.name, {**data, "states": document.get("states")})
        had, fault = drive.fault, document.get("fault")
        if fault is None and had is not None and drive.states is None:
            fault = {**had, "stale": True}  # none is only certain while its states are known
        drive.fault = fault
        if fault_key(had) != fault_key(fault):
            data = {"drive": drive.name, "active": fault is not None, "fault": fault or had}
            self._give("trip", drive.name, data)
        remarks = {str(key): str(text) for key, text in (document.get("remarks") or {}).items()}
        before, drive.remarks = drive.remarks, remarks
        if before.get("lease") != remarks.get("lease"):
            self._leases_due = True
        for subject in {**before, **remarks}:
            text = remarks.get(subject)
            if before.get(subject) != text:
                self._give("remark", drive.name,
                           {"drive": drive.name, "subject": subject, "text": text})  # fmt: skip

    def _value(self, reading: Reading, read_at_s: float, heard_s: float = -inf) -> FollowedValue:
        if not reading.is_good:
            return FollowedValue(reading, read_at_s, -inf, heard_s)
        every_s = self._periods.get((reading.drive, key_of(reading)))
        good_until_s = read_at_s + good_for_s(every_s, self.stretch)
        return FollowedValue(reading, read_at_s, good_until_s, heard_s)

    def _give(self, kind: str, drive: str, data: Mapping[str, Any]) -> None:
        event = Event("", kind, drive, data)
        for listener in self.listeners:
            listener(event)


def key_of(reading: Reading) -> str:
    """Return what a value is kept under: `C0050`, or `C0039/1`."""
    return f"{reading.code}/{reading.subcode}" if reading.subcode else reading.code


def states_of(document: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Return what status words show; None: not known."""
    found = document.get("states")
    return None if found is None else tuple(str(one) for one in found)


def fault_key(fault: Mapping[str, Any] | None) -> tuple[Any, ...] | None:
    """Return what makes a fault another fault; its age and what was found out later do not."""
    return None if fault is None else tuple(fault.get(key) for key in ("keypad", "number", "kind"))


def state_of(drive: FollowedDrive) -> tuple[str, str, tuple[str, ...] | None]:
    """Return what a state event says of a drive."""
    return drive.state, drive.reason, drive.states


@lru_cache(maxsize=4096)
def is_secret_code(family_name: str, code: str) -> bool:
    """Whether a code of a family holds a password."""
    try:
        return family(family_name).is_secret(Code.parse(code))
    except (LecombusError, ValueError, KeyError):
        return False


def is_secret(family_name: str, reading: Reading) -> bool:
    """Whether a value is a password."""
    return is_secret_code(family_name, key_of(reading))
