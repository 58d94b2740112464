"""Which signal configuration each drive has, and so what the bits of its words mean.

On a 93XX most bits of C0135 and C0150 mean what the signal configuration C0005 makes of them. It
is read at every audit; until it is known, and whenever it was written and not yet read again, a
drive is taken by what holds for every configuration. Once known it is kept while the drive is
away: the audit that brings the drive back reads it anew.

Strategy: as in `fault_watch`, no task and no timer: `seen` is told every value read and `written`
every write, and both cost one look-up where a drive's family has no configurations.
Source: EDB2102EN 8.2 (C0135, C0150).
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from lecombus.drives import Family
from lecombus.errors import LecombusError
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.schedule import Outcome, Settle

__all__ = ["Configurations"]

logger = logging.getLogger(__name__)


class Configurations:
    """Tells whoever works with a drive's words which family they follow.

    Args:
        change: Told that a drive is to be taken by another description of its family.
        ask: Reads a code of a drive now; raises a `LecombusError` where that cannot be asked.
    """

    def __init__(
        self, change: Callable[[str, Family], None], ask: Callable[[str, Code, Settle], None]
    ) -> None:
        self._change = change
        self._ask = ask
        self._families: dict[str, Family] = {}
        self._codes: dict[str, Code] = {}

    def watch(self, drive: str, family: Family) -> None:
        """Follow a drive from now on; its configuration is not known yet."""
        self.forget(drive)
        if family.configured_by is not None:
            self._families[drive] = family
            self._codes[drive] = family.configured_by

    def forget(self, drive: str) -> None:
        """The drive has left the roster."""
        self._families.pop(drive, None)
        self._codes.pop(drive, None)

    def seen(self, drive: str, code: Code, value: Value) -> None:
        """Take a value that was read."""
        if self._codes.get(drive) == code:
            number = value.number
            whole = not isinstance(number, str | bytes) and number == int(number)
            self._take(drive, int(number) if whole else None)

    def written(self, drive: str, code: Code) -> None:
        """Take note that a code was written: whether it took is known when it is read."""
        if self._codes.get(drive) != code:
            return
        self._take(drive, None)
        try:
            self._ask(drive, code, ignore)
        except LecombusError as exc:
            logger.info("drive=%s event=configuration-not-asked reason=%s", drive, exc)

    def _take(self, drive: str, number: int | None) -> None:
        known = self._families[drive]
        found = known.configured(number)
        if found is known:
            return
        self._families[drive] = found
        logger.info(
            "drive=%s event=configuration code=%s from=%s to=%s",
            drive, self._codes[drive], known.configuration or "any", found.configuration or "any",
        )  # fmt: skip
        self._change(drive, found)


def ignore(outcome: Outcome, reason: str) -> None:
    """What the read brings is told by `Configurations.seen`."""
