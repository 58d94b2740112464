"""The procedure: drive by drive to the new rate, and the way back.

A drive may send the acknowledgement of the write at its new rate already, so a missing one says
nothing (EDB2102EN 5), and one that came does not prove anything either. So

1. each drive is asked once more whether it is stopped, and is written to, once. Without an
   acknowledgement it is looked for at both rates, the old one first, before anything else is sent
   to it; only a drive that still holds the old rate is written to again, once (`WRITES`);
2. those that acknowledged are looked for at the new rate, and at the old one where they are not
   there; one that still holds the old rate is written to again;
3. found means: its baud code reads the rate, and its identity is the same as before;
4. the first drive that cannot be moved ends the writing: no other drive is moved, and the user
   decides whether the moved ones are brought back;
5. when all are moved, those whose family loses parameters at power-off save them (93XX).

The way back is the same with the rates exchanged, for all drives that are not at the old rate, but
one that fails does not end it.

Source: EDB2102EN 5 (C0125 over LECOM), 6.1.3 (C0003), 8.2; CMVLC401A 4.2 (P411).
"""

from __future__ import annotations

from collections.abc import Sequence

from lecombus.drives import saving_rule

from .checking import Obstacle, check, is_same_drive, standstill
from .drives import DrivePlace, InterruptedRebaudError, LineAccess, RebaudDrive, RebaudLine, Subject

__all__ = ["Rebaud"]

WRITES = 2
"""A rate is written to a drive so often at most: once, and once more when it did not take it."""

PAUSES_S = (0.0, 0.3, 1.0)
"""Before each round of looking for a drive at both rates: some take a moment."""


class Rebaud:
    """One change of a line's baud rate.

    Args:
        subjects: All drives of the line.
        old: The present baud rate, bit/s.
        new: The baud rate wanted, bit/s.

    Attributes:
        drives: What is known of each.
        line: The reads and writes; to be interrupted.
        obstacles: Why nothing may be written, after `check`.
    """

    def __init__(self, subjects: Sequence[Subject], old: int, new: int) -> None:
        self.drives = [RebaudDrive(one) for one in subjects]
        self.old = old
        self.new = new
        self.line = RebaudLine()
        self.obstacles: list[Obstacle] = []
        self._began_there: list[RebaudDrive] = []

    async def check(self, access: LineAccess) -> None:
        """Ask every drive whether the change may begin; changes nothing."""
        self.line.access = access
        try:
            self.obstacles = await check(self.line, self.drives, self.old, self.new)
        except InterruptedRebaudError:
            return
        for drive in self.drives:
            if drive.rate is not None:
                drive.be(DrivePlace.OLD if drive.rate == self.old else DrivePlace.NEW, drive.rate)
        self._began_there = [one for one in self.drives if one.place is DrivePlace.NEW]

    async def move(self, access: LineAccess) -> None:
        """Bring every drive to the new rate; to be called after a `check` without obstacles."""
        self.line.access = access
        try:
            await self._over()
            await self._confirm_all(self.old, self.new)
            if all(drive.place is DrivePlace.NEW for drive in self.drives):
                await self._save(self.drives, self.new)
        except InterruptedRebaudError:
            return

    async def back(self, access: LineAccess) -> None:
        """Bring every drive that is not at the old rate back to it, as far as possible."""
        self.line.access = access
        try:
            astray = [
                one for one in self.drives if one.place not in (DrivePlace.OLD, DrivePlace.UNSEEN)
            ]
            for drive in astray:
                await self._one_back(drive)
            await self._confirm_all(self.new, self.old)
            told = [one for one in self.drives if one in self._began_there or one.saved is not None]
            home = [one for one in told if one.place is DrivePlace.OLD]
            await self._save(home, self.old)
        except InterruptedRebaudError:
            return

    # ---- parts --------------------------------------------------------------------------------

    async def _over(self) -> None:
        """Write the new rate to one drive after the other, until one cannot be brought over."""
        for drive in self.drives:
            if drive.place is not DrivePlace.OLD:
                continue
            found = await standstill(self.line, drive, self.old)
            if found.obstacle:
                drive.why = f"nothing was written to it: it {found.obstacle}"
                return
            await self._carry(drive, self.old, self.new)
            if drive.place not in (DrivePlace.WRITTEN, DrivePlace.NEW):
                return

    async def _one_back(self, drive: RebaudDrive) -> None:
        """Write the old rate to a drive, wherever it is."""
        drive.writes = 0
        rate, number = self.new, drive.subject.number(self.new)
        if drive.place is not DrivePlace.NEW:
            found = await self._search(drive, self.old, self.new)
            if found is None:
                drive.be(DrivePlace.LOST, None, drive.why or "it answers at neither rate")
                return
            rate, number = found
        if (rate, number) == (self.old, drive.subject.number(self.old)):
            await self._settle(drive, self.old)
            return
        await self._carry(drive, rate, self.old)

    async def _confirm_all(self, here: int, there: int) -> None:
        """Look for those that were written to and not seen since; write once more where needed."""
        for drive in self.drives:
            if drive.place is not DrivePlace.WRITTEN:
                continue
            if (await self.line.read_rate(drive, there)) == drive.subject.number(there):
                await self._settle(drive, there)
            elif await self._was_not_taken(drive, here, there, "it acknowledged the write"):
                await self._carry(drive, here, there)
                if drive.place is DrivePlace.WRITTEN:
                    await self._was_not_taken(drive, here, there, "it acknowledged twice")

    async def _carry(self, drive: RebaudDrive, here: int, there: int) -> None:
        """Write a rate to a drive that answers at `here`; look for it if nothing comes back."""
        number = drive.subject.number(there)
        assert number is not None, "the rates were checked beforehand"
        while True:
            self.line.check_interruption()
            drive.be(DrivePlace.WRITTEN, drive.rate)
            drive.writes += 1
            written = await self.line.write(drive, here, drive.subject.code, number)
            if written.done:
                return
            if not (await self._was_not_taken(drive, here, there, written.text)):
                return

    async def _was_not_taken(self, drive: RebaudDrive, here: int, there: int, text: str) -> bool:
        """Find out where a drive is after a write, and whether it is to be written once more."""
        found = await self._search(drive, here, there)
        if found is None:
            told = f"{there} baud was written to it, and it answers at neither rate"
            drive.be(DrivePlace.LOST, None, told)
            return False
        rate, number = found
        if number == drive.subject.number(rate) == drive.subject.number(there):
            await self._settle(drive, rate)
            return False
        if number == drive.subject.number(there):
            told = f"it took {there} baud, but still answers at {rate}"
            drive.be(DrivePlace.PENDING, rate, told)
            return False
        if drive.writes < WRITES:
            return True
        place = DrivePlace.OLD if rate == self.old else DrivePlace.NEW
        drive.be(place, rate, f"it does not take {there} baud: {text}")
        return False

    async def _search(self, drive: RebaudDrive, first: int, second: int) -> tuple[int, int] | None:
        """Look for a drive at both rates; gives the rate and the number it holds."""
        for pause_s in PAUSES_S:
            if pause_s:
                await self.line.wait(second, pause_s)
            for rate in (first, second):
                number = await self.line.read_rate(drive, rate)
                if number is not None:
                    return rate, number
        return None

    async def _settle(self, drive: RebaudDrive, rate: int) -> None:
        """A drive was found at a rate that it holds: it must also be the same."""
        differs = await is_same_drive(self.line, drive, rate)
        if differs:
            drive.be(DrivePlace.LOST, None, f"something answers at {rate} baud, but {differs}")
        else:
            drive.be(DrivePlace.OLD if rate == self.old else DrivePlace.NEW, rate)

    async def _save(self, drives: Sequence[RebaudDrive], rate: int) -> None:
        """Make drives save what was written, where their family needs that."""
        for drive in drives:
            rule = saving_rule(drive.subject.family)
            if rule is None or rule.value is None:
                continue
            drive.saved = False
            written = await self.line.write(drive, rate, rule.codes[0], rule.value)
            drive.saved = written.done
            if not drive.saved:
                drive.why = f"it was told to save ({rule.codes[0]}) and did not say that it did"
