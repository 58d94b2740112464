"""Between two exchanges: when the bus may be used again, and what is received.

After each answer the turnaround is kept. After an exchange without its answer nothing is sent for
30 ms and twice the adapter's latency (quarantine): an adapter delivers what it still holds. An
answer may come later than that; `late_answers` deals with it. Bytes received during the quarantine
extend it, up to a limit: otherwise a line with constant noise would never send again
(`BusIdleTimer`).

What comes between two exchanges (`UnsolicitedBytes`: late answers, noise, another device; their
metric is `stray_bytes`) is never used as a value. A complete read answer that was pending ends that
wait: a request with the same answer may be sent again. If it was the only pending one, it also
measures how slow its drive is (`drives.measured`).

A drive far slower than its manual would never be received on a busy line: the next telegram cancels
its answer before it begins. So after a cyclic read or a probe without answer, several times in a
row (`ExtendedListen`), the quarantine is extended for up to a second, until such an answer would
have come. That delays cyclic reads of other drives, and nothing else. The extension begins only if
every watchdog can still be fed in time after it. It ends when anything but cyclic and background
work needs the line: a stop, a control word, an urgent feed, a client's request. The next telegram
begins with EOT, which makes a drive drop an answer that it has not sent yet (EDB2102EN 8.3). Late
answers stay pending, and the quarantine lasts, as long as without the extension.

Limits: once a minute for a line, once in five minutes for a code of a drive, and less often while
nothing arrives, because the drive is usually absent. A second time in the same minute is allowed
after a late answer, because one late answer alone proves nothing.

Source: EDB2102EN 8.3.5 (time monitoring).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from lecombus.fieldbus.lecom.exchanges.jobs import ReadJob
from lecombus.fieldbus.lecom.exchanges.late_answers import (
    Duplicates,
    PendingLateAnswers,
    UnansweredRead,
)
from lecombus.fieldbus.lecom.exchanges.prepared_telegrams import PreparedTelegram
from lecombus.fieldbus.lecom.protocol.exchange import ACK_FIELD, Result
from lecombus.fieldbus.lecom.protocol.parser import AnswerParser
from lecombus.fieldbus.lecom.protocol.telegrams import (
    MAX_ANSWER_CHARS,
    BadAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.fieldbus.requests import Station
from lecombus.parameters import Code
from lecombus.schedule import Priority, Request, Schedule
from lecombus.schedule.shares import LISTEN_EVERY_S, LISTEN_S

__all__ = ["BusIdleTimer", "ExtendedListen", "IdleReceive", "UnsolicitedBytes"]

AFTER_OPEN_S = 0.05
"""Least quarantine after opening a port, seconds: bytes that an adapter had buffered are dropped.
Where the adapter may take longer it is twice its latency: to the server and back."""

LONGEST_CHATTER_S = 1.0
"""Limit of the delay by unsolicited bytes, seconds; longer than any late answer."""


class BusIdleTimer:
    """Calculates when one line may send; times are arguments.

    Args:
        turnaround_s: Least pause between the end of an answer and the next telegram, seconds.

    Attributes:
        turnaround_s: As given.
        free_at_s: End of the turnaround; nothing is sent before it.
        quiet_until_s: End of the quarantine; only a stop is sent before it.
    """

    def __init__(self, turnaround_s: float) -> None:
        self.turnaround_s = turnaround_s
        self._chatter_ends_s = 0.0
        self._least_until_s = 0.0  # without extended listen
        self._heard_s = self._gave_up_s = -LONGEST_CHATTER_S
        self.free_at_s = 0.0
        self.quiet_until_s = 0.0

    def is_over(self, now_s: float) -> bool:
        """Whether there is no quarantine; the turnaround may still run."""
        return now_s >= self.quiet_until_s

    def opened(self, now_s: float, latency_s: float) -> None:
        """A port was opened; its adapter may add so much to an answer."""
        self._quarantine(now_s, max(AFTER_OPEN_S, 2.0 * latency_s))

    def exchange_ended(self, ended_s: float) -> None:
        """An exchange ended, with or without its answer."""
        self.free_at_s = ended_s + self.turnaround_s

    def answer_missing(self, ended_s: float, quarantine_s: float) -> None:
        """It ended without its answer."""
        self._quarantine(ended_s, quarantine_s)

    def draw_out(self, until_s: float) -> None:
        """Extend the quarantine, to receive an answer that is very late."""
        self.quiet_until_s = until_s
        self._chatter_ends_s = until_s + LONGEST_CHATTER_S

    def cut_short(self, at_s: float) -> None:
        """End the extension at this time at the latest."""
        self.quiet_until_s = min(self.quiet_until_s, max(at_s, self._least_until_s))

    def give_up(self, now_s: float) -> None:
        """End the quarantine although bytes still come: they are longer than any answer.

        The EOT of the next telegram stops the drive that sends them (EDB2102EN 8.3). If that was
        tried within the last second, the drive does not receive it, and the quarantine is kept.
        """
        if now_s - self._gave_up_s < LONGEST_CHATTER_S:
            return
        self._gave_up_s = now_s
        self.quiet_until_s = self._least_until_s = self._chatter_ends_s = now_s

    def _quarantine(self, from_s: float, for_s: float) -> None:
        self.quiet_until_s = self._least_until_s = from_s + for_s
        self._chatter_ends_s = self.quiet_until_s + LONGEST_CHATTER_S

    def heard(self, now_s: float, gap_s: float, *, none_is_late: bool) -> None:
        """Bytes came outside an exchange.

        Args:
            now_s: When.
            gap_s: They end with a gap of this length, seconds.
            none_is_late: They completed the last late answer: the quarantine may end.
        """
        if now_s - self._heard_s > gap_s:
            self._chatter_ends_s = max(self._chatter_ends_s, now_s + LONGEST_CHATTER_S)
        self._heard_s = now_s
        over_s = now_s + gap_s
        wanted_s = over_s if none_is_late else max(self.quiet_until_s, over_s)
        self.quiet_until_s = min(wanted_s, self._chatter_ends_s)
        self._least_until_s = min(max(self._least_until_s, over_s), self.quiet_until_s)


class UnsolicitedBytes:
    """Listens between exchanges.

    Args:
        late_answers: Is updated when a late answer has come.
        duplicates: Is told of each late answer, and of each that is not missing.
    """

    def __init__(
        self,
        late_answers: PendingLateAnswers,
        duplicates: Duplicates,
    ) -> None:
        self._late_answers = late_answers
        self._duplicates = duplicates
        self._parser = AnswerParser(parity=True)
        # Asked last, and listened for since.
        self.awaited: tuple[bytes, UnansweredRead] | None = None
        self.bytes_total = 0
        self.ends_answer = False  # the last bytes, of a whole or a damaged one
        self._begun_at = 0

    def opened(self, *, parity: bool) -> None:
        """A port was opened; bytes carry even parity in bit 7 if `parity`."""
        self._parser = AnswerParser(parity=parity)
        self.awaited = None

    def begin(self) -> None:
        """Start again: an exchange has just been given up."""
        self._begun_at = self.bytes_total
        self._parser.reset()

    @property
    def is_endless(self) -> bool:
        """Whether more has come since an exchange was given up than any answer is long."""
        return self.bytes_total - self._begun_at > MAX_ANSWER_CHARS

    def feed(self, data: bytes, now_s: float) -> bool:
        """Process unsolicited bytes.

        Args:
            data: The bytes, parity bits included.
            now_s: When they came.

        Returns:
            Whether they completed a whole late answer.
        """
        self.bytes_total += len(data)
        answer = self._parser.feed(data)
        self.ends_answer = answer is not None
        if answer is None:
            return False
        self._parser.reset()
        if isinstance(answer, BadAnswer):
            return False
        if isinstance(answer, ValueAnswer | UnknownCodeAnswer | TransmissionErrorAnswer):
            self._measure(answer.field, now_s)
            if self._late_answers.resolve(answer.field, now_s):
                self._duplicates.late_came(answer.field)
            else:
                self._duplicates.came(answer.field, now_s)
        elif self._late_answers.blocked_until_s(ACK_FIELD, now_s) <= now_s:
            self._duplicates.came(ACK_FIELD, now_s)
        return True

    def _measure(self, field: bytes, now_s: float) -> None:
        """Let a drive know its own slowness, where it is certain whose answer this is.

        The end of the answer is taken for its beginning: a time-out may rather be too long.
        """
        asked = self._late_answers.sole(field, now_s)
        if self.awaited is not None:  # nothing was sent since, however long ago that was
            asked = self.awaited[1] if self.awaited[0] == field else None
        if asked is not None:
            station, code = asked.station, asked.code
            late_s = now_s - asked.said_s
            station.measured.note_late(code, station.documented_s(code), late_s, now_s)


CUT_S: Final = 2.0
"""After an interrupted extended listen the next one waits at least this long, seconds."""
MISSES: Final = 3
CODE_EVERY_S: Final = 300.0
CODE_EVERY_MOST_S: Final = 3600.0
MOST_RUNS: Final = 512


@dataclass(slots=True)
class _Run:
    """The misses of one code of one drive since it was last answered in time."""

    since_s: float
    misses: int = 0
    next_s: float = 0.0
    every_s: float = CODE_EVERY_S


class ExtendedListen:
    """Counts missing answers and extended listens."""

    def __init__(self) -> None:
        self._runs: dict[tuple[str, Code], _Run] = {}
        self._next_s = 0.0
        self._heard = False  # something, the last time

    def wanted(self, station: Station, code: Code, now_s: float) -> bool:
        """Count a read without answer; return whether to extend the receive time for it."""
        key = (station.name, code)
        run = self._runs.get(key)
        answered_s = station.measured.answered_s(code)
        if run is None or (answered_s is not None and answered_s > run.since_s):
            if len(self._runs) >= MOST_RUNS:
                self._runs.clear()
            run = self._runs[key] = _Run(now_s)
        run.misses += 1
        return run.misses >= MISSES and now_s >= max(run.next_s, self._next_s)

    def in_vain(self, station: Station, code: Code, now_s: float) -> None:
        """Record that the whole extended time passed without an answer."""
        run = self._runs.get((station.name, code))
        if run is not None:
            run.next_s = now_s + run.every_s
            run.every_s = min(2.0 * run.every_s, CODE_EVERY_MOST_S)
        self._next_s = now_s + LISTEN_EVERY_S
        self._heard = False

    def cut(self, now_s: float) -> None:
        """Record that an urgent request ended the extended time."""
        self._next_s = now_s + CUT_S

    def heard(self, now_s: float) -> None:
        """Record that the late answer came."""
        if self._heard:
            self._next_s = now_s + LISTEN_EVERY_S
        self._heard = not self._heard


LEAST_S = 0.02
"""Less than this on top of the quarantine is not worth it, seconds."""


@dataclass(frozen=True, slots=True)
class _Awaited:
    """The answer that is listened for."""

    station: Station
    code: Code
    since_s: float
    until_s: float


class IdleReceive:
    """Listens between the exchanges of one line.

    Args:
        schedule: Asked what wants the line.
        bus_idle: Keeps the pauses.
        late_answers: Which answers may still come.
        over: Called when the line may send earlier than announced.
        duplicates: Records answers without an open request.
    """

    def __init__(
        self,
        schedule: Schedule,
        bus_idle: BusIdleTimer,
        late_answers: PendingLateAnswers,
        over: Callable[[], None],
        duplicates: Duplicates,
    ) -> None:
        self._over = over
        self._schedule = schedule
        self._bus_idle = bus_idle
        self._late_answers = late_answers
        self._unsolicited = UnsolicitedBytes(late_answers, duplicates)
        self._extended_listen = ExtendedListen()
        self._awaited: _Awaited | None = None

    @property
    def is_on(self) -> bool:
        """Whether an answer is listened for: `quiet_until_s` must be asked before the next word."""
        return self._awaited is not None

    def opened(self, now_s: float, latency_s: float, *, parity: bool) -> None:
        """A port was opened; bytes carry even parity in bit 7 if `parity`."""
        self._awaited = None
        self._unsolicited.opened(parity=parity)
        self._bus_idle.opened(now_s, latency_s)

    def unsolicited(self, data: bytes, now_s: float, gap_s: float) -> bool:
        """Process unsolicited bytes; return whether they completed a late answer."""
        awaited = self._awaited
        late = self._unsolicited.feed(data, now_s)
        if late and awaited is not None:
            self._extended_listen.heard(now_s)
            self._end(now_s)
            self._over()
        over = late and not self._late_answers.any(now_s)
        if self._unsolicited.ends_answer:  # a stop does not wait for it: the plan promises that
            gap_s = max(gap_s, self._bus_idle.turnaround_s)
        self._bus_idle.heard(now_s, gap_s, none_is_late=over)
        if self._unsolicited.is_endless:
            self._unsolicited.begin()
            self._bus_idle.give_up(now_s)
            self._over()
        return late

    def missed(
        self, request: Request, job: object, prepared: PreparedTelegram, result: Result
    ) -> None:
        """Keep the quarantine after an answer that did not come, or listen longer.

        Args:
            request: What was asked for.
            job: Its job.
            prepared: How it was asked.
            result: How the exchange ended.
        """
        now_s, until_s = result.ended_s, result.started_s + LISTEN_S
        self._unsolicited.begin()
        self._bus_idle.answer_missing(now_s, prepared.quarantine_s)
        if result.kind is not ResultKind.NO_REPLY or type(job) is not ReadJob:
            return
        if request.source is None and request.priority is not Priority.INTERACTIVE:
            return
        if not self._extended_listen.wanted(job.station, job.step.code, now_s):
            return
        since_s = now_s + prepared.quarantine_s
        asked = self._late_answers.asked(prepared.ask.field, now_s)
        if asked is None or until_s < since_s + LEAST_S:
            return
        if self._schedule.may_idle(now_s, until_s - now_s):
            self._awaited = _Awaited(job.station, job.step.code, since_s, until_s)
            self._unsolicited.awaited = (prepared.ask.field, asked)
            self._bus_idle.draw_out(until_s)

    def quiet_until_s(self, now_s: float, *, stop_goes: bool) -> float:
        """Return when to call again: at the end of the quarantine, or to check for urgent work."""
        awaited = self._awaited
        if awaited is None:
            return self._bus_idle.quiet_until_s
        if now_s < awaited.since_s and not stop_goes:
            return awaited.since_s
        if now_s >= awaited.until_s:
            self._extended_listen.in_vain(awaited.station, awaited.code, now_s)
        elif not stop_goes:
            wanted_s = self._schedule.wanted_at_s(now_s)
            if wanted_s > now_s:
                return min(wanted_s, awaited.until_s)
            self._extended_listen.cut(now_s)
        self._end(now_s)
        return self._bus_idle.quiet_until_s

    def _end(self, now_s: float) -> None:
        assert self._awaited is not None
        self._bus_idle.cut_short(now_s)
        self._awaited = self._unsolicited.awaited = None
