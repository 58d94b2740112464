"""Drives behind a 2102 fieldbus module: what the module itself adds.

Source: EDB2102EN 6.2, 6.3, 8.2.
"""

from __future__ import annotations

from typing import ClassVar

from lecombus.fieldbus.lecom.simulator.model import INHIBIT, QSP, Model, word_text

__all__ = ["Module2102", "tens_digit"]


def tens_digit(number: int) -> int:
    """What C0068 shows of a fault number in bits 0..3: OH, 50, gives 5. Source: EDB2102EN 8.2."""
    return number // 10 % 10


class Module2102(Model):
    """A drive whose watchdog and start state live in a 2102 module."""

    watchdog_codes: ClassVar[tuple[int, ...]] = (1922, 1923)

    def start_word(self) -> int:
        """C1920: 0 quick stop, 1 controller inhibit. Source: EDB2102EN 6.3.1."""
        return INHIBIT if self.params.text(1920) == "1" else QSP

    def watchdog_setting(self) -> tuple[float, int]:
        """C1923 and C1922. Source: EDB2102EN 6.3.3."""
        return self.params.number(1923) / 1000.0, int(self.params.text(1922))

    def expire(self, action: int) -> None:
        """1 controller inhibit, 2 quick stop. Source: EDB2102EN 6.3.3."""
        self.control |= INHIBIT if action == 1 else QSP

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

    def shortened(self) -> bool:
        """Whether writes are acknowledged before they are done (C1921)."""
        return self.params.text(1921) == "1"
