"""What is said to a drive to get one request done: a read, a write with its proof, a stop.

A job is the part of a request that knows the protocol. The schedule carries it without looking
in; the worker asks it for the next step, runs that step as one exchange and gives it the result,
until the job says how the request ended. Between two steps of a job anything more urgent may run.

Rules held here (EDB2102EN 8.3.5; CMVLC401A 6):

* a read may be repeated, a limited number of times;
* a write whose acknowledgement did not come is read back first. Only a plain value is then
  written again; an edge, a step, a save is not: it may have happened;
* NAK is an answer and is not repeated;
* a stop is repeated at once, for saying it twice does no harm, and is read back in the end.

What must not live here: telegrams, time-outs, who goes first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from ..drives import Family, WriteClass
from ..errors import ExchangeError
from ..protocol.addressing import Code, Form
from ..protocol.exchange import Result, ResultKind
from ..protocol.telegrams import AckAnswer, ValueAnswer
from ..protocol.values import Value
from ..schedule.request import Outcome
from .failures import error_of

__all__ = [
    "Job",
    "MulticastJob",
    "ReadJob",
    "Station",
    "Step",
    "StepKind",
    "StopJob",
    "Verdict",
    "WriteJob",
]

Verdict = tuple[Outcome, str] | None
"""How a request ended and why, or None when another step is wanted."""


@dataclass(frozen=True, slots=True)
class Station:
    """A drive as the line sees it.

    Args:
        name: Its name in the roster.
        address: 1..99, not ending in 0; for a multicast the group address.
        family: Its description, with the roster's overrides applied.
        forms: The addressing forms it is spoken to in, the preferred first.
        hold_s: How long it is left alone after a write, seconds: with shortened response time
            (C1921 = 1) the module acknowledges before it has passed the value on.
    """

    name: str
    address: int
    family: Family
    forms: tuple[Form, ...]
    hold_s: float = 0.0


class StepKind(Enum):
    """What one exchange does."""

    READ = "read"
    WRITE = "write"
    MULTICAST = "multicast"


@dataclass(frozen=True, slots=True)
class Step:
    """One exchange to be run: read `code`, or write `value` to it."""

    kind: StepKind
    code: Code
    value: Value | None = None


class Job(Protocol):
    """What the worker needs of a job."""

    station: Station
    error: ExchangeError | None

    @property
    def step(self) -> Step:
        """The next exchange to run."""

    def advance(self, result: Result) -> Verdict:
        """Take the result of the step that was run."""


class ReadJob:
    """Read one code; the value stands in `value` afterwards.

    Args:
        station: The drive.
        code: What to read.
        retries: How often a failed attempt is repeated.
        instead: Codes that will do as well while an old answer to `code` may still come.
    """

    __slots__ = ("attempts", "error", "instead", "retries", "station", "step", "value")

    def __init__(
        self, station: Station, code: Code, retries: int, instead: tuple[Code, ...] = ()
    ) -> None:
        self.station = station
        self.instead = instead
        self.step = Step(StepKind.READ, code)
        self.retries = retries
        self.attempts = 0
        self.value: Value | None = None
        self.error: ExchangeError | None = None

    def advance(self, result: Result) -> Verdict:
        """End with the value, with the drive's refusal, or after the last retry."""
        self.attempts += 1
        answer = result.answer
        if type(answer) is ValueAnswer:
            self.value = answer.value
            return Outcome.DONE, ""
        self.error = error_of(self.station, self.step, result, self.attempts)
        if self.error.retryable and self.attempts <= self.retries and not _is_lost(result):
            return None
        refused = result.kind is ResultKind.ANSWERED
        return (Outcome.REFUSED if refused else Outcome.UNKNOWN), str(self.error)


class WriteJob:
    """Write one code, and prove it where that is asked for or the acknowledgement is missing.

    Args:
        station: The drive.
        code: What to write.
        value: The value, in the code's format.
        write_class: Whether it may be repeated.
        retries: How often a failed attempt is repeated.
        verify: Read back after the acknowledgement too.
    """

    __slots__ = (
        "attempts", "code", "error", "proof", "retries", "station", "step", "value", "verify",
        "write_class", "_acknowledged", "_proving",
    )  # fmt: skip

    def __init__(
        self,
        station: Station,
        code: Code,
        value: Value,
        *,
        write_class: WriteClass,
        retries: int,
        verify: bool = False,
    ) -> None:
        self.station = station
        self.code = code
        self.value = value
        self.write_class = write_class
        self.retries = retries
        self.verify = verify
        self.step = Step(StepKind.WRITE, code, value)
        self.proof: Value | None = None
        self.error: ExchangeError | None = None
        self.attempts = 0
        self._acknowledged = False
        self._proving: ReadJob | None = None

    def advance(self, result: Result) -> Verdict:
        """Go from the write to its proof, back to a repetition, or to the end."""
        if self._proving is not None:
            return self._proven(self._proving, result)
        self.attempts += 1
        answer = result.answer
        if type(answer) is AckAnswer:
            self._acknowledged = True
            return self._prove() if self.verify else (Outcome.DONE, "")
        self.error = error_of(self.station, self.step, result, self.attempts)
        if result.kind is ResultKind.ANSWERED:
            return Outcome.REFUSED, str(self.error)
        if _is_lost(result) or self.write_class is not WriteClass.PLAIN:
            return Outcome.UNKNOWN, f"{self.error}; not repeated, it may have happened"
        return self._prove()

    def _prove(self) -> Verdict:
        self._proving = ReadJob(self.station, self.code, self.retries)
        self.step = self._proving.step
        return None

    def _proven(self, proving: ReadJob, result: Result) -> Verdict:
        verdict = proving.advance(result)
        if verdict is None:
            return None
        self.proof = proving.value
        if self.proof is None:
            self.error = proving.error
            what = "acknowledged" if self._acknowledged else "not acknowledged"
            return Outcome.UNKNOWN, f"the write was {what} and could not be read back: {verdict[1]}"
        if self.proof.number == self.value.number:
            self.error = None
            return Outcome.VERIFIED, ""
        if self._acknowledged:
            return Outcome.REFUSED, f"acknowledged, but it reads {self.proof.raw} afterwards"
        if self.attempts <= self.retries:
            return self._again()
        return Outcome.REFUSED, f"{self.error}; it still reads {self.proof.raw}"

    def _again(self) -> Verdict:
        self._proving = None
        self.step = Step(StepKind.WRITE, self.code, self.value)
        return None


class StopJob:
    """Stop one drive: say it until it is acknowledged, then read back whether it took effect.

    Args:
        station: The drive.
        command: Gives code and value at the moment of sending, from the control word if known.
        word_code: The control word to be read first, or None when nothing need be known.
        confirmed: Says whether a value read back shows the stop.
        retries: How often a failed attempt is repeated.
        said: The stop was already said by a multicast; begin with reading back.
    """

    __slots__ = (
        "attempts", "command", "confirmed", "error", "proof", "retries", "station", "step",
        "word", "_checking", "_learning",
    )  # fmt: skip

    def __init__(
        self,
        station: Station,
        command: Callable[[int | None], tuple[Code, Value]],
        *,
        word_code: Code | None,
        confirmed: Callable[[Code, Value], bool],
        retries: int,
        said: bool = False,
    ) -> None:
        self.station = station
        self.command = command
        self.confirmed = confirmed
        self.retries = retries
        self.attempts = 0
        self.word: int | None = None
        self.proof: Value | None = None
        self.error: ExchangeError | None = None
        self._learning = word_code is not None and not said
        self._checking: ReadJob | None = None
        if self._learning and word_code is not None:
            self.step = Step(StepKind.READ, word_code)
        elif said:
            self._check()
        else:
            self._say()

    def advance(self, result: Result) -> Verdict:
        """Go from learning the word to saying the stop, and on to its proof."""
        if self._checking is not None:
            return self._checked(self._checking, result)
        if self._learning:
            return self._learnt(result)
        self.attempts += 1
        if type(result.answer) is AckAnswer:
            return self._check()
        self.error = error_of(self.station, self.step, result, self.attempts)
        if _is_lost(result):
            return Outcome.UNKNOWN, str(self.error)
        if self.attempts <= self.retries:
            return None
        return self._check()

    def _learnt(self, result: Result) -> Verdict:
        """Use the word if it was read; without it the stop is said all the same."""
        self._learning = False
        answer = result.answer
        if type(answer) is ValueAnswer and isinstance(answer.value.number, int):
            self.word = answer.value.number
        if _is_lost(result):
            self.error = error_of(self.station, self.step, result, 1)
            return Outcome.UNKNOWN, str(self.error)
        return self._say()

    def _say(self) -> Verdict:
        code, value = self.command(self.word)
        self.step = Step(StepKind.WRITE, code, value)
        return None

    def _check(self) -> Verdict:
        code = self.command(self.word)[0]
        self._checking = ReadJob(self.station, code, self.retries)
        self.step = self._checking.step
        return None

    def _checked(self, checking: ReadJob, result: Result) -> Verdict:
        verdict = checking.advance(result)
        if verdict is None:
            return None
        self.proof = checking.value
        if self.proof is not None and self.confirmed(checking.step.code, self.proof):
            self.error = None
            return Outcome.VERIFIED, ""
        said_all = self.attempts > self.retries
        if self.proof is not None and not said_all and not _is_lost(result):
            self._checking = None
            return self._say()
        if self.proof is None:
            self.error = checking.error
            return Outcome.UNKNOWN, f"the stop was said, but could not be read back: {verdict[1]}"
        return Outcome.REFUSED, f"the stop was said, but the drive reads {self.proof.raw}"


class MulticastJob:
    """Say one write to a group address, which nobody answers.

    Args:
        station: The group's name and address.
        code: What to write.
        value: The value.
        processing_s: How long the slowest member takes over it, seconds.
    """

    __slots__ = ("error", "processing_s", "station", "step")

    def __init__(
        self, station: Station, code: Code, value: Value, *, processing_s: float
    ) -> None:
        self.station = station
        self.processing_s = processing_s
        self.step = Step(StepKind.MULTICAST, code, value)
        self.error: ExchangeError | None = None

    def advance(self, result: Result) -> Verdict:
        """End: it went out, or the line or its echo failed."""
        if result.kind is ResultKind.SENT:
            return Outcome.DONE, "sent as one multicast; nobody acknowledges those"
        self.error = error_of(self.station, self.step, result, 1)
        return Outcome.UNKNOWN, str(self.error)


def _is_lost(result: Result) -> bool:
    return result.kind is ResultKind.LOST
