"""The supervisor: audits every drive's watchdog, sets it where the roster wants that, feeds it.

What its user sees: after the start, and whenever a drive or the line comes back, each drive is
audited before it is called online. A 2102 module forgets its watchdog's settings with its supply
(EDB2102EN 6.3), so this is not a formality. Asked before it is online: is it there at all; what is
its control word, which a quick stop needs; may it be written to (`write_prechecks`); what is its
watchdog set to, and does the roster want something else (`watchdogs`). Asked afterwards, when the
line has time: what need not be waited for.

Feeding itself is the schedule's: the supervisor says which drive must be spoken to how often
(`Schedule.set_feeding`), and the schedule finds the telegram, mostly one that was due anyhow. It
begins with the roster's time at the start, before the audit: after a restart of lecombus the
drives' watchdogs are already running. A multicast never counts as feeding.

The supervisor's task cannot end silently: it lives in the daemon's root task group, and an error in
it ends the daemon, which the service manager starts again.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager

import anyio

from lecombus.drive_state.drive_runtime import Drive, RunningAudit
from lecombus.drive_state.motion import learnt_setpoint
from lecombus.drive_state.readings import DriveState
from lecombus.drive_state.store import Store
from lecombus.drives import WatchdogTraits
from lecombus.errors import LecombusError, RefusedError
from lecombus.fieldbus.requests import Station
from lecombus.operations.awaited_requests import Requests, is_of_the_line
from lecombus.operations.facade import Operations
from lecombus.schedule import Priority, WatchdogFeeding
from lecombus.supervision.health import Health
from lecombus.supervision.watchdogs import PATIENCE_S, Rechecks, WatchdogAudit
from lecombus.supervision.write_prechecks import WritePrechecks

__all__ = ["DriveSupervisor"]

logger = logging.getLogger(__name__)

FIRST_RETRY_S = 1.0
LONGEST_RETRY_S = 30.0

SETTLED_MOST = 3
"""So often a watchdog is put in order in one audit, where its drive is silent for a while each
time; `Rechecks` finds one that was lost all the same."""

SLOW_S = 0.1
"""Watchdogs whose codes take longer than this to read are audited one after the other."""


class DriveSupervisor:
    """Keeps the watchdogs of one line.

    Args:
        requests: Sends requests and waits for their end.
        store: Gets the remarks.
        health: Has the audits that were asked for, and takes the end of each.
        operations: Knows the drives' identities and which were moved to another address.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        health: Health,
        operations: Operations,
        clock: Callable[[], float],
    ) -> None:
        self._requests = requests
        self._drives = requests.drives
        self._clock = clock
        self._health = health
        self._watchdogs = WatchdogAudit(requests, store, self._feed, operations.actions.wrote)
        self._prechecks = WritePrechecks(
            requests, store, operations.identities, operations.readdressing
        )
        self._rechecks = Rechecks(requests, store, self._watchdogs, health)
        self._one_at_a_time = anyio.Lock()

    async def run(self) -> None:
        """Make the audits that are asked for, until the daemon ends.

        Subscribers of line events only request audits: they cannot await, so this task makes them.
        """
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._rechecks.run)
            while True:
                for drive, audit in await self._health.audits.next():
                    tasks.start_soon(self._audit_within, drive, audit)

    def begin(self, drive: Drive) -> None:
        """Feed a drive by the roster's watchdog until the audit knows more."""
        if drive.entry.watchdog is not None:
            self._feed(drive, drive.entry.watchdog.time_s)

    async def _audit_within(self, drive: Drive, audit: RunningAudit) -> None:
        """Audit a drive for as long as it is the drive it was: a reload cancels its audit."""
        with anyio.CancelScope() as audit.scope:
            if audit.cancelled:
                return
            await self._audit_until_done(drive, audit)
        if drive.audit.running is audit:
            drive.audit.running = None

    async def _audit_until_done(self, drive: Drive, running: RunningAudit) -> None:
        """Audit one drive, again and again until it is done or the drive is offline.

        Failures are waited out longer and longer, until there is news such as a line reopened.
        """
        delay_s = FIRST_RETRY_S
        while self._drives.find(drive.name) is drive:
            drive.audit.again = False
            running.asked_again.clear()
            try:
                await self._audit(drive)
            except LecombusError as exc:
                self._audit_failed(drive, exc)
                if drive.health.state is DriveState.OFFLINE:
                    return
                await anyio.sleep(FIRST_RETRY_S)
                with anyio.move_on_after(delay_s - FIRST_RETRY_S):
                    await running.asked_again.wait()
                is_news = running.asked_again.is_set()
                delay_s = FIRST_RETRY_S if is_news else min(2.0 * delay_s, LONGEST_RETRY_S)
            else:
                if not drive.audit.again:
                    self._health.audited(drive)
                    self._prechecks.passed(drive)
                    with anyio.CancelScope() as running.learning:
                        await self._learn_the_rest(drive)
                    running.learning = None
                if not drive.audit.again:
                    return

    async def _audit(self, drive: Drive) -> None:
        """Audit one drive once.

        All of it is done with all drives in parallel where it is quick. Where reading a module's
        own codes takes up to 500 ms each, their watchdogs are audited one after the other.
        """
        if drive.health.state is not DriveState.DEGRADED:
            drive.audit.anew = True  # it may be another device: look at everything again
        station = drive.station
        try:
            await self._contact(station)
        finally:
            drive.audit.tried = True
        await self._examine(
            drive, self._one_at_a_time if is_slow(station) else contextlib.nullcontext()
        )

    async def _contact(self, station: Station) -> None:
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

    async def _examine(self, drive: Drive, turn: AbstractAsyncContextManager[object]) -> None:
        """Find out what is at the other end and put its watchdog in order.

        Who it is is asked of all drives in parallel: one audit alone has a request waiting only
        now and then, and the cyclic reads take the line's time between. Where answers come twice
        it is asked of one after the other: a neighbour's answer to the same question would fit. Its
        watchdog takes two turns: what it does is looked at before any drive's is set, because one
        that is off needs no feeding, and with less to feed setting them goes faster.

        Args:
            drive: The drive.
            turn: Entered for each turn.

        Raises:
            LecombusError: It could not be finished.
        """
        seen_s, station = self._clock(), self._requests.station(drive.name)
        if not self._requests.may_be_anothers():
            station = await self._identify(drive)
        if self._requests.may_be_anothers():  # also if that has shown only now
            async with self._one_at_a_time:
                seen_s = self._clock()
                station = await self._identify(drive)
        traits = station.family.watchdog
        if traits is None or drive.entry.watchdog is None:
            return
        async with turn:
            if drive.lasting.restarted_s >= seen_s:
                seen_s = self._clock()
                station = await self._identify(drive)
            action = await self._watchdogs.look(drive, station, traits)
        if action is not None:
            async with turn:
                await self._settle(drive, station, traits, action, seen_s)

    async def _identify(self, drive: Drive) -> Station:
        """See who a drive is, and learn how it is to be spoken to and stopped.

        Raises:
            LecombusError: It could not be finished.
        """
        station = self._requests.station(drive.name)
        station = await self._prechecks.check_addressing(drive, station)
        await self._learn_words(station)
        known = await self._prechecks.check_identity(drive, station)
        gate = station.family.software
        if gate is not None:
            await self._prechecks.check_software(drive, station, gate, known.get(gate.code))
        return station

    async def _settle(
        self,
        drive: Drive,
        station: Station,
        traits: WatchdogTraits,
        action: int | None,
        seen_s: float,
    ) -> None:
        """Put a watchdog in order, by what it does now.

        A drive that was silent since it was looked at may be another device, and a module that
        lost its supply has its action back at 0.

        Args:
            drive: The drive.
            station: How it is spoken to.
            traits: How its watchdog is set.
            action: What its watchdog did when it was looked at; None: that cannot be seen.
            seen_s: When it was looked at who it is, monotonic seconds.
        """
        for _ in range(SETTLED_MOST):
            if drive.lasting.restarted_s >= seen_s:
                seen_s = self._clock()
                station = await self._identify(drive)
                action = await self._watchdogs.look(drive, station, traits)
            if action is None:
                return
            await self._watchdogs.settle(drive, station, traits, action)
            if drive.lasting.restarted_s < seen_s:
                return

    async def _learn_words(self, station: Station) -> None:
        """Read the control word, and before it the code that decides what its bits mean.

        A quick stop changes one bit of the control word and must not wait for reading it first;
        of a drive without that code it is an inhibit.
        """
        family = station.family
        stops = {rule.code for rule in family.stops.values() if rule.value is None}
        codes = filter(None, (family.configured_by, *stops))
        await self._requests.read_known(station, codes, timeout_s=PATIENCE_S)

    async def _learn_the_rest(self, drive: Drive) -> None:
        """Read when the line has time what a drive need not be kept from work for.

        A watchdog that the roster does not name is looked at, so that its user learns of it; and
        whether the module answers writes early (C1921), until when it is taken to do so.
        """
        station, family = drive.station, drive.family
        try:
            if drive.entry.watchdog is None and family.watchdog is not None:
                await self._watchdogs.learn(drive.name, station, family.watchdog)
            # The setpoint is shown beside the speed; `configurations` takes what C1921 brings.
            for code in filter(None, (learnt_setpoint(family), family.shortened_code)):
                await self._requests.read(station, code, Priority.BACKGROUND, timeout_s=PATIENCE_S)
        except LecombusError as exc:
            if not is_of_the_line(exc):
                logger.info("drive=%s event=not-learnt reason=%s", drive.name, exc)

    def _audit_failed(self, drive: Drive, exc: LecombusError) -> None:
        self._health.audit_failed(drive, str(exc))
        # `port-lost` or `line-silent` says it once for all drives, `state` for one.
        if not is_of_the_line(exc) and drive.health.heard:
            logger.info("drive=%s event=audit-failed reason=%s", drive.name, exc)

    def _feed(self, drive: Drive, time_s: float | None) -> None:
        feeding = None
        if time_s is not None:
            feeding = WatchdogFeeding(time_s, self._requests.feed_maker(drive.name))
        self._requests.worker.schedule.set_feeding(drive.name, feeding, self._clock())


def is_slow(station: Station) -> bool:
    """Whether a drive's audit takes line time that others notice."""
    traits = station.family.watchdog
    return (
        traits is not None and station.family.answer_time_s(traits.time_code, write=False) > SLOW_S
    )
