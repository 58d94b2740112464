"""What the end of a lease does to its drives, and what keeps a latched drive from moving.

Theory of operation. One task sleeps until the next lease lapses; nothing polls. What ended is
handed out once by the book and carried out by the drive's `on_lapse`:

* `quick-stop`, `inhibit`: a stop in the stop class, by one multicast where a group's members all
  lapsed and one telegram reaches them. A member that is not proven is silenced, so that its own
  watchdog stops it; where no watchdog would, or where it would drop a load that must not be dropped
  (`stop_fallback: none`), the stop is repeated until it is proven.
* `silence`: no telegram but a stop that is asked for, until a new lease is held and the watchdog's
  time has passed.
* `hold`: a remark and a metric, until the drive is enabled under a new lease.

A drive that is latched and comes back, and every drive with a required lease after a start, is
looked at when it is online: unless its words show it stopped, the same is done.
Source: docs/adr/0079-what-a-lease-promises.md.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Final

import anyio

from lecombus.capacity.lease_bounds import stops_by_silence
from lecombus.drive_state.drive_runtime import Drive
from lecombus.drive_state.motion import Doing, Motion
from lecombus.drive_state.readings import DriveState
from lecombus.drive_state.store import Store
from lecombus.drives import StopAction
from lecombus.errors import LecombusError
from lecombus.leases import DriveControl, EndedLease, EndOfLease, Latch
from lecombus.metrics import LeaseFigures
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.facade import Operations
from lecombus.schedule import Outcome
from lecombus.supervision.health import Health

__all__ = ["LeaseWatch"]

logger = logging.getLogger(__name__)

REMARK: Final = "lease"

REPEAT_S: Final = 2.0
"""Between two stops of a drive that does not show the first and has no watchdog to stop it."""

REPEAT_MOST_S: Final = 60.0
"""While such a drive is offline its stop is repeated ever more seldom, down to this: each takes a
second of the line. It is stopped again `REPEAT_S` after it answers."""

LOOK_S: Final = 0.25
"""How often latched drives are looked at that were away, seconds."""

WORDS_S: Final = 3.0
"""How long a drive that is online may take until its words show what it does, seconds."""

AWAY: Final = (DriveState.OFFLINE, DriveState.STARTING)

LOST_MOST_S: Final = 60.0
"""The task sleeps no longer than this."""


class LeaseWatch:
    """Carries out the ends of the leases of one line.

    Args:
        requests: Has the drives.
        store: Gets the remarks; knows what the drives do.
        operations: Has the leases, and stops drives.
        health: Silences drives.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        operations: Operations,
        health: Health,
        clock: Callable[[], float],
    ) -> None:
        self._drives = requests.drives
        self._store = store
        self._operations = operations
        self._leases = operations.leases
        self._book = operations.leases.book
        self._health = health
        self._clock = clock
        self._changed = asyncio.Event()
        self._lapses: Counter[str] = Counter()
        self._rounds: Counter[str] = Counter()  # by drive: how often an end was carried out
        self._silenced: dict[str, str] = {}
        self._holding: set[str] = set()
        self._to_look_at: set[str] = set()
        self._online_s: dict[str, float] = {}
        self._restarts: dict[str, float] = {}  # by drive: the restart that was looked at last
        self._leases.changed = self._changed.set

    async def run(self) -> None:
        """Carry out each end when it comes, until the daemon ends."""
        async with anyio.create_task_group() as tasks:
            while True:
                self._changed.clear()
                for ended in self._book.take_ended(self._clock()):
                    tasks.start_soon(self._carry_out, ended)
                for due in self._look():
                    tasks.start_soon(self._carry_out, due)
                with anyio.move_on_after(self._sleep_s()):
                    await self._changed.wait()

    def roster_changed(self) -> None:
        """Keep drives silent that a reload made begin again; forget those that left."""
        names = (self._silenced, self._holding, self._to_look_at, self._restarts, self._online_s)
        for name in {one for of in names for one in of}:
            drive = self._drives.find(name)
            if drive is None:
                self._silenced.pop(name, None)
                self._holding.discard(name)
                self._to_look_at.discard(name)
                self._restarts.pop(name, None)
                self._online_s.pop(name, None)
            elif name in self._silenced and not drive.health.silenced:
                self._health.silence(drive, self._silenced[name])
        self._remark()

    def figures(self) -> LeaseFigures | None:
        """Return what the metrics show; None: no lease is needed, and none was taken."""
        now_s = self._clock()
        held = len(self._book.leases(now_s))
        latched = {
            name: control.latch is not None
            for name, control in self._book.drives.items()
            if control.terms.required or control.lease is not None or control.ended is not None
        }
        if not latched:
            return None
        lapses = {name: self._lapses[name] for name in latched}
        return LeaseFigures(
            held, lapses, latched, frozenset(self._holding), frozenset(self._silenced)
        )

    # -- what to do, and when ---------------------------------------------------------------------

    def _sleep_s(self) -> float:
        now_s, next_s = self._clock(), self._book.next_s()
        sleep_s = LOST_MOST_S if next_s is None else min(LOST_MOST_S, max(0.0, next_s - now_s))
        waits = self._silenced or any(one.latch is not None for one in self._book.drives.values())
        return min(sleep_s, LOOK_S) if waits else sleep_s

    def _look(self) -> list[EndedLease]:
        """Look at latched drives; return what is to be done to those that came back."""
        now_s = self._clock()
        for name in self._book.due(now_s):
            self._book.start_done(name)
            self._to_look_at.add(name)
        for name in list(self._silenced):
            self._end_silence(name)
        found: list[EndedLease] = []
        for name, control in self._book.drives.items():
            if control.latch is None:
                self._to_look_at.discard(name)
                self._holding.discard(name)
                continue
            if self._is_back(name, control):
                self._to_look_at.add(name)
            if self._store.state(name) in AWAY:
                self._online_s.pop(name, None)
                if control.due_s is None and name not in self._silenced:
                    self._to_look_at.add(name)
            elif self._drives.get(name).health.audit_due:
                self._online_s.pop(name, None)
            elif name in self._to_look_at and not self._waits_for_words(name, now_s):
                self._to_look_at.discard(name)
                if not self._is_shown_stopped(name):
                    found.append(self._again(name, now_s))
        self._remark()
        return found

    def _is_back(self, name: str, control: DriveControl) -> bool:
        """Whether a drive may have restarted since it was stopped, or was last looked at.

        A short loss of its supply makes a drive `degraded` and no more, and one that comes online
        soon may have been away between two looks.
        """
        restarted_s = self._drives.get(name).lasting.restarted_s
        if restarted_s == self._restarts.get(name):
            return False
        self._restarts[name] = restarted_s
        self._online_s.pop(name, None)
        is_new = control.ended is None or restarted_s > control.ended.at_s
        is_open = control.due_s is None and name not in self._silenced
        return is_new and is_open and name not in self._holding

    def _again(self, name: str, now_s: float) -> EndedLease:
        """Make the end to be carried out for a drive that runs and has no controller."""
        control = self._book.drives[name]
        if control.ended is None or control.latch is Latch.STARTED:
            return EndedLease("", 0, (name,), EndOfLease.NONE_TAKEN, now_s)
        ended = control.ended
        return EndedLease(ended.name, ended.number, (name,), EndOfLease.CAME_BACK, now_s)

    def _waits_for_words(self, name: str, now_s: float) -> bool:
        """Whether a drive's words are waited for; a stop of a drive that stands does no harm."""
        online_s = self._online_s.setdefault(name, now_s)
        policy = self._book.drives[name].terms.on_lapse
        if policy in set(StopAction) or self._motion(name).doing is not Doing.UNKNOWN:
            return False
        return now_s - online_s < WORDS_S

    def _is_shown_stopped(self, name: str) -> bool:
        """Whether the drive's own words, as read of late, show that it does not drive its motor."""
        motion = self._motion(name)
        return motion.doing is Doing.STOPPED and not motion.stale

    def _motion(self, name: str) -> Motion:
        """Give what a drive does by what was read since it may have restarted."""
        return self._store.motion(name, since_s=self._drives.lasting(name).restarted_s)

    def _end_silence(self, name: str) -> None:
        """Speak to a drive again once a lease is held for it and its watchdog has had its time."""
        drive, control = self._drives.find(name), self._book.drives.get(name)
        if drive is None or control is None:
            del self._silenced[name]
            return
        if control.lease is not None and self._health.is_silence_over(drive):
            del self._silenced[name]
            if control.terms.on_lapse in set(StopAction):
                self._to_look_at.add(name)
            logger.info("drive=%s event=silence-ended lease=%s", name, control.lease.name)
            self._leases.tell("silence-ended", (name,), {"lease": control.lease.name})
            self._health.end_silence(drive)

    # -- the end of a lease -----------------------------------------------------------------------

    async def _carry_out(self, ended: EndedLease) -> None:
        """Do to each drive what its roster says, once."""
        drives = [drive for name in ended.drives if (drive := self._drives.find(name)) is not None]
        logger.warning(
            "event=lease-ended lease=%s number=%d end=%s drives=%s",
            ended.name or "none", ended.number, ended.end, ",".join(ended.drives),
        )  # fmt: skip
        fields = {"lease": ended.name, "number": str(ended.number), "end": ended.end.value}
        self._leases.tell("ended", ended.drives, fields)
        by_action: dict[str, list[Drive]] = {}
        for drive in drives:
            self._rounds[drive.name] += 1
            self._lapses[drive.name] += ended.end is EndOfLease.LAPSED
            by_action.setdefault(drive.entry.lease.on_lapse, []).append(drive)
        why = words_of(ended)
        for drive in by_action.pop("silence", ()):
            # What was given up in order and stands need not be stopped by its watchdog.
            if ended.end is not EndOfLease.RELEASED or not self._is_shown_stopped(drive.name):
                self._silence(drive, f"sent nothing, so that its watchdog acts: {why}")
        for drive in by_action.pop("hold", ()):
            self._holding.add(drive.name)
            logger.error("drive=%s event=hold lease=%s", drive.name, ended.name or "none")
            self._leases.tell("hold", (drive.name,), {"lease": ended.name})
        self._remark()
        async with anyio.create_task_group() as tasks:
            for action, members in by_action.items():
                names = [drive.name for drive in members]
                for target, reached in self._targets(names):
                    tasks.start_soon(self._stop, StopAction(action), target, reached, why)

    def _targets(self, names: Sequence[str]) -> Iterable[tuple[str, tuple[str, ...]]]:
        """Find the fewest telegrams: groups with a multicast of which all members lapsed."""
        left = dict.fromkeys(names)
        groups = self._operations.context.groups.items()
        for group, entry in sorted(groups, key=lambda one: -len(one[1].members)):
            members = tuple(entry.members)
            if (
                entry.multicast_address is not None
                and len(members) > 1
                and left.keys() >= {*members}
            ):
                yield group, members
                for name in members:
                    del left[name]
        for name in left:
            yield name, (name,)

    async def _stop(
        self, action: StopAction, target: str, names: tuple[str, ...], why: str
    ) -> None:
        """Stop drives; silence, or stop again, those that do not show it."""
        rounds = {name: self._rounds[name] for name in names}
        # A drive that goes and comes back is audited: what its watchdog does is not known then.
        drives = filter(None, map(self._drives.find, names))
        left = {drive.name for drive in drives if has_watchdog_that_stops(drive)}
        missing = await self._unproven(action, target, names)
        for name in names:
            if name not in missing:
                self._note_stopped(action, name, alone=len(names) == 1)
        async with anyio.create_task_group() as tasks:
            for name in missing:
                tasks.start_soon(self._escalate, action, name, rounds[name], name in left, why)

    async def _unproven(
        self, action: StopAction, target: str, names: tuple[str, ...]
    ) -> tuple[str, ...]:
        """Stop a drive or a group; name the members that do not show it."""
        try:
            report = await self._operations.stop(action, target)
        except LecombusError as exc:
            logger.error("drive=%s event=lapse-not-stopped reason=%s", target, exc)
            return names
        outcomes = {one.drive: one.outcome for one in report.members}
        return tuple(name for name in names if outcomes.get(name) is not Outcome.VERIFIED)

    async def _escalate(
        self, action: StopAction, name: str, round_: int, is_left: bool, why: str
    ) -> None:
        """Have the drive's watchdog stop it (`is_left`), or stop it again until that is proven."""
        pause_s = REPEAT_S
        while self._is_open(name, round_):
            drive = self._drives.get(name)
            if is_left and stops_by_silence(drive.entry):
                self._silence(drive, f"{action} is not proven, its watchdog is left to act: {why}")
                return
            pause_s = await self._pause(name, round_, pause_s)
            if self._is_open(name, round_) and not await self._unproven(action, name, (name,)):
                self._note_stopped(action, name, alone=True)
                return

    def _note_stopped(self, action: StopAction, name: str, *, alone: bool) -> None:
        """A stop is proven: a restart that was seen before that calls for no further one.

        A member of a group may have restarted behind its own proof and before that of others.
        """
        logger.info("drive=%s event=lapse-stopped action=%s", name, action)
        if alone:
            self._restarts[name] = self._drives.lasting(name).restarted_s
            self._to_look_at.discard(name)

    async def _pause(self, name: str, round_: int, pause_s: float) -> float:
        """Wait between two stops of a drive, as long as it is offline; give the next such wait."""
        end_s = self._clock() + pause_s
        while True:
            await anyio.sleep(REPEAT_S)
            is_away = self._is_open(name, round_) and self._store.state(name) is DriveState.OFFLINE
            if not is_away:
                return REPEAT_S
            if self._clock() >= end_s:
                return min(2.0 * pause_s, REPEAT_MOST_S)

    def _is_open(self, name: str, round_: int) -> bool:
        """Whether the drive is still latched by the end that is being carried out."""
        control = self._book.drives.get(name)
        is_latest = self._rounds[name] == round_ and self._drives.find(name) is not None
        return is_latest and control is not None and control.latch is not None

    def _silence(self, drive: Drive, reason: str) -> None:
        self._silenced[drive.name] = reason
        self._to_look_at.discard(drive.name)
        logger.error("drive=%s event=silenced reason=%s", drive.name, reason)
        self._leases.tell("silenced", (drive.name,), {"reason": reason})
        self._health.silence(drive, reason)

    # -- what is shown ----------------------------------------------------------------------------

    def _remark(self) -> None:
        """Say of each latched drive why, and what to do."""
        for name, control in self._book.drives.items():
            text = None
            if name in self._holding:
                text = (
                    "runs on without a controller (on_lapse: hold), unless it was stopped since: "
                    "take a lease and enable it, or stop it"
                )
            elif control.latch is not None:
                text = f"latched ({LATCHES[control.latch]}): take a lease, then enable it"
                if control.lease is not None:
                    text = f"latched ({LATCHES[control.latch]}): enable it under its lease"
            if self._drives.find(name) is not None:
                self._store.note(name, REMARK, text)


def has_watchdog_that_stops(drive: Drive) -> bool:
    """Whether a drive's own watchdog stops it as the roster allows, by what was seen of it last.

    The drive may have another one than the roster says, or none. What was not seen counts as there.
    """
    found, traits = drive.audit.watchdog, drive.family.watchdog
    if not stops_by_silence(drive.entry):
        return False
    if found is None or traits is None:
        return True
    is_quick_stop = traits.action_of(found.action) == "quick-stop"
    return found.armed and (drive.entry.stop_fallback == "inhibit" or is_quick_stop)


LATCHES: Final = {
    Latch.STARTED: "no lease was taken yet",
    Latch.LAPSED: "its lease lapsed",
    Latch.RELEASED: "its lease was given up",
}


def words_of(ended: EndedLease) -> str:
    """Say how a lease ended."""
    if ended.end is EndOfLease.NONE_TAKEN:
        return "no lease was taken in time"
    how = "was given up" if ended.end is EndOfLease.RELEASED else "lapsed"
    return f"lease {ended.name} {how}"
