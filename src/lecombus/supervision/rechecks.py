"""Looking now and then whether a drive that stays online has kept its watchdog's settings.

An audit follows silence. But a drive can lose its settings without ever being missed: an SMVector
is put back to its defaults at its keypad, a module that is seldom asked restarts between two reads.
Its watchdog is off from then on, and nothing on the line shows it.

Strategy: one drive after the other is asked in the background, each every five minutes, or as
seldom as keeps all of it to a hundredth of the line's time: a module's own codes take half a
second each. What differs makes the drive one to be audited, and that puts it in order, or says what
it is.

What must not live here: what the settings should be, and setting them (`watchdogs`).
Source: EDB2102EN 6.3 (kept without supply: nothing), CMVLC401A 7.3.
"""

from __future__ import annotations

import logging

import anyio

from lecombus.drive_runtime import Drive
from lecombus.drives import WatchdogTraits
from lecombus.errors import LecombusError
from lecombus.fieldbus.station import Station
from lecombus.operations.requests import Requests
from lecombus.readings import DriveState
from lecombus.supervision.health import Health
from lecombus.supervision.watchdogs import WatchdogAudit

__all__ = ["Rechecks"]

logger = logging.getLogger(__name__)

EVERY_S = 300.0
LINE_SHARE = 0.01


class Rechecks:
    """Asks the drives of one line.

    Args:
        requests: Sends requests and waits for their end.
        watchdogs: Knows what was set.
        health: Takes doubts about drives.
    """

    def __init__(
        self,
        requests: Requests,
        watchdogs: WatchdogAudit,
        health: Health,
    ) -> None:
        self._requests = requests
        self._watchdogs = watchdogs
        self._health = health

    async def run(self) -> None:
        """Go round for as long as the daemon lives."""
        while True:
            drives = [one for one in self._requests.drives if self._watched(one) is not None]
            pause_s = self._round_s(drives) / max(1, len(drives))
            for drive in drives:
                await anyio.sleep(pause_s)
                await self._look(drive.name)
            if not drives:
                await anyio.sleep(pause_s)

    def _round_s(self, drives: list[Drive]) -> float:
        """Give how long one round takes, seconds."""
        cost_s = 0.0
        for watched in filter(None, map(self._watched, drives)):
            station, traits = watched
            for code in (traits.time_code, traits.action_code):
                cost_s += self._requests.maker.cost_of_read_s(station, code)
        return max(EVERY_S, cost_s / LINE_SHARE)

    def _watched(self, drive: Drive | None) -> tuple[Station, WatchdogTraits] | None:
        """A drive that is online, and of whose watchdog the roster and an audit know."""
        if drive is None or drive.entry.watchdog is None or drive.audit.watchdog is None:
            return None
        traits = drive.family.watchdog
        if traits is None or drive.health.state is not DriveState.ONLINE:
            return None
        return drive.station, traits

    async def _look(self, name: str) -> None:
        """Ask one drive, if it is still one to be asked."""
        drive = self._requests.drives.find(name)
        watched = self._watched(drive)
        if drive is None or watched is None:
            return
        try:
            change = await self._watchdogs.changed(drive, *watched)
        except LecombusError as exc:
            logger.debug("drive=%s event=not-rechecked reason=%s", name, exc)
            return
        if change and self._watched(self._requests.drives.find(name)) == watched:
            logger.warning("drive=%s event=watchdog-changed reason=%s", name, change)
            self._health.doubted(drive, f"its watchdog was changed {change}: to be audited")
