"""A drive's own watchdog: read, set where the roster wants that, or the difference remarked.

What a watchdog does is looked at before any drive's is set, because one that is off needs no
feeding, and with less to feed setting them goes faster. Only what differs is written, the action
last, each proven by reading back; on a drive that nothing may be written to it is only remarked.

An audit follows silence. But a drive can lose its settings without ever being missed: an SMVector
is put back to its defaults at its keypad, a module that is seldom asked restarts between two reads.
Its watchdog is off from then on, and nothing on the line shows it. So `Rechecks` asks one drive
after the other in the background, each every five minutes, or as seldom as keeps all of it to a
hundredth of the line's time: a module's own codes take half a second each. A drive that was not
heard for longer than its watchdog's time is asked at once what its watchdog does: other drives'
time-outs may have taken the line while its supply failed. What differs makes the drive one to be
audited. A drive whose addressing was moved is audited so often: it may be back.
Source: EDB2102EN 6.3 (C1920..C1923; kept without supply: nothing), CMVLC401A 7.3.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Awaitable, Callable, Iterator

import anyio

from lecombus.drive_state.drive_runtime import Drive, WatchdogSetting
from lecombus.drive_state.readings import ADDRESSING_LOCK, ADDRESSING_MOVED, DriveState
from lecombus.drive_state.store import Store
from lecombus.drives import WatchdogTraits
from lecombus.errors import LecombusError, OperationError, UnknownCodeError
from lecombus.fieldbus.requests import Station
from lecombus.operations.awaited_requests import Requests
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority
from lecombus.schedule.request import STOPPED
from lecombus.supervision.health import Health

__all__ = ["DOES_NOT_FIT", "PATIENCE_S", "AuditError", "Rechecks", "WatchdogAudit"]

logger = logging.getLogger(__name__)

PATIENCE_S = 120.0
"""An audit's read may wait this long: at the start 31 modules with 500 ms each come before it."""

REMARK = "watchdog"

OFF = WatchdogSetting(0.0, 0)
"""A watchdog that was seen to be off, before its time is known."""

LEAST_FED_S = 0.05
"""A watchdog shorter than this (the 2102's least, EDB2102EN 6.3.3) cannot be kept on any line of
this kind; trying to would take the line from everybody else."""

DOES_NOT_FIT = "does-not-fit"
"""A module's own code takes so long to read that others' watchdogs would lapse during it."""


EVERY_S = 300.0
LINE_SHARE = 0.01
"""Each drive is asked again this often, seconds, or as seldom as this part of the line allows."""

UNFED_EVERY_S = 1.0
"""Drives whose watchdog's time passed unfed are looked for so often, seconds."""

ASSUMED_EVERY_S = 5.0
ASSUMED_SHARE = 0.03
"""What was assumed is looked for so often, seconds, and read in this part of the line's time."""


class WatchdogAudit:
    """Compares and sets the watchdogs of one line's drives.

    Args:
        requests: Sends requests and waits for their end.
        store: Gets the remarks.
        feed: Sets how often a drive must be spoken to, seconds; None: not on purpose.
        wrote: Told what was written: drive, code, value as on the wire, outcome.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        feed: Callable[[Drive, float | None], None],
        wrote: Callable[[str, Code, str, str], None],
    ) -> None:
        self._requests = requests
        self._store = store
        self._feed = feed
        self._wrote = wrote

    async def changed(self, drive: Drive, station: Station, traits: WatchdogTraits) -> str:
        """Look, when the line has time, whether a watchdog is still set as it was.

        Returns:
            How it changed, in words; empty where it did not, or was never seen.

        Raises:
            LecombusError: It could not be read.
        """
        known = drive.audit.watchdog
        if known is None:
            return ""
        found = await self._read_setting(station, traits, Priority.BACKGROUND)
        if found.acts_like(known) or drive.audit.watchdog != known:
            return ""
        return f"from {describe(traits, known)} to {describe(traits, found)}"

    async def lost(self, drive: Drive, station: Station, traits: WatchdogTraits) -> str:
        """Look, when the line has time, whether a module forgot its watchdog with its supply.

        Returns:
            How it changed, in words; empty where it did not, or was never seen.

        Raises:
            LecombusError: It could not be read.
        """
        known = drive.audit.watchdog
        if known is None or not known.armed or not traits.volatile:
            return ""
        action = int(number(await self._read(station, traits.action_code, Priority.BACKGROUND)))
        if action == known.action or drive.audit.watchdog != known:
            return ""
        found = WatchdogSetting(known.time_s, action)
        return f"from {describe(traits, known)} to {describe(traits, found)}"

    async def look(self, drive: Drive, station: Station, traits: WatchdogTraits) -> int | None:
        """Read what the watchdog does; None: it cannot be seen, which is remarked.

        It is not read either where it fits only because of others' silence of late (ADR 95).
        """
        action: int | None = None
        with self._remarking(drive):
            self._requests.see_that_it_fits(station, traits.action_code)
            drive.audit.unfed = False  # it may be unfed again during the audit
            action = int(number(await self._read(station, traits.action_code)))
            if action == 0:
                drive.audit.watchdog = OFF
                self._feed(drive, None)
        return action

    async def settle(
        self, drive: Drive, station: Station, traits: WatchdogTraits, action: int
    ) -> None:
        """Put it in order, or say how it differs; make a remark of what can never be read.

        Args:
            drive: The drive.
            station: How it is spoken to.
            traits: How its watchdog is set.
            action: What it does now.
        """
        with self._remarking(drive, action):
            await self._audit_watchdog(drive, station, traits, action)

    async def learn(self, name: str, station: Station, traits: WatchdogTraits) -> None:
        """Look at a watchdog that the roster does not name, so that its user learns of it."""
        found = await self._read_setting(station, traits, Priority.BACKGROUND)
        self._remark_unwanted(name, traits, found)

    @contextlib.contextmanager
    def _remarking(self, drive: Drive, action: int | None = None) -> Iterator[None]:
        """Make a remark of what can never be read, instead of asking for it again and again."""
        try:
            yield
            return
        except UnknownCodeError as exc:
            text = f"its watchdog cannot be seen: {exc}"
        except OperationError as exc:
            if exc.kind != DOES_NOT_FIT:
                raise
            text = f"its watchdog cannot be checked: {exc}"
        known = drive.audit.watchdog
        was_off = known is not None and known.action == 0
        if action is None and was_off and drive.entry.watchdog is not None:
            self._feed(drive, drive.entry.watchdog.time_s)  # it may be on by now, or off still
        drive.audit.watchdog = OFF if action == 0 or was_off else None
        drive.audit.anew = True  # rechecks compare nothing with it
        self._store.note(drive.name, REMARK, text)

    async def _audit_watchdog(
        self, drive: Drive, station: Station, traits: WatchdogTraits, action: int
    ) -> None:
        wanted = drive.entry.watchdog
        assert wanted is not None
        target = WatchdogSetting(wanted.time_s, traits.actions[wanted.action])
        found = WatchdogSetting(
            await self._find_time(drive, station, traits, target, action), action
        )
        locked = self._store.drive(drive.name).write_lock is not None
        if not found.acts_like(target) and wanted.configure and not locked:
            logger.info(
                "drive=%s event=watchdog-configure from=%s to=%s",
                drive.name, describe(traits, found), describe(traits, target),
            )  # fmt: skip
            found = await self._configure(drive, station, traits, found, target)
        family = station.family
        codes = f"{family.spoken(traits.time_code)} and {family.spoken(traits.action_code)}"
        remedy = f"set configure: true, or {codes} in the drive"
        if wanted.configure and locked:
            remedy = "it is set when the drive may be written to again"
        elif wanted.configure:
            remedy = f"look at {codes}: it was written, in vain"
        self._settle(drive, traits, found, target, remedy)

    async def _find_time(
        self,
        drive: Drive,
        station: Station,
        traits: WatchdogTraits,
        target: WatchdogSetting,
        action: int,
    ) -> float:
        """Read the time, unless the action shows that nothing was lost since it was in order.

        A module that lost its settings with its supply has its action back at 0, and reading a
        module's own code keeps everybody else waiting for half a second. Settings that are stored
        show nothing of that where the drive may be another device. What is assumed behind a
        silence is looked at when the drive is online.
        """
        asked_anew = drive.audit.anew and not traits.volatile
        known = None if asked_anew else drive.audit.watchdog
        if target.armed and action == target.action and known == target:
            drive.audit.assumed |= drive.audit.anew
            return target.time_s
        drive.audit.assumed = False
        return number(await self._read(station, traits.time_code)) / 1000.0

    async def _configure(
        self,
        drive: Drive,
        station: Station,
        traits: WatchdogTraits,
        found: WatchdogSetting,
        target: WatchdogSetting,
    ) -> WatchdogSetting:
        """Write what differs, the action last: until then an idle watchdog needs no feeding."""
        proven = True
        if found.time_s != target.time_s:
            proven &= await self._write(station, traits.time_code, target.time_s * 1000.0)
        self._feed(drive, target.time_s)
        if found.action != target.action:
            proven &= await self._write(station, traits.action_code, target.action)
        return target if proven else await self._read_setting(station, traits)

    def _settle(
        self,
        drive: Drive,
        traits: WatchdogTraits,
        found: WatchdogSetting,
        target: WatchdogSetting,
        remedy: str,
    ) -> None:
        """Feed by what the drive really has, and say where that differs from the roster."""
        drive.audit.watchdog, drive.audit.anew = found, False
        text = None
        if not found.acts_like(target):
            text = (
                f"the drive's watchdog is {describe(traits, found)}, the roster says "
                f"{describe(traits, target)}: {remedy}"
            )
            logger.warning("drive=%s event=watchdog-differs reason=%s", drive.name, text)
        self._store.note(drive.name, REMARK, text)
        self._feed(drive, max(LEAST_FED_S, found.time_s if found.armed else target.time_s))

    def _remark_unwanted(self, name: str, traits: WatchdogTraits, found: WatchdogSetting) -> None:
        """The roster names no watchdog: feeding one on purpose would go against it."""
        if found.action == 0:
            self._store.note(name, REMARK, None)
            return
        self._store.note(
            name,
            REMARK,
            f"the drive's watchdog is {describe(traits, found)}, but the roster names none: it is "
            "fed only by whatever is read anyhow",
        )

    async def _read_setting(
        self,
        station: Station,
        traits: WatchdogTraits,
        priority: Priority = Priority.INTERACTIVE,
    ) -> WatchdogSetting:
        time = await self._read(station, traits.time_code, priority)
        action = await self._read(station, traits.action_code, priority)
        return WatchdogSetting(number(time) / 1000.0, int(number(action)))

    async def _read(
        self, station: Station, code: Code, priority: Priority = Priority.INTERACTIVE
    ) -> Value:
        return await self._requests.read_if_there(station, code, priority, timeout_s=PATIENCE_S)

    async def _write(self, station: Station, code: Code, value: float) -> bool:
        """Write and read back; what did not take shows when the setting is read again.

        Raises:
            AuditError: Stops ended it each time; the audit is made again.
        """
        wire = Value.decimal(round(value))
        outcome, reason = await self._requests.write_to_the_end(station, code, wire, verify=True)
        self._wrote(station.name, code, wire.raw, outcome.value)
        if outcome is not Outcome.VERIFIED:
            logger.warning(
                "drive=%s code=%s event=watchdog-not-set value=%s outcome=%s reason=%s",
                station.name, code, wire.raw, outcome, reason,
            )  # fmt: skip
        if reason.startswith(STOPPED):
            raise AuditError(
                f"{station.family.spoken(code)} = {wire.raw} was not written: {reason}"
            )
        return outcome is Outcome.VERIFIED


class Rechecks:
    """Asks the drives of one line.

    Args:
        requests: Sends requests and waits for their end.
        store: Has the remarks.
        watchdogs: Knows what was set.
        health: Takes doubts about drives.
    """

    def __init__(
        self, requests: Requests, store: Store, watchdogs: WatchdogAudit, health: Health
    ) -> None:
        self._requests = requests
        self._store = store
        self._watchdogs = watchdogs
        self._health = health

    async def run(self) -> None:
        """Go round for as long as the daemon lives."""
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._look_at_unfed)
            tasks.start_soon(self._look_at_assumed)
            await self._go_round()

    async def _look_at_unfed(self) -> None:
        """Look at the watchdogs that may have been lost while their drives were not asked.

        The drive stays online: mostly the line or the daemon was late, and nothing was lost.
        """
        while True:
            await anyio.sleep(UNFED_EVERY_S)
            for drive in list(self._requests.drives):
                watched = self._watched(drive)
                if drive.audit.unfed and watched is not None:
                    drive.audit.unfed = False  # it may be unfed again while it is read
                    if not await self._compare(drive, watched, self._watchdogs.lost):
                        drive.audit.unfed = True

    async def _look_at_assumed(self) -> None:
        """Look at the watchdogs whose time was taken to be as it was before a silence."""
        while True:
            await anyio.sleep(ASSUMED_EVERY_S)
            for drive in list(self._requests.drives):
                watched = self._watched(drive)
                if drive.audit.assumed and watched is not None:
                    await anyio.sleep(self._cost_s(*watched) / ASSUMED_SHARE)
                    await self._look(drive.name)

    async def _go_round(self) -> None:
        while True:
            drives = [one for one in self._requests.drives
                      if self._watched(one) is not None or self._is_moved(one)]  # fmt: skip
            pause_s = self._round_s(drives) / max(1, len(drives))
            for drive in drives:
                await anyio.sleep(pause_s)
                await self._look(drive.name)
            if not drives:
                await anyio.sleep(pause_s)

    def _round_s(self, drives: list[Drive]) -> float:
        """Give how long one round takes, seconds."""
        cost_s = sum(self._cost_s(*one) for one in filter(None, map(self._watched, drives)))
        return max(EVERY_S, cost_s / LINE_SHARE)

    def _cost_s(self, station: Station, traits: WatchdogTraits) -> float:
        """Give what it takes to read a watchdog's setting, seconds."""
        codes = traits.time_code, traits.action_code
        return sum(self._requests.maker.cost_of_read_s(station, code) for code in codes)

    def _watched(self, drive: Drive | None) -> tuple[Station, WatchdogTraits] | None:
        """A drive that is online, and of whose watchdog the roster and an audit know."""
        if drive is None or drive.entry.watchdog is None or drive.audit.anew:
            return None
        traits = drive.family.watchdog
        if traits is None or drive.health.state is not DriveState.ONLINE:
            return None
        return drive.station, traits

    def _is_moved(self, drive: Drive) -> bool:
        """Whether a drive is online whose addressing was moved: another master may put it back."""
        remarks = self._store.drive(drive.name).remarks
        is_online = drive.health.state is DriveState.ONLINE
        return is_online and not remarks.keys().isdisjoint((ADDRESSING_LOCK, ADDRESSING_MOVED))

    async def _look(self, name: str) -> None:
        """Ask one drive, if it is still one to be asked."""
        drive = self._requests.drives.find(name)
        if drive is not None and self._is_moved(drive):
            self._health.audits.ask(drive, restarted=False)
            return
        watched = self._watched(drive)
        if drive is None or watched is None:
            return
        if await self._compare(drive, watched, self._watchdogs.changed):
            drive.audit.assumed = False

    async def _compare(
        self,
        drive: Drive,
        watched: tuple[Station, WatchdogTraits],
        changed: Callable[[Drive, Station, WatchdogTraits], Awaitable[str]],
    ) -> bool:
        """Have a drive audited if its watchdog has changed; False: that could not be seen."""
        name = drive.name
        try:
            change = await changed(drive, *watched)
        except LecombusError as exc:
            logger.debug("drive=%s event=not-rechecked reason=%s", name, exc)
            return False
        if not change:
            return True
        if self._watched(self._requests.drives.find(name)) != watched:
            return False
        logger.warning("drive=%s event=watchdog-changed reason=%s", name, change)
        drive.audit.watchdog = None  # what was known is not so: both codes are read
        self._health.doubted(drive, f"its watchdog was changed {change}: to be audited")
        return True


class AuditError(LecombusError):
    """What a drive says in its audit makes no sense or may be another's, or a write was ended."""


def number(value: Value) -> float:
    """The number a watchdog setting holds; nonsense from a drive is an audit that failed."""
    found = value.quantity
    if found is None:
        raise AuditError(f"the drive gives {value.raw!r} where a number was expected")
    return float(found)


def describe(traits: WatchdogTraits, setting: WatchdogSetting) -> str:
    """Put a setting into words."""
    action = traits.action_of(setting.action) or f"action {setting.action}"
    return "off" if action == "none" else f"{action} after {setting.time_s:g} s"
