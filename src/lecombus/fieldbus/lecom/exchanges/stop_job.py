"""Sends a stop to one drive until it is verified.

A stop is repeated immediately, because sending it twice does no harm, and is read back at the end:
an acknowledgement does not show an effect. Source: EDB2102EN 8.2, 8.3.5; CMVLC401A 4.2.

A quick stop never lifts an inhibit: the word that is sent has the inhibit's bit whenever the drive
is inhibited, which is read first where it is not known. The value of C0135 does not show it: no
manual says that it shows more than was last written to it.

Strategy: send it, read it back, and repeat both while the proof is missing, whether the drive reads
as not stopped or does not answer. Time is the limit, not a number of attempts: a line that received
nothing for a second is no reason to leave a running drive running. After the first few attempts
there are pauses, in which the watchdogs of the others are fed. Where nothing may be read because an
old answer may still come, it is sent again.

A quick stop that is not possible becomes an inhibit, with the reason: when the control word cannot
be read, when the drive refuses the telegram again and again, when it takes it and does not show it.
Only inhibit is possible in every operating mode (EDB2102EN 6.2.1).

What a drive refuses, does not know or does not show is sent in the other addressing form next,
where it knows two: a code bank or an input selection left in C0249 or C0248 leads
every standard telegram to another code, and none in extended addressing (EDB2102EN 8.3.1).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from lecombus.drives import StopAction, confirm_codes, knows_stop, needs_control_word, stop_value
from lecombus.drives.stops import (
    LEAST_STOP_ATTEMPTS,
    STOP_PATIENCE_S,
    STOP_PAUSE_S,
    inhibit_mask,
    inhibit_proofs,
    may_ignore,
    usable_word,
)
from lecombus.errors import ExchangeError
from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.fieldbus.requests import JobStep, Station, StepKind, StopWork, Verdict
from lecombus.parameters import Code, Value
from lecombus.schedule.request import Outcome

from ..protocol.telegrams import AckAnswer, NakAnswer, UnknownCodeAnswer, ValueAnswer
from .jobs import error_of
from .late_answers import COPY_S, Duplicates
from .read_back_proof import ReadBackProof

__all__ = ["LongestTimes", "StopJob"]

LEAST_INHIBIT_S = 1.5
"""What an inhibit in a quick stop's place is tried for at least, seconds."""

PROVING_S = 2.0
"""If one reading already shows the stop, it gets this much extra time for the other readings,
seconds: on a full line each of them may wait for a round of feeds."""

UNSHOWN_S = 1.0
"""A quick stop that was acknowledged gets this long to show before it is taken for without effect,
seconds: with shortened response time a 820X takes a value up 230 ms later (EDB2102EN 6.3.2)."""

BELIEVED_S = 1.0
"""An acknowledged stop that may not be read back yet is sent again after this time, seconds."""

NO_FALLBACK = "; it was not inhibited instead: the roster says stop_fallback: none"


class LongestTimes(NamedTuple):
    """The longest that a telegram of a stop can hold the line, seconds.

    Args:
        any_s: Any of them.
        read_s: Any reading: far less than the write to an 820X.
    """

    any_s: float
    read_s: float


class StopJob(StopWork):
    """Stop one drive: send it until it is acknowledged, then read back whether it took effect.

    A quick stop changes one bit of the control word. Where the word is not known, or whether the
    drive is inhibited, that is read first; where it cannot be read the drive is inhibited instead,
    because a guessed word could start what was standing still. A quick stop that the drive refuses
    is not a stop: it is inhibited then too.

    Args:
        station: The drive.
        action: How it shall stop.
        word: Gives its control word as last read or written, None when not known; asked when the
            stop is sent, for it may change while the stop waits.
        inhibited: Says whether the drive is inhibited, None when not known; asked likewise.
        last_word: Gives its control word as it was known last, for a drive that may not be
            inhibited and cannot be read: its answers may be lost and not its hearing.
        retries: How often a failed attempt is repeated without a pause.
        said: The stop was already said by a multicast; begin with reading back.
        repeats: A multicast said it, but the drive read as stopped before: say it once more, and
            let feeds go first.
        silent: The drive did not answer before: its stop takes more to be shown.
        offline: It was offline: also where answers come twice, more must be its own.
        may_inhibit: A quick stop that cannot be had may become an inhibit.
        duplicates: What is known of answers that come twice on this line.
        patience_s: How long it is tried, seconds; once the drive answers: `STOP_PATIENCE_S`.
        times: How long its telegrams take; None: not known.
    """

    def __init__(
        self,
        station: Station,
        action: StopAction,
        *,
        word: Callable[[], int | None],
        inhibited: Callable[[], bool | None] = lambda: False,
        last_word: Callable[[], int | None] = lambda: None,
        retries: int,
        said: bool = False,
        repeats: bool = False,
        silent: bool = False,
        offline: bool = False,
        may_inhibit: bool = True,
        duplicates: Duplicates | None = None,
        patience_s: float = STOP_PATIENCE_S,
        times: LongestTimes | None = None,
    ) -> None:
        self.station = station
        self.action = action
        self.word = word
        self.inhibited = inhibited
        self.last_word = last_word
        self.retries = retries
        self.patience_s = patience_s
        self.attempts = 0
        self.may_inhibit = may_inhibit
        self._times = times
        self.proof: Value | None = None
        self.proof_code: Code | None = None
        self._proving = ReadBackProof(duplicates, silent=silent, offline=offline)
        self.error: ExchangeError | None = None
        self._since_s: float | None = None
        self._ended_s = -math.inf  # its last exchange
        self._checking, self._least_sayings = said, LEAST_STOP_ATTEMPTS - said
        self._repeats, self._learning = repeats, False
        self._read_word: int | None = None  # read for the telegram that comes next
        self._read_inhibit: bool | None = None  # likewise
        # In a row: sayings without an acknowledgement, reads that failed, refusals, and proofs that
        # did not show the stop.
        self._unheard = self._failed_reads = self._naks = self._unshown = 0
        self._why = ""  # a quick stop became an inhibit, or was made from the last known word
        self._unread_word: int | None = None  # what it is made from where nothing can be read
        self._turned = False  # it is being sent in the other addressing form
        self._step: JobStep | None = None

    def begin_unsaid(self) -> None:
        """The multicast that was to say it was not sent: say it first."""
        if self._since_s is None:
            self._checking, self._least_sayings, self._step = False, LEAST_STOP_ATTEMPTS, None
            self._repeats = False

    @property
    def step(self) -> JobStep:
        """What is to be sent now; it stays the same from the first look until its result."""
        if self._step is None:
            self._step = self._made()
        return self._step

    @property
    def asks_for_word(self) -> bool:
        """Whether the next step is made from the control word as it is when that is sent."""
        if self._step is not None or self._checking:
            return False
        return needs_control_word(self.station.family, self.action)

    @property
    def cut_outcome(self) -> Outcome | None:
        """A stop that was sent and not proven is not known to have stopped anything."""
        return Outcome.UNKNOWN if self.attempts or self._checking else None

    @property
    def goes_behind(self) -> bool:
        """Whether stops that wait go first: not before one whose word has just been read."""
        return not self._is_ready or self.action is StopAction.INHIBIT

    @property
    def yields(self) -> bool:
        """Whether feeds may go first: as far as is known the drive is stopped."""
        return self.only_proves or (self._repeats and not self._unshown)

    @property
    def only_proves(self) -> bool:
        """Whether the drive took the stop and showed it, and only more proof of that is wanted."""
        return self._checking and self._proving.is_begun

    def longest_s(self, else_s: float) -> float:
        """Return the longest that the next telegram can hold the line, seconds.

        Args:
            else_s: Where that is not known, seconds.
        """
        if self._times is None:
            return else_s
        return self._times.read_s if self.only_proves else self._times.any_s

    @property
    def _is_ready(self) -> bool:
        """Whether what comes next was made from what has just been read or refused."""
        read = self._read_word is not None or self._read_inhibit is not None
        return read or self._step is not None

    @property
    def pause_s(self) -> float:
        """How long the line is left to others before the next step, seconds.

        A module that acknowledges early hears nothing until it has passed the stop on: a proof
        asked for sooner stays without an answer, and sending the stop again starts from the
        beginning. A reading that could only show what is known is no reason to keep others from the
        line.
        """
        if self._checking:
            return max(self.station.hold_s, STOP_PAUSE_S if self._proving.repeated else 0.0)
        fresh = self._is_ready or max(self.attempts, self._failed_reads) <= self.retries
        return 0.0 if fresh else STOP_PAUSE_S

    def instead_of_reading_s(
        self, now_s: float, until_s: float, *, others_late: bool = False
    ) -> float | None:
        """Go on with something that can be sent where nothing may be read before a time.

        A drive that has not shown the stop may not have heard it, and an old answer may be waited
        for much longer than a stop is repeated: it is sent again then, after a pause.

        Args:
            now_s: The time.
            until_s: Until when old answers may come; `now_s`: the reading is only kept apart from
                another drive's.
            others_late: It is kept apart from another drive's late answer.

        Returns:
            After how long that can be sent, seconds; None: the reading is waited for.
        """
        step, pause_s = self.step, max(self.station.hold_s, STOP_PAUSE_S)
        tried_s = -math.inf if self._since_s is None else now_s - self._since_s
        if until_s <= now_s:
            if others_late:
                if tried_s < self.patience_s + (COPY_S if self._proving.is_begun else 0.0):
                    return self._while_others_are_late_s(now_s, pause_s)
                self._proving.proves_nothing = True
            elif self._proving.waits_apart(now_s):
                return None
            self._step = step._replace(apart=False)
            return 0.0
        if self._learning:
            if not self.may_inhibit:
                return None
            self._inhibit(
                f"needs {self._spoken(step.code)}, which may not be read now: an old answer may "
                "still come"
            )
            return 0.0
        over = tried_s >= self.patience_s
        if self._proving.is_begun or until_s - now_s <= pause_s or over:
            return None
        return self._say_again_s(now_s, pause_s)

    def _while_others_are_late_s(self, now_s: float, pause_s: float) -> float | None:
        """Send it again until the drive has shown it: it may not have heard it.

        An acknowledgement may be another drive's, and is believed for a time.
        """
        acknowledged = self._proving.acknowledged
        if not acknowledged or (
            not self._proving.has_shown and now_s - self._ended_s >= BELIEVED_S
        ):
            return self._say_again_s(now_s, pause_s)
        self._step = None  # another code may be read sooner then
        return None

    def _say_again_s(self, now_s: float, pause_s: float) -> float:
        """Send it again instead of reading; return after how long, seconds."""
        self._checking, self._step = False, None
        return max(self._ended_s + pause_s - now_s, 0.0)

    def advance(self, result: Result) -> Verdict:
        """Go from learning the word to saying the stop, and on to its proof."""
        step, self._step = self.step, None
        if self._since_s is None:
            self._since_s = result.started_s
        self._ended_s = result.ended_s
        if result.kind is ResultKind.ANSWERED:
            self.patience_s, self._unread_word = STOP_PATIENCE_S, None
        else:
            self._proving.silent = True
        if result.kind is ResultKind.LOST:
            self.error = error_of(self.station, step, result, self.attempts + 1)
            return Outcome.UNKNOWN, str(self.error)
        over = result.ended_s - self._since_s >= self.patience_s
        over = over and (bool(self.attempts) or not self.may_inhibit)
        if self._learning:
            return self._learnt(step, result, over)
        if self._checking:
            return self._checked(step, result, over)
        self.attempts += 1
        acknowledged = type(result.answer) is AckAnswer
        self._proving.said(
            acknowledged=acknowledged, refused=type(result.answer) is NakAnswer,
            drive=self.station.name, at_s=result.started_s,
        )  # fmt: skip
        if type(result.answer) is AckAnswer:
            self.error, self._unheard, self._naks, self._checking = None, 0, 0, True
            return None
        self._unheard += 1
        self._turn(refused=type(result.answer) is NakAnswer)
        self.error = error_of(self.station, step, result, self.attempts)
        self._checking = over or self._unheard > self.retries
        self._naks = self._naks + 1 if type(result.answer) is NakAnswer else 0
        if self._naks > max(1, self.retries) and self._can_inhibit:
            self._inhibit("was refused by the drive (NAK)", result.ended_s)
        return None

    def _turn(self, *, refused: bool) -> None:
        """Go on in the other addressing form after a refusal, and back when that failed too."""
        forms = self.station.forms
        if len(forms) > 1 and (refused or self._turned):
            self.station = replace(self.station, forms=(*forms[1:], forms[0]))
            self._turned = not self._turned

    def _made(self) -> JobStep:
        family = self.station.family
        if self._checking:
            return self._proving.step(self.station, self.action)
        if not needs_control_word(family, self.action):
            return self._saying(None)
        code = family.stops[self.action].code
        if self._unread_word is not None:
            return self._saying(self._unread_word)
        word = usable_word(self.word())
        word = self._read_word if word is None else word
        if word is None:
            return self._to_learn(code)
        mask = inhibit_mask(family, code)
        if not word & mask:
            inhibited = self.inhibited()
            inhibited = self._read_inhibit if inhibited is None else inhibited
            if inhibited is None:
                return self._to_learn(next(iter(inhibit_proofs(family))))
            word |= mask if inhibited else 0
        self._read_word = self._read_inhibit = None
        return self._saying(word)

    def _to_learn(self, code: Code) -> JobStep:
        self._learning = True
        return JobStep(StepKind.READ, code)

    def _saying(self, word: int | None) -> JobStep:
        code, value = stop_value(self.station.family, self.action, word)
        return JobStep(StepKind.WRITE, code, value)

    @property
    def _can_inhibit(self) -> bool:
        quick = self.action is StopAction.QUICK_STOP and self.may_inhibit
        return quick and knows_stop(self.station.family, StopAction.INHIBIT)

    def _inhibit(self, why: str, now_s: float | None = None) -> None:
        """Say an inhibit from now on, and give it time even where the quick stop used it up."""
        self._why = f"{self.action} {why}; "
        self._learning = self._checking = self._repeats = False
        self._proving.begin()
        self._read_word = self._read_inhibit = None
        self._unheard = self._unshown = 0
        self.action = StopAction.INHIBIT
        self._step = self._saying(None)
        if now_s is not None and self._since_s is not None:
            self._since_s = max(self._since_s, now_s - STOP_PATIENCE_S + LEAST_INHIBIT_S)

    def _learnt(self, step: JobStep, result: Result, over: bool) -> Verdict:
        """Keep what the stop is made of: the word, or whether the drive is inhibited.

        A drive that this job has sent no stop is inhibited after one read that fails, also where a
        multicast sent one: a second read would delay the stop by a time-out (ADR 39). A drive that
        it has sent a stop is asked more than once: the quick stop may be under way.
        """
        self._learning = False
        answer = result.answer
        value = answer.value if type(answer) is ValueAnswer else None
        if value is not None and self._takes(step.code, value):
            self._failed_reads = 0
            return None
        self._failed_reads += 1
        unknown = type(answer) is UnknownCodeAnswer
        self._turn(refused=unknown)
        if not self.may_inhibit:
            if self._says_unread(value, over) or not over:
                return None
            outcome = Outcome.UNKNOWN if self.attempts else Outcome.REFUSED
            return outcome, f"{self.action} {self._unreadable(step, result, value)}{NO_FALLBACK}"
        if unknown and self._turned:
            return None
        said = result.kind is ResultKind.ANSWERED and type(answer) is not NakAnswer
        asked_enough = said or self._failed_reads > self.retries
        if not self.attempts or asked_enough or over:
            self._inhibit(self._unreadable(step, result, value), result.ended_s)
        return None

    def _says_unread(self, value: Value | None, over: bool) -> bool:
        """Say the quick stop with the last known word from now on, if there is nothing better.

        A drive that hears and is not heard would else run on: it may not be inhibited.
        """
        if value is None and (over or self._failed_reads > self.retries):
            self._unread_word = self.last_word()
        if self._unread_word is None:
            return False
        self._failed_reads = 0
        self._why = "made from the control word as it was known last; "
        return True

    def _takes(self, code: Code, value: Value) -> bool:
        """Keep a value that the next telegram needs; False: it is no such value."""
        family = self.station.family
        if code == family.stops[self.action].code:
            self._read_word = usable_word(value.word)
            return self._read_word is not None
        self._read_inhibit = inhibit_proofs(family)[code].shown_by(value)
        return self._read_inhibit is not None

    def _unreadable(self, step: JobStep, result: Result, value: Value | None) -> str:
        """Return why a control word, or whether the drive is inhibited, could not be learnt."""
        if value is not None:
            what = (
                "control" if step.code == self.station.family.stops[self.action].code else "status"
            )
            return f"needs {self._spoken(step.code)}, which reads {value.number!s}: no {what} word"
        error = error_of(self.station, step, result, max(1, self._failed_reads))
        return f"needs {self._spoken(step.code)}, which could not be read: {error}"

    def _checked(self, step: JobStep, result: Result, over: bool) -> Verdict:
        self._checking = False
        self._unheard = 0
        answer = result.answer
        proving, family = self._proving, self.station.family
        if proving.proves_nothing and result.kind is ResultKind.ANSWERED:
            return self._unproven(step, over)
        if type(answer) is not ValueAnswer:
            return self._unread(step, result, over)
        self._failed_reads = 0
        if proving.take(self.station, self.action, answer, step.code):
            if step.code in confirm_codes(family, self.action):
                self.proof, self.proof_code = answer.value, step.code
            self.error = None
            if proving.is_enough(self.station, self.action, result.ended_s):
                text = f"{self._why}{self.action}: {self._shown}"
                two = proving.may_be_two(self.station, result.ended_s)
                return (Outcome.UNKNOWN, f"{text}, but {two}") if two else (Outcome.VERIFIED, text)
            assert self._since_s is not None
            if result.ended_s - self._since_s < self.patience_s + PROVING_S:
                goes_on = proving.acknowledged or proving.is_begun
                self._checking = goes_on and not proving.wants_own_ack(
                    self.station, self.action, result.ended_s
                )
                return None
            text = f"{self._why}{self.action} was sent and {self._shown}, but "
            return Outcome.UNKNOWN, text + proving.missing(self.station)
        if step.code not in confirm_codes(family, self.action):
            text = f"{self._why}{self.action} was sent, but {proving.missing(self.station)}"
            return (Outcome.UNKNOWN, text) if over else None
        self.proof, self.proof_code = answer.value, step.code
        self._unshown += 1
        self._turn(refused=True)
        came_to = "was refused by the drive (NAK), and" if self._naks else "was sent, but"
        reads = f"{came_to} {self._spoken(step.code)} reads {self.proof.raw}"
        if self._is_without_effect(result, over):
            self._inhibit(reads, result.ended_s)
            return None
        if not over:
            return None
        return self._not_shown(step, reads)

    def _unproven(self, step: JobStep, over: bool) -> Verdict:
        """Send it again: it may not have been heard. At the end say why nothing proves it."""
        self._failed_reads = 0
        if not over:
            return None
        return Outcome.UNKNOWN, (
            f"{self._why}{self.action} was sent, but second or late answers come on this line, and "
            f"other drives are asked for {self._spoken(step.code)} all the time: no answer is this "
            "drive's for certain"
        )

    def _not_shown(self, step: JobStep, reads: str) -> Verdict:
        """Say that a stop was sent for as long as it is tried, and does not show."""
        family, more = self.station.family, ""
        if self.action is StopAction.QUICK_STOP and not self.may_inhibit:
            more = NO_FALLBACK
        outcome = Outcome.REFUSED
        if self.proof is not None and may_ignore(family, self.action, step.code, self.proof):
            outcome = Outcome.UNKNOWN
            more = f", which this drive shows whether it follows it or not{more}"
        return outcome, f"{self._why}{self.action} {reads}{more}"

    @property
    def _shown(self) -> str:
        """What shows the stop; a command that reads back shows no more than that it is held."""
        assert self.proof is not None
        assert self.proof_code is not None
        held = self.proof_code == self.station.family.stops[self.action].code
        text = f"{self._spoken(self.proof_code)} reads {self.proof.raw}"
        return f"command held, {text}" if held else text

    def _spoken(self, code: Code) -> str:
        return self.station.family.spoken(code)

    def _is_without_effect(self, result: Result, over: bool) -> bool:
        """Whether a quick stop was taken often enough without showing."""
        assert self._since_s is not None
        waited = over or result.ended_s - self._since_s >= UNSHOWN_S
        enough = self.attempts and self._unshown > max(1, self.retries)
        return bool(self._can_inhibit and waited and enough)

    def _unread(self, step: JobStep, result: Result, over: bool) -> Verdict:
        """Send it again; at the end, or if the drive does not know the code, report that."""
        self._failed_reads += 1
        self.error = error_of(self.station, step, result, self._failed_reads)
        # One damaged character makes "no such code" of a value, so that is asked twice.
        no_code = type(result.answer) is UnknownCodeAnswer
        if self._proving.refused(self.station, step.code, result.answer) and no_code:
            self._checking = True
            return None
        if self._proving.is_begun and self._failed_reads <= self.retries:
            self._checking = True
            return None
        self._turn(refused=no_code)
        unknown = no_code and self._failed_reads > 1
        over = over and self.attempts >= self._least_sayings
        if self.attempts and (over or unknown):
            text = f"{self.action} was sent but not read back: {self.error}"
            return Outcome.UNKNOWN, self._why + text
        return None
