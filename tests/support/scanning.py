"""A scan carried out on a simulated line in computed time, without port and worker.

What the worker makes of bytes is made here in the plainest way: the first whole answer that
repeats the question's code counts, everything else is a disturbance.
"""

from __future__ import annotations

from collections.abc import Awaitable
from typing import TypeVar

from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.parser import AnswerParser
from lecombus.fieldbus.lecom.protocol.telegrams import (
    BadAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from lecombus.fieldbus.lecom.scanning import Heard, HeardKind, Question
from lecombus.fieldbus.lecom.simulator import SimLine
from support.sim_host import Host, read_telegram

PATIENCE_S, PATIENT_S, PAUSE_S = 0.13, 0.65, 0.06

T = TypeVar("T")


def run_now(work: Awaitable[T]) -> T:
    """Run a coroutine to its end that waits for nothing but computed time."""
    steps = work.__await__()
    try:
        next(steps)
    except StopIteration as end:
        result: T = end.value
        return result
    raise AssertionError("it waits for something")


class ScannedLine:
    """Says what a scan wants said.

    Args:
        line: The line.

    Attributes:
        asked: Every question.
        writes: How many requests were not reads.
    """

    def __init__(self, line: SimLine) -> None:
        self.line = line
        self.host = Host(line)
        self.asked: list[Question] = []
        self.writes = 0
        self.disturbances = 0
        line.on_request = lambda _, heard: self._count(heard.text)

    def _count(self, text: str | None) -> None:
        self.writes += text is not None

    def run(self, work: Awaitable[T]) -> T:
        """Carry out a scan, or a part of it, to its end."""
        return run_now(work)

    async def ask(self, ask: Question) -> Heard:
        return self.hear(ask)

    async def listen(self, baud: int, for_s: float) -> Heard:
        self.line.host_baud = baud
        return Heard(HeardKind.SILENCE, received=self.host.hear(until_s=self.host.now_s + for_s))

    def hear(self, step: Question) -> Heard:
        host = self.host
        self.line.host_baud = step.baud
        self.asked.append(step)
        extended = step.form is Form.EXTENDED
        number, subcode = step.code.number, step.code.subcode
        host.say(read_telegram(step.address, number, subcode, extended=extended))
        slow = 0.6 if 1920 <= number <= 1923 and step.family != "generic" else 0.0
        patience_s = (PATIENT_S if step.patient else PATIENCE_S) + slow + 450.0 / step.baud
        received = host.hear(until_s=host.now_s + patience_s)
        late = host.hear(until_s=host.now_s + PAUSE_S)
        heard = self._heard(received, encode_code(step.code, step.form))
        self.disturbances += bool(late) or heard.kind is HeardKind.GARBLED
        return Heard(heard.kind, heard.value, heard.received + late, self.disturbances)

    def _heard(self, received: bytes, field: bytes) -> Heard:
        if not received:
            return Heard(HeardKind.SILENCE)
        answer = AnswerParser(parity=True).feed(received)
        if answer is None or isinstance(answer, BadAnswer):
            return Heard(HeardKind.GARBLED, received=received)
        if getattr(answer, "field", b"") != field:
            self.disturbances += 1
            return Heard(HeardKind.SILENCE, received=received)
        if isinstance(answer, ValueAnswer):
            return Heard(HeardKind.VALUE, answer.value)
        if isinstance(answer, UnknownCodeAnswer):
            return Heard(HeardKind.NO_SUCH_CODE)
        assert isinstance(answer, TransmissionErrorAnswer)
        return Heard(HeardKind.TRANSMISSION_ERROR)
