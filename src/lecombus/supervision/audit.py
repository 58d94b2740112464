"""What an audit is: the questions a drive is asked before it is called online, and after.

Asked before: is it there at all; what is its control word; is its software one that may be
written to; what is its own watchdog set to, and does the roster want something else. Where the
roster says `configure: true` what differs is written and read back; otherwise the difference
stands as a remark on the drive until it is gone. Asked after, when the line has time: what nobody
need wait for.

When an audit is due, and what is fed meanwhile, is the keeper's. Source: EDB2102EN 6.3
(C1920..C1923), CMVLC401A preface, 7.3.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass

from lecombus.config import DriveEntry
from lecombus.drives import SoftwareGate, WatchdogTraits
from lecombus.errors import LecombusError, OperationError, RefusedError, UnknownCodeError
from lecombus.line.station import Station
from lecombus.operations.requests import Requests
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.readings import WRITE_LOCK
from lecombus.schedule import Outcome, Priority
from lecombus.store import Store

__all__ = ["Audit", "AuditError", "WatchdogSetting"]

logger = logging.getLogger(__name__)

PATIENCE_S = 120.0
"""An audit's read may wait this long: at the start 31 modules with 500 ms each come before it."""

REMARK = "watchdog"

LEAST_FED_S = 0.05
"""A watchdog shorter than this (the 2102's least, EDB2102EN 6.3.3) cannot be kept on any line of
this kind; trying to would take the line from everybody else."""

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

    @property
    def armed(self) -> bool:
        """Whether it acts at all."""
        return self.action != 0 and self.time_s > 0.0


Turn = Callable[[], AbstractAsyncContextManager[object]]
"""Gives what is entered while the line is asked; slow drives are given the same lock."""


class Audit:
    """Asks drives the questions of an audit.

    Args:
        requests: Sends requests and waits for their end.
        store: Gets the remarks.
        feed: Told how often a drive must be spoken to, seconds; None: not on purpose.
    """

    def __init__(
        self, requests: Requests, store: Store, feed: Callable[[str, float | None], None]
    ) -> None:
        self._requests = requests
        self._store = store
        self._feed = feed
        self._known: dict[str, WatchdogSetting] = {}

    def forget(self, name: str) -> None:
        """It may be another device now: look at everything again."""
        self._known.pop(name, None)

    async def contact(self, station: Station) -> None:
        """Any answer shows that the drive is there, also that it has no such code.

        One attempt only: at the start others' watchdogs are waiting behind an absent drive.

        Raises:
            LecombusError: It is not there, or the line is not.
        """
        with contextlib.suppress(RefusedError):
            await self._requests.read(
                station,
                station.family.feed_code,
                Priority.INTERACTIVE,
                timeout_s=PATIENCE_S,
                retries=0,
            )

    async def examine(self, entry: DriveEntry, station: Station, turn: Turn) -> None:
        """Find out what is at the other end and put its watchdog in order.

        In two turns: what a drive's watchdog does is looked at before any drive's is set, because
        one that is off needs no feeding, and with less to feed setting them goes faster.

        Args:
            entry: What the roster says of the drive.
            station: The drive.
            turn: Entered for each of the two; slow drives take turns.

        Raises:
            LecombusError: It could not be finished.
        """
        family = station.family
        watched = family.watchdog is not None and entry.watchdog is not None
        async with turn():
            for code in {rule.code for rule in family.stops.values() if rule.value is None}:
                with contextlib.suppress(UnknownCodeError):  # its quick stop will be an inhibit
                    await self._read(station, code)
            if family.software is not None:
                await self._audit_software(entry, station, family.software)
            action = None
            if watched and family.watchdog is not None:
                action = await self._look(entry.name, station, family.watchdog)
        if action is not None and family.watchdog is not None:
            async with turn():
                with self._remarking(entry.name):
                    await self._audit_watchdog(entry, station, family.watchdog, action)

    async def learn_the_rest(self, entry: DriveEntry, station: Station) -> None:
        """What a drive need not be kept from work for: read when the line has time.

        A watchdog that the roster does not name is looked at, so that its user learns of it; and
        whether the module answers writes early (C1921), until when it is taken to do so.
        """
        try:
            if entry.watchdog is None and station.family.watchdog is not None:
                traits = station.family.watchdog
                found = await self._read_setting(station, traits, Priority.BACKGROUND)
                self._remark_unwanted(entry.name, traits, found)
            if station.family.shortened_code is not None:
                await self._learn_response(station, station.family.shortened_code)
        except LecombusError as exc:
            logger.info("drive=%s event=not-learnt reason=%s", entry.name, exc)

    async def _learn_response(self, station: Station, code: Code) -> None:
        """With shortened response time on, a drive is left alone after each write."""
        value = await self._requests.read(station, code, Priority.BACKGROUND, timeout_s=PATIENCE_S)
        hold_s = station.family.hold_after_write_s if value.number == 1 else 0.0
        if hold_s != station.hold_s:
            self._requests.replace_station(station, dataclasses.replace(station, hold_s=hold_s))

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

    async def _look(self, name: str, station: Station, traits: WatchdogTraits) -> int | None:
        """Read what the watchdog does; None: it cannot be seen, and a remark says so."""
        action: int | None = None
        with self._remarking(name):
            action = int(number(await self._read(station, traits.action_code)))
            if action == 0:
                self._feed(name, None)
        return action

    @contextlib.contextmanager
    def _remarking(self, name: str) -> Iterator[None]:
        """Make a remark of what can never be read, instead of asking for it for ever."""
        try:
            yield
        except UnknownCodeError as exc:
            self._store.note(name, REMARK, f"its watchdog cannot be seen: {exc}")
        except OperationError as exc:
            if exc.kind != DOES_NOT_FIT:
                raise
            self._store.note(name, REMARK, f"its watchdog cannot be checked: {exc}")

    async def _audit_watchdog(
        self, entry: DriveEntry, station: Station, traits: WatchdogTraits, action: int
    ) -> None:
        wanted = entry.watchdog
        assert wanted is not None
        target = WatchdogSetting(wanted.time_s, traits.actions[wanted.action])
        found = WatchdogSetting(
            await self._find_time(entry.name, station, traits, target, action), action
        )
        locked = WRITE_LOCK in self._store.drive(entry.name).remarks
        if found != target and wanted.configure and not locked:
            logger.info(
                "drive=%s event=watchdog-configure from=%s to=%s",
                entry.name, describe(traits, found), describe(traits, target),
            )  # fmt: skip
            found = await self._configure(station, traits, found, target)
        self._settle(entry.name, traits, found, target)

    async def _find_time(
        self,
        name: str,
        station: Station,
        traits: WatchdogTraits,
        target: WatchdogSetting,
        action: int,
    ) -> float:
        """Read the time, unless the action shows that nothing was lost since it was in order.

        A module that lost its settings with its supply has its action back at 0, and reading a
        module's own code keeps everybody else waiting for half a second.
        """
        if target.armed and action == target.action and self._known.get(name) == target:
            return target.time_s
        return number(await self._read(station, traits.time_code)) / 1000.0

    async def _configure(
        self,
        station: Station,
        traits: WatchdogTraits,
        found: WatchdogSetting,
        target: WatchdogSetting,
    ) -> WatchdogSetting:
        """Write what differs, the action last: until then an idle watchdog needs no feeding."""
        proven = True
        if found.time_s != target.time_s:
            proven &= await self._write(station, traits.time_code, target.time_s * 1000.0)
        self._feed(station.name, target.time_s)
        if found.action != target.action:
            proven &= await self._write(station, traits.action_code, target.action)
        return target if proven else await self._read_setting(station, traits)

    def _settle(
        self, name: str, traits: WatchdogTraits, found: WatchdogSetting, target: WatchdogSetting
    ) -> None:
        """Feed by what the drive really has, and say where that differs from the roster."""
        self._known[name] = found
        text = None
        if found != target:
            text = (
                f"the drive's watchdog is {describe(traits, found)}, the roster says "
                f"{describe(traits, target)}: set configure: true, or {traits.time_code} and "
                f"{traits.action_code} in the drive"
            )
            logger.warning("drive=%s event=watchdog-differs reason=%s", name, text)
        self._store.note(name, REMARK, text)
        self._feed(name, max(LEAST_FED_S, found.time_s if found.armed else target.time_s))

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


class AuditError(LecombusError):
    """A drive says something about its watchdog that makes no sense."""


def number(value: Value) -> float:
    """The number a watchdog setting holds; nonsense from a drive is an audit that failed."""
    found = value.number
    if isinstance(found, str | bytes):
        raise AuditError(f"the drive gives {value.raw!r} where a number was expected")
    return float(found)


def describe(traits: WatchdogTraits, setting: WatchdogSetting) -> str:
    """Put a setting into words."""
    words = {value: word for word, value in traits.actions.items()}
    action = words.get(setting.action, f"action {setting.action}")
    return "off" if action == "none" else f"{action} after {setting.time_s:g} s"
