"""A device of another maker that speaks the telegrams: counters, converters, displays.

Strategy: codes 0..255 hold any decimal number, with standard addressing only and nothing behind
them. Two of such a device's habits can be set: a bad write is answered by NAK or by nothing.
"""

from __future__ import annotations

from typing import ClassVar, Final

from ..model import Model
from ..parameters import Kept, Spec, d, s

__all__ = ["Generic"]

_IDENTITY: Final = 200


class Generic(Model):
    """A device without a description."""

    family: ClassVar[str] = "generic"
    standard_only: ClassVar[bool] = True
    banked: ClassVar[bool] = False

    def __init__(self) -> None:
        specs: list[Spec] = [
            d(number, "0", ("-214748.3648", "214748.3647"), decimals=4, kept=Kept.DRIVE)
            for number in range(256)
            if number != _IDENTITY
        ]
        super().__init__((*specs, s(_IDENTITY, "COUNTER 1.0")))

    def think_s(self, number: int, *, write: bool, now_s: float) -> float:
        """No manual speaks for it: 20 ms."""
        return 0.020
