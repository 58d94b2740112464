"""A port of our own, for what needs no daemon: `read --port`, `scan --port` and `rebaud`.

The same worker as in the daemon speaks on it, so time-outs, parity, echo, quarantine and doubts
are those that a line has. A port that is in use is refused by `line` when it is opened.
"""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Iterable
from contextlib import AsyncExitStack, asynccontextmanager

import anyio
import anyio.to_thread

from lecombus.cli.exits import CommandError, Exit
from lecombus.config import LineEntry, line_timing
from lecombus.drive_state.drive_runtime import LineDrives
from lecombus.drive_state.readings import Quality, Reading
from lecombus.drives import family
from lecombus.errors import ExchangeError, LecombusError, LineLostError, NoReplyError
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.loop_interface import ExchangeReport
from lecombus.fieldbus.port import Port, PortSettings, Receiver
from lecombus.fieldbus.protocols import find
from lecombus.fieldbus.requests import Station
from lecombus.line.devices import END_IT, others_at, shared, unheard_remedy
from lecombus.line.event_loop import run
from lecombus.line.opening import open_port
from lecombus.line.worker import LineWorker, WorkerOptions
from lecombus.operations.awaited_requests import Requests
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority, Schedule

__all__ = ["OwnLine", "OwnPort", "own_line", "own_port", "read_directly"]

LECOM = find("lecom")
"""What is spoken where no roster says it."""

STRAYS_KEPT = 256
"""How many unsolicited bytes are kept."""

ADAPTER_LATENCY_S = 0.05
"""What a device server adds; an adapter adds less, and longer time-outs cost nothing here."""
RETRIES = 2
"""How often a read without a roster is repeated, as a roster has it by default."""

OPTIONS = WorkerOptions(stall_s=0.0)
"""A line may be silent here: perhaps no drive is on it."""


class OwnLine:
    """A port opened by a command; records received and unsolicited bytes.

    Args:
        settings: The port.
        timing: Its times.
        retries: How often a failed read is repeated.
        options: How the line is worked.

    Attributes:
        requests: What is asked goes through here.
        schedule: For those who ask drives by a name.
        bytes_heard: How many bytes have come, of any kind.
        disturbances: How often something came that was no answer to its question.
    """

    def __init__(
        self, settings: PortSettings, timing: LineTiming, retries: int, options: WorkerOptions
    ) -> None:
        self.known = anyio.Event()
        self.error: LineLostError | None = None
        self.schedule = Schedule()
        self.worker = LineWorker(LECOM, settings, self._open, self.schedule, timing, options, self)
        maker = LECOM.request_maker(timing, retries, _count, self.worker.exchange_loop)
        self.requests = Requests(self.worker, maker, LineDrives(), time.monotonic)
        self.bytes_heard = 0
        self.disturbances = 0
        self._strays = bytearray()

    def take_strays(self) -> bytes:
        """Return the unsolicited bytes since the last call, the first of them."""
        strays = bytes(self._strays)
        self._strays.clear()
        return strays

    async def _open(self, settings: PortSettings, receiver: Receiver) -> Port:
        """Open the port, and keep why it could not be opened; the worker calls this."""
        try:
            return await open_port(settings, _CountingReceiver(receiver, self))
        except LineLostError as exc:
            self.error = exc
            raise

    def exchange_ended(self, report: ExchangeReport) -> None:
        """Count what was no answer."""
        if not report.result.clean:
            self.disturbances += 1

    def line_changed(self, up: bool, reason: str) -> None:
        """Note that the opening was tried."""
        self.known.set()

    def thinking(self, for_s: float) -> None:
        """Do nothing while a drive thinks."""

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        """Keep unsolicited bytes: they may be those of another master."""
        self.disturbances += 1
        self._strays += data[: STRAYS_KEPT - len(self._strays)]


class _CountingReceiver:
    """Counts bytes on their way to the worker: an echo is heard and then removed there."""

    def __init__(self, receiver: Receiver, line: OwnLine) -> None:
        self._receiver = receiver
        self._line = line

    def received(self, data: bytes) -> None:
        """Count, and pass on."""
        self._line.bytes_heard += len(data)
        self._receiver.received(data)

    def lost(self, exc: Exception | None) -> None:
        """Pass on."""
        self._receiver.lost(exc)


def _count(priority: Priority, outcome: Outcome) -> None:
    """Requests are not counted here."""


@asynccontextmanager
async def own_line(
    settings: PortSettings,
    timing: LineTiming,
    *,
    retries: int,
    options: WorkerOptions = OPTIONS,
) -> AsyncIterator[OwnLine]:
    """Open a port for the length of a block.

    Args:
        settings: The port.
        timing: Its times.
        retries: How often a failed read is repeated.
        options: How the line is worked.

    Raises:
        LecombusError: The port cannot be opened, or what the block raises.
    """
    line = OwnLine(settings, timing, retries, options)
    failure: LecombusError | CommandError | None = None
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(line.worker.run)
        await line.known.wait()
        try:
            if line.error is not None:
                raise line.error
            yield line
        except (LecombusError, CommandError) as exc:  # outside the group, or it would be wrapped
            failure = exc
        finally:
            line.worker.close()
    if failure is not None:
        raise failure


class OwnPort:
    """A port of a command, reopened when the baud rate changes.

    Args:
        line: Port, parity and direction; its baud rate is not used.
        retries: How often a failed read is repeated.
        options: How the line is worked.
        drives: Drives that the schedule knows, by name.
        stack: Closes the line that is open.
    """

    def __init__(
        self,
        line: LineEntry,
        retries: int,
        options: WorkerOptions,
        drives: Iterable[str],
        stack: AsyncExitStack,
    ) -> None:
        self._entry = line
        self._retries = retries
        self._options = options
        self._drives = tuple(drives)
        self._stack = stack
        self._line: OwnLine | None = None
        self._baud = 0
        self._heard_before = 0

    @property
    def bytes_heard(self) -> int:
        """How many bytes have come, over all openings."""
        return self._heard_before + (self._line.bytes_heard if self._line is not None else 0)

    async def at(self, baud: int) -> OwnLine:
        """Return the line at a baud rate, bit/s.

        Raises:
            LecombusError: The port cannot be opened.
        """
        if self._line is None or self._baud != baud:
            self._heard_before, self._line = self.bytes_heard, None
            await self._stack.aclose()
            entry = self._entry.model_copy(update={"baud": baud})
            settings = PortSettings(
                entry.port, baud, entry.direction, LECOM.framing(entry.parity), entry.name
            )
            opening = own_line(
                settings, line_timing(entry), retries=self._retries, options=self._options
            )
            self._line, self._baud = await self._stack.enter_async_context(opening), baud
            for name in self._drives:
                self._line.schedule.add_drive(name)
        return self._line


@asynccontextmanager
async def own_port(
    line: LineEntry,
    *,
    retries: int,
    options: WorkerOptions = OPTIONS,
    drives: Iterable[str] = (),
) -> AsyncIterator[OwnPort]:
    """Open and reopen a port within a block; arguments as for `OwnPort`."""
    async with AsyncExitStack() as stack:
        yield OwnPort(line, retries, options, drives, stack)


def read_directly(port: str, baud: int, address: int, family_name: str, code: Code) -> Reading:
    """Read one code.

    Args:
        port: Device path or `socket://HOST:PORT`.
        baud: 1200..19200 bit/s.
        address: 1..99, not ending in 0.
        family_name: Whose answer times and value names to go by.
        code: What to read.

    Raises:
        LecombusError: The port cannot be opened, or the drive did not give a value.
        CommandError: Another program reads the port, or nothing is heard.
    """
    described = family(family_name)
    station = Station("drive", address, described, described.forms)
    value = run(_read, PortSettings(port, baud), station, code)
    info = described.info(code)
    meaning = info.meaning(value) if info is not None else None
    return Reading(
        drive=str(address),
        code=code,
        name=info.name if info else "",
        unit=info.unit if info else None,
        format=value.format.name,
        value=value,
        quality=Quality.GOOD,
        reason=None,
        time_s=time.time(),
        age_s=0.0,
        text=str(meaning) if meaning is not None else None,
    )


async def _read(settings: PortSettings, station: Station, code: Code) -> Value:
    timing = LineTiming(settings.baud, adapter_latency_s=ADAPTER_LATENCY_S)
    async with own_line(settings, timing, retries=RETRIES) as line:
        line.schedule.add_drive(station.name)
        try:
            return await line.requests.read(station, code, Priority.INTERACTIVE)
        except ExchangeError as exc:
            others = await anyio.to_thread.run_sync(others_at, settings.url)
            if others:
                what = f"{exc}; {shared(settings.url, others)}"
                raise CommandError(Exit.FAILED, what, END_IT, "port-shared") from exc
            if isinstance(exc, NoReplyError) and not line.bytes_heard:
                what = f"no drive answers at address {station.address}: not one byte came back"
                remedy = f"{unheard_remedy(settings.url, settings.baud)}, and its address"
                raise CommandError(Exit.FAILED, what, remedy, "no-answer") from exc
            raise
