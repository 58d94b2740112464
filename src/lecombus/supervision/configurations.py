"""What a drive is set to that decides how it is to be taken: two codes.

*Signal configuration.* On a 93XX most bits of C0135 and C0150 mean what the signal configuration
C0005 makes of them. It is read at every audit; until it is known, and whenever it was written and
not yet read again, a drive is taken by what holds for every configuration. Once known it is kept
while the drive is away: the audit that brings the drive back reads it anew.

*Shortened response time.* With C1921 = 1 a module acknowledges a write before it has passed it on,
and must be left alone meanwhile. Until it is known, and after it was written, it is taken to.

Strategy: as in `fault_watch`, no task and no timer: `seen` is told every value read and `written`
every write, and both cost one look-up where a drive's family has no such codes.
Source: EDB2102EN 8.2 (C0135, C0150), 6.3.2 (C1921).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Final

from lecombus.drives import Family
from lecombus.errors import LecombusError
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.schedule import Outcome, Settle

__all__ = ["Configurations"]

logger = logging.getLogger(__name__)

_NOTHING: Final[Mapping[Code, Callable[[str, int | None], None]]] = {}


class Configurations:
    """Tells whoever works with a drive how it is to be taken.

    Args:
        change: Told that a drive is to be taken by another description of its family.
        early: Told whether a drive acknowledges early; None: not known.
        ask: Reads a code of a drive now; raises a `LecombusError` where that cannot be asked.
        ask_later: The same when the line has time: half a second for a module's own code.
    """

    def __init__(
        self,
        change: Callable[[str, Family], None],
        early: Callable[[str, bool | None], None],
        ask: Callable[[str, Code, Settle], None],
        ask_later: Callable[[str, Code, Settle], None],
    ) -> None:
        self._change = change
        self._early = early
        self._ask = ask
        self._ask_later = ask_later
        self._families: dict[str, Family] = {}
        self._followed: dict[str, Mapping[Code, Callable[[str, int | None], None]]] = {}

    def watch(self, drive: str, family: Family) -> None:
        """Follow a drive from now on; nothing is known of it yet."""
        self.forget(drive)
        followed = {}
        if family.configured_by is not None:
            self._families[drive] = family
            followed[family.configured_by] = self._take_configuration
        if family.shortened_code is not None:
            followed[family.shortened_code] = self._take_response
        if followed:
            self._followed[drive] = followed

    def forget(self, drive: str) -> None:
        """The drive has left the roster."""
        self._families.pop(drive, None)
        self._followed.pop(drive, None)

    def seen(self, drive: str, code: Code, value: Value) -> None:
        """Take a value that was read."""
        take = self._followed.get(drive, _NOTHING).get(code)
        if take is not None:
            number = value.number
            whole = not isinstance(number, str | bytes) and number == int(number)
            take(drive, int(number) if whole else None)

    def written(self, drive: str, code: Code) -> None:
        """Take note that a code was written: whether it took is known when it is read."""
        take = self._followed.get(drive, _NOTHING).get(code)
        if take is None:
            return
        take(drive, None)
        known = self._families.get(drive)
        urgent = known is not None and known.configured_by == code
        try:
            (self._ask if urgent else self._ask_later)(drive, code, ignore)
        except LecombusError as exc:
            logger.info("drive=%s event=configuration-not-asked reason=%s", drive, exc)

    def _take_response(self, drive: str, number: int | None) -> None:
        self._early(drive, None if number is None else number == 1)

    def _take_configuration(self, drive: str, number: int | None) -> None:
        known = self._families[drive]
        found = known.configured(number)
        if found is known:
            return
        self._families[drive] = found
        logger.info(
            "drive=%s event=configuration code=%s from=%s to=%s",
            drive, found.configured_by, known.configuration or "any", found.configuration or "any",
        )  # fmt: skip
        self._change(drive, found)


def ignore(outcome: Outcome, reason: str) -> None:
    """What the read brings is told by `Configurations.seen`."""
