"""A child: one master that does nothing but exchanges, ours or a peer's.

`python -m benchmarks.masters KIND PORT`. The only question is `spend` with a number of exchanges,
and how often one is wanted if not at once; the answer is the processor time of one, seconds, the
kernel's share included.

* `protocol`: pyserial-asyncio's transport with a bare Protocol and a future for each exchange,
  without time-out, parity or any look at the answer but where it ends.
* `worker`: our line worker, given the same request again and again.
* `scheduled`: our line worker with our schedule and one cyclic read that is always due.
* `pymodbus`: its asynchronous RTU client reading one holding register.
"""

from __future__ import annotations

import asyncio
import importlib
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any

import serial_asyncio

from lecombus.drives import family
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.exchanges.jobs import ReadJob
from lecombus.fieldbus.lecom.fieldbus import FIELDBUS
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.protocol.controls import with_parity
from lecombus.fieldbus.lecom.protocol.telegrams import read_telegram
from lecombus.fieldbus.loop_interface import ExchangeReport
from lecombus.fieldbus.port import PortSettings
from lecombus.fieldbus.requests import Station
from lecombus.line.event_loop import new_event_loop
from lecombus.line.opening import open_port
from lecombus.line.worker import LineWorker, WorkerOptions
from lecombus.parameters import Code
from lecombus.schedule import Cyclic, Outcome, Priority, Request, Schedule
from support.children import answer_lines

__all__ = ["main"]

BAUD = 19200
STATUS = Code(150)

Exchanges = Callable[[int], Awaitable[None]]
"""Does so many exchanges."""


# ---- pyserial-asyncio ---------------------------------------------------------------------------


class BareProtocol(asyncio.Protocol):
    """Collects an answer and hands it to the future."""

    def __init__(self) -> None:
        self.answer: asyncio.Future[bytes] | None = None
        self.buffer = b""

    def data_received(self, data: bytes) -> None:
        """Take bytes; an answer ends with ETX and BCC."""
        self.buffer += data
        if len(self.buffer) > 2 and self.buffer[-2] & 0x7F == 0x03 and self.answer is not None:
            self.answer.set_result(self.buffer)
            self.buffer = b""


async def protocol(port: str) -> Exchanges:
    """Open the port as pyserial-asyncio does it."""
    loop = asyncio.get_running_loop()
    transport, bare = await serial_asyncio.create_serial_connection(
        loop, BareProtocol, port, baudrate=BAUD
    )
    telegram = with_parity(read_telegram(1, STATUS, Form.STANDARD))

    async def run(count: int) -> None:
        for _ in range(count):
            bare.answer = loop.create_future()
            transport.write(telegram)
            await bare.answer

    return run


# ---- ours ---------------------------------------------------------------------------------------


class Counter:
    """An observer that counts exchanges and calls back at the last one."""

    def __init__(self, count: int, done: Callable[[], None]) -> None:
        self._left = count
        self._done = done

    def exchange_ended(self, report: ExchangeReport) -> None:
        """Count it."""
        self._left -= 1
        if not self._left:
            self._done()

    def line_changed(self, up: bool, reason: str) -> None:
        """Tell nobody."""

    def thinking(self, for_s: float) -> None:
        """Use it for nothing."""

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        """Drop them."""


STATION = Station("d01", 1, family("smvector"), (Form.STANDARD, Form.EXTENDED))


def settled(outcome: Outcome, reason: str) -> None:
    """Nobody waits."""


class Again:
    """Instead of a schedule: always the same request."""

    def __init__(self) -> None:
        job = ReadJob(STATION, STATUS, 0)
        self._request = Request("d01", Priority.CYCLIC, 0.001, 0.1, settled, job)

    def next(self, now_s: float) -> Request:
        """Give it again."""
        self._request.settled = False
        return self._request

    def stop_goes(self, now_s: float) -> bool:
        """There is none."""
        return False

    def look_ahead(self, under_way: Request | None, started_s: float, at_s: float) -> Request:
        """It is always the same."""
        return self._request

    def planned(self, now_s: float) -> Request:
        """It is always the same."""
        return self._request

    def follow(self, done: Request, started_s: float, ended_s: float, now_s: float) -> None:
        """Book one exchange."""
        self.finished(done, started_s, ended_s, True)

    def finished(self, request: Request, started_s: float, now_s: float, reached: bool) -> None:
        """Book nothing."""
        request.settled = False

    def fail_all(self, now_s: float, reason: str, *, stops: bool = True) -> None:
        """Nothing waits."""


def one_cyclic() -> Schedule:
    """A schedule with one read that is always due."""
    schedule = Schedule()
    schedule.add_drive("d01")

    def make() -> Request:
        return Request("d01", Priority.CYCLIC, 0.001, 0.1, settled, ReadJob(STATION, STATUS, 0))

    schedule.add_cyclic(Cyclic("d01", 1e-6, make), time.monotonic())
    return schedule


async def worker(port: str, schedule: Any) -> Exchanges:
    """Open the port as the daemon does it; the worker rests by being cancelled between turns."""
    timing = LineTiming(BAUD, turnaround_s=0.0, adapter_latency_s=0.005, paced=False)
    options = WorkerOptions(turnaround_s=0.0, echo=False)
    settings = PortSettings(port, BAUD, "adapter", line="bench")

    async def run(count: int) -> None:
        counter = Counter(count, lambda: ours.close())
        ours = LineWorker(FIELDBUS, settings, open_port, schedule, timing, options, counter)
        await ours.run()

    return run


# ---- pymodbus -----------------------------------------------------------------------------------


async def pymodbus(port: str) -> Exchanges:
    """Open the port as pymodbus does it; imported by name, for only `make bench` installs it."""
    client = importlib.import_module("pymodbus.client").AsyncModbusSerialClient(
        port, baudrate=BAUD, timeout=1
    )
    await client.connect()

    async def run(count: int) -> None:
        for _ in range(count):
            answer = await client.read_holding_registers(0, count=1, device_id=1)
            assert answer.registers == [1]

    return run


# ---- the child ----------------------------------------------------------------------------------


async def open_master(kind: str, port: str) -> Exchanges:
    """Make a master ready."""
    if kind == "protocol":
        return await protocol(port)
    if kind == "pymodbus":
        return await pymodbus(port)
    return await worker(port, Again() if kind == "worker" else one_cyclic())


async def spread(exchanges: Exchanges, count: int, every_s: float) -> None:
    """Do one exchange after the other at their times, and sleep between."""
    due_s = time.monotonic()
    for _ in range(count):
        await exchanges(1)
        due_s += every_s
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))


async def serve(kind: str, port: str) -> None:
    """Answer `spend` until the input ends."""
    exchanges = await open_master(kind, port)

    async def answer(question: dict[str, Any]) -> float:
        count: int = question["count"]
        every_s: float | None = question.get("every_s")
        before_s = time.process_time()
        if every_s is None:
            await exchanges(count)
        else:
            await spread(exchanges, count, every_s)
        return (time.process_time() - before_s) / count

    await answer_lines(answer)


def main(kind: str, port: str) -> None:
    """Run on the loop that this kind of program would use: ours on ours, the peers on asyncio's."""
    theirs = kind in ("protocol", "pymodbus")
    loop = asyncio.new_event_loop() if theirs else new_event_loop()
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(serve(kind, port))


if __name__ == "__main__":
    main(*sys.argv[1:])
