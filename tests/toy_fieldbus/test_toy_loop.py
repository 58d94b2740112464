"""The toy's exchange loop does what every loop owes the schedule."""

from __future__ import annotations

import asyncio
from typing import cast

import pytest

from lecombus.drives import family
from lecombus.errors import LineLostError
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.loop_interface import ExchangeReport, Observer, OpenConnection
from lecombus.fieldbus.port import Port
from lecombus.fieldbus.protocols import register
from lecombus.fieldbus.requests import Station
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority, Request, Schedule
from lecombus.schedule.request import CLIENT_GONE
from support.known_protocols import known_protocols_kept
from support.virtual_loop import run
from toy_fieldbus.toy import ANSWER_S, TOY, Form, Maker, ToyLoop

SPEED, SETPOINT = Code(2), Code(1)


class Line:
    """A line whose drives answer what the test says, 1 ms later; None: nothing."""

    is_lost = False
    port = object()

    def __init__(self, answer: bytes | None) -> None:
        self.answer = answer
        self.sent: list[tuple[float, bytes]] = []
        self.reports: list[ExchangeReport] = []
        self.schedule = Schedule()
        self.schedule.add_drive("fan")
        self.loop = ToyLoop(self.schedule, cast(OpenConnection, self), cast(Observer, self))
        self.make = Maker(LineTiming(baud=9600), 0, lambda priority, outcome: None)
        self.ends: list[tuple[Outcome, str]] = []

    def say(self, telegram: bytes) -> LineLostError | None:
        loop = asyncio.get_running_loop()
        self.sent.append((loop.time(), telegram))
        if self.answer is not None:
            loop.call_later(0.001, self.loop.received, self.answer)
        return None

    def settled(self) -> None:
        pass

    def exchange_ended(self, report: ExchangeReport) -> None:
        self.reports.append(report)

    def settle(self, outcome: Outcome, reason: str) -> None:
        self.ends.append((outcome, reason))

    async def works(self, *requests: Request) -> None:
        """Submit requests to an idle line and let it work."""
        now = asyncio.get_running_loop().time()
        self.loop.start(cast(Port, self.port))
        for request in requests:
            self.schedule.submit(request, now)
        await asyncio.sleep(0.5)
        self.loop.clear()


@pytest.fixture
def fan(monkeypatch: pytest.MonkeyPatch) -> Station:
    known_protocols_kept(monkeypatch)
    register(TOY)
    return Station("fan", 6, family("toymotor"), (Form.PLAIN,), hold_s=0.2)


def write(line: Line, fan: Station) -> Request:
    return line.make.write(fan, SETPOINT, Value.decimal("42"), settle=line.settle, verify=True)


def test_a_write_whose_client_has_left_is_not_sent(fan: Station) -> None:
    async def main() -> None:
        line = Line(b"OK\n")
        request = write(line, fan)
        request.is_gone = lambda: True
        await line.works(request)
        assert line.sent == []
        assert line.ends == [(Outcome.REFUSED, CLIENT_GONE)]

    run(main())


def test_a_write_that_was_begun_goes_on_without_its_client(fan: Station) -> None:
    async def main() -> None:
        line = Line(b"OK\n")
        request = write(line, fan)
        request.is_gone = lambda: bool(line.sent)
        await line.works(request)
        assert [said for _, said in line.sent] == [b"W 6 1 42\n", b"R 6 1\n"]

    run(main())


@pytest.mark.parametrize("cut_s", [0.0, 0.02])
def test_an_answer_is_given_up_as_early_as_the_schedule_says(fan: Station, cut_s: float) -> None:
    async def main() -> None:
        line = Line(None)
        request = line.make.read(fan, SPEED, Priority.INTERACTIVE, settle=line.settle)
        request.documented = request.cost_s, 0.0
        request.shorten(request.worst_s - cut_s)
        await line.works(request)
        (report,) = line.reports
        waited_s = report.result.ended_s - report.result.started_s
        assert waited_s == pytest.approx(ANSWER_S - cut_s)

    run(main())


@pytest.mark.parametrize("answer", [b"OK\n", None])
def test_a_drive_is_left_alone_after_a_write(fan: Station, answer: bytes | None) -> None:
    async def main() -> None:
        line = Line(answer)
        read = line.make.read(fan, SPEED, Priority.INTERACTIVE)
        await line.works(write(line, fan), read)
        (first_s, first), (next_s, _), *_ = line.sent
        assert first == b"W 6 1 42\n"
        ended_s = first_s + (ANSWER_S if answer is None else 0.001)
        assert next_s == pytest.approx(ended_s + 0.2)

    run(main())
