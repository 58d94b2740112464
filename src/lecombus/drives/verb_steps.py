"""The steps a verb is made of, as data: what is written, or which bits are changed.

Bits of the control word are named and never made into a word here: whoever carries a step out
takes the word as it is then, so that what somebody else wrote meanwhile is not undone.
"""

from __future__ import annotations

from dataclasses import dataclass

from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value

__all__ = ["BitsStep", "InhibitStep", "RestartStep", "VerbStep", "WriteStep"]


@dataclass(frozen=True, slots=True)
class WriteStep:
    """Write a code."""

    code: Code
    value: Value


@dataclass(frozen=True, slots=True)
class BitsStep:
    """Change bits of the control word as it is then.

    Args:
        code: The control word.
        set_mask: Bits set.
        clear_mask: Bits cleared.
        always: Write it also where the bits are so already.
    """

    code: Code
    set_mask: int = 0
    clear_mask: int = 0
    always: bool = False

    def applied(self, word: int) -> int:
        """Give the word with the bits changed."""
        return (word | self.set_mask) & ~self.clear_mask


@dataclass(frozen=True, slots=True)
class InhibitStep:
    """Inhibit the drive, as a stop is said and proven."""


@dataclass(frozen=True, slots=True)
class RestartStep(BitsStep):
    """Change bits whereupon the drive starts anew without an answer; wait until it is back."""


VerbStep = WriteStep | BitsStep | InhibitStep | RestartStep
