"""One read through a port of our own, for `lecombus read --port`: no daemon, no roster.

The same worker as in the daemon does it, with a schedule of one drive, so time-outs, parity, echo
and retries are those that a line has. A port that is in use is refused by `line` when it is opened.
"""

from __future__ import annotations

import time

import anyio

from lecombus.api.exact import encode
from lecombus.cli.reports import Document
from lecombus.drives import LineTiming, family
from lecombus.errors import LecombusError, LineLostError
from lecombus.line.loop import run
from lecombus.line.observer import ExchangeReport
from lecombus.line.opening import open_port
from lecombus.line.port import Port, PortSettings, Receiver
from lecombus.line.station import Station
from lecombus.line.worker import LineWorker, WorkerOptions
from lecombus.operations.request_maker import RequestMaker
from lecombus.operations.requests import Requests
from lecombus.protocol import Code, Value
from lecombus.readings import Quality, Reading
from lecombus.schedule import Outcome, Priority, Schedule

__all__ = ["read_directly"]

ADAPTER_LATENCY_S = 0.05
"""What a device server adds; an adapter adds less, and longer time-outs cost nothing here."""
RETRIES = 2
"""As a roster has it by default."""


def read_directly(
    port: str, baud: int, address: int, family_name: str, code: Code
) -> tuple[str, Document]:
    """Read one code.

    Args:
        port: Device path or `socket://HOST:PORT`.
        baud: 1200..19200 bit/s.
        address: 1..99, not ending in 0.
        family_name: Whose answer times and value names to go by.
        code: What to read.

    Returns:
        The reading, as a JSON text and as a document.

    Raises:
        LecombusError: The port cannot be opened, or the drive did not give a value.
    """
    described = family(family_name)
    station = Station("drive", address, described, described.forms)
    value = run(_read, PortSettings(port, baud), station, code)
    info = described.info(code)
    reading = Reading(
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
    )
    document = reading.as_json()
    return encode(document), document


class _Opening:
    """Opens the port, and tells whether that went well the first time."""

    def __init__(self) -> None:
        self.known = anyio.Event()
        self.error: LineLostError | None = None

    async def open(self, settings: PortSettings, receiver: Receiver) -> Port:
        """Open the port; the worker calls this."""
        try:
            return await open_port(settings, receiver)
        except LineLostError as exc:
            self.error = exc
            raise

    def exchange_ended(self, report: ExchangeReport) -> None:
        """Nobody keeps books here."""

    def line_changed(self, up: bool, reason: str) -> None:
        """Take note that it was tried."""
        self.known.set()

    def thinking(self, for_s: float) -> None:
        """Nothing is done meanwhile."""

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        """Bytes of others are thrown away by the worker."""


def _count(priority: Priority, outcome: Outcome) -> None:
    """Nobody counts one read."""


async def _read(settings: PortSettings, station: Station, code: Code) -> Value:
    opening, schedule = _Opening(), Schedule()
    schedule.add_drive(station.name)
    timing = LineTiming(settings.baud, adapter_latency_s=ADAPTER_LATENCY_S)
    worker = LineWorker(settings, opening.open, schedule, timing, WorkerOptions(), opening)
    requests = Requests(worker, RequestMaker(timing, RETRIES, _count), time.monotonic)
    failure: LecombusError | None = None
    value: Value | None = None
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(worker.run)
        await opening.known.wait()
        try:
            if opening.error is not None:
                raise opening.error
            value = await requests.read(station, code, Priority.INTERACTIVE)
        except LecombusError as exc:
            failure = exc
        worker.close()
    if value is None:
        assert failure is not None
        raise failure
    return value
