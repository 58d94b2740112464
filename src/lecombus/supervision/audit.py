"""What an audit is: the questions a drive is asked before it is called online, and after.

Asked before: is it there at all; does it answer what it is asked; what is its control word, which a
quick stop needs; is it to be written to (`write_prechecks`); what is its own watchdog set to, and
does the roster want something else (`watchdogs`). Asked after, when the line has time: what need
not be waited for.

When an audit is due, and what is fed until then, is the supervisor's.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager

from lecombus.drive_runtime import Drive
from lecombus.errors import LecombusError, RefusedError
from lecombus.fieldbus.station import Station
from lecombus.motion import learnt_setpoint
from lecombus.operations.requests import Requests, is_of_the_line
from lecombus.schedule import Priority
from lecombus.supervision.watchdogs import PATIENCE_S, WatchdogAudit
from lecombus.supervision.write_prechecks import WritePrechecks

__all__ = ["Audit"]

logger = logging.getLogger(__name__)

Turn = Callable[[], AbstractAsyncContextManager[object]]
"""Gives what is entered while the line is asked; slow drives are given the same lock."""


class Audit:
    """Asks drives the questions of an audit.

    Args:
        requests: Sends requests and waits for their end.
        prechecks: What decides whether a drive may be written to.
        watchdogs: Looks at the drives' watchdogs.
    """

    def __init__(
        self, requests: Requests, prechecks: WritePrechecks, watchdogs: WatchdogAudit
    ) -> None:
        self._requests = requests
        self._prechecks = prechecks
        self._watchdogs = watchdogs

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

    async def examine(self, drive: Drive, turn: Turn) -> None:
        """Find out what is at the other end and put its watchdog in order.

        In two turns: what a drive's watchdog does is looked at before any drive's is set, because
        one that is off needs no feeding, and with less to feed setting them goes faster.

        Args:
            drive: The drive.
            turn: Entered for each of the two; slow drives take turns.

        Raises:
            LecombusError: It could not be finished.
        """
        station = self._requests.station(drive.name)
        traits = station.family.watchdog if drive.entry.watchdog is not None else None
        action = None
        async with turn():
            station = await self._prechecks.check_addressing(drive, station)
            await self._learn_words(station)
            known = await self._prechecks.check_identity(drive, station)
            gate = station.family.software
            if gate is not None:
                await self._prechecks.check_software(drive, station, gate, known.get(gate.code))
            if traits is not None:
                action = await self._watchdogs.look(drive, station, traits)
        if action is not None and traits is not None:
            async with turn():
                await self._watchdogs.settle(drive, station, traits, action)

    async def _learn_words(self, station: Station) -> None:
        """Read the control word, and before it the code that decides what its bits mean.

        A quick stop changes one bit of the control word and must not wait for reading it first;
        of a drive without that code it is an inhibit.
        """
        family = station.family
        stops = {rule.code for rule in family.stops.values() if rule.value is None}
        codes = filter(None, (family.configured_by, *stops))
        await self._requests.read_known(station, codes, timeout_s=PATIENCE_S)

    async def learn_the_rest(self, drive: Drive, station: Station) -> None:
        """What a drive need not be kept from work for: read when the line has time.

        A watchdog that the roster does not name is looked at, so that its user learns of it; and
        whether the module answers writes early (C1921), until when it is taken to do so.
        """
        try:
            if drive.entry.watchdog is None and station.family.watchdog is not None:
                await self._watchdogs.learn(drive.name, station, station.family.watchdog)
            setpoint = learnt_setpoint(station.family)
            if setpoint is not None:  # what it was set to before is shown beside its speed
                await self._requests.read(
                    station, setpoint, Priority.BACKGROUND, timeout_s=PATIENCE_S
                )
            shortened = station.family.shortened_code
            if shortened is not None:  # what it brings is seen by `configurations`
                await self._requests.read(
                    station, shortened, Priority.BACKGROUND, timeout_s=PATIENCE_S
                )
        except LecombusError as exc:
            if not is_of_the_line(exc):
                logger.info("drive=%s event=not-learnt reason=%s", drive.name, exc)
