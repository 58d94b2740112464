"""What a quick stop has read of a drive: its control word, and whether it is inhibited.

Where answers come twice on the line, the word of another drive may come in the place of this
one's, with that one's direction and fixed speed: an answer carries no address. A word is this
drive's if no other drive was asked for the like lately, if it is as this drive's was known last,
but for an inhibit that has ended, or if two readings in a row agree, in two addressing forms where
the drive knows two.
"""

from __future__ import annotations

from typing import Final

from lecombus.drives.stops import inhibit_mask, inhibit_proofs, usable_word
from lecombus.fieldbus.requests import Station
from lecombus.parameters import AddressForm, Code, Value

from ..protocol.addressing import encode_code
from ..protocol.telegrams import ValueAnswer
from .late_answers import Duplicates

__all__ = ["LearntWord"]

MOST_READINGS: Final = 4
"""So often it is read until two readings agree."""


class LearntWord:
    """What was read for the telegram that comes next.

    Args:
        code: The control word's code.
        duplicates: What is known of answers that come twice on this line; None: there are none.

    Attributes:
        word: The control word; None: it was not read.
        inhibited: Whether the drive is inhibited; None: that was not read.
    """

    def __init__(self, code: Code, duplicates: Duplicates | None) -> None:
        self.word: int | None = None
        self.inhibited: bool | None = None
        self._code = code
        self._duplicates = duplicates
        self._before: tuple[bytes, int] | None = None  # field and word of the reading before
        self._readings = 0

    @property
    def is_there(self) -> bool:
        """Whether anything was read."""
        return self.word is not None or self.inhibited is not None

    def take(self, station: Station, code: Code, value: Value) -> bool:
        """Keep a value that the next telegram needs; False: it is no such value."""
        if code == self._code:
            self.word = usable_word(value.word)
            return self.word is not None
        self.inhibited = inhibit_proofs(station.family)[code].shown_by(value)
        return self.inhibited is not None

    @property
    def may_be_asked_again(self) -> bool:
        """Whether another reading may still show whose it is."""
        return self._readings < MOST_READINGS

    def form(self, station: Station, code: Code) -> AddressForm | None:
        """Return the form to ask in: not that of the reading before; None: the station's first."""
        if self._before is None or code != self._code:
            return None
        forms = _forms(station, code)
        return next((one for one in forms if encode_code(code, one) != self._before[0]), None)

    def is_own(
        self, station: Station, code: Code, answer: ValueAnswer, asked_s: float, known: int | None
    ) -> bool:
        """Return whether a reading is this drive's; any but that of a control word is.

        Args:
            station: The drive.
            code: What was read.
            answer: The reading; what is no word is nobody's, and judged by `take`.
            asked_s: When it was asked for.
            known: The word as it was known last.
        """
        word, duplicates = usable_word(answer.value.word), self._duplicates
        if code != self._code or word is None or duplicates is None:
            return True
        if not duplicates.may_be_anothers(answer.field, station.name, asked_s):
            return True
        mask = inhibit_mask(station.family, code)
        if known is not None and not (known ^ word) & ~mask and not word & ~known & mask:
            return True  # an inhibit that only the reading has may be another drive's
        before, self._before = self._before, (answer.field, word)
        self._readings += 1
        if before is None or before[1] != word:
            return False
        return before[0] != answer.field or len(_forms(station, code)) == 1

    def forget(self) -> None:
        """Begin again: it was used, or is of no use any more."""
        self.word = self.inhibited = self._before = None
        self._readings = 0


def _forms(station: Station, code: Code) -> list[AddressForm]:
    return [form for form in station.forms if form.carries(code)]
