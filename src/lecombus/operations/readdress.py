"""Giving a drive another address, and following it there.

A drive that takes another address answers at it from then on, also perhaps the very write: nothing
says that it went well but the drive itself, found again. So this is done in steps, each of which
can still end well:

1. *before*: the roster allows it, no drive has the address, the drive is online, the one it should
   be, and is stopped, as far as it can say; the new address is silent when it is asked. What is
   about to be written is saved, which may take seconds: then the drive is asked once more whether
   it is stopped. Nothing was changed yet.
2. *the write*, once, never repeated blindly, and not behind a write that may let the drive run.
   Until all is over the drive is not enabled, nor its fault reset.
3. *after*: the new address is asked for its own address and identity. Found: the line follows,
   a drive that needs it gets the command to save, and a remark stands until the roster says the
   same.
4. *the way back*: not found there, the old address is asked. There with the old value: nothing has
   happened. There with the new value (it would move at its next start): the old is written back.
   Found at neither: that is said, with what to do, and stands as a remark that outlives the daemon.

A baud rate is not changed here: all drives of a line share it, and no daemon can feed those that
are at another. `lecombus rebaud` changes it, without a daemon (`lecombus.fieldbus.lecom.rebaud`).
Source: EDB2102EN 5 (C0009, C0125 over LECOM), 6.2.2, 8.3.4; CMVLC401A 4.2 (P410).
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import anyio

from lecombus.drive_state.drive_runtime import Drive
from lecombus.drive_state.readings import DriveState, rfc3339
from lecombus.drive_state.store import Store
from lecombus.drives import Family
from lecombus.drives.procedures import ask_standstill, text_of
from lecombus.drives.restore_rules import saving_rule
from lecombus.errors import (
    ExchangeError,
    LineError,
    NoReplyError,
    OperationError,
    ScheduleError,
)
from lecombus.fieldbus.protocols import find
from lecombus.fieldbus.requests import Station
from lecombus.leases import Use
from lecombus.operations.awaited_requests import IS_GONE, Requests, refuse_for_gone_client
from lecombus.operations.identities import Identities
from lecombus.operations.lease_operations import Leases
from lecombus.operations.operation_reports import WriteReport, stopped_first
from lecombus.parameters import Code, Value
from lecombus.saved_state import Moved, State
from lecombus.schedule import Outcome, Priority
from lecombus.schedule.request import CLIENT_GONE, LEASE_ENDED

__all__ = ["Readdress"]

logger = logging.getLogger(__name__)

MOVED = "address"
"""The remark on a drive whose address is not the roster's."""

PAUSES_S = (0.1, 0.4, 1.0, 2.0)
"""Before each look for the drive at its new address: some take a moment."""

TROUBLE = (ExchangeError, LineError, OperationError, ScheduleError)
"""What may come once the address was written: the outcome must not say that nothing was sent."""


class Readdress:
    """Changes addresses of the drives of one line.

    Args:
        requests: Sends requests and waits for their end.
        store: What is known; gets the remarks.
        state: Remembers where a drive was moved to.
        identities: Knows who the drives are.
        leases: Who may control them now.
        clock: Monotonic time, seconds.
        wall: The time of day, Unix seconds.
        follow: Makes the line speak to a drive at another address.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        state: State,
        identities: Identities,
        leases: Leases,
        clock: Callable[[], float],
        wall: Callable[[], float],
        follow: Callable[[str, int], None],
    ) -> None:
        self._requests = requests
        self._store = store
        self._state = state
        self._identities = identities
        self._leases = leases
        self._clock = clock
        self._wall = wall
        self._follow = follow
        self._drives = requests.drives
        self._following = False
        self._one_at_a_time = anyio.Lock()

    def roster_changed(self) -> None:
        """Say which of the roster's drives were moved elsewhere.

        While a drive is followed, its entry has its new address: its home stays where the
        roster's file has it.
        """
        for drive in self._drives:
            if not self._following:
                drive.home = drive.entry.address
            self._judge(drive)

    def seen_at_home(self, drive: Drive) -> None:
        """Note that a drive answers at the roster's address with the expected identity."""
        facts, address = self._state.drive(drive.name), drive.entry.address
        if facts.moved is not None and facts.moved.address != address:
            facts.moved = None
            self._state.touch()
            self._remark(drive.name, address, None)

    async def change(self, drive: str, address: int) -> WriteReport:
        """Give a drive another address and follow it there.

        Args:
            drive: The drive.
            address: 1..99, not ending in 0, of no drive.

        Returns:
            `verified`: it was found there. `refused`: nothing was changed. `unknown`: it was found
            nowhere; the reason says what is known.

        Raises:
            OperationError: It may not be done now; nothing was sent that changes anything.
            ExchangeError: The drive could not be asked whether it is stopped; nothing was changed.
            LineError: There is no line; nothing was changed.
        """
        async with self._one_at_a_time:
            station = self._requests.station(drive)
            with self._requests.alone(drive, "readdress"):
                return await self._change(drive, station, address)

    async def _change(self, drive: str, station: Station, address: int) -> WriteReport:
        """Take the steps, while nothing else may enable the drive."""
        lasting = self._drives.lasting(drive)
        stops, lifts = lasting.stops, lasting.lifts
        self._check(drive, station, address)
        await self._see_that_it_is_stopped(station)
        async with self._at(station, address) as there:
            await self._see_silence(drive, there)
            before = self._state.drive(drive).moved
            # Should lecombus end after the write, the next run must know of it.
            self._remember(drive, self._unseen(address))
            await self._state.save_now()
            try:
                held = await self._see_that_it_is_stopped(station)
                report = await self._write(drive, station, address, stops, lifts)
            except TROUBLE:
                self._put_back(drive, before)
                raise
            if report is not None:
                self._put_back(drive, before)
                return report
            found = await self._find(drive, there, address)
        if found:
            report = self._moved(drive, station, address, held)
            return await self._save(drive, report)
        report = await self._look_back(drive, station, address)
        if report.outcome is Outcome.REFUSED:  # it has its old address
            self._put_back(drive, before)
        return report

    async def _write(
        self, drive: str, station: Station, address: int, stops: int, lifts: int
    ) -> WriteReport | None:
        """Write the address once; None: the drive may have taken it."""
        lasting, is_gone = self._drives.lasting(drive), IS_GONE.get()

        def is_unwanted() -> bool:
            return lasting.lifts != lifts or (is_gone is not None and is_gone())

        self._check(drive, station, address)
        code = address_code(station.family)
        was_stopped = self._requests.stops_said(drive) != stops
        if was_stopped or self._requests.stopped_since_asked(drive):
            return stopped_first(drive, code)
        refuse_for_gone_client(drive)
        logger.warning("drive=%s event=readdress from=%d to=%d", drive, station.address, address)
        outcome, reason = await self._requests.write(
            station, code, Value.decimal(address), verify=False,
            lease_ended=self._leases.ended_check({drive: Use.SETTING}), is_gone=is_unwanted,
        )  # fmt: skip
        if reason == CLIENT_GONE and lasting.lifts != lifts:
            raise self._not_stopped(station, "may run: a write came that may have enabled it")
        if outcome is Outcome.SUPERSEDED:
            return stopped_first(drive, code)
        if outcome in (Outcome.DONE, Outcome.UNKNOWN):
            return None
        kind = "lease-lost" if reason.startswith(LEASE_ENDED) else "nak"
        kind = "client-gone" if reason == CLIENT_GONE else kind
        return WriteReport(drive, code, outcome, reason, kind=kind)

    # ---- before -----------------------------------------------------------------------------

    def _check(self, drive: str, station: Station, address: int) -> None:
        """See what can be seen without a telegram."""
        self._leases.check(drive, Use.SETTING)

        def refuse(text: str, kind: str, remedy: str) -> OperationError:
            code = str(address_code(station.family))
            return OperationError(text, kind=kind, drive=drive, code=code, remedy=remedy)

        if not find(station.family.protocol).is_address(address):
            text = f"{address} is not a drive's address"
            raise refuse(text, "bad-value", "1 to 99 without 10, 20 .. 90 would be right")
        other = next((one.name for one in self._drives if one.entry.address == address), None)
        if other is not None:
            text = f"{other} has address {address}" + (" already" if other == drive else "")
            raise refuse(text, "address-taken", "choose an address that no drive has")
        if not self._drives.get(drive).entry.allow_address_change:
            text = f"the roster does not let the address of {drive} be changed"
            remedy = "write `allow_address_change: true` for it, reload, and take it out afterwards"
            raise refuse(text, "not-permitted", remedy)
        info = self._store.drive(drive)
        if info.write_lock is not None:
            raise refuse(f"nothing is written to {drive}: {info.write_lock}", "locked", "")
        if info.state is not DriveState.ONLINE:
            text = f"{drive} is {info.state.value}: {info.reason}"
            raise refuse(text, "starting", "it is done with a drive that is online")

    async def _see_that_it_is_stopped(self, station: Station) -> str:
        """A drive that turns must be reachable all the time; gives what it says of its motion."""
        code = address_code(station.family)
        found = await ask_standstill(
            lambda asked: self._read(station, asked), station.family, code, "its address"
        )
        if not found.obstacle:
            return found.known
        raise self._not_stopped(station, found.obstacle, inhibited=found.inhibited)

    def _not_stopped(
        self, station: Station, obstacle: str, *, inhibited: bool = False
    ) -> OperationError:
        remedy = f"`lecombus inhibit {station.name}` first: while its address changes it cannot be "
        remedy += "stopped over the line"
        return OperationError(
            f"{station.name} {obstacle}",
            kind="not-stopped",
            drive=station.name,
            code=str(address_code(station.family)),
            remedy="wait until its motor has come to rest" if inhibited else remedy,
        )

    async def _see_silence(self, drive: str, there: Station) -> None:
        """Any answer at the new address, also a damaged one, is another device."""
        try:
            await self._read(there, there.family.feed_code, retries=1)
        except NoReplyError:
            return
        except ExchangeError:
            pass
        raise OperationError(
            f"something answers at address {there.address} already, and it is not in the roster",
            kind="address-taken",
            drive=drive,
            code=str(address_code(there.family)),
            remedy="choose another address, or take that device off the line",
        )

    # ---- after ------------------------------------------------------------------------------

    async def _find(self, drive: str, there: Station, address: int) -> bool:
        """Look for the drive at its new address: it must say so itself, and be the same."""
        for pause_s in PAUSES_S:
            await anyio.sleep(pause_s)
            try:
                if (await self._read(there, address_code(there.family))).number != address:
                    continue
                return await self._is_the_same(drive, there)
            except TROUBLE:
                continue
        return False

    async def _is_the_same(self, drive: str, there: Station) -> bool:
        for text, value in self._identities.report(drive).found.items():
            if text_of(await self._read(there, Code.parse(text))) != value:
                return False
        return True

    def _moved(self, drive: str, station: Station, address: int, held: str) -> WriteReport:
        self._remember(drive, Moved(address, rfc3339(self._wall()), confirmed=True))
        logger.warning("drive=%s event=readdressed from=%d to=%d", drive, station.address, address)
        self._following = True
        try:
            self._follow(drive, address)
        finally:
            self._following = False
        home = self._drives.get(drive).home
        text = f"it answers at address {address} now, and is the same drive (before: {held})"
        remedy = (
            f"write `address: {address}` for {drive} into the roster, then reload: until "
            f"then lecombus speaks to {address}, after a restart to {home} again"
        )
        if address == home:
            text, remedy = f"{text}; the roster says {home} too", ""
        return WriteReport(
            drive, address_code(station.family), Outcome.VERIFIED, text, remedy=remedy
        )

    async def _save(self, drive: str, report: WriteReport) -> WriteReport:
        """Make a drive save its address, where its family needs that: a 93XX."""
        station = self._requests.station(drive)
        rule = saving_rule(station.family)
        if rule is None or rule.value is None:
            return report
        try:
            outcome, reason = await self._requests.write_to_the_end(
                station, rule.codes[0], Value.decimal(rule.value), verify=False
            )
        except TROUBLE as exc:
            outcome, reason = Outcome.REFUSED, str(exc)
        if outcome is Outcome.DONE:
            return dataclasses.replace(report, reason=f"{report.reason}; it saved that")
        logger.warning("drive=%s event=readdress-unsaved reason=%s", drive, reason)
        text = f"{report.reason}; it was told to save that and did not say that it did ({reason})"
        unsaved = (
            f"save it at the drive ({rule.codes[0]} = {rule.value}): unsaved, it is at "
            f"the address that it had before when it is switched on again"
        )
        remedy = f"{unsaved}; {report.remedy}" if report.remedy else unsaved
        return dataclasses.replace(report, reason=text, remedy=remedy)

    async def _look_back(self, drive: str, station: Station, address: int) -> WriteReport:
        """Not at the new address: is it still at the old, and what does it hold there?"""
        code = address_code(station.family)
        try:
            async with self._at(station, station.address) as here:  # it may count as offline by now
                held = (await self._read(here, code)).number
            if held == station.address:
                text = f"it still answers at address {station.address}: nothing was changed"
                return WriteReport(drive, code, Outcome.REFUSED, text, kind="not-in-effect")
            outcome, reason = await self._requests.write_to_the_end(
                station, code, Value.decimal(station.address), verify=True
            )
        except TROUBLE as exc:
            return self._lost(drive, station, address, str(exc))
        if outcome is Outcome.VERIFIED:
            text = (
                f"it took {address} but still answers at {station.address}, so it would move at "
                f"its next start: {station.address} was written back"
            )
            remedy = "set the address at its keypad"
            return WriteReport(
                drive, code, Outcome.REFUSED, text, kind="not-in-effect", remedy=remedy
            )
        return self._lost(drive, station, address, f"writing it back ended {outcome}: {reason}")

    def _lost(self, drive: str, station: Station, address: int, why: str) -> WriteReport:
        self._remember(drive, self._unseen(address))
        logger.error(
            "drive=%s event=readdress-lost from=%d to=%d reason=%s",
            drive, station.address, address, why,
        )  # fmt: skip
        self._remark(drive, station.address, self._state.drive(drive).moved)
        return WriteReport(
            drive,
            address_code(station.family),
            Outcome.UNKNOWN,
            f"{address} was written to it, and it answers neither there nor at "
            f"{station.address} ({why})",
            kind="no-answer",
            remedy=f"switch it off and on, then look at its address at the keypad: with "
            f"{station.address} it comes back by itself, with {address} write `address: "
            f"{address}` into the roster and reload",
        )

    # ---- parts ------------------------------------------------------------------------------

    def _unseen(self, address: int) -> Moved:
        """Give what is kept of a drive that was written to and not found since."""
        return Moved(address, rfc3339(self._wall()), confirmed=False)

    def _remember(self, drive: str, moved: Moved | None) -> None:
        self._state.drive(drive).moved = moved
        self._state.touch()

    def _put_back(self, drive: str, before: Moved | None) -> None:
        """Nothing was changed; a reload may have made a remark of what was about to be."""
        self._remember(drive, before)
        found = self._drives.find(drive)
        if found is not None:
            self._judge(found)

    def _judge(self, drive: Drive) -> None:
        """Remark where a drive was moved to, unless the roster says the same."""
        facts = self._state.drive(drive.name)
        if facts.moved is not None and facts.moved.address == drive.home:
            facts.moved = None
            self._state.touch()
        self._remark(drive.name, drive.home, facts.moved)

    def _remark(self, drive: str, roster: int, moved: Moved | None) -> None:
        text = None
        if moved is not None and moved.confirmed:
            text = (
                f"it was moved to address {moved.address} at {moved.at}, the roster says {roster}: "
                f"write `address: {moved.address}` there and reload"
            )
        elif moved is not None:
            text = (
                f"{moved.address} was written as its address at {moved.at}, and it was not found "
                f"since, there or at {roster}: look at its address at the keypad"
            )
        self._store.note(drive, MOVED, text)

    @asynccontextmanager
    async def _at(self, station: Station, address: int) -> AsyncIterator[Station]:
        """A drive at another address, known to the schedule for a while under another name."""
        name = f"{station.name}@{address}"
        schedule = self._requests.worker.schedule
        schedule.add_drive(name)
        try:
            yield dataclasses.replace(station, name=name, address=address)
        finally:
            schedule.remove_drive(name, self._clock(), f"{name} is not looked for any more")

    async def _read(self, station: Station, code: Code, *, retries: int | None = None) -> Value:
        return await self._requests.read(station, code, Priority.INTERACTIVE, retries=retries)


def address_code(family: Family) -> Code:
    """Return the code that holds a drive's own address.

    Raises:
        OperationError: `not-writable`: none does.
    """
    code = find(family.protocol).address_code(family)
    if code is None:
        raise OperationError(
            f"no code of family {family.name} holds the address of a drive",
            kind="not-writable",
            remedy="set the address at the drive",
        )
    return code
