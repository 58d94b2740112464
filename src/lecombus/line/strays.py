"""Bytes that come when nobody was asked: old answers, noise, somebody else on the line.

They are never used as values. A whole read answer that was in doubt tells that the doubt is over:
the late one has come, and its like may be asked for again.
"""

from __future__ import annotations

from ..protocol.parser import AnswerParser
from ..protocol.telegrams import (
    BadAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from .doubts import Doubts

__all__ = ["Strays"]


class Strays:
    """Listens between exchanges.

    Args:
        doubts: Told when a late answer has come.
    """

    def __init__(self, doubts: Doubts) -> None:
        self._doubts = doubts
        self._parser = AnswerParser(parity=True)
        self._parity = True
        self.bytes_total = 0
        self.late_answers_total = 0

    @property
    def parity(self) -> bool:
        """Whether bytes carry even parity in bit 7."""
        return self._parity

    @parity.setter
    def parity(self, value: bool) -> None:
        self._parity = value
        self._parser = AnswerParser(parity=value)

    def begin(self) -> None:
        """Listen anew: an exchange has just been given up."""
        self._parser.reset()

    def feed(self, data: bytes) -> bool:
        """Take bytes nobody asked for.

        Args:
            data: The bytes, parity bits included.

        Returns:
            Whether they completed a whole old answer.
        """
        self.bytes_total += len(data)
        answer = self._parser.feed(data)
        if answer is None:
            return False
        self._parser.reset()
        if isinstance(answer, BadAnswer):
            return False
        self.late_answers_total += 1
        if isinstance(answer, ValueAnswer | UnknownCodeAnswer | TransmissionErrorAnswer):
            self._doubts.resolve(answer.field)
        return True
