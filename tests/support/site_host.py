"""A line on the virtual clock: a bare worker, or a whole site, over simulated drives in memory.

`Rig` is schedule and worker without store, supervisor and roster, for looking at telegrams and
outcomes; `Plant` is a whole `LineRuntime` of a roster. Both are entered inside `virtual_loop.run`.
What passes is noted; a `Watch` given in place of the notes gets it instead, as in the proof.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine, Iterable
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Any, NamedTuple, Protocol

import anyio

from lecombus.config import Roster, parse_roster
from lecombus.drive_state.readings import DriveState
from lecombus.drives import StopAction, family
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.fieldbus import FIELDBUS
from lecombus.fieldbus.lecom.request_maker import LecomRequestMaker
from lecombus.fieldbus.lecom.simulator.drive import SimDrive
from lecombus.fieldbus.lecom.simulator.line import SimLine, build
from lecombus.fieldbus.lecom.simulator.memory import MemoryEnd
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.fieldbus.port import Port, PortSettings, Receiver
from lecombus.fieldbus.requests import Station
from lecombus.line.worker import LineWorker, WorkerOptions
from lecombus.line_runtime import LineRuntime
from lecombus.parameters import Code, Value
from lecombus.saved_state import State
from lecombus.schedule import Outcome, Priority, Request, Schedule
from support.taps import STRIPPED, WALL_S, ObserverTap, PortTap, ReceiverTap, running
from support.virtual_loop import run

__all__ = [
    "Ended",
    "Plant",
    "Recorder",
    "Rig",
    "TappedEnd",
    "Telegram",
    "Watch",
    "plainly",
    "until",
]

PORT = PortSettings("sim:", 19200, "adapter", line="test")


class Ended:
    """Remembers how a request ended; a second end is a failure of the test."""

    def __init__(self) -> None:
        self.outcome: Outcome | None = None
        self.reason = ""
        self.at_s = 0.0
        self.done = asyncio.Event()

    def settle(self, outcome: Outcome, reason: str) -> None:
        assert self.outcome is None, "a request ended twice"
        self.outcome, self.reason = outcome, reason
        self.at_s = asyncio.get_running_loop().time()
        self.done.set()


@dataclass
class Recorder:
    """An observer that remembers."""

    reports: list[ExchangeReport] = field(default_factory=list)
    line: list[tuple[float, bool, str]] = field(default_factory=list)
    strays: list[tuple[bytes, bool]] = field(default_factory=list)

    def exchange_ended(self, report: ExchangeReport) -> None:
        self.reports.append(report)

    def line_changed(self, up: bool, reason: str) -> None:
        self.line.append((asyncio.get_running_loop().time(), up, reason))

    def thinking(self, for_s: float) -> None:
        pass

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        self.strays.append((data, late_answer))

    @property
    def kinds(self) -> list[str]:
        return [report.result.kind.value for report in self.reports]


class Telegram(NamedTuple):
    """What the host handed to the port, parity stripped, and when."""

    at_s: float
    data: bytes


def _telegram(data: bytes) -> Telegram:
    return Telegram(asyncio.get_running_loop().time(), data.translate(STRIPPED))


class Watch(Protocol):
    """Sees what passes on a line, before the line's own parts do."""

    def said(self, data: bytes) -> None:
        """Called with bytes that go to the port, parity bits included."""

    def heard(self, data: bytes) -> None:
        """Called with bytes that come from the port, parity bits included."""

    def ended(self, report: ExchangeReport) -> None:
        """Called at the end of an exchange."""


class TappedEnd:
    """A `MemoryEnd` whose telegrams are noted, or shown to a `Watch`.

    Attributes:
        sent: Telegrams, oldest first.
        heard: Bytes that came from the port.
        tries: When the port was opened, or an opening was tried.
        watch: Gets what passes; None: it is noted here.
        port: The port opened last.
    """

    def __init__(self, line: SimLine, *, latency_s: float = 0.0) -> None:
        self.memory = MemoryEnd(line, latency_s=latency_s)
        self.sent: list[Telegram] = []
        self.heard: list[Telegram] = []
        self.tries: list[float] = []
        self.watch: Watch | None = None
        self.port: Port | None = None

    async def open(self, settings: PortSettings, receiver: Receiver) -> Port:
        self.tries.append(asyncio.get_running_loop().time())
        watch = self.watch
        self._tap = ReceiverTap(receiver, self._note_heard if watch is None else watch.heard)
        port = await self.memory.open(settings, self._tap)
        self.port = PortTap(port, self._note_sent if watch is None else watch.said)
        return self.port

    def _note_sent(self, data: bytes) -> None:
        self.sent.append(_telegram(data))

    def _note_heard(self, data: bytes) -> None:
        self.heard.append(_telegram(data))

    def unplug(self) -> None:
        self.memory.unplug()

    def replug(self) -> None:
        self.memory.replug()

    def say(self, data: bytes) -> None:
        """Let bytes come from the adapter just now, whatever the line does."""
        assert self.memory.port is not None
        self._tap.received(bytes(byte | (byte.bit_count() & 1) << 7 for byte in data))


class Rig:
    """Schedule and worker over simulated drives: `async with Rig(...) as rig`.

    Args:
        drives: Name, address and family of each.
        options: How the line is worked.
        retries: Repetitions.
        baud: Bits per second.
        opener: Opens the port instead of the simulated line.
        Others as for `simulator.line.build`.
    """

    def __init__(
        self,
        drives: Iterable[tuple[str, int, str]] = (("a", 1, "8200vector"), ("b", 2, "8200vector")),
        *,
        options: WorkerOptions | None = None,
        retries: int = 2,
        baud: int = 19200,
        faults: str = "",
        seed: int = 0,
        latency_s: float = 0.0,
        spread: float = 0.0,
        opener: Callable[[PortSettings, Receiver], object] | None = None,
    ) -> None:
        self._drives = list(drives)
        self.options = options or WorkerOptions()
        self.line = build(self._drives, baud=baud, faults=faults, seed=seed, spread=spread)
        self.end = TappedEnd(self.line, latency_s=latency_s)
        self.timing = LineTiming(
            baud, turnaround_s=self.options.turnaround_s, adapter_latency_s=0.005,
            quarantine_s=0.04,
        )  # fmt: skip
        self.maker = LecomRequestMaker(self.timing, retries, lambda priority, outcome: None)
        self.stations: dict[str, Station] = {}
        self.schedule = Schedule()
        for name, address, kind in self._drives:
            described = family(kind)
            self.stations[name] = Station(name, address, described, described.forms)
            self.schedule.add_drive(name)
        self.seen = Recorder()
        self._opens = opener is None
        self.worker = LineWorker(
            FIELDBUS,
            replace(PORT, baud=baud), opener or self.end.open,  # type: ignore[arg-type]
            self.schedule, self.timing, self.options, self.seen,
        )  # fmt: skip

    async def __aenter__(self) -> Rig:
        self._stack = contextlib.AsyncExitStack()
        self.tasks = await self._stack.enter_async_context(anyio.create_task_group())
        self.tasks.start_soon(self.worker.run)
        if self._opens:
            await until(lambda: self.worker.is_open)
            await anyio.sleep(0.06)
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        exc: BaseException | None,
        trace: TracebackType | None,
    ) -> bool | None:
        self.tasks.cancel_scope.cancel()
        return await self._stack.__aexit__(kind, exc, trace)

    @property
    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    @property
    def sent(self) -> list[Telegram]:
        return self.end.sent

    def submit(self, make: Callable[[Callable[[Outcome, str], None]], Request]) -> Ended:
        ended = Ended()
        self.worker.submit(make(ended.settle))
        return ended

    def read(self, drive: str, code: int, priority: Priority = Priority.INTERACTIVE) -> Ended:
        station = self.stations[drive]
        return self.submit(
            lambda settle: self.maker.read(station, Code(code), priority, settle=settle)
        )

    def write(self, drive: str, code: int, value: int | str, *, verify: bool = False) -> Ended:
        station = self.stations[drive]
        wire = Value.parse(str(value))
        return self.submit(
            lambda settle: self.maker.write(station, Code(code), wire, settle=settle, verify=verify)
        )


def plainly(main: Coroutine[Any, Any, None], *, limit_s: float = 10_000.0) -> None:
    """Run in virtual time; raise a lone error itself, without the groups round it."""
    try:
        run(main, limit_s=limit_s)
    except BaseExceptionGroup as group:
        error: BaseException = group
        while isinstance(error, BaseExceptionGroup) and len(error.exceptions) == 1:
            error = error.exceptions[0]
        raise error from None


def with_rig(test: Callable[[Rig], Awaitable[None]], *args: Any, **kwargs: Any) -> None:
    """Run a test with a rig made of the other arguments."""

    async def main() -> None:
        async with Rig(*args, **kwargs) as rig:
            await test(rig)

    plainly(main())


def with_plant(test: Callable[[Plant], Awaitable[None]], *args: Any, **kwargs: Any) -> None:
    """Run a test with a plant made of the other arguments."""

    async def main() -> None:
        async with Plant(*args, **kwargs) as plant:
            await test(plant)

    plainly(main())


def stop(rig: Rig, drive: str, action: StopAction = StopAction.INHIBIT) -> Ended:
    """Stop a drive whose control word is not known."""
    station = rig.stations[drive]
    return rig.submit(
        lambda settle: rig.maker.stop(station, action, word=lambda: None, said=False, settle=settle)
    )


def reader(rig: Rig, drive: str, code: int, priority: Priority) -> Callable[[], Request]:
    """What a cyclic entry or a feed is made from."""
    return lambda: rig.maker.read(rig.stations[drive], Code(code), priority, retries=0)


class Plant:
    """A whole site of a roster over simulated drives: `async with Plant(roster) as plant`.

    Args:
        roster: The roster's text, or the roster.
        faults: Of the line, as `parse_faults` reads them.
        seed: Where chance starts from.
        options: How the line is worked, instead of by the roster.
        also: Drives on the line that the roster does not name.
        state: What was kept from before.
        word_as_written: C0135 of its drives reads what was last written to it.
        only_changes: Of such drives, only a change of bit 3 lifts a quick stop.
        line: Simulated drives instead of those of the roster.
        latency_s: What the adapter adds, seconds; bytes then come in pieces.

    Attributes:
        site: What works the line.
        reports: Every exchange so far, unless there is a watch.
    """

    def __init__(
        self,
        roster: str | Roster,
        *,
        also: Iterable[tuple[str, int, str]] = (),
        faults: str = "",
        seed: int = 0,
        options: WorkerOptions | None = None,
        spread: float = 0.0,
        state: State | None = None,
        word_as_written: bool = False,
        only_changes: bool = False,
        line: SimLine | None = None,
        latency_s: float = 0.0,
    ) -> None:
        self.roster = parse_roster(roster, "r.yaml") if isinstance(roster, str) else roster
        self.line = line or build(
            [*((one.name, one.address, one.family) for one in self.roster.drives), *also],
            baud=self.roster.line.baud, faults=faults, seed=seed, spread=spread,
            word_as_written=word_as_written, only_changes=only_changes,
        )  # fmt: skip
        self.end = TappedEnd(self.line, latency_s=latency_s)
        self.reports: list[ExchangeReport] = []
        clock = asyncio.get_running_loop().time
        self.site = LineRuntime(
            self.roster, self.end.open, clock, lambda: WALL_S + clock(),
            options=options, state=state,
        )  # fmt: skip

    def watched_by(self, watch: Watch) -> None:
        """Show a watch all that passes, in place of noting it; before the line is entered."""
        self.end.watch = watch

    async def __aenter__(self) -> Plant:
        talk, watch = self.site.worker.exchange_loop, self.end.watch
        ended = self.reports.append if watch is None else watch.ended
        talk.observer = ObserverTap(talk.observer, ended)
        self._running = running(self.site)
        await self._running.__aenter__()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        exc: BaseException | None,
        trace: TracebackType | None,
    ) -> bool | None:
        return await self._running.__aexit__(kind, exc, trace)

    @property
    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    @property
    def is_online(self) -> bool:
        """Whether all drives of the roster are."""
        return all(self.state(drive.name) is DriveState.ONLINE for drive in self.roster.drives)

    def trip(self, drive: str, number: int, *, stays: bool = False) -> None:
        """Let a fault occur by its LECOM number; one whose cause stays cannot be reset yet."""
        self.line.advance(self.now_s)
        self.line[drive].trip(number, stays=stays)

    def clear_fault(self, drive: str) -> None:
        """Take the causes of a drive's faults away; a TRIP still waits for its reset."""
        self.line.advance(self.now_s)
        self.line[drive].clear_fault()

    def factory_reset(self, drive: str) -> None:
        """Put a drive's stored parameters back to the maker's; the line still reaches it."""
        self.line.advance(self.now_s)
        self.line[drive].factory_reset()

    def power_cycle(self, drive: str, off_s: float | None = None) -> None:
        """Switch a drive off and on."""
        self.line[drive].power_cycle(self.now_s, off_s)

    def swap(
        self, drive: str, family: str | None = None, overrides: dict[int, str] | None = None
    ) -> SimDrive:
        """Put another drive, new from the maker, in a drive's place (see `SimLine.swap`)."""
        return self.line.swap(drive, self.now_s, family, overrides)

    def wear(self, drive: str) -> dict[tuple[int, int], int]:
        """How often each code (number, subcode) was written into a drive's memory."""
        return dict(self.line[drive].model.params.wear)

    def apply(self, text: str) -> None:
        """Take another roster."""
        self.site.apply(parse_roster(text, "r.yaml"))

    def state(self, drive: str) -> DriveState:
        return self.site.store.state(drive)

    def sent_to(self, address: int, since_s: float = 0.0) -> list[Telegram]:
        head = b"\x04%02d" % address
        return [one for one in self.end.sent if one.at_s >= since_s and one.data[:3] == head]

    def misses(self, drive: str, since_s: float) -> int:
        """How many exchanges with a drive, begun since, brought no usable answer."""
        return sum(
            one.drive == drive and one.result.started_s > since_s
            and one.result.kind is not ResultKind.ANSWERED
            for one in self.reports
        )  # fmt: skip

    def is_asking(self, begin: bytes) -> bool:
        """Whether the last telegram begins so, and nothing has come since."""
        said, heard = self.end.sent[-1], self.end.heard
        return said.data.startswith(begin) and not (heard and heard[-1].at_s >= said.at_s)

    async def online(self, *drives: str, within_s: float = 300.0) -> None:
        """Wait until drives (none named: all) are online."""
        names = drives or tuple(one.name for one in self.roster.drives)
        await until(
            lambda: all(self.state(name) is DriveState.ONLINE for name in names),
            within_s=within_s,
        )


async def until(
    condition: Callable[[], bool], *, within_s: float = 60.0, look_s: float = 0.005
) -> None:
    """Let virtual time pass until something is so; `look_s`: how long between two looks."""
    with anyio.fail_after(within_s):
        while not condition():  # noqa: ASYNC110 - any condition of the site, without its help
            await anyio.sleep(look_s)
