"""A toy line protocol, to prove that a line needs no LECOM: `R 5 12` is answered `V 42`.

Drives 1 to 9 on 8N1 at 4800 or 9600 bit/s. A read is `R ADDRESS CODE`, a write `W ADDRESS CODE
NUMBER`; a drive answers `V NUMBER`, `OK`, `NO` (it refuses) or `WHAT` (it has no such code).
No answer is late: a drive answers within 3 ms or never, so there is no quarantine.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lecombus.drives import StopAction, stop_value
from lecombus.errors import ExchangeError, ExchangeRecord, NakError, NoReplyError, UnknownCodeError
from lecombus.fieldbus.costs import Cost, ExchangeCosts, LineTiming
from lecombus.fieldbus.loop_interface import (
    AnswerKind,
    ExchangeLoop,
    ExchangeReport,
    LateWakes,
    Observer,
    OpenConnection,
    ResultKind,
    WorkerOptions,
)
from lecombus.fieldbus.port import Framing, Parity, Port, PortOpener, PortSettings, Receiver
from lecombus.fieldbus.protocols import Fieldbus
from lecombus.fieldbus.requests import (
    Job,
    JobStep,
    ReadWork,
    RequestMaker,
    Station,
    StepKind,
    StopWork,
    Verdict,
    WriteWork,
)
from lecombus.parameters import AddressForm, Code, DecimalLimits, ParameterRules, Value
from lecombus.roster import DriveEntry, Roster
from lecombus.schedule import Outcome, Priority, Request, Schedule, Settle, ignore_end
from lecombus.schedule.fan_out import Part

__all__ = ["TOY", "Toy"]


class Form(AddressForm):
    PLAIN = "plain"

    def carries(self, code: Code) -> bool:
        return code.subcode == 0


DIGITS = DecimalLimits(Decimal(0), Decimal(99), 0)
RULES = ParameterRules(
    "toy", {"plain": Form.PLAIN}, highest_code=99, highest_subcode=0, decimals=DIGITS
)
ANSWER_S = 0.05
"""How long an answer is waited for."""
ERRORS = {AnswerKind.REFUSED: NakError, AnswerKind.NO_SUCH_CODE: UnknownCodeError}


@dataclass(frozen=True)
class Answer:
    kind: AnswerKind
    value: Value | None = None
    text: str = ""


@dataclass(frozen=True)
class Result:
    kind: ResultKind
    started_s: float
    ended_s: float
    answer: Answer | None = None
    fault: str = ""
    late: int = 0
    clean: bool = True
    older_by_s: float = 0.0


def parse(line: bytes) -> Answer:
    word, _, rest = line.decode("ascii").partition(" ")
    if word == "V":
        return Answer(AnswerKind.VALUE, Value.decimal(rest))
    kinds = {"OK": AnswerKind.ACKNOWLEDGED, "NO": AnswerKind.REFUSED}
    return Answer(kinds.get(word, AnswerKind.NO_SUCH_CODE), text="the drive refused")


def error_of(station: Station, step: JobStep, result: Result, attempt: int) -> ExchangeError:
    kind = ERRORS.get(result.answer.kind, NakError) if result.answer else NoReplyError
    record = ExchangeRecord(
        address=station.address, code=step.code.number, subcode=0, attempt=attempt,
        elapsed_s=result.ended_s - result.started_s, received=b"",
    )  # fmt: skip
    return kind(f"{station.name}, {step.code}: {result.fault or 'refused'}", record)


class ReadJob(ReadWork):
    def __init__(self, station: Station, code: Code, retries: int) -> None:
        self.station, self.retries = station, retries
        self.step = JobStep(StepKind.READ, code)
        self.value: Value | None = None
        self.error: ExchangeError | None = None
        self.attempts = 0
        self.cut_outcome: Outcome | None = None

    def advance(self, result: Result) -> Verdict:
        self.attempts += 1
        self.value = result.answer.value if result.answer else None
        if self.value is not None:
            return Outcome.DONE, ""
        self.error = error_of(self.station, self.step, result, self.attempts)
        again = result.answer is None and self.attempts <= self.retries
        return None if again else (Outcome.REFUSED, str(self.error))


class _Written:
    """A write that may be read back."""

    station: Station
    cut_outcome: Outcome | None = Outcome.UNKNOWN

    def _begin(self, station: Station, code: Code, value: Value, *, verify: bool) -> None:
        self.station, self.code, self.value, self.verify = station, code, value, verify
        self.step = JobStep(StepKind.WRITE, code, value)
        self.proof: Value | None = None
        self.error: ExchangeError | None = None
        self.attempts = 0

    def advance(self, result: Result) -> Verdict:
        self.attempts += 1
        answer = result.answer
        if self.step.kind is StepKind.WRITE and answer and answer.kind is AnswerKind.ACKNOWLEDGED:
            if not self.verify:
                return Outcome.DONE, ""
            self.step = JobStep(StepKind.READ, self.code)
            return None
        if self.step.kind is StepKind.READ and answer and answer.value is not None:
            self.proof = answer.value
            same = self.proof.means_same(self.value)
            return (Outcome.VERIFIED, "") if same else (Outcome.UNKNOWN, "it reads otherwise")
        self.error = error_of(self.station, self.step, result, self.attempts)
        return (Outcome.REFUSED if answer else Outcome.UNKNOWN), str(self.error)


class WriteJob(_Written, WriteWork):
    def __init__(self, station: Station, code: Code, value: Value, *, verify: bool) -> None:
        self._begin(station, code, value, verify=verify)


class StopJob(_Written, StopWork):
    def __init__(self, station: Station, action: StopAction) -> None:
        self.action = action
        code, value = stop_value(station.family, action, 0)
        self._begin(station, code, value, verify=True)
        self.proof_code: Code | None = code


class ToyLoop(ExchangeLoop):
    """One exchange after the other; `fieldbus.loop_interface` says what it owes the schedule."""

    def __init__(self, schedule: Schedule, port: OpenConnection, observer: Observer) -> None:
        self.observer, self.exchanges, self.rests = observer, 0, 0
        self._schedule, self._connection = schedule, port
        self._ending, self._buffer = False, b""
        self._under_way: tuple[Request, Job, float] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._ended: asyncio.Future[None] | None = None

    def start(self, port: Port) -> asyncio.Future[None]:
        self._ended = asyncio.get_running_loop().create_future()
        self.nudge()
        return self._ended

    def end(self) -> None:
        self._ending = True

    def clear(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def nudge(self) -> None:
        if self._under_way is None and self._connection.port is not None:
            self._after(0.0, self._go)

    def stop_came(self) -> None:
        pass  # `nudge` comes next, and an exchange is short

    def lost(self, exc: Exception | None) -> None:
        self._connection.note_loss(exc)
        self._conclude(ResultKind.LOST, None, "the line was lost")

    def received(self, data: bytes) -> None:
        self._buffer += data
        line, end, self._buffer = self._buffer.partition(b"\n")
        if not end:
            self._buffer = line
        elif self._under_way is None:
            self.observer.stray_bytes(line, True)
        else:
            self._connection.settled()
            self._conclude(ResultKind.ANSWERED, parse(line), "")

    def _after(self, for_s: float, do: Callable[[], None]) -> None:
        self.clear()
        self._timer = asyncio.get_running_loop().call_later(for_s, do)

    def _go(self) -> None:
        now = asyncio.get_running_loop().time()
        if self._ending or self._connection.is_lost:
            if self._ended is not None and not self._ended.done():
                self._ended.set_result(None)
            return
        request = self._schedule.next(now)
        if request is None:
            self.rests += 1
            wake_s = self._schedule.wake_at_s(now)
            self._after(min(1.0, max(0.0, (wake_s or now + 1.0) - now)), self._go)
            return
        job: Any = request.work
        unwanted = request.why_unwanted(writes=job.step.kind is not StepKind.READ)
        if unwanted:
            self._schedule.defer(request, now, now)
            self._schedule.withdraw(request, Outcome.REFUSED, unwanted)
            self._after(0.0, self._go)
            return
        self._send(request, now)

    def _send(self, request: Request, now: float) -> None:
        job: Any = request.work
        step, address = job.step, job.station.address
        number = "" if step.value is None else f" {step.value.raw}"
        said = "W" if step.kind is StepKind.WRITE else "R"
        self._under_way = (request, job, now)
        self._connection.say(f"{said} {address} {step.code.number}{number}\n".encode())
        wait_s = max(0.0, ANSWER_S - request.cut_by_s)
        self._after(wait_s, lambda: self._conclude(ResultKind.NO_REPLY, None, "no answer in time"))

    def _conclude(self, kind: ResultKind, answer: Answer | None, fault: str) -> None:
        done, self._under_way = self._under_way, None
        if done is not None:
            request, job, started_s = done
            now = asyncio.get_running_loop().time()
            result = Result(kind, started_s, now, answer, fault)
            report = ExchangeReport(
                request.drive, job.step, result, request.priority,
                started_s - request.submitted_at_s, 0.0, (), job.station.address, request.attempts,
            )  # fmt: skip
            self.exchanges += 1
            self._schedule.finished(request, started_s, now, answer is not None)
            if job.step.kind is StepKind.WRITE and kind is not ResultKind.LOST:
                self._schedule.hold(request.drive, now + job.station.hold_s, now)
            verdict = job.advance(result)
            if verdict is None:
                request.cut_outcome = job.cut_outcome
                self._schedule.again(request, now, now, behind=False)
            else:
                request.end(*verdict)
            self.observer.exchange_ended(report)
        self.nudge()


def cost(timing: LineTiming) -> Cost:
    """`W 9 99 99`, `V 99`, 2 ms to think: every exchange is taken to be as long."""
    wire_s = 15 * timing.char_s
    late_s = timing.adapter_latency_s + ANSWER_S
    return Cost(wire_s + 0.002, late_s, wire_s + late_s, late_s, wire_s + late_s, wire_s)


class Costs(ExchangeCosts):
    def reads(self, timing: LineTiming, drive: DriveEntry, code: Code) -> Sequence[Cost]:
        return [cost(timing)]

    def write(self, timing: LineTiming, drive: DriveEntry, code: Code, value: Value) -> Cost:
        return cost(timing)

    def stop_attempts(self, timing: LineTiming, drive: DriveEntry) -> Sequence[Cost]:
        return [cost(timing)]


class Maker(RequestMaker):
    def __init__(
        self, timing: LineTiming, retries: int, count: Callable[[Priority, Outcome], None]
    ) -> None:
        self._timing, self._retries, self._count = timing, retries, count

    @property
    def timing(self) -> LineTiming:
        return self._timing

    def _make(
        self, station: Station, priority: Priority, settle: Settle, work: Job, **more: Any
    ) -> Request:
        def end(outcome: Outcome, reason: str) -> None:
            self._count(priority, outcome)
            settle(outcome, reason)

        price = cost(self.timing)
        return Request(station.name, priority, price.expected_s, price.worst_s, end, work, **more)

    def read(
        self, station: Station, code: Code, priority: Priority, *, settle: Settle = ignore_end,
        retries: int | None = None, instead: tuple[Code, ...] = (),
        expires_at_s: float | None = None,
    ) -> Request:  # fmt: skip
        job = ReadJob(station, code, self._retries if retries is None else retries)
        return self._make(station, priority, settle, job, expires_at_s=expires_at_s)

    def cost_of_read_s(self, station: Station, code: Code) -> float:
        return cost(self.timing).expected_s

    def part_of_write(self, station: Station, code: Code, value: Value) -> Part:
        return Part(cost(self.timing).expected_s, station.hold_s, cost(self.timing).expected_s)

    def write(
        self, station: Station, code: Code, value: Value, *, settle: Settle, verify: bool,
        expires_at_s: float | None = None, urgency: Priority | None = None,
    ) -> Request:  # fmt: skip
        job = WriteJob(station, code, value, verify=verify)
        more = {"expires_at_s": expires_at_s, "writes": True, "hold_s": station.hold_s}
        return self._make(station, urgency or Priority.CONTROL, settle, job, **more)

    def stop(self, station: Station, action: StopAction, *, settle: Settle, **_: Any) -> Request:
        job = StopJob(station, action)
        return self._make(station, Priority.STOP, settle, job, stops=(station.name,))


class SimulatedLine:
    """Drives in memory: the speed follows the setpoint while the drive is enabled."""

    carries_parity = True

    def __init__(self, drives: Mapping[int, dict[int, int]], receiver: Receiver) -> None:
        self.drives, self._receiver, self._open = drives, receiver, True

    def write(self, data: bytes) -> None:
        kind, *numbers = data.decode().split()
        address, code, *value = map(int, numbers)
        values = self.drives.get(address)
        if values is None:
            return
        answer = "WHAT"
        if kind == "W":
            values[code] = value[0]
            answer = "OK"
        elif code == 2:
            answer = f"V {values[1] if values[3] else 0}"
        elif code in values:
            answer = f"V {values[code]}"
        loop = asyncio.get_running_loop()
        for at_s, part in ((0.002, answer[:1]), (0.003, f"{answer[1:]}\n")):
            loop.call_later(at_s, self._say, part.encode())

    def _say(self, data: bytes) -> None:
        if self._open:
            self._receiver.received(data)

    def discard_input(self) -> None:
        pass

    def look(self) -> None:
        pass

    def abort(self) -> None:
        self._open = False

    def describe(self) -> str:
        return f"toy: {len(self.drives)} drives in memory"


class Toy(Fieldbus):
    name = "toy"
    rules = RULES
    bauds = (4800, 9600)
    addresses = "1 to 9"
    bits_per_char = 10
    costs = Costs()
    families = ("toymotor",)
    unused_keys = frozenset({"echo", "parity", "addressing"})
    lowest_address, highest_address = 1, 9
    most_drives: Mapping[str, int] = MappingProxyType({"rs232": 1, "rs485": 9, "fibre": 9})
    most_with_repeaters = 9

    def read_family_file(self, name: str) -> str:
        return (Path(__file__).parent / name).read_text(encoding="utf-8")

    def framing(self, parity: Parity) -> Framing:
        return "8N1"

    def exchange_loop(
        self, schedule: Schedule, timing: LineTiming, options: WorkerOptions,
        connection: OpenConnection, line: str, observer: Observer, lateness: LateWakes,
    ) -> ToyLoop:  # fmt: skip
        return ToyLoop(schedule, connection, observer)

    def request_maker(
        self, timing: LineTiming, retries: int, count: Callable[[Priority, Outcome], None],
        loop: Any,
    ) -> Maker:  # fmt: skip
        return Maker(timing, retries, count)

    def simulator(self, roster: Roster) -> PortOpener:
        drives = {entry.address: {1: 0, 3: 0} for entry in roster.drives}

        async def opened(settings: PortSettings, receiver: Receiver) -> Port:
            assert settings.framing == "8N1"
            return SimulatedLine(drives, receiver)

        return opened


TOY = Toy()
