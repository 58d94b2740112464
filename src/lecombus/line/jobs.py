"""What is said to get one request done: a read, a write with its proof, a multicast.

Rules held here (EDB2102EN 8.3.5; CMVLC401A 6):

* a read may be repeated, a limited number of times;
* a write whose acknowledgement did not come is read back first. Only a plain value is then
  written again; an edge, a step, a save is not: it may have happened;
* NAK is an answer: nothing was changed. It can also mean that the telegram was damaged on its way
  (EDB2102EN 8.3.1; CMVLC401A 6.1), so a plain value is written once more, and a read is asked once
  more; never an edge, a step or a save. That counts as one of the repetitions.

What must not live here: telegrams, time-outs, who goes first.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..drives import WriteClass
from ..drives.stops import usable_word
from ..errors import ExchangeError, NakError
from ..protocol.addressing import Code
from ..protocol.exchange import Result, ResultKind
from ..protocol.telegrams import AckAnswer, Answer, NakAnswer, UnknownCodeAnswer, ValueAnswer
from ..protocol.values import Value
from ..schedule.request import Outcome
from .failures import error_of
from .station import Station, Step, StepKind, Verdict

__all__ = ["MulticastJob", "ReadJob", "WriteJob"]


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
            # One damaged character makes "no such code" of a value, and a NAK of a question.
            doubtful = type(answer) in (UnknownCodeAnswer, NakAnswer) and self.attempts == 1
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
        "_refused",
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
        self._refused = False
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
            if self._repeats_after(answer):
                return None
            return Outcome.REFUSED, str(self.error)
        if _is_lost(result) or self.write_class is not WriteClass.PLAIN:
            return Outcome.UNKNOWN, f"{self.error}; not repeated, it may have happened"
        return self._prove()

    @property
    def cut_outcome(self) -> Outcome | None:
        """Acknowledged, refused and not yet said again, or perhaps done."""
        if self._acknowledged:
            return Outcome.DONE
        return Outcome.REFUSED if isinstance(self.error, NakError) else Outcome.UNKNOWN

    def _repeats_after(self, answer: Answer | None) -> bool:
        """Whether a refusal may have been a damaged telegram: a plain value is said once more."""
        plain = self.write_class is WriteClass.PLAIN and self.attempts <= self.retries
        if type(answer) is not NakAnswer or self._refused or not plain:
            return False
        self._refused = True
        return True

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
        if self._is_no_word(self.proof):
            text = f"it reads {self.proof.raw} afterwards, which is no control word"
            return Outcome.UNKNOWN, text
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

    def _is_no_word(self, value: Value) -> bool:
        """Whether what should be a control word has more than 16 bits: it is something else."""
        number = value.number
        if self.code not in self.station.family.control_words or not isinstance(number, int):
            return False
        return usable_word(number) is None

    def _again(self) -> Verdict:
        self._proving = None
        self.step = Step(StepKind.WRITE, self.code, self.value)
        return None


class MulticastJob:
    """Say one write to a group address, which nobody answers.

    Args:
        station: The group's name and address.
        code: What to write.
        value: The value.
        processing_s: How long the line waits for members to have done with it, seconds.
        holds: How long single members are left alone after that, seconds by name.
    """

    __slots__ = ("error", "holds", "processing_s", "station", "step")

    def __init__(
        self,
        station: Station,
        code: Code,
        value: Value,
        *,
        processing_s: float,
        holds: Mapping[str, float] | None = None,
    ) -> None:
        self.station = station
        self.processing_s = processing_s
        self.holds = holds or {}
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
