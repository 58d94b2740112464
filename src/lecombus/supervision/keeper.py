"""The keeper: audits every drive's watchdog, arms it where the roster says so, keeps it fed.

What its user sees: after the start, and whenever a drive or the line comes back, each drive is
audited before it is called online. The audit reads what the drive's own watchdog is set to and
compares it with the roster. Where the roster says `configure: true` the setting is written and
read back; otherwise the difference stands as a remark on the drive until it is gone. A 2102
module forgets these settings with its supply (EDB2102EN 6.3), so this is not a formality.

Feeding itself is the schedule's: the keeper says which drive must be spoken to how often
(`Schedule.set_feeding`), and the schedule finds the telegram, mostly one that was due anyhow. It
begins with the roster's time at the start, before the audit: after a restart of lecombus the
drives' watchdogs are already running. A multicast never counts as feeding.

The keeper's task cannot end silently: it lives in the daemon's root task group, and an error in
it ends the daemon, which the service manager starts again.

What must not live here: telegrams, time-outs, who goes first.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
from collections.abc import Callable
from dataclasses import dataclass

import anyio
from anyio.abc import TaskGroup

from lecombus.config import DriveEntry
from lecombus.drives import SoftwareGate, WatchdogTraits
from lecombus.errors import LecombusError, OperationError, RefusedError, UnknownCodeError
from lecombus.line.station import Station
from lecombus.operations.requests import Requests
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.readings import WRITE_LOCK, DriveState
from lecombus.schedule import Feeding, Outcome, Priority, Schedule
from lecombus.store import Store
from lecombus.supervision.health import Health

__all__ = ["Keeper", "WatchdogSetting"]

logger = logging.getLogger(__name__)

FIRST_RETRY_S = 1.0
LONGEST_RETRY_S = 30.0
PATIENCE_S = 120.0
"""An audit's read may wait this long: at the start 31 modules with 500 ms each come before it."""

REMARK = "watchdog"

DOES_NOT_FIT = "does-not-fit"
"""A module's own code takes so long to read that others' watchdogs would lapse meanwhile."""


@dataclass(frozen=True, slots=True)
class WatchdogSetting:
    """What a drive's watchdog is set to.

    Args:
        time_s: After this long without a telegram it acts, seconds.
        action: What it does, as the drive's number for it; 0 is nothing.
    """

    time_s: float
    action: int


class Keeper:
    """Keeps the watchdogs of one line.

    Args:
        requests: Sends requests and waits for their end.
        schedule: Told which drives to feed.
        store: Gets the remarks.
        clock: Monotonic time, seconds.
        health: Told when a drive has been audited.
    """

    def __init__(
        self,
        requests: Requests,
        schedule: Schedule,
        store: Store,
        clock: Callable[[], float],
        health: Health,
    ) -> None:
        self._requests = requests
        self._schedule = schedule
        self._store = store
        self._clock = clock
        self._entries: dict[str, DriveEntry] = {}
        self._auditing: set[str] = set()
        self._again: set[str] = set()
        self._tasks: TaskGroup | None = None
        self._waiting: list[str] = []
        self._one_at_a_time = anyio.Lock()
        self._health = health
        self.tried: set[str] = set()

    async def run(self) -> None:
        """Audit whatever asks for it, for as long as the daemon lives."""
        async with anyio.create_task_group() as tasks:
            self._tasks = tasks
            for name in self._waiting:
                self.audit_soon(name)
            self._waiting.clear()
            try:
                await anyio.sleep_forever()
            finally:
                self._tasks = None

    def add_drive(self, entry: DriveEntry) -> None:
        """Keep a drive from now on: feed it by the roster's word until the audit knows more."""
        self._entries[entry.name] = entry
        if entry.watchdog is not None:
            self._feed(entry.name, entry.watchdog.time_s)

    def remove_drive(self, name: str) -> None:
        """Keep it no longer: nothing is sent to it on account of its watchdog."""
        self._entries.pop(name, None)
        self.tried.discard(name)

    def audit_soon(self, name: str) -> None:
        """Audit a drive; a drive under audit is audited once more when that has ended."""
        if self._tasks is None:
            self._waiting.append(name)
        elif name in self._auditing:
            self._again.add(name)
        else:
            self._auditing.add(name)
            self._tasks.start_soon(self._audit_until_done, name)

    async def _audit_until_done(self, name: str) -> None:
        """Audit one drive, again and again until it is done or the drive is offline.

        First contact is made with all at once. The rest goes drive by drive, because reading a
        module's own codes takes up to 500 ms each: so they come online one after the other.
        """
        delay_s = FIRST_RETRY_S
        try:
            while name in self._entries:
                self._again.discard(name)
                try:
                    station = self._requests.station(name)
                    await self._contact(name, station)
                    async with self._one_at_a_time:
                        await self._audit(self._entries[name], station)
                except LecombusError as exc:
                    self._audit_failed(name, exc)
                    if name not in self._entries or self._is_offline(name):
                        return
                    await anyio.sleep(delay_s)
                    delay_s = min(2.0 * delay_s, LONGEST_RETRY_S)
                else:
                    if name not in self._again:
                        self._health.audited(name)
                        await self._learn_the_rest(name)
                    if name not in self._again:
                        return
        finally:
            self._auditing.discard(name)

    def _is_offline(self, name: str) -> bool:
        return self._health.state(name) is DriveState.OFFLINE

    def _audit_failed(self, name: str, exc: LecombusError) -> None:
        if name in self._entries:
            self._health.audit_failed(name, str(exc))
        logger.info("drive=%s event=audit-failed reason=%s", name, exc)

    async def _contact(self, name: str, station: Station) -> None:
        """Any answer shows that the drive is there, also that it has no such code.

        One attempt only: at the start others' watchdogs are waiting behind an absent drive.
        """
        try:
            with contextlib.suppress(RefusedError):
                await self._requests.read(
                    station,
                    station.family.feed_code,
                    Priority.INTERACTIVE,
                    timeout_s=PATIENCE_S,
                    retries=0,
                )
        finally:
            self.tried.add(name)

    async def _audit(self, entry: DriveEntry, station: Station) -> None:
        """Find out what is at the other end and put its watchdog in order."""
        family = station.family
        for code in {rule.code for rule in family.stops.values() if rule.value is None}:
            with contextlib.suppress(UnknownCodeError):  # its quick stop will be an inhibit
                await self._read(station, code)
        if family.software is not None:
            await self._audit_software(entry, station, family.software)
        if family.watchdog is not None and entry.watchdog is not None:
            await self._audit_watchdog(entry, station, family.watchdog)

    async def _learn_the_rest(self, name: str) -> None:
        """What a drive need not be kept from work for: read when the line has time.

        A watchdog that the roster does not name is looked at, so that its user learns of it; and
        whether the module answers writes early (C1921), until when it is taken to do so.
        """
        entry, station = self._entries[name], self._requests.station(name)
        try:
            if entry.watchdog is None and station.family.watchdog is not None:
                traits = station.family.watchdog
                found = await self._read_setting(station, traits, Priority.BACKGROUND)
                self._remark_unwanted(name, traits, found)
            if station.family.shortened_code is not None:
                await self._learn_response(station, station.family.shortened_code)
        except LecombusError as exc:
            logger.info("drive=%s event=not-learnt reason=%s", name, exc)

    async def _learn_response(self, station: Station, code: Code) -> None:
        """With shortened response time on, a drive is left alone after each write."""
        value = await self._requests.read(station, code, Priority.BACKGROUND, timeout_s=PATIENCE_S)
        hold_s = station.family.hold_after_write_s if value.number == 1 else 0.0
        if hold_s != station.hold_s:
            self._requests.replace_station(dataclasses.replace(station, hold_s=hold_s))

    async def _audit_software(
        self, entry: DriveEntry, station: Station, gate: SoftwareGate
    ) -> None:
        """A drive whose software the manual does not vouch for is read, and never written to."""
        found = await self._read(station, gate.code)
        accepted = (*gate.versions, *entry.accept_software)
        known = any(found.raw == one or found.means_same(Value.parse(one)) for one in accepted)
        text = None
        if not known:
            text = (
                f"{gate.code} reads software {found.raw}, the manual's codes are those of "
                f"{', '.join(gate.versions)}: nothing is written to this drive but stops; if its "
                f"manual says the same codes, add accept_software: ['{found.raw}'] in the roster"
            )
            logger.warning("drive=%s event=software-unknown reason=%s", entry.name, text)
        self._store.note(entry.name, WRITE_LOCK, text)

    async def _audit_watchdog(
        self, entry: DriveEntry, station: Station, traits: WatchdogTraits
    ) -> None:
        try:
            found = await self._read_setting(station, traits)
        except UnknownCodeError as exc:
            self._store.note(entry.name, REMARK, f"its watchdog cannot be seen: {exc}")
            return
        except OperationError as exc:
            if exc.kind != DOES_NOT_FIT:
                raise
            self._store.note(entry.name, REMARK, f"its watchdog cannot be checked: {exc}")
            return
        wanted = entry.watchdog
        assert wanted is not None
        target = WatchdogSetting(wanted.time_s, traits.actions[wanted.action])
        locked = WRITE_LOCK in self._store.drive(entry.name).remarks
        if found != target and wanted.configure and not locked:
            logger.info(
                "drive=%s event=watchdog-configure from=%s to=%s",
                entry.name, describe(traits, found), describe(traits, target),
            )  # fmt: skip
            proven = await self._write(station, traits.time_code, target.time_s * 1000.0)
            proven &= await self._write(station, traits.action_code, target.action)
            found = target if proven else await self._read_setting(station, traits)
        self._settle(entry.name, traits, found, target)

    def _settle(
        self, name: str, traits: WatchdogTraits, found: WatchdogSetting, target: WatchdogSetting
    ) -> None:
        """Feed by what the drive really has, and say where that differs from the roster."""
        if found == target:
            self._store.note(name, REMARK, None)
        else:
            text = (
                f"the drive's watchdog is {describe(traits, found)}, the roster says "
                f"{describe(traits, target)}: set configure: true, or {traits.time_code} and "
                f"{traits.action_code} in the drive"
            )
            self._store.note(name, REMARK, text)
            logger.warning("drive=%s event=watchdog-differs reason=%s", name, text)
        armed = found.action != 0 and found.time_s > 0.0
        self._feed(name, found.time_s if armed else target.time_s)

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
        return await self._requests.read(station, code, priority, timeout_s=PATIENCE_S)

    async def _write(self, station: Station, code: Code, value: float) -> bool:
        """Write and read back; what did not take shows when the setting is read again."""
        wire = Value.decimal(round(value))
        outcome, reason = await self._requests.write(station, code, wire, verify=True)
        if outcome is not Outcome.VERIFIED:
            logger.warning(
                "drive=%s code=%s event=watchdog-not-set value=%s outcome=%s reason=%s",
                station.name, code, wire.raw, outcome, reason,
            )  # fmt: skip
        return outcome is Outcome.VERIFIED

    def _feed(self, name: str, time_s: float) -> None:
        self._schedule.set_feeding(
            name, Feeding(time_s, self._requests.feed_maker(name)), self._clock()
        )


class KeeperError(LecombusError):
    """A drive says something about its watchdog that makes no sense."""


def number(value: Value) -> float:
    """The number a watchdog setting holds; nonsense from a drive is an audit that failed."""
    found = value.number
    if isinstance(found, str | bytes):
        raise KeeperError(f"the drive gives {value.raw!r} where a number was expected")
    return float(found)


def describe(traits: WatchdogTraits, setting: WatchdogSetting) -> str:
    """Put a setting into words."""
    words = {value: word for word, value in traits.actions.items()}
    action = words.get(setting.action, f"action {setting.action}")
    return "off" if action == "none" else f"{action} after {setting.time_s:g} s"
