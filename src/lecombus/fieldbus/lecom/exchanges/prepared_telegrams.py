"""Makes the telegram of a job's next step, with its time-outs.

Here is decided in which addressing form a step is sent, what its answer must look like and how long
to wait for it; and when it may not be sent yet, because a late answer that could pass for its own
may still come (`late_answers`). What reads a code is made once per drive and code, for the same few
are sent for years, and again when the drive turns out to be slower.

Time-outs: twice the longest response time plus the adapter's latency, from the cost model.
Source: EDB2102EN 8.3.5; 3.5 for the times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from lecombus.drives.measured import SlowAnswers, slow_from_s
from lecombus.fieldbus.costs import Cost, LineTiming
from lecombus.fieldbus.lecom.address_codes import address_code
from lecombus.fieldbus.lecom.telegram_costs import read_cost, write_cost
from lecombus.fieldbus.requests import Job, JobStep, Station, StepKind
from lecombus.parameters import AddressForm, Code

from ..protocol.addressing import encode_code
from ..protocol.exchange import ACK_FIELD, Ask
from ..protocol.parser import with_parity
from ..protocol.telegrams import read_telegram, write_request_chars, write_telegram
from .jobs import MulticastJob, ReadJob
from .late_answers import Duplicates, PendingLateAnswers

__all__ = ["PreparedTelegram", "TelegramPreparer"]

APART_S = 0.04
APART_CHARS = 20
"""How long behind an answer its second copy has come whole, seconds and characters, if it comes
directly behind it."""

MAX_CACHED = 8192
"""Reads whose questions are kept; a line has at most 90 drives with some ten codes each."""


@dataclass(frozen=True, slots=True)
class PreparedTelegram:
    """A telegram ready to be sent.

    Args:
        ask: Bytes, expected answer, deadlines.
        quarantine_s: Silence wanted after it if its answer does not come, seconds.
        hold_s: How long the drive is left alone after it, seconds.
        thinking_s: For how long nothing can arrive after it was handed over, seconds.
        documented_s: The longest that manual and roster let the drive think, seconds.
        documented_ask: For a drive that is slower than documented, the same with the time-outs of
            one that is not; else None.
    """

    ask: Ask
    quarantine_s: float
    hold_s: float
    thinking_s: float
    documented_s: float
    documented_ask: Ask | None = None

    def cut_by(self, time_s: float) -> PreparedTelegram:
        """Wait for the answer for so much less: watchdogs leave no more (`Request.shorten`).

        It is never given up before manual and roster let the drive answer: what is cut off was
        measured, and this telegram may be of a code that is no slower than documented.
        """
        ask, least = self.ask, self.documented_ask
        if least is None:
            return self
        first_byte_s = max(ask.first_byte_s - time_s, least.first_byte_s)
        whole_s = max(ask.whole_s - time_s, least.whole_s)
        return replace(self, ask=replace(ask, first_byte_s=first_byte_s, whole_s=whole_s))


@dataclass(frozen=True, slots=True)
class _Kept:
    """The questions that read one code, one for each form that can, the preferred first."""

    slow: SlowAnswers
    telegrams: tuple[PreparedTelegram, ...]


class TelegramPreparer:
    """Makes the questions of one line.

    Args:
        timing: Baud rate and latencies.
        late_answers: Which answers may still come.
        duplicates: From which drive each answer was requested last.
    """

    def __init__(
        self, timing: LineTiming, late_answers: PendingLateAnswers, duplicates: Duplicates
    ) -> None:
        self._timing = timing
        self._late_answers = late_answers
        self._duplicates = duplicates
        self._reads: dict[tuple[Station, Code], _Kept] = {}
        self._parity = True
        self.apart_s = APART_S + APART_CHARS * timing.char_s
        self.gap_s = 5.0 * timing.char_s + timing.adapter_latency_s

    def opened(self, *, parity: bool) -> None:
        """A port was opened; telegrams carry even parity in bit 7 if `parity`."""
        if parity != self._parity:
            self._reads.clear()
        self._parity = parity

    def ask(self, job: Job, now_s: float, *, urgent: bool) -> PreparedTelegram | float:
        """Put the job's next step into a telegram.

        Args:
            job: What is to be done.
            now_s: The time.
            urgent: A stop: it is sent although late answers may still come.

        Returns:
            The telegram, or the time before which it may not be sent.
        """
        step = job.step
        if step.kind is StepKind.READ:
            return self._read(job, step, now_s)
        if isinstance(job, MulticastJob):
            return self._multicast(job, step)
        free_at = self._late_answers.blocked_until_s(ACK_FIELD, now_s)
        if free_at > now_s and not urgent:
            return free_at
        return self._write(job.station, step)

    def late_until_s(self, job: Job, now_s: float) -> float:
        """Return until when old answers keep a job's reading waiting; `now_s`: they do not."""
        found = self._free(job.station, job.step.code, now_s, job.step._replace(apart=False))
        return found if isinstance(found, float) else now_s

    def _read(self, job: Job, step: JobStep, now_s: float) -> PreparedTelegram | float:
        prepared = self._free(job.station, step.code, now_s, step)
        if type(prepared) is float and isinstance(job, ReadJob):
            for code in job.instead:
                other = self._free(job.station, code, now_s)
                if isinstance(other, PreparedTelegram):
                    job.step = JobStep(StepKind.READ, code)
                    return other
        return prepared

    def _free(
        self,
        station: Station,
        code: Code,
        now_s: float,
        step: JobStep | None = None,
    ) -> PreparedTelegram | float:
        """Find the form in which a code may be read now; else the time when one may be used."""
        free_at_s = math.inf
        telegrams = self._of_read(station, code)
        if step is not None and step.form is not None:
            field = encode_code(code, step.form)
            telegrams = tuple(sorted(telegrams, key=lambda one: one.ask.field != field))
            telegrams = telegrams[:1] if step.only else telegrams
        for prepared in telegrams:
            until_s = self._late_answers.blocked_until_s(prepared.ask.field, now_s)
            if step is not None and step.apart and self._duplicates.doubtful(now_s):
                field = prepared.ask.field
                other_s = self._duplicates.other_ended_s(field, station.name)
                until_s = max(until_s, other_s + self.apart_s)
                if code != address_code(station.family):  # another drive's is another value
                    until_s = max(until_s, self._duplicates.late_until_s(field, station.name))
            if until_s <= now_s:
                return prepared
            free_at_s = min(free_at_s, until_s)
        return free_at_s

    def _of_read(self, station: Station, code: Code) -> tuple[PreparedTelegram, ...]:
        kept, slow = self._reads.get((station, code)), station.measured.slow
        if kept is None or kept.slow is not slow:
            if len(self._reads) >= MAX_CACHED:
                self._reads.clear()
            forms = [form for form in station.forms if form.carries(code)]
            kept = _Kept(slow, tuple(self._to_read(station, code, form) for form in forms))
            self._reads[station, code] = kept
        return kept.telegrams

    def _to_read(self, station: Station, code: Code, form: AddressForm) -> PreparedTelegram:
        cost = read_cost(self._timing, station.family, code, form, station.answer_s(code))
        sent = self._on_the_wire(read_telegram(station.address, code, form))
        documented_s = station.documented_s(code)
        made = self._prepared(
            sent, encode_code(code, form), cost, hold_s=0.0, documented_s=documented_s
        )
        by_manual = read_cost(self._timing, station.family, code, form, station.answer_time_s)
        return _with_documented(made, cost, by_manual)

    def _write(self, station: Station, step: JobStep) -> PreparedTelegram:
        assert step.value is not None
        form = next(form for form in station.forms if form.carries(step.code))
        cost, by_manual = (
            write_cost(self._timing, station.family, step.code, step.value, form, answer_s)
            for answer_s in (station.answer_s(step.code, write=True), station.answer_time_s)
        )
        telegram = write_telegram(station.address, step.code, step.value, form)
        made = self._prepared(
            self._on_the_wire(telegram), ACK_FIELD, cost,
            hold_s=station.hold_s, documented_s=station.documented_s(step.code, write=True),
        )  # fmt: skip
        return _with_documented(made, cost, by_manual)

    def _multicast(self, job: MulticastJob, step: JobStep) -> PreparedTelegram:
        """The slowest member is left its processing time before anything else is sent."""
        assert step.value is not None
        form = next(form for form in job.station.forms if form.carries(step.code))
        telegram = write_telegram(job.station.address, step.code, step.value, form)
        char_s = self._timing.char_s
        request_s = write_request_chars(form, len(step.value.raw)) * char_s
        whole_s = request_s + self._timing.adapter_latency_s + job.processing_s
        ask = Ask(self._on_the_wire(telegram), b"", request_s, whole_s, whole_s, self.gap_s, char_s)
        return PreparedTelegram(ask, 0.0, 0.0, request_s, 0.0)

    def _prepared(
        self, sent: bytes, field: bytes, cost: Cost, *, hold_s: float, documented_s: float
    ) -> PreparedTelegram:
        ask = Ask(
            sent, field, cost.request_s, cost.first_byte_s, cost.whole_s, cost.gap_s,
            self._timing.char_s,
            cost.request_s + slow_from_s(documented_s) + self._timing.adapter_latency_s,
        )  # fmt: skip
        return PreparedTelegram(
            ask, cost.worst_s - cost.whole_s, hold_s, cost.request_s, documented_s
        )

    def _on_the_wire(self, telegram: bytes) -> bytes:
        return with_parity(telegram) if self._parity else telegram


def _with_documented(made: PreparedTelegram, cost: Cost, by_manual: Cost) -> PreparedTelegram:
    """Add the time-outs by manual and roster where the drive was measured to be slower."""
    if by_manual.first_byte_s >= cost.first_byte_s:
        return made
    ask = replace(made.ask, first_byte_s=by_manual.first_byte_s, whole_s=by_manual.whole_s)
    return replace(made, documented_ask=ask)
