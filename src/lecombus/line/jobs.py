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

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from ..drives import (
    Family,
    StopAction,
    WriteClass,
    confirm_codes,
    needs_control_word,
    stop_confirmed,
    stop_value,
)
from ..errors import ExchangeError
from ..protocol.addressing import Code, Form
from ..protocol.exchange import Result, ResultKind
from ..protocol.telegrams import AckAnswer, UnknownCodeAnswer, ValueAnswer
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


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """A drive as the line sees it.

    Args:
        name: Its name in the roster.
        address: 1..99, not ending in 0; for a multicast the group address.
        family: Its description, with the roster's overrides applied.
        forms: The addressing forms it is spoken to in, the preferred first.
        hold_s: How long it is left alone after a write, seconds: with shortened response time
            (C1921 = 1) the module acknowledges before it has passed the value on.
        answer_time_s: The roster's word on how long it thinks, seconds; None: the family's.
    """

    name: str
    address: int
    family: Family
    forms: tuple[Form, ...]
    hold_s: float = 0.0
    answer_time_s: float | None = None


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

    @property
    def cut_outcome(self) -> Outcome | None:
        """How it ends if it is cut off between two steps; None: nothing was changed."""

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
        if self.attempts <= self.retries and not _is_lost(result):
            # One damaged character makes "no such code" of a value, so that is asked twice.
            doubtful = type(answer) is UnknownCodeAnswer and self.attempts == 1
            if self.error.retryable or doubtful:
                return None
        refused = result.kind is ResultKind.ANSWERED
        return (Outcome.REFUSED if refused else Outcome.UNKNOWN), str(self.error)

    @property
    def cut_outcome(self) -> Outcome | None:
        """A read changes nothing."""
        return None


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
        "_acknowledged",
        "_proving",
        "attempts",
        "code",
        "error",
        "proof",
        "retries",
        "station",
        "step",
        "value",
        "verify",
        "write_class",
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
            self.error = None
            return self._prove() if self.verify else (Outcome.DONE, "")
        self.error = error_of(self.station, self.step, result, self.attempts)
        if result.kind is ResultKind.ANSWERED:
            return Outcome.REFUSED, str(self.error)
        if _is_lost(result) or self.write_class is not WriteClass.PLAIN:
            return Outcome.UNKNOWN, f"{self.error}; not repeated, it may have happened"
        return self._prove()

    @property
    def cut_outcome(self) -> Outcome | None:
        """Acknowledged, or perhaps done."""
        return Outcome.DONE if self._acknowledged else Outcome.UNKNOWN

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
        if self.proof.means_same(self.value):
            self.error = None
            return Outcome.VERIFIED, ""
        if self._acknowledged:
            # An edge or a step may have happened and still read as before.
            plain = self.write_class is WriteClass.PLAIN
            outcome = Outcome.REFUSED if plain else Outcome.UNKNOWN
            return outcome, f"acknowledged, but it reads {self.proof.raw} afterwards"
        if self.attempts <= self.retries:
            return self._again()
        return Outcome.REFUSED, f"{self.error}; it still reads {self.proof.raw}"

    def _again(self) -> Verdict:
        self._proving = None
        self.step = Step(StepKind.WRITE, self.code, self.value)
        return None


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


class MulticastJob:
    """Say one write to a group address, which nobody answers.

    Args:
        station: The group's name and address.
        code: What to write.
        value: The value.
        processing_s: How long the slowest member takes over it, seconds.
    """

    __slots__ = ("error", "processing_s", "station", "step")

    def __init__(self, station: Station, code: Code, value: Value, *, processing_s: float) -> None:
        self.station = station
        self.processing_s = processing_s
        self.step = Step(StepKind.MULTICAST, code, value)
        self.error: ExchangeError | None = None

    @property
    def cut_outcome(self) -> Outcome | None:
        """It has one step only."""
        return Outcome.UNKNOWN

    def advance(self, result: Result) -> Verdict:
        """End: it went out, or the line or its echo failed."""
        if result.kind is ResultKind.SENT:
            return Outcome.DONE, "sent as one multicast; nobody acknowledges those"
        self.error = error_of(self.station, self.step, result, 1)
        return Outcome.UNKNOWN, str(self.error)


def _is_lost(result: Result) -> bool:
    return result.kind is ResultKind.LOST
