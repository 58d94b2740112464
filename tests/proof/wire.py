"""What passes on the wire of one line, looked at with other means than the daemon's.

Every telegram that is handed to the port opens an exchange here, every byte that comes in is put to
the one that is open, and every report of the daemon must fit the exchange that it tells of:

* No two telegrams overlap: while the host speaks, its last telegram is out, and no drive speaks,
  thinks or has bytes on their way. After an exchange that was given up, a drive may.
* At most one exchange is open: the one before had its whole answer, or is reported as failed.
* No answer is taken for another exchange's: what is reported is what that drive did upon that
  telegram, as the drive itself remembers it. Noise alone may turn an answer into that of a drive
  without the code (see `simulator.faults`), and a stop may be ended by the late acknowledgement
  of a write that stayed without its own: it is not believed, but proven by a read (`shown`).
  Where answers get a wrong BCC as well, both may flip the same bit: no receiver sees that.
"""

from __future__ import annotations

import hashlib
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

from lecombus.fieldbus.lecom.protocol.exchange import EARLIEST_SHARE
from lecombus.fieldbus.lecom.protocol.telegrams import (
    AckAnswer,
    NakAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from lecombus.fieldbus.lecom.simulator.drive import SimDrive
from lecombus.fieldbus.lecom.simulator.families.f82xx import Drive82XX
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.fieldbus.requests import StepKind
from lecombus.schedule import Priority
from support.taps import STRIPPED

__all__ = ["Wire", "differ_by_a_bit", "is_whole"]

CHARACTER_BITS = 10
UNREPORTED = 2
"""At the end one exchange may be under way, and one's report put off until the next is said."""
NOT_REMEMBERED = (UnknownCodeAnswer, TransmissionErrorAnswer, NakAnswer)
"""What noise makes, in the answer or in the question: a drive remembers nothing of it."""
LATE_ANSWER_S = 0.5
"""So long an answer that was given up may still come, as the roster of every line says."""
_TIME = struct.Struct("<d")
STX, ETX, EOT, ACK, NAK = 2, 3, 4, 6, 21


@dataclass(slots=True)
class _Exchange:
    """A telegram and what came before the next one.

    Args:
        said_s: When it was handed to the port.
        drive: Whom it speaks to; None: a group, or nobody there.
        spoken_over: A drive was not through with it when the next telegram was said.
    """

    said_s: float
    drive: SimDrive | None
    heard: bytearray = field(default_factory=bytearray)
    spoken_over: bool = False


class Wire:
    """Watches the wire.

    Args:
        sim: The drives.
        clean: Whether every answer comes undamaged and in time.
        say: Told what did not hold.
        told_apart: Whether an answer can be told from a copy of another drive's.
        may_cancel: Whether noise and a wrong BCC may strike one answer.
    """

    def __init__(
        self, sim: SimLine, clean: bool, say: Callable[[str], None], *,
        told_apart: bool = True, may_cancel: bool = False,
    ) -> None:  # fmt: skip
        self._sim = sim
        self._clean = clean
        self._told_apart = told_apart
        self._may_cancel = may_cancel
        self._say = say
        self._open: _Exchange | None = None
        self._unreported: deque[_Exchange] = deque()
        self._drives = {drive.address: drive for drive in sim.drives}
        self._host_free_s = 0.0
        self._early_s = 0.0  # a late answer that comes in the last tenth ends a telegram's exchange
        self._unheard_until_s = 0.0  # an old acknowledgement may come until then
        self._log = hashlib.sha256()

    @property
    def digest(self) -> str:
        """Everything that was said and heard, and when, as one number."""
        return self._log.hexdigest()[:16]

    def said(self, data: bytes, now_s: float) -> None:
        """A telegram is handed to the port."""
        self._log.update(_TIME.pack(now_s) + b">" + data)
        if now_s < self._host_free_s - (0.0 if self._clean else self._early_s):
            self._say("a telegram was said while the one before was still going out")
        wire_s = len(data) * CHARACTER_BITS / self._sim.host_baud
        self._host_free_s = now_s + wire_s
        self._early_s = (1.0 - EARLIEST_SHARE) * wire_s
        before, busy = self._open, self._sim.under_way(now_s)
        if before is not None:
            before.spoken_over = busy
        if busy and self._clean:
            self._say("a telegram was said while a drive was not through with the one before")
        text = data.translate(STRIPPED)
        self._open = _Exchange(now_s, self._drives.get(int(text[1:3])))
        self._unreported.append(self._open)

    def heard(self, data: bytes, now_s: float) -> None:
        """Bytes come in."""
        self._log.update(_TIME.pack(now_s) + b"<" + data)
        if self._open is not None:
            self._open.heard += data

    def ended(self, report: ExchangeReport) -> None:
        """The daemon reports an exchange: the oldest that it has not reported yet."""
        result = report.result
        one = self._unreported.popleft() if self._unreported else None
        if one is None or one.said_s != result.started_s:
            self._say(f"an exchange with {report.drive} was reported that was not said then")
            return
        following = self._unreported[0] if self._unreported else None
        if following is not None and following.said_s < result.ended_s:
            self._say(f"the exchange with {report.drive} was open when the next one began")
        if result.kind is ResultKind.ANSWERED:
            self._judge_answer(one, report)
            old = one.said_s < self._unheard_until_s and isinstance(result.answer, AckAnswer)
            if old:  # this may have been the old one, and its own the next old one
                self._unheard_until_s = result.ended_s + LATE_ANSWER_S
        elif report.step.kind is StepKind.WRITE:
            self._unheard_until_s = result.ended_s + LATE_ANSWER_S

    def _judge_answer(self, one: _Exchange, report: ExchangeReport) -> None:
        whole = not one.spoken_over and is_whole(bytes(one.heard))
        if not (whole if self._clean else _has_come(one, report.result.answer)):
            self._say(f"{report.drive} is said to have answered, and it was not through")
        if one.drive is None or one.drive.address != report.address:
            self._say(f"an answer of nobody was taken for that of {report.drive}")
            return
        trap = not self._clean and isinstance(report.result.answer, NOT_REMEMBERED)
        again = not self._clean and self._is_not_believed(one, report)
        if self._told_apart and not trap and not again and not self._is_told(one, report):
            self._say(f"{report.drive} did not answer {report.result.answer} to {report.step}")

    def _is_told(self, one: _Exchange, report: ExchangeReport) -> bool:
        """Whether a drive remembers to have done upon this telegram what it is reported to.

        A drive that could not understand a telegram remembers nothing; it says so, and that is told
        apart from every answer judged here.
        """
        step, answer = report.step, report.result.answer
        assert one.drive is not None
        model = one.drive.model
        if isinstance(answer, AckAnswer) and isinstance(model, Drive82XX) and model.shortened():
            return step.kind is StepKind.WRITE  # it remembers the write when it has passed it on
        last = one.drive.log[-1] if one.drive.log else None
        if last is None or not one.said_s < last.time_s <= report.result.ended_s:
            return False
        same = (last.code, last.subcode) == (step.code.number, step.code.subcode)
        if isinstance(answer, ValueAnswer):
            said = last.text == answer.value.raw
            said = said or (self._may_cancel and differ_by_a_bit(last.text, answer.value.raw))
            return same and last.kind == "read" and last.accepted and said
        if isinstance(answer, AckAnswer | NakAnswer):
            accepted = isinstance(answer, AckAnswer)
            return same and last.kind == "write" and last.accepted is accepted
        if isinstance(answer, UnknownCodeAnswer):
            return same and step.kind is StepKind.READ and not last.accepted
        return False

    def _is_not_believed(self, one: _Exchange, report: ExchangeReport) -> bool:
        """Whether a stop took an acknowledgement that may be an old one, of any drive.

        Stops alone are said before an old answer can no longer come: theirs is proven by a read.
        """
        stop = report.priority is Priority.STOP and isinstance(report.result.answer, AckAnswer)
        return stop and one.said_s < self._unheard_until_s

    def end(self) -> None:
        """Look whether an exchange was forgotten."""
        if len(self._unreported) > UNREPORTED:
            self._say(f"{len(self._unreported)} exchanges were said and never reported")


def differ_by_a_bit(said: str, heard: str) -> bool:
    """Whether two texts differ in one bit of one character."""
    apart = [ord(one) ^ ord(other) for one, other in zip(said, heard, strict=False) if one != other]
    return len(said) == len(heard) and len(apart) == 1 and apart[0].bit_count() == 1


def _has_come(one: _Exchange, answer: object) -> bool:
    """Whether the bytes that came hold an answer; noise may stand before and behind it."""
    text = bytes(one.heard).translate(STRIPPED)
    if isinstance(answer, ValueAnswer):
        return answer.field + answer.value.raw.encode("ascii") + bytes((ETX,)) in text
    if isinstance(answer, TransmissionErrorAnswer):
        return answer.field + b"?" + bytes((ETX,)) in text
    return any(byte in text for byte in (ACK, NAK, EOT))


@lru_cache(maxsize=4096)
def is_whole(heard: bytes) -> bool:
    """Whether bytes are one whole answer and nothing else, by position alone."""
    text = heard.translate(STRIPPED)
    if text in (bytes((ACK,)), bytes((NAK,))):
        return True
    if text[:1] != bytes((STX,)):
        return False
    if text[-1:] == bytes((EOT,)) and ETX not in text:
        return True
    return text.find(ETX) == len(text) - 2
