"""Putting a request into the line and waiting for its end, for everything inside lecombus.

The supervisor and the operations that users start both wait here. Cancelling the wait drops the
result and never a telegram: a request that still waits in the schedule runs or expires as it
would have. Only a write whose client has closed its connection before it was sent is withdrawn
(`IS_GONE`, ADR 56).
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from typing import Final

from lecombus.drive_state.drive_runtime import LineDrives
from lecombus.drive_state.readings import DriveState
from lecombus.drives.stops import asks_to_stop
from lecombus.errors import (
    CutReplyError,
    ExchangeError,
    LecombusError,
    LineError,
    NakError,
    OperationError,
    UnknownCodeError,
)
from lecombus.fieldbus.requests import ReadWork, RequestMaker, Station
from lecombus.line.worker import LineWorker
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority, Request
from lecombus.schedule.request import CLIENT_GONE, LEASE_ENDED, STOPPED

__all__ = [
    "CAME_S",
    "HELD_FROM_S",
    "IS_GONE",
    "SILENCED_REMEDY",
    "Ending",
    "Requests",
    "client_check",
    "is_of_the_line",
    "refuse_for_gone_client",
]


CAME_S: ContextVar[float | None] = ContextVar("came_s", default=None)
"""When what is being done was asked for, monotonic seconds; None: just now. A request may wait for
its turn before anything is done about it, and a stop that comes before that ends it too."""

HELD_FROM_S: ContextVar[float | None] = ContextVar("held_from_s", default=None)
"""From when on what is being done waited for its followers (`actions`), monotonic seconds; None: it
did not. A plain write that stops the drive does not wait for them and came first, though it was
asked for later: it ends what waited, as it would have stopped what was sent before it."""

WRITE_TRIES: Final = 3
"""How often `write_to_the_end` writes."""

NAK_READS: Final = 3
"""A drive that refuses a code so often in a row does not have it: no noise makes that many NAKs."""

OWN_READS: Final = 3
"""So many values a code may show until one is read again and is certain to be the drive's own."""

BACK_WITHIN_S: Final = 300.0
"""A drive that fell silent less than so long ago is expected back, seconds."""

IS_GONE: ContextVar[Callable[[], bool] | None] = ContextVar("IS_GONE", default=None)
"""Says whether the client that asked for what is being done has closed its connection; None: there
is no such client."""


def refuse_for_gone_client(drive: str) -> None:
    """Begin nothing for a client that has left: no motor may start for a person who gave up.

    Raises:
        OperationError: `client-gone`.
    """
    is_gone = IS_GONE.get()
    if is_gone is not None and is_gone():
        text = "the client closed its connection: nothing was sent"
        raise OperationError(text, kind="client-gone", drive=drive)


def client_check(station: Station, code: Code, wire: Value) -> Callable[[], bool] | None:
    """Give what withdraws a write that waits when its client leaves; None for one that stops."""
    return None if asks_to_stop(station.family, code, wire) else IS_GONE.get()


SILENCED_REMEDY: Final = (
    "nothing was sent; requests are sent to it again once a lease is held for it and its watchdog "
    "has had its time"
)
"""What is said to those who ask a silenced drive for something."""


class Ending:
    """Waits for the end of one request: give `settle` to the request, then await `wait`."""

    __slots__ = ("_future", "request")

    def __init__(self) -> None:
        self.request: Request | None = None
        self._future: asyncio.Future[tuple[Outcome, str]] = (
            asyncio.get_running_loop().create_future()
        )

    def settle(self, outcome: Outcome, reason: str) -> None:
        """Take the end; a waiter that has gone away is not missed."""
        if not self._future.done():
            self._future.set_result((outcome, reason))

    async def wait(self) -> tuple[Outcome, str]:
        """Return outcome and reason; others may wait beside one that is cancelled."""
        return await asyncio.shield(self._future)

    async def is_done(self) -> bool:
        """Wait beside the one that asked for it, and say whether it was done."""
        await asyncio.wait([self._future])
        return self._future.result()[0].is_good

    @property
    def error(self) -> ExchangeError | None:
        """What the last exchange of the request failed with, if it did."""
        job = self.request.work if self.request is not None else None
        return getattr(job, "error", None)

    @property
    def was_sent(self) -> bool:
        """Whether any telegram of the request went out."""
        job = self.request.work if self.request is not None else None
        return getattr(job, "attempts", 0) > 0

    def failure(self, outcome: Outcome, reason: str) -> str:
        """Return the stable word of the API for why a write was not done."""
        if outcome in (Outcome.EXPIRED, Outcome.SUPERSEDED):
            return outcome.value
        if reason == CLIENT_GONE:
            return "client-gone"
        if reason.startswith(LEASE_ENDED):
            return "lease-lost"
        error = self.error
        if error is None and is_line_lost(reason):
            return "line-lost"
        if error is None:
            return "not-in-effect" if self.was_sent else "offline"
        if isinstance(error, NakError):
            return "nak"
        return "line-lost" if isinstance(error, CutReplyError) else "no-answer"


class Requests:
    """Sends requests to the drives of one line.

    Args:
        worker: The line.
        maker: Makes the requests with their costs.
        drives: The drives.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self,
        worker: LineWorker,
        maker: RequestMaker,
        drives: LineDrives,
        clock: Callable[[], float],
    ) -> None:
        self.worker = worker
        self.maker = maker
        self.drives = drives
        self._clock = clock

    def note_stop(self, name: str) -> None:
        """Count a stop of a drive, at this moment."""
        lasting = self.drives.lasting(name)
        lasting.stops += 1
        lasting.stopped_at_s = self._clock()

    def stops_said(self, name: str) -> int:
        """Return how many stops of a drive there were, also if it left the roster since."""
        return self.drives.lasting(name).stops

    def stopped_since_asked(self, name: str) -> bool:
        """Whether a stop of the drive came after what is being done was asked for."""
        came_s, held_s = CAME_S.get(), HELD_FROM_S.get()
        lasting = self.drives.lasting(name)
        if held_s is not None and lasting.stop_written_at_s >= held_s:
            return True
        return came_s is not None and lasting.stopped_at_s > came_s

    @contextlib.contextmanager
    def alone(self, drive: str, work: str) -> Iterator[None]:
        """Let one enable, reset or change of address at a time be made of a drive.

        Raises:
            OperationError: `busy`.
        """
        lasting = self.drives.lasting(drive)
        if lasting.alone:
            raise OperationError(
                f"{lasting.alone} of {drive} is under way: {work} was not begun",
                kind="busy",
                drive=drive,
                remedy="ask again when it has ended; a stop need not wait",
            )
        lasting.alone = work
        try:
            yield
        finally:
            lasting.alone = ""

    def station(self, name: str) -> Station:
        """Return how a drive is spoken to.

        Raises:
            OperationError: `no-such-drive`.
        """
        return self.drives.get(name).station

    async def read(
        self,
        station: Station,
        code: Code,
        priority: Priority,
        *,
        timeout_s: float = 10.0,
        retries: int | None = None,
    ) -> Value:
        """Read one code now.

        Args:
            station: The drive.
            code: What to read.
            priority: The class to run in.
            timeout_s: Not begun after this long, seconds.
            retries: How often a failed attempt is repeated; None: as the roster says.

        Raises:
            ExchangeError: The drive did not answer, or refused.
            OperationError: It was never sent: expired, or the drive is offline.
            LineError: There is no line.
            QueueFullError: Too many wait.
        """
        ending = Ending()
        request = self.maker.read(
            station,
            code,
            priority,
            settle=ending.settle,
            retries=retries,
            expires_at_s=self._clock() + timeout_s,
        )
        return (await self._value(request, ending, station, code))[0]

    async def read_known(
        self, station: Station, codes: Iterable[Code], *, timeout_s: float = 10.0
    ) -> dict[Code, Value]:
        """Read codes one after the other; those that the drive does not have are left out.

        Raises:
            LecombusError: As for `read`.
        """
        found: dict[Code, Value] = {}
        for code in codes:
            with contextlib.suppress(UnknownCodeError):
                found[code] = await self.read_if_there(
                    station, code, Priority.INTERACTIVE, timeout_s=timeout_s
                )
        return found

    async def read_if_there(
        self, station: Station, code: Code, priority: Priority, *, timeout_s: float = 10.0
    ) -> Value:
        """Read a code that the drive need not have; it may say so by NAK too (CMVLC401A 6.1).

        Raises:
            UnknownCodeError: It has no such code.
            LecombusError: As for `read`; `NakError` never.
        """
        tries = 1
        while True:
            try:
                return await self.read(station, code, priority, timeout_s=timeout_s)
            except NakError as exc:
                if tries >= NAK_READS:
                    raise UnknownCodeError(str(exc), exc.record) from exc
            tries += 1

    def see_that_it_fits(self, station: Station, code: Code) -> None:
        """See that a read fits beside the roster's watchdogs, also of drives expected back.

        Raises:
            OperationError: `does-not-fit`.
        """
        since_s = self._clock() - BACK_WITHIN_S
        away = {
            drive.name
            for drive in self.drives
            if drive.health.state is DriveState.OFFLINE
            and not (drive.health.heard and drive.health.silent_from_s > since_s)
        }
        request = self.maker.read(station, code, Priority.INTERACTIVE)
        if reason := self.worker.schedule.never_beside_roster(request, away):
            raise never_sent(Outcome.REFUSED, reason, station, code)

    async def write(
        self,
        station: Station,
        code: Code,
        value: Value,
        *,
        verify: bool,
        expires_at_s: float | None = None,
        lease_ended: Callable[[], bool] | None = None,
        is_gone: Callable[[], bool] | None = None,
    ) -> tuple[Outcome, str]:
        """Write one code and wait for the outcome; `lease_ended` and `is_gone` as in `Request`.

        Raises:
            LineError: There is no line; nothing was sent.
            QueueFullError: Too many wait; nothing was sent.
        """
        ending = Ending()
        request = self.maker.write(
            station, code, value, settle=ending.settle, verify=verify, expires_at_s=expires_at_s,
        )  # fmt: skip
        request.lease_ended, request.is_gone = lease_ended, is_gone
        self.worker.submit(request)
        return await ending.wait()

    async def write_to_the_end(
        self, station: Station, code: Code, value: Value, *, verify: bool
    ) -> tuple[Outcome, str]:
        """Write as `write` does; a write that a stop ended is asked for again behind it.

        Also one that was sent before and perhaps not heard: its reason begins with `STOPPED`.
        """
        for _ in range(WRITE_TRIES):
            outcome, reason = await self.write(station, code, value, verify=verify)
            if outcome is not Outcome.SUPERSEDED and not reason.startswith(STOPPED):
                break
        return outcome, reason

    def submit(self, request: Request) -> None:
        """Submit a request; one that is refused ends so that nothing waits for it.

        Raises:
            LineError: There is no line.
            QueueFullError: Too many wait.
        """
        try:
            self.worker.submit(request)
        except LecombusError as exc:
            request.end(Outcome.REFUSED, str(exc))
            raise

    async def read_back(
        self,
        station: Station,
        code: Code,
        value: Value,
        priority: Priority,
        *,
        timeout_s: float = 10.0,
    ) -> tuple[Value, str]:
        """Read whether a code holds a value now.

        Returns:
            What it reads, and why an equal value may be another drive's; empty: it is its own.

        Raises:
            ExchangeError: The drive did not answer, or refused.
            OperationError: It was never sent: expired, or the drive is offline.
            LineError: There is no line.
            QueueFullError: Too many wait.
        """
        ending = Ending()
        request = self.maker.read_back(
            station, code, value, priority, settle=ending.settle,
            expires_at_s=self._clock() + timeout_s,
        )  # fmt: skip
        return await self._value(request, ending, station, code)

    def may_be_anothers(self) -> bool:
        """Whether an answer may be another drive's: one came without a request within a minute."""
        return bool(self.worker.exchange_loop.second_answers(self._clock()).whose)

    async def own_value(
        self, station: Station, code: Code, value: Value, *, timeout_s: float
    ) -> Value | None:
        """Read until it is certain which value is this drive's; None: it does not get so.

        Args:
            station: The drive.
            code: What was read.
            value: What it read as.
            timeout_s: Each reading is not begun after this long, seconds.

        Raises:
            UnknownCodeError: It has no such code: the value was another drive's.
            LecombusError: As for `read`.
        """
        for _ in range(OWN_READS):
            found, doubt = await self.read_back(
                station, code, value, Priority.INTERACTIVE, timeout_s=timeout_s
            )
            if doubt:
                return None
            if found.means_same(value):
                return found
            value = found
        return None

    async def _value(
        self, request: Request, ending: Ending, station: Station, code: Code
    ) -> tuple[Value, str]:
        """Submit a read and return its value and the reason of its end; not sent if cancelled."""
        self.worker.submit(request)
        try:
            outcome, reason = await ending.wait()
        except asyncio.CancelledError:
            self.worker.schedule.withdraw(request, Outcome.SUPERSEDED, "it is no longer wanted")
            raise
        job = request.work
        assert isinstance(job, ReadWork)
        if job.value is not None:
            return job.value, reason
        if job.error is not None:
            raise job.error
        raise never_sent(outcome, reason, station, code, silenced=self.is_silenced(station.name))

    def is_silenced(self, drive: str) -> bool:
        """Whether a drive is sent nothing but stops, so that its watchdog acts."""
        found = self.drives.find(drive)
        return found is not None and bool(found.health.silenced)

    def feed_maker(self, name: str) -> Callable[[], Request]:
        """Give the maker of the cheapest useful read of a drive."""

        def make() -> Request:
            station = self.station(name)
            instead = tuple(code for code, _ in station.family.status)
            return self.maker.feed(station, instead)

        return make

    def cyclic_maker(self, name: str, code: Code) -> Callable[[], Request]:
        """Give the maker of a cyclic read; its next slot is its retry."""
        drive = self.drives.get(name)

        def make() -> Request:
            return self.maker.read(drive.station, code, Priority.CYCLIC, retries=0)

        return make


def never_sent(
    outcome: Outcome, reason: str, station: Station, code: Code, *, silenced: bool = False
) -> OperationError:
    """The error for a request that ended before a telegram was sent.

    Args:
        outcome: How it ended.
        reason: Why.
        station: The drive.
        code: What was asked for.
        silenced: The drive is sent nothing but stops.
    """
    text = reason or f"the request {outcome}"
    kind, remedy = "does-not-fit", "a longer watchdog time, a higher baud rate or fewer drives"
    if outcome is Outcome.EXPIRED:
        kind, remedy = "expired", "ask again, or allow more time"
    elif reason.startswith(f"{station.name} is offline"):
        kind = "offline"
        remedy = "check the drive's supply, its address and the wires; it is probed all the time"
        if silenced:
            remedy = SILENCED_REMEDY
    elif is_line_lost(reason):
        kind, remedy = "line-lost", "the port is being reopened; ask again when the line is open"
    return OperationError(
        f"{station.name}, {station.family.spoken(code)}: {text}", kind=kind, drive=station.name,
        code=str(code), remedy=remedy,
    )  # fmt: skip


def is_of_the_line(exc: LecombusError) -> bool:
    """Whether what was asked failed because the line went, and for nothing of the drive's."""
    of_kind = isinstance(exc, OperationError) and exc.kind == "line-lost"
    return of_kind or isinstance(exc, CutReplyError | LineError)


def is_line_lost(reason: str) -> bool:
    """Whether a request that waited ended because the line went: the reason begins with it."""
    return reason.startswith("line ")
