"""One exchange: a telegram that was sent, and what may be made of the bytes that come after it.

Theory of operation. The exchange loop begins an exchange at the moment it hands a telegram to
the port, feeds it every byte that arrives with the time of arrival, and asks at the deadline.
Between the two the exchange is in one phase::

    phase    bytes come                                        deadline passes
    -------  ------------------------------------------------  ----------------------------
    ECHO     match sent telegram: stay, all matched: WAIT      ECHO fault (nothing returned)
             differ: FOREIGN, the echo fault is remembered
    PROBE    first byte is that of the sent telegram: ECHO     NO_REPLY
             else: as WAIT
    WAIT     too early to be an answer: FOREIGN                NO_REPLY; after a NAK: ANSWERED
             the answer asked for: ends, ANSWERED
             a whole answer to something else: WAIT, counted
             NAK to a read: WAIT, for no longer than a pause
             a bad answer: FOREIGN; the beginning of one: ANSWER
    ANSWER   as WAIT                                           GARBLED (half an answer)
    FOREIGN  swallowed; after a pause: WAIT                    GARBLED, or ECHO if remembered

PROBE is how `echo: auto` finds out: the host's telegrams begin with EOT and no answer does, so
the first byte that returns shows it; it is kept only when the whole echo has come. A line that did
not echo so far may begin to, so it is found out again in each exchange. What cannot
be this exchange's answer is never handed up. A NAK to a read is one (CMVLC401A 6.1, and devices
of other makers), but a single byte is easily made by noise: it counts when a pause follows it.
After a bad answer the exchange goes on listening
until its deadline: the right answer may still come, and the line must fall silent anyway before
anyone speaks (EDB2102EN 8.3.5).

Silence is proven by looking. A process that was not run for a while finds bytes in its port and
does not know when they came, so the caller gives the time until which nothing had come:
a pause is one, and an answer a late one, only if the port was checked in between and was empty.
`look_s` says when to look. An answer found after its deadline counts as in time: it may have
arrived in time; `older_by_s` says how much older than it seems it may be.

Pure: time is an argument in seconds. Time-outs are given by the caller; retries, quarantine and
the meaning of an answer belong to `exchanges`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from lecombus.fieldbus.loop_interface import ResultKind

from .parser import AnswerParser
from .telegrams import (
    AckAnswer,
    Answer,
    BadAnswer,
    NakAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)

__all__ = ["ACK_FIELD", "Ask", "Exchange", "Result"]

ACK_FIELD = b"\x06"
"""Stands for "an acknowledgement" where a code field stands for "an answer to that code"."""

MAX_KEPT = 64
"""Bytes of unusable input kept for error reports."""

EARLIEST_SHARE = 0.9
"""An answer may begin after this share of the request's wire time: UART clocks differ by 5 %."""


@dataclass(frozen=True, slots=True)
class Ask:
    """What is expected after a telegram.

    Args:
        sent: The telegram's bytes as they go out, parity bits included.
        field: The code field a read's answer must repeat; `ACK_FIELD` for a write; empty for a
            multicast, which is not answered.
        request_s: Wire time of the telegram, seconds.
        first_byte_s: The answer must have begun this long after the start, seconds.
        whole_s: The answer must be complete this long after the start, seconds; for a multicast
            the time its members are left alone.
        gap_s: The longest pause inside an answer, seconds.
        char_s: Wire time of a character, seconds.
        late_s: An answer that begins later than this after the start is later than it should be.
    """

    sent: bytes
    field: bytes
    request_s: float
    first_byte_s: float
    whole_s: float
    gap_s: float
    char_s: float
    late_s: float = math.inf


@dataclass(slots=True)
class Result:
    """The result of an exchange; not to be changed (freezing would double the cost of making it).

    Args:
        kind: How it ended.
        answer: The drive's answer, when `kind` is ANSWERED.
        started_s: When the telegram was handed to the port.
        ended_s: When the answer was complete, or the deadline at which it was given up.
        fault: Why it failed, in words; empty when it did not.
        late: Whole answers to something else that came during the exchange.
        received: The first bytes that could not be used.
        clean: False when anything but echo and answer was heard.
        thought_s: From the end of the request to the first byte of the answer, what the adapter
            adds included; None: no answer, or not checked when it would have been late.
        older_by_s: How long after its last moment the exchange was ended, because the process did
            not run: what it brought may be so much older than `ended_s`.
        others: The code fields of those whole answers, `ACK_FIELD` for an acknowledgement.
    """

    kind: ResultKind
    started_s: float
    ended_s: float
    answer: Answer | None = None
    fault: str = ""
    late: int = 0
    received: bytes = b""
    clean: bool = True
    thought_s: float | None = None
    older_by_s: float = 0.0
    others: tuple[bytes, ...] = ()


class _Phase(Enum):
    ECHO = 0
    PROBE = 1
    WAIT = 2
    ANSWER = 3
    FOREIGN = 4


_ECHO, _PROBE, _WAIT, _ANSWER, _FOREIGN = _Phase
"""By themselves, for the way through `_Phase` costs 60 ns, and an exchange goes it ten times."""


class Exchange:
    """The state of the exchange under way; one object serves a line for all its exchanges.

    Args:
        parity: Bytes carry even parity in bit 7.
        echo: True or False where the roster says so, None to find out.

    Attributes:
        disturbed: Something came after which a silence counts: what is not the answer, or a NAK.
    """

    def __init__(self, *, parity: bool, echo: bool | None = None) -> None:
        self._parser = AnswerParser(parity=parity)
        self._finds_out = echo is None
        self.echo: bool | None = echo
        self._phase = _WAIT
        self._ask = Ask(b"", b"", 0.0, 0.0, 0.0, 0.0, 0.0)
        self.started_s = 0.0
        self._said_s = self._quiet_s = 0.0
        self._earliest_s = 0.0
        self._last_byte_s = self._answer_at_s = self._before_s = 0.0
        self._echo_at = 0
        self._echo_fault = ""
        self._fault = ""
        self._late = 0
        self._others: list[bytes] = []
        self._kept = bytearray()
        self._takes_nak = True
        self._refused = False
        self.disturbed = False

    def begin(
        self, ask: Ask, now_s: float, said_s: float | None = None, *, takes_nak: bool = True
    ) -> None:
        """Start an exchange whose telegram is handed to the port.

        Args:
            ask: The telegram, and what is expected after it.
            now_s: Before it was handed over.
            said_s: After that, from when on its answer is waited for; None: immediately.
            takes_nak: A NAK may be a read's answer: none of an earlier exchange may still come.
        """
        self._ask = ask
        self._takes_nak, self._refused = takes_nak, False
        self.started_s = self._last_byte_s = now_s
        self._said_s = self._quiet_s = now_s if said_s is None else said_s
        self._earliest_s = now_s + EARLIEST_SHARE * ask.request_s
        self._echo_at = 0
        self._echo_fault = self._fault = ""
        self._late = 0
        if self._others:
            self._others.clear()
        self.disturbed = False
        if self._kept:
            self._kept.clear()
        self._parser.reset()
        if self.echo:
            self._phase = _ECHO
        else:
            self._phase = _PROBE if self._finds_out else _WAIT

    def feed(self, data: bytes, now_s: float, quiet_s: float | None = None) -> Result | None:
        """Take bytes that arrived.

        Args:
            data: The bytes, parity bits included.
            now_s: When they were read.
            quiet_s: When the port was last looked at and nothing was there; None: just now.

        Returns:
            The result when the exchange has ended with its answer, else None.
        """
        self._quiet_s = now_s if quiet_s is None else quiet_s
        paused = self._quiet_s - self._last_byte_s > self._ask.gap_s
        self._last_byte_s = now_s
        if self._phase is not _WAIT and (paused or self._phase is not _ANSWER):
            data = self._not_of_the_answer(data, paused)
            if not data:
                return None
        if now_s < self._earliest_s or not self._ask.field:
            self._reject(data, "bytes came that nobody asked for")
            return None
        if self._phase is _WAIT:
            self._answer_at_s, self._before_s = now_s, self._quiet_s
        return self._parse(data, now_s)

    def _not_of_the_answer(self, data: bytes, paused: bool) -> bytes:
        """Take off what is echo or foreign; give what may be the answer or more of it."""
        if self._phase is _PROBE or self._phase is _ECHO:
            data = self._match_echo(data)
            if not data:
                return b""
        if self._phase is _FOREIGN or self._phase is _ANSWER:
            if paused:
                self._start_over()
            elif self._phase is _FOREIGN:
                self._keep(data)
                return b""
        return data

    def deadline_s(self) -> float:
        """When to call `expire`: it moves while an answer is coming in."""
        ask = self._ask
        if not ask.field:
            return self._said_s + ask.whole_s
        first = self._said_s + ask.first_byte_s
        if self._phase is not _ANSWER:
            if self._refused and self._phase is _WAIT:
                return min(first, self._last_byte_s + ask.gap_s)
            return first
        # Never later, however slowly characters come in: costs and bounds count on it.
        return max(first, min(self._last_byte_s + ask.gap_s, self._said_s + ask.whole_s))

    def look_s(self) -> float:
        """When to look at the port next: at the deadline, or before it where a silence counts."""
        if self._phase is _FOREIGN:
            look_s = self._last_byte_s + self._ask.gap_s
        else:
            look_s = self._said_s + self._ask.late_s
        deadline_s = self.deadline_s()
        return look_s if self._quiet_s < look_s < deadline_s else deadline_s

    def hasten(self, ask: Ask) -> None:
        """Wait no longer than by another ask for the same, unless the answer is coming in."""
        if self._phase is not _ANSWER:
            self._ask = ask

    def expire(self, now_s: float) -> Result | None:
        """End the exchange if its deadline has passed; the port was looked at just now.

        Returns:
            The result, or None when `deadline_s` has moved on.
        """
        self._quiet_s = now_s
        if now_s < self.deadline_s():
            return None
        if self._refused and self._phase is _WAIT and not self._fault:
            if self.echo is None:
                self.echo = False
            return self._result(ResultKind.ANSWERED, now_s, NakAnswer())
        kind, fault = self._verdict()
        return self._result(kind, now_s, None, fault)

    def lost(self, now_s: float) -> Result:
        """End the exchange because the port went away."""
        return self._result(ResultKind.LOST, now_s, None, "the line was lost during the exchange")

    def _verdict(self) -> tuple[ResultKind, str]:
        if self._echo_fault:
            return ResultKind.ECHO, self._echo_fault
        if self._phase is _ECHO:
            came = f"only {self._echo_at} of {len(self._ask.sent)} bytes" if self._echo_at else "no"
            return ResultKind.ECHO, f"{came} echo came back: adapter or wire is broken"
        if not self._ask.field:
            return ResultKind.SENT, ""
        if self._phase is _ANSWER:
            self._keep(self._parser.pending)
            return ResultKind.GARBLED, "the answer broke off"
        if self._fault:
            return ResultKind.GARBLED, self._fault
        return ResultKind.NO_REPLY, "no answer in time"

    def _result(
        self, kind: ResultKind, now_s: float, answer: Answer | None, fault: str = ""
    ) -> Result:
        clean = not (self._fault or self._echo_fault or self._late)
        kept = bytes(self._kept) if self._kept else b""
        ask, thought_s = self._ask, None
        last_s = self._said_s + ask.whole_s
        if answer is not None:
            late_s = self._said_s + ask.late_s
            if self._answer_at_s <= late_s or self._before_s >= late_s:
                thought_s = self._answer_at_s - self._said_s - ask.request_s
        elif ask.field:
            last_s = self.deadline_s()
        return Result(
            kind, self.started_s, now_s, answer, fault, self._late, kept, clean, thought_s,
            now_s - last_s if now_s > last_s else 0.0, tuple(self._others),
        )  # fmt: skip

    def _match_echo(self, data: bytes) -> bytes:
        sent = self._ask.sent
        if self._phase is _PROBE:
            if data[0] != sent[0]:
                self._phase = _WAIT
                return data
            self._phase = _ECHO
        due = sent[self._echo_at : self._echo_at + len(data)]
        if data[: len(due)] != due:
            self._echo_fault = "the echo differs from what was sent: a collision or a broken line"
            self._phase = _FOREIGN
            self.disturbed = True
            self._keep(data)
            return b""
        self._echo_at += len(due)
        if self._echo_at == len(sent):
            self._phase = _WAIT
            self.echo = True
        return data[len(due) :]

    def _parse(self, data: bytes, now_s: float) -> Result | None:
        while True:
            answer = self._parser.feed(data)
            if answer is None:
                self._phase = _ANSWER
                return None
            if type(answer) is BadAnswer:
                self._reject(answer.received, f"the answer is bad: {answer.fault.value}")
                return None
            if self._fits(answer):
                self._late += self._refused  # the NAK before it was not the answer
                return self._accept(answer, now_s)
            if self._is_refusal(answer):
                self._refused = self.disturbed = True
            else:
                self._late += 1 + self._refused
                self._others.append(getattr(answer, "field", ACK_FIELD))
                self._refused = False
            data = self._parser.tail
            self._parser.reset()
            self._phase = _WAIT
            if not data:
                return None

    def _fits(self, answer: Answer) -> bool:
        field = self._ask.field
        if field == ACK_FIELD:
            return type(answer) is AckAnswer or type(answer) is NakAnswer
        if type(answer) is ValueAnswer:  # nearly always; the union below is made at every call
            return answer.field == field
        if isinstance(answer, UnknownCodeAnswer | TransmissionErrorAnswer):
            return answer.field == field
        return False

    def _is_refusal(self, answer: Answer) -> bool:
        """Whether a read was answered by a NAK that stands alone so far."""
        if type(answer) is not NakAnswer or self._ask.field == ACK_FIELD or not self._takes_nak:
            return False
        return not (self._parser.tail or self._fault or self._late or self._refused)

    def _accept(self, answer: Answer, now_s: float) -> Result | None:
        """End with the answer, unless other bytes came with it.

        A single byte is easily made by noise, so an acknowledgement among others proves nothing;
        and a value with bytes behind its BCC may be one whose middle was damaged into an ETX.
        """
        if self._parser.tail or (self._fault and self._ask.field == ACK_FIELD):
            self._reject(self._parser.tail, "bytes came with the answer that do not belong to it")
            return None
        if self.echo is None:
            self.echo = False
        return self._result(ResultKind.ANSWERED, now_s, answer)

    def _reject(self, data: bytes, fault: str) -> None:
        self._fault = self._fault or fault
        self._phase = _FOREIGN
        self.disturbed = True
        self._keep(data)

    def _start_over(self) -> None:
        if self._phase is _ANSWER:
            self._fault = self._fault or "the answer broke off"
            self._keep(self._parser.pending)
        self._parser.reset()
        self._phase = _WAIT

    def _keep(self, data: bytes) -> None:
        self._kept += data[: MAX_KEPT - len(self._kept)]
