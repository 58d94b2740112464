"""Receives between exchanges, and decides how long the line stays quiet for a late answer.

After an exchange without its answer there is always a quarantine (`bus_idle`). If `extended_listen`
asks for it, the quarantine is extended until the answer of a very slow drive would have come. That
delays cyclic reads of other drives by up to a second, and nothing else. The extension begins only
if every watchdog can still be fed in time after it. It ends when anything but cyclic and background
work needs the line: a stop, a control word, an urgent feed, a client's request. The next telegram
begins with EOT, which makes a drive drop an answer that it has not sent yet (EDB2102EN 8.3). Late
replies stay pending, and the quarantine lasts, as long as without the extension.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.reports import ResultKind
from lecombus.fieldbus.station import Station
from lecombus.line.bus_idle import BusIdleTimer
from lecombus.parameters import Code
from lecombus.schedule import Priority, Request, Schedule
from lecombus.schedule.shares import LISTEN_S

from .duplicates import Duplicates
from .extended_listen import ExtendedListen
from .jobs import ReadJob
from .late_replies import PendingLateReplies
from .prepared_telegrams import PreparedTelegram
from .unsolicited_bytes import UnsolicitedBytes

__all__ = ["IdleReceive"]

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
        late_replies: Which answers may still come.
        over: Called when the line may send earlier than announced.
        duplicates: Records answers without an open request.
    """

    def __init__(
        self,
        schedule: Schedule,
        bus_idle: BusIdleTimer,
        late_replies: PendingLateReplies,
        over: Callable[[], None],
        duplicates: Duplicates,
    ) -> None:
        self._over = over
        self._schedule = schedule
        self._bus_idle = bus_idle
        self._late_replies = late_replies
        self._unsolicited = UnsolicitedBytes(late_replies, duplicates.came)
        self._extended_listen = ExtendedListen()
        self._awaited: _Awaited | None = None

    @property
    def is_on(self) -> bool:
        """Whether an answer is listened for: `quiet_until_s` must be asked before the next word."""
        return self._awaited is not None

    def opened(self, now_s: float, *, parity: bool) -> None:
        """A port was opened; bytes carry even parity in bit 7 if `parity`."""
        self._awaited = None
        self._unsolicited.parity = parity
        self._bus_idle.opened(now_s)

    def stray(self, data: bytes, now_s: float, gap_s: float) -> bool:
        """Process unsolicited bytes; return whether they completed a late answer."""
        awaited = self._awaited
        late = self._unsolicited.feed(data, now_s)
        if late and awaited is not None:
            self._extended_listen.heard(now_s)
            self._end(now_s)
            self._over()
        over = late and not self._late_replies.any(now_s)
        self._bus_idle.heard(now_s, gap_s, nothing_in_doubt=over)
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
        asked = self._late_replies.asked(prepared.ask.field, now_s)
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
