"""The steps of one request: a read, a write with its verification, a multicast; and its error.

Rules (EDB2102EN 8.3.5; CMVLC401A 6):

* a read may be repeated, a limited number of times;
* a write whose acknowledgement did not come is read back first. Only a plain value is then
  written again; an edge, a step, a save is not: it may have happened;
* NAK is an answer: nothing was changed. It can also mean that the telegram was damaged on its way
  (EDB2102EN 8.3.1; CMVLC401A 6.1), so a plain value is written once more, and a read is asked once
  more; never an edge, a step or a save. That counts as one of the repetitions;
* an acknowledgement carries no address: where answers come twice, what rests on it alone says so;
* what was written is proven by reading it back: an answer that may be another drive's, because it
  was asked for the same, takes more readings (`read_back_proof`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from lecombus.drives import WriteClass
from lecombus.drives.stops import asks_to_stop, usable_word
from lecombus.errors import (
    ChecksumReportedError,
    CutReplyError,
    EchoError,
    ExchangeError,
    ExchangeRecord,
    GarbledReplyError,
    NakError,
    NoReplyError,
    UnexpectedReplyError,
    UnknownCodeError,
)
from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.fieldbus.requests import (
    JobStep,
    MulticastWork,
    ReadWork,
    Station,
    StepKind,
    Verdict,
    WriteWork,
)
from lecombus.parameters import AddressForm, Code, Value
from lecombus.schedule.request import Outcome

from ..protocol.exchange import ACK_FIELD
from ..protocol.telegrams import (
    AckAnswer,
    Answer,
    NakAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from .late_answers import Duplicates
from .read_back_proof import ReadBackProof, WrittenValue

__all__ = ["MulticastJob", "ReadBackJob", "ReadJob", "WriteJob", "error_of"]

_BY_ANSWER: dict[type, tuple[type[ExchangeError], str]] = {
    NakAnswer: (NakError, "the drive refused it (NAK)"),
    TransmissionErrorAnswer: (
        ChecksumReportedError,
        "the drive saw a transmission error in the request",
    ),
    UnknownCodeAnswer: (UnknownCodeError, "the drive has no such code"),
}

REFUSED_WRITE = "the drive refused the write (NAK): nothing was changed"
REFUSED_TWICE = "the drive refused the write twice (NAK): nothing was changed"
REFUSED_READ = "the drive refused the read (NAK)"

_BY_KIND: dict[ResultKind, type[ExchangeError]] = {
    ResultKind.NO_REPLY: NoReplyError,
    ResultKind.GARBLED: GarbledReplyError,
    ResultKind.ECHO: EchoError,
    ResultKind.LOST: CutReplyError,
}


def error_of(
    station: Station, step: JobStep, result: Result, attempt: int, *, refused_before: bool = False
) -> ExchangeError:
    """Make the error for an exchange that did not give what was asked for.

    Valid but unwelcome answers (NAK, `?`, unknown code) are answers in the protocol room; from here
    on they are errors that carry what was on the wire.

    Args:
        station: The drive.
        step: What was sent.
        result: How it ended, anything but the wished-for answer.
        attempt: Which attempt it was, 1 upwards.
        refused_before: The drive has refused this write before.
    """
    cls, text = _BY_ANSWER.get(type(result.answer), (UnexpectedReplyError, ""))
    if cls is NakError:
        text = REFUSED_READ if step.kind is StepKind.READ else REFUSED_WRITE
    twice = refused_before and cls is NakError
    if result.answer is None:
        cls, text = _BY_KIND[result.kind], result.fault
    record = ExchangeRecord(
        address=station.address,
        code=step.code.number,
        subcode=step.code.subcode,
        attempt=attempt,
        elapsed_s=result.ended_s - result.started_s,
        received=result.received,
    )
    code = station.family.spoken(step.code)
    where = f"{station.name} (address {station.address}), {code}"
    said = REFUSED_TWICE if twice else f"{text} (attempt {attempt})"
    return cls(f"{where}: {said}", record)


MOST_READINGS = 10
"""Reading back ends after so many: two of the value, the others of the drive's own address."""


ANOTHERS_ACK = (
    "answers come twice on this line: the acknowledgement may be another drive's, verify shows it"
)
"""Why a write that is done may not have reached its drive: acknowledgements carry no address."""


class ReadJob(ReadWork):
    """Read one code; the value stands in `value` afterwards.

    Args:
        station: The drive.
        code: What to read.
        retries: How often a failed attempt is repeated.
        instead: Codes that will do as well while a late answer to `code` may still come.
        form: The addressing form to ask in where that is free; None: the station's first.
        only: Wait until that form is free, and ask in no other.
        apart: Do not ask directly behind another drive's same question (`JobStep`).
    """

    __slots__ = ("attempts", "error", "instead", "retries", "station", "step", "value")
    cut_outcome: Final = None

    def __init__(
        self,
        station: Station,
        code: Code,
        retries: int,
        instead: tuple[Code, ...] = (),
        form: AddressForm | None = None,
        *,
        only: bool = False,
        apart: bool = False,
    ) -> None:
        self.station = station
        self.instead = instead
        self.step = JobStep(StepKind.READ, code, form=form, only=only, apart=apart)
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


class ReadBackJob(ReadWork):
    """Read back what was written, as often as it takes to be sure whose answer it is.

    Args:
        station: The drive.
        written: The code and what it should read as.
        retries: How often a failed reading is repeated.
        duplicates: What is known of answers that come twice on this line; None: there are none.

    Attributes:
        value: What the code read as last; None: it could not be read.
        is_shown: It reads as written, in an answer that is this drive's.
    """

    cut_outcome: Final = None

    def __init__(
        self,
        station: Station,
        written: WrittenValue,
        retries: int,
        duplicates: Duplicates | None = None,
    ) -> None:
        self.station = station
        self.written = written
        self.error: ExchangeError | None = None
        self.value: Value | None = None
        self.is_shown = False
        self._retries = retries
        self._proving = ReadBackProof(duplicates, silent=False)
        self._begin()

    def said(self, *, answered: bool) -> None:
        """Begin again, behind another write; where that had no answer, the drive may be gone."""
        self._proving.said(acknowledged=False)
        self._proving.silent |= not answered
        self._begin()

    def waits_apart(self, now_s: float, late_until_s: float) -> bool:
        """Whether the next reading waits; a second without a pause, and it proves nothing.

        Args:
            now_s: The time.
            late_until_s: Until when old answers keep it waiting.
        """
        step = self._reading.step
        if not step.apart or late_until_s > now_s or self._proving.waits_apart(now_s):
            return True
        self.step = self._reading.step = step._replace(apart=False)
        return False

    def advance(self, result: Result) -> Verdict:
        """Read on until the value is shown, differs, or cannot be had."""
        self._proving.silent |= result.kind is not ResultKind.ANSWERED
        verdict = self._reading.advance(result)
        if verdict is None:
            return None
        self._readings += 1
        self.error = self._reading.error
        code, answer = self._reading.step.code, result.answer
        if type(answer) is ValueAnswer:
            if code == self.written.code:
                self.value = answer.value
            if self._proving.proves_nothing:
                return self._unproven()
            shows = self._proving.take(self.station, self.written, answer, code)
            if not shows and code == self.written.code:
                return Outcome.REFUSED, ""
            if shows and self._proving.is_written(self.station, self.written, result.ended_s):
                self.is_shown, self.error = True, None
                return Outcome.VERIFIED, ""
        elif self._proving.proves_nothing and result.kind is ResultKind.ANSWERED:
            return self._unproven()
        elif not self._proving.refused(self.station, code, answer):
            if self.value is not None:
                return self._in_doubt()
            return Outcome.UNKNOWN, f"could not be read back: {verdict[1]}"
        if self._readings >= MOST_READINGS or self._proving.has_no_address:
            return self._in_doubt()
        self._next()
        return None

    def may_be_two(self, now_s: float) -> str:
        """As of a `ReadBackProof`."""
        return self._proving.may_be_two(self.station, now_s)

    def _unproven(self) -> Verdict:
        """Read again what may be another drive's answer; it took a second, so it counts more."""
        self._readings += 2
        if self._readings >= MOST_READINGS:
            why = self._proving.not_its_own(self.station)
            return (Outcome.UNKNOWN, why) if self.value is None else self._in_doubt()
        self._next()
        return None

    def _in_doubt(self) -> Verdict:
        assert self.value is not None
        text = f"it reads {self.value.raw}, but {self._proving.not_its_own(self.station)}"
        return Outcome.UNKNOWN, text

    def _begin(self) -> None:
        self.value, self._readings = None, 0
        self._next()

    def _next(self) -> None:
        """Read next what is still missing; in the form shown already it would prove no more."""
        wanted, only = self._proving.step(self.station, self.written), self._proving.has_shown
        self._reading = ReadJob(
            self.station, wanted.code, self._retries,
            form=wanted.form, only=only, apart=wanted.apart,
        )  # fmt: skip
        self.step = self._reading.step


class WriteJob(WriteWork):
    """Write one code, and prove it where that is asked for or the acknowledgement is missing.

    Args:
        station: The drive.
        code: What to write.
        value: The value, in the code's format.
        write_class: Whether it may be repeated.
        retries: How often a failed attempt is repeated.
        verify: Read back after the acknowledgement too.
        duplicates: What is known of answers that come twice on this line; None: there are none.
    """

    def __init__(
        self,
        station: Station,
        code: Code,
        value: Value,
        *,
        write_class: WriteClass,
        retries: int,
        verify: bool = False,
        duplicates: Duplicates | None = None,
    ) -> None:
        self.station = station
        self.code = code
        self.value = value
        self.write_class = write_class
        self.retries = retries
        self.verify = verify
        self.step = JobStep(StepKind.WRITE, code, value)
        self.proof: Value | None = None
        self.error: ExchangeError | None = None
        self.attempts = 0
        self._acknowledged = False
        self._refused = False
        self._duplicates = duplicates
        self._back: ReadBackJob | None = None
        self._proving = False

    def waits_apart(self, now_s: float, late_until_s: float) -> bool:
        """As of a `ReadBackJob`, while the write is read back."""
        if self._back is None or not self._proving:
            return True
        waits = self._back.waits_apart(now_s, late_until_s)
        self.step = self._back.step
        return waits

    def advance(self, result: Result) -> Verdict:
        """Go from the write to its proof, back to a repetition, or to the end."""
        if self._back is not None and self._proving:
            return self._proven(self._back, result)
        self.attempts += 1
        answer = result.answer
        if type(answer) is AckAnswer:
            self._acknowledged = True
            self.error = None
            return self._prove() if self.verify else (Outcome.DONE, self._doubt(result.started_s))
        self.error = error_of(
            self.station, self.step, result, self.attempts, refused_before=self._refused
        )
        if result.kind is ResultKind.ANSWERED:
            if self._repeats_after(answer):
                return None
            return Outcome.REFUSED, str(self.error)
        if _is_lost(result) or self.write_class is not WriteClass.PLAIN:
            return Outcome.UNKNOWN, f"{self.error}; not repeated, it may have happened"
        return self._prove()

    @property
    def cut_outcome(self) -> Outcome | None:
        """Refused and not yet sent again, or perhaps done: an acknowledgement proves nothing."""
        if self._acknowledged:
            return Outcome.UNKNOWN
        return Outcome.REFUSED if isinstance(self.error, NakError) else Outcome.UNKNOWN

    def _doubt(self, said_s: float) -> str:
        """Say why the acknowledgement may be another drive's; empty where it is this one's."""
        duplicates, name = self._duplicates, self.station.name
        if duplicates is None or not duplicates.may_be_anothers(ACK_FIELD, name, said_s):
            return ""
        return ANOTHERS_ACK

    def _repeats_after(self, answer: Answer | None) -> bool:
        """Whether a refusal may have been a damaged telegram: a plain value is sent once more."""
        plain = self.write_class is WriteClass.PLAIN and self.attempts <= self.retries
        if type(answer) is not NakAnswer or self._refused or not plain:
            return False
        self._refused = True
        return True

    def _prove(self) -> Verdict:
        if self._back is None:
            written = WrittenValue(self.code, self.value)
            self._back = ReadBackJob(self.station, written, self.retries, self._duplicates)
        self._back.said(answered=self._acknowledged)
        self._proving = True
        self.step = self._back.step
        return None

    def _proven(self, back: ReadBackJob, result: Result) -> Verdict:
        verdict = back.advance(result)
        self.step = back.step
        if verdict is None:
            return None
        self.proof = back.value
        what = "acknowledged" if self._acknowledged else "not acknowledged"
        if self.proof is None:
            self.error = back.error
            return Outcome.UNKNOWN, f"the write was {what} and {verdict[1]}"
        if self._is_no_word(self.proof):
            text = f"it reads {self.proof.raw} afterwards, which is not a control word"
            return Outcome.UNKNOWN, text
        if back.is_shown and not self._acknowledged and self._stops:
            if self.attempts <= self.retries:
                return self._again()
            text = "the write was not acknowledged: something else may hold the drive"
            return (
                Outcome.UNKNOWN,
                f"{text}, {self.station.family.spoken(self.code)} reads {self.proof.raw}",
            )
        if back.is_shown:
            self.error = None
            two = back.may_be_two(result.ended_s) if self._stops else ""
            return (Outcome.UNKNOWN, f"it reads as written, but {two}") if two else verdict
        if self.proof.means_same(self.value):
            self.error = back.error
            return Outcome.UNKNOWN, f"the write was {what}; {verdict[1]}"
        if self._acknowledged:
            # An edge or a step may have happened and still read as before.
            plain = self.write_class is WriteClass.PLAIN
            outcome = Outcome.REFUSED if plain else Outcome.UNKNOWN
            return outcome, f"acknowledged, but it reads {self.proof.raw} afterwards"
        if self.attempts <= self.retries:
            return self._again()
        return Outcome.REFUSED, f"{self.error}; it still reads {self.proof.raw}"

    @property
    def _stops(self) -> bool:
        """Whether it stops the drive: its reading then does not show that the drive has heard it.

        A terminal or the keypad may hold the drive, and let it go.
        """
        return asks_to_stop(self.station.family, self.code, self.value)

    def _is_no_word(self, value: Value) -> bool:
        """Whether what should be a control word has more than 16 bits: it is something else."""
        if self.code not in self.station.family.control_words or value.word is None:
            return False
        return usable_word(value.word) is None

    def _again(self) -> Verdict:
        self._proving = False
        self.step = JobStep(StepKind.WRITE, self.code, self.value)
        return None


class MulticastJob(MulticastWork):
    """Send one write to a group address; no drive answers it.

    Args:
        station: The group's name and address.
        code: What to write.
        value: The value.
        processing_s: How long the line waits for members to have done with it, seconds.
        holds: How long single members are left alone after that, seconds by name.
    """

    cut_outcome: Final = Outcome.UNKNOWN

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
        self.step = JobStep(StepKind.MULTICAST, code, value)
        self.error: ExchangeError | None = None

    def advance(self, result: Result) -> Verdict:
        """End: it went out, or the line or its echo failed."""
        if result.kind is ResultKind.SENT:
            return Outcome.DONE, "sent as one multicast; drives do not acknowledge it"
        self.error = error_of(self.station, self.step, result, 1)
        return Outcome.UNKNOWN, str(self.error)


def _is_lost(result: Result) -> bool:
    return result.kind is ResultKind.LOST
