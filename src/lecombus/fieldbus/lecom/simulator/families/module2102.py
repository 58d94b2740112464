"""Drives behind a 2102 fieldbus module: what the module itself adds.

The default of a code is the setting the maker ships. Where the manual prints none, and for the
controllers' own codes that it only mentions, it is what such a drive commonly shows.

Source: EDB2102EN 6.2, 6.3, 8.2.
"""

from __future__ import annotations

from typing import ClassVar, Final

from ..model import Model, word_text
from ..parameters import Kept, Spec, d, s

__all__ = ["MODULE_SPECS", "RFG_STOP", "RFG_ZERO", "Module2102"]

RFG_STOP: Final = 0x0010
RFG_ZERO: Final = 0x0020
"""Bits of C0135 that act on the ramp generator. Source: EDB2102EN 8.2."""

MODULE_SPECS: Final[tuple[Spec, ...]] = (
    d(248, "0", (0, 255), kept=Kept.MODULE),
    d(249, "0", (0, 15), kept=Kept.MODULE),
    s(1810, "33S2102I_10000"),
    s(1811, "2000-05-02"),
    d(1920, "0", (0, 1), kept=Kept.MODULE),
    d(1921, "0", (0, 1), kept=Kept.MODULE),
    d(1922, "0", (0, 2), kept=Kept.MODULE),
    d(1923, "3000", (50, 65535), kept=Kept.MODULE),
    d(1962, "0"),
)
"""The module's own codes. The manual prints no default for C1923; 3000 ms stands in."""


class Module2102(Model):
    """A drive whose watchdog and start state live in a 2102 module."""

    start_code: ClassVar[int | None] = 1920
    watchdog_codes: ClassVar[tuple[int, ...]] = (1923, 1922)

    def _install(self) -> None:
        self.readers |= {
            40: lambda _: "0" if self.inhibited() else "1",
            43: lambda _: "1" if self.fault else "0",
            68: lambda _: word_text(self.operating_status()),
            135: lambda _: self.read_control_word(),
            150: lambda _: word_text(self.status_word()),
            1962: lambda _: str(int(self.extended_fault)),
        }
        self.writers |= {
            40: self.take_inhibit,
            43: lambda _: self.reset_fault(),
            135: self.write_control_word,
        }

    def operating_status(self) -> int:
        """C0068 of the family."""
        raise NotImplementedError

    def status_word(self) -> int:
        """C0150 of the family."""
        raise NotImplementedError

    def controller_state(self) -> int:
        """Bits 8..11 of C0150 of 821X, 822X, 8200 vector, 93XX. Source: EDB2102EN 8.2."""
        if self.fault:
            return 8
        if self.troubles.message:
            return 7
        return 3 if self.inhibited() else 6

    def shortened(self) -> bool:
        """Whether writes are acknowledged before they are done (C1921)."""
        return self.params.text(1921) == "1"
