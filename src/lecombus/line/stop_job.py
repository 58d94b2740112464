"""Saying a stop to one drive until it is known to have been taken.

A stop is repeated at once, for saying it twice does no harm, and is read back in the end: an
acknowledgement is not an effect. Source: EDB2102EN 8.2, 8.3.5; CMVLC401A 4.2.

What must not live here: who is stopped, and in what order (operations).
"""

from __future__ import annotations

from ..drives import (
    StopAction,
    confirm_codes,
    needs_control_word,
    stop_confirmed,
    stop_value,
)
from ..errors import ExchangeError
from ..protocol.exchange import Result, ResultKind
from ..protocol.telegrams import AckAnswer, ValueAnswer
from ..protocol.values import Value
from ..schedule.request import Outcome
from .failures import error_of
from .jobs import ReadJob
from .station import Station, Step, StepKind, Verdict

__all__ = ["StopJob"]


class StopJob:
    """Stop one drive: say it until it is acknowledged, then read back whether it took effect.

    A quick stop changes one bit of the control word. Where the word is not known it is read
    first; where it cannot be read the drive is inhibited instead, because a guessed word could
    start what was standing still.

    Args:
        station: The drive.
        action: How it shall stop.
        word: Its control word as last read or written; None when not known.
        retries: How often a failed attempt is repeated.
        said: The stop was already said by a multicast; begin with reading back.
    """

    __slots__ = (
        "_checking",
        "_learning",
        "action",
        "attempts",
        "error",
        "proof",
        "retries",
        "station",
        "step",
        "word",
    )  # fmt: skip

    def __init__(
        self,
        station: Station,
        action: StopAction,
        *,
        word: int | None,
        retries: int,
        said: bool = False,
    ) -> None:
        self.station = station
        self.action = action
        self.word = word
        self.retries = retries
        self.attempts = 0
        self.proof: Value | None = None
        self.error: ExchangeError | None = None
        self._checking: ReadJob | None = None
        needs_word = needs_control_word(station.family, action)
        self._learning = needs_word and word is None and not said
        if self._learning:
            self.step = Step(StepKind.READ, station.family.stops[action].code)
        elif said:
            self._check()
        else:
            self._say()

    def advance(self, result: Result) -> Verdict:
        """Go from learning the word to saying the stop, and on to its proof."""
        if result.kind is ResultKind.LOST:
            self.error = error_of(self.station, self.step, result, self.attempts + 1)
            return Outcome.UNKNOWN, str(self.error)
        if self._checking is not None:
            return self._checked(self._checking, result)
        if self._learning:
            return self._learnt(result)
        self.attempts += 1
        if type(result.answer) is AckAnswer:
            self.error = None
            return self._check()
        self.error = error_of(self.station, self.step, result, self.attempts)
        return None if self.attempts <= self.retries else self._check()

    @property
    def cut_outcome(self) -> Outcome | None:
        """A stop that was said and not proven is not known to have stopped anything."""
        return Outcome.UNKNOWN if self.attempts or self._checking is not None else None

    def _learnt(self, result: Result) -> Verdict:
        self._learning = False
        answer = result.answer
        if type(answer) is ValueAnswer and isinstance(answer.value.number, int):
            self.word = answer.value.number
        else:
            self.action = StopAction.INHIBIT
        return self._say()

    def _say(self) -> Verdict:
        self._checking = None
        code, value = stop_value(self.station.family, self.action, self.word)
        self.step = Step(StepKind.WRITE, code, value)
        return None

    def _check(self) -> Verdict:
        code = confirm_codes(self.station.family, self.action)[0]
        self._checking = ReadJob(self.station, code, self.retries)
        self.step = self._checking.step
        return None

    def _checked(self, checking: ReadJob, result: Result) -> Verdict:
        verdict = checking.advance(result)
        if verdict is None:
            return None
        self.proof, code = checking.value, checking.step.code
        if self.proof is None:
            self.error = checking.error
            return Outcome.UNKNOWN, f"{self.action} was said but not read back: {verdict[1]}"
        if stop_confirmed(self.station.family, self.action, code, self.proof):
            self.error = None
            return Outcome.VERIFIED, f"{self.action}: {code} reads {self.proof.raw}"
        if self.attempts <= self.retries:
            return self._say()
        return Outcome.REFUSED, f"{self.action} was said, but {code} reads {self.proof.raw}"
