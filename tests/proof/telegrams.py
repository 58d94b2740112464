"""Every telegram of one line as the drives see it: who was meant, when, and what came back.

Times are those of the wire, not those of the daemon: a telegram lasts from its first character to
its last, an answer from the moment the drive begins to speak. Whoever judges a telegram gets it
together with the one before it, once the daemon has reported it and its class is known.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from lecombus.fieldbus.lecom.simulator.drive import SimDrive
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.fieldbus.lecom.simulator.receiver import RequestReceiver
from lecombus.fieldbus.lecom.simulator.wire import read_code_field
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.schedule import Priority

__all__ = ["Telegram", "Telegrams"]

CHARACTER_BITS = 10


@dataclass(slots=True)
class Telegram:
    """One telegram of the host.

    Args:
        said_s: When its first character went out.
        end_s: When its last one did.
        address: Whom it is for; a multiple of ten is a group.
        code: Its code and subcode.
        text: What it writes; None: it reads.
        answer_end_s: When the drive it is for had spoken its answer; None: it did not speak.
        ended_s: When the daemon takes its exchange as ended; None: not reported yet.
        heard: Whether any byte came to the host before the next telegram.
        answered: Whether the daemon takes it as answered.
        busy_until_s: Until when the drive is busy with a write, as known when this one is said.
        priority: The class it ran in.
    """

    said_s: float
    end_s: float
    address: int
    code: tuple[int, int]
    text: str | None
    answer_end_s: float | None = None
    ended_s: float | None = None
    heard: bool = False
    answered: bool = False
    busy_until_s: float = 0.0
    priority: Priority = Priority.BACKGROUND

    @property
    def stop(self) -> bool:
        """Whether it belongs to a stop."""
        return self.priority is Priority.STOP

    @property
    def group(self) -> bool:
        """Whether it is a multicast."""
        return self.address % 10 == 0


class Telegrams:
    """Keeps the last telegrams of one line.

    Args:
        sim: Its drives.
    """

    def __init__(self, sim: SimLine) -> None:
        self._sim = sim
        self._listener = RequestReceiver(parity=sim.parity)
        self._last: Telegram | None = None
        self._unreported: deque[Telegram] = deque()
        self._before: Telegram | None = None
        sim.on_answer = self._spoke

    def said(self, data: bytes, now_s: float) -> Telegram:
        """Take a telegram that is handed to the port."""
        heard = self._listener.whole(data)
        assert heard is not None, f"{data!r} is not a telegram"
        number, subcode, _ = read_code_field(heard.field) or (-1, 0, False)
        end_s = now_s + len(data) * CHARACTER_BITS / self._sim.host_baud
        self._last = Telegram(now_s, end_s, heard.address, (number, subcode), heard.text)
        self._unreported.append(self._last)
        return self._last

    def heard(self) -> None:
        """Bytes came to the host."""
        if self._last is not None:
            self._last.heard = True

    def _spoke(self, drive: SimDrive, begin_s: float, end_s: float) -> None:
        for one in reversed(self._unreported):
            if one.end_s <= begin_s + 1e-9:
                if one.address == drive.address:
                    one.answer_end_s = end_s
                return

    def ended(self, report: ExchangeReport) -> tuple[Telegram | None, Telegram] | None:
        """Give the telegram that a report tells of, and the one before it."""
        if not self._unreported:
            return None
        one = self._unreported.popleft()
        one.priority = report.priority
        one.ended_s = report.result.ended_s
        one.answered = report.result.kind is ResultKind.ANSWERED
        before, self._before = self._before, one
        return before, one
