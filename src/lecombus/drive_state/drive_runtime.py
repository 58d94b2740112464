"""One drive of the running line: all that is known and set of it, in one object.

`Drive` has one attribute for each thing that is followed; the modules that change it are named
beside it, and no other does. `LineDrives` holds the drives of the line by name. A drive stays the
same object for as long as its name is in the roster, also when a reload or a change of its address
makes another entry of it: `Drive.begin` then forgets what was known of it, because another device
may answer from now on. Drives are added, changed, moved and removed by
`supervision.drive_changes`, and by nothing else.

Kept elsewhere by name, with the reason: the schedule (it knows no roster), the store (what API and
metrics read, and what stays while the device stays), counters (a series may be a group's), the
state file (it outlives the process).
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import anyio

from lecombus.capacity.exchange_costs import watched_s
from lecombus.drive_state.control_word import ControlWord, control_word_of
from lecombus.drive_state.readings import DriveState
from lecombus.errors import OperationError, meant

if TYPE_CHECKING:
    from lecombus.config import DriveEntry
    from lecombus.drives import Family
    from lecombus.drives.faults.fault_tables import FaultKind
    from lecombus.drives.measured import SlowAnswers
    from lecombus.fieldbus.requests import Station
    from lecombus.parameters import Code
    from lecombus.schedule import PollingEntry, Request

__all__ = [
    "AnswerTimeRecord",
    "AuditRecord",
    "ConfigurationRecord",
    "Drive",
    "EnableRecord",
    "FaultRecord",
    "FeedRecord",
    "HealthRecord",
    "IdentityRecord",
    "LastingRecord",
    "LineDrives",
    "RunningAudit",
    "SpeedRecord",
    "WatchdogSetting",
]


@dataclass(slots=True)
class HealthRecord:
    """How the drive is doing (`supervision.health`).

    Args:
        state: Its state.
        misses: Exchanges in a row that failed.
        silent_from_s: When the first of these ended, monotonic seconds.
        heard: It has answered since the line was opened.
        audit_due: It answers again and is to be audited.
        due_from_s: Since when, monotonic seconds.
        logged: The state that the log shows.
        silenced: Why it is sent nothing but stops; empty: it is spoken to.
        silent_since_s: When the last telegram to it may have gone out, monotonic seconds.
    """

    state: DriveState = DriveState.STARTING
    misses: int = 0
    silent_from_s: float = 0.0
    heard: bool = False
    audit_due: bool = False
    due_from_s: float = 0.0
    logged: DriveState = DriveState.STARTING
    silenced: str = ""
    silent_since_s: float = 0.0


@dataclass(slots=True)
class FaultRecord:
    """Which fault the drive shows (`supervision.fault_watch`).

    Args:
        family: The family by which its words are read; None: no value was read yet.
        raw: The status words as last read.
        shows: What each status word last showed.
        kind: The worst of these.
        since_s: When that rose, Unix seconds.
        number: The fault's number, once the memory gave one that agrees.
        digit: The tens digit last read while a fault was shown.
        candidate: What the memory last held while a fault was shown.
        tries: How often the memory was asked.
        looks: How often words that contradict each other were read again.
        asking: A read of the memory is under way.
        logged: This fault stands in the log already.
    """

    family: Family | None = None
    raw: dict[Code, str] = field(default_factory=dict)
    shows: dict[Code, FaultKind | None] = field(default_factory=dict)
    kind: FaultKind | None = None
    since_s: float = 0.0
    number: int | None = None
    digit: int = 0
    candidate: int | None = None
    tries: int = 0
    looks: int = 0
    asking: bool = False
    logged: bool = False


@dataclass(slots=True)
class IdentityRecord:
    """What the drive said of itself at its last audit, by code (`operations.identities`)."""

    found: dict[Code, str] = field(default_factory=dict)

    def as_text(self) -> dict[str, str]:
        """Return the same with the codes as text, as documents have it."""
        return {str(code): text for code, text in self.found.items()}


@dataclass(slots=True)
class SpeedRecord:
    """What the drive's speed did last (`supervision.command_effects`).

    Args:
        turns: Whether the motor turned; None: not known, or a command was given since.
        raw: What the codes that show it read last.
        looked_s: When a status word was last read for it, monotonic seconds.
    """

    turns: bool | None = None
    raw: dict[Code, str] = field(default_factory=dict)
    looked_s: float = -math.inf


@dataclass(slots=True)
class ConfigurationRecord:
    """The family as the drive's signal configuration makes it (`supervision.configurations`)."""

    family: Family


@dataclass(frozen=True, slots=True)
class WatchdogSetting:
    """What a drive's watchdog is set to.

    Args:
        time_s: After this long without a telegram it acts, seconds.
        action: What it does, as the drive's number for it; 0 is nothing.
    """

    time_s: float
    action: int

    @property
    def armed(self) -> bool:
        """Whether it acts at all."""
        return self.action != 0 and self.time_s > 0.0

    def acts_like(self, other: WatchdogSetting) -> bool:
        """Whether both do the same: the time of one that is off means nothing."""
        return self == other or self.action == other.action == 0


class RunningAudit:
    """An audit that runs or is about to."""

    __slots__ = ("asked_again", "cancelled", "learning", "scope")

    def __init__(self) -> None:
        self.asked_again = asyncio.Event()
        self.cancelled = False
        self.scope: anyio.CancelScope | None = None
        self.learning: anyio.CancelScope | None = None
        """What is read behind the audit, when the line has time."""

    def repeat(self) -> None:
        """Have it made again soon."""
        self.asked_again.set()
        if self.learning is not None:
            self.learning.cancel()

    def cancel(self) -> None:
        """End it, whether it has begun or not."""
        self.cancelled = True
        if self.scope is not None:
            self.scope.cancel()


@dataclass(slots=True)
class AuditRecord:
    """How far the drive's audit has come.

    Changed by `drive_supervisor`, `health`, `line_watch` and `watchdogs` of `supervision`.

    Args:
        running: The audit under way or waiting to begin.
        again: One more was asked for since that began.
        tried: First contact was tried.
        watchdog: What its watchdog was set to when it was last looked at; None: it was not seen.
        anew: It may be another device since: its whole setting is read again.
        assumed: Its watchdog's time is taken to be as it was, and was not read since a silence.
        unfed: It was not heard for longer than its watchdog's time since that was last looked at.
    """

    running: RunningAudit | None = None
    again: bool = False
    tried: bool = False
    watchdog: WatchdogSetting | None = None
    anew: bool = True
    assumed: bool = False
    unfed: bool = False


@dataclass(slots=True)
class AnswerTimeRecord:
    """What was said of its answer times (`supervision.line_requests`).

    Args:
        seen: The measured times that were looked at last.
        logged: That it is slow stands in the log already.
    """

    seen: SlowAnswers | None = None
    logged: bool = False


@dataclass(slots=True)
class FeedRecord:
    """What was said of its watchdog's feeding (`supervision.line_watch`).

    Args:
        lapses: How often the schedule had counted a lapse at the last look.
    """

    lapses: int = 0


@dataclass(slots=True)
class EnableRecord:
    """What became of the drive's last enable (`operations.why`).

    Args:
        lapses_then: How often its watchdog had run out when it was last enabled.
    """

    lapses_then: int = 0


@dataclass(slots=True)
class LastingRecord:
    """What counts for the drive of this name with any entry, also when it comes back later.

    Changed by `awaited_requests`, `stop_conditions`, `verb_steps`, `wear`, `writes` and
    `group_writes` of `operations`, and by `supervision.health`.

    Args:
        stops: How often a stop was sent to it, for work of several steps: what is not in the
            schedule yet when a stop comes must not be written either.
        stopped_at_s: When a stop was last sent to it, monotonic seconds.
        stop_written_at_s: When a plain write that stops it was last sent, monotonic seconds.
        stop_write_done: Waits for the end of that write and says whether it was done; None: it was
            not sent.
        stops_and_writes: How often it was to stop, by a stop or by a plain write.
        stop_writes: How often by a plain write that did not say what was said last: a PLC may say
            its stop ten times a second.
        lifts: How many plain writes may have lifted its inhibit.
        alone: The enable, the reset or the change of its address that is under way.
        awaited: What verbs wait for and a stop cuts short (`operations.verb_steps`).
        full_at_s: By code that is stored at every write: when its limit of writes is back at a
            whole burst, monotonic seconds (`operations.wear`).
        restarted_s: When it may last have restarted: it answered again, or was found to be other
            than it was, monotonic seconds.
    """

    stops: int = 0
    stopped_at_s: float = -math.inf
    stop_written_at_s: float = -math.inf
    stop_write_done: Callable[[], Awaitable[bool]] | None = None
    stops_and_writes: int = 0
    stop_writes: int = 0
    lifts: int = 0
    alone: str = ""
    awaited: set[anyio.CancelScope] = field(default_factory=set)
    full_at_s: dict[Code, float] = field(default_factory=dict)
    restarted_s: float = -math.inf

    def count_stop(self) -> None:
        """Count a stop, or a plain write that means one, and end what verbs wait for."""
        self.stops_and_writes += 1
        for scope in self.awaited:
            scope.cancel()


class Drive:
    """What is known and set of one drive.

    Args:
        entry: The roster's entry.
        station: How it is spoken to.
        clock: Monotonic time, seconds.
        lasting: What counts from before; None: nothing does.
    """

    __slots__ = (
        "_clock", "answer_times", "audit", "configuration", "control_word", "cyclic", "enable",
        "entry", "fault", "feed", "health", "home", "identity", "lasting", "name", "probe", "speed",
        "station",
    )  # fmt: skip

    def __init__(
        self,
        entry: DriveEntry,
        station: Station,
        clock: Callable[[], float],
        lasting: LastingRecord | None = None,
    ) -> None:
        self.name = entry.name
        self._clock = clock
        self.lasting = lasting or LastingRecord()
        self.enable = EnableRecord()
        self.fault = FaultRecord()
        self.entry = entry
        self.home = entry.address
        """The address that the roster's file gives it (`operations.readdress`)."""
        self.feed = FeedRecord()
        self.cyclic: dict[Code, PollingEntry] = {}
        """The reads that the schedule repeats (`supervision.drive_changes`)."""
        self.probe: Callable[[], Request] | None = None
        """Makes the read that asks whether it is back, while it is offline."""
        self.begin(entry, station)

    def begin(self, entry: DriveEntry, station: Station) -> None:
        """Start with an entry: nothing is known of the device yet that answers there.

        The fault stays with the values, in the store too: while address and family do. Only a word
        that is read shows its end.
        """
        if (self.entry.address, self.entry.family) != (entry.address, entry.family):
            self.enable = EnableRecord()
            self.fault = FaultRecord()
        self.entry = entry
        self.station = station
        """Changed by `drive_changes`, `write_prechecks` and `line_requests`."""
        self.health = HealthRecord()
        self.identity = IdentityRecord()
        self.speed = SpeedRecord()
        self.configuration = ConfigurationRecord(station.family)
        self.audit = AuditRecord()
        self.answer_times = AnswerTimeRecord()
        self.control_word: ControlWord = control_word_of(
            station.family,
            self._clock,
            watchdog_s=watched_s(entry),
            watchdog_inhibits=entry.watchdog is not None and entry.watchdog.action == "inhibit",
        )
        """Changed by `exchange_recorder`, `health`, `drive_changes` and `write_prechecks`, and by
        `stop_requests`, `writes` and `group_writes` of `operations`."""

    @property
    def family(self) -> Family:
        """Its family, as its signal configuration makes it."""
        return self.station.family

    def may_have_restarted(self) -> None:
        """Forget its control word, and note when: it may have lost its supply."""
        self.control_word.forget()
        self.lasting.restarted_s = self._clock()

    @property
    def watchdog_quick_stops(self) -> bool:
        """Whether its watchdog stops it by a quick stop."""
        return self.entry.watchdog is not None and self.entry.watchdog.action == "quick-stop"


class LineDrives:
    """The drives of one line by name."""

    def __init__(self) -> None:
        self._drives: dict[str, Drive] = {}
        self._lasting: dict[str, LastingRecord] = {}

    def __iter__(self) -> Iterator[Drive]:
        """Give the drives, the one that was added or begun last at the end."""
        return iter(self._drives.values())

    def __len__(self) -> int:
        """Count the drives."""
        return len(self._drives)

    def put(self, drive: Drive) -> None:
        """Take a drive in, or put one that begins again at the end."""
        self._drives.pop(drive.name, None)
        self._drives[drive.name] = drive

    def take_out(self, drive: Drive) -> None:
        """Take a drive out."""
        del self._drives[drive.name]

    def lasting(self, name: str) -> LastingRecord:
        """Give what counts for a name, also before it is a drive's and after."""
        return self._lasting.setdefault(name, LastingRecord())

    def find(self, name: str) -> Drive | None:
        """Look a drive up; None: there is none of the name."""
        return self._drives.get(name)

    def get(self, name: str) -> Drive:
        """Look a drive up.

        Raises:
            OperationError: `no-such-drive`.
        """
        drive = self._drives.get(name)
        if drive is None:
            raise OperationError(
                f"there is no drive {name!r} on this line",
                kind="no-such-drive",
                drive=name,
                remedy=meant(name, self._drives, "the drives"),
            )
        return drive

    def entries(self) -> Mapping[str, DriveEntry]:
        """Give the roster's entries by name."""
        return {drive.name: drive.entry for drive in self._drives.values()}
