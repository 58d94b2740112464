"""A change of baud rate carried out on a simulated line in computed time, without port and worker.

What the worker makes of bytes is made here in the plainest way, as for a scan.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

from lecombus.drives import family
from lecombus.drives.procedures import ReadAttempt, WriteAttempt, identity_codes
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.protocol.controls import with_parity
from lecombus.fieldbus.lecom.rebaud import LineAccess, Rebaud, Subject
from lecombus.fieldbus.lecom.scanning import HeardKind, Question
from lecombus.fieldbus.lecom.simulator import SimDrive, SimLine
from lecombus.parameters import Code, Value
from support.scanning import ScannedLine, run_now
from support.sim_host import write_telegram

PATIENCE_S, PAUSE_S = 0.6, 0.06
ANSWERS = {with_parity(b"\x06"): "done", with_parity(b"\x15"): "refused"}

Standing = tuple[str, int, str]


@dataclass(frozen=True, slots=True)
class Read:
    """Read a code at a baud rate; a failed attempt is repeated `retries` times."""

    baud: int
    drive: str
    code: Code
    retries: int


@dataclass(frozen=True, slots=True)
class Write:
    """Write a code at a baud rate, once."""

    baud: int
    drive: str
    code: Code
    value: Value


@dataclass(frozen=True, slots=True)
class Wait:
    """Send nothing for some seconds."""

    baud: int
    for_s: float


Step = Read | Write | Wait


def subject_of(name: str, address: int, kind: str, **more: object) -> Subject:
    described = family(kind)
    form = Form.EXTENDED if Form.EXTENDED in described.forms else Form.STANDARD
    asked = identity_codes((), described.identity)
    return Subject(name, address, described, form, asked, **more)  # type: ignore[arg-type]


class RebaudLine:
    """Simulated drives, a change of their baud rate, and what was said.

    Args:
        drives: Name, address and family of each.
        old: Their baud rate, bit/s.
        new: The rate wanted.
        subjects: The drives as they should be; else as they are.

    Attributes:
        before: Called before every step; may change the line.
        lose_acks: No acknowledgement arrives.
        steps: What was said.
    """

    def __init__(
        self,
        drives: Sequence[Standing],
        *,
        old: int = 9600,
        new: int = 19200,
        subjects: Sequence[Subject] | None = None,
    ) -> None:
        self.drives = {name: SimDrive(address, kind, name) for name, address, kind in drives}
        self.line = SimLine(list(self.drives.values()), baud=old)
        self.scanned = ScannedLine(self.line)
        self.work = Rebaud(subjects or [subject_of(*one) for one in drives], old, new)
        self.subjects = {one.subject.name: one.subject for one in self.work.drives}
        self.steps: list[Step] = []
        self.before: Callable[[Step], None] = lambda _: None
        self.lose_acks = False

    def __getitem__(self, name: str) -> SimDrive:
        return self.drives[name]

    @property
    def rates(self) -> dict[str, int]:
        """Which rate each drive really speaks."""
        return {name: drive.baud for name, drive in self.drives.items()}

    @property
    def places(self) -> dict[str, str]:
        """Where the procedure takes each drive to be."""
        return {one.name: one.place.value for one in self.work.drives}

    @property
    def kinds(self) -> list[str]:
        """The kinds of obstacle found."""
        return [one.kind for one in self.work.obstacles]

    def why(self, name: str) -> str:
        return next(one.why for one in self.work.drives if one.name == name)

    def writes(self, name: str) -> list[Write]:
        return [one for one in self.steps if isinstance(one, Write) and one.drive == name]

    def check(self) -> RebaudLine:
        self.run(self.work.check)
        return self

    def move(self) -> RebaudLine:
        self.run(self.work.move)
        return self

    def back(self) -> RebaudLine:
        self.run(self.work.back)
        return self

    def run(self, procedure: Callable[[LineAccess], Awaitable[None]]) -> None:
        run_now(procedure(self))

    def at(self, baud: int, drive: str, *, retries: int) -> StandingDrive:
        return StandingDrive(self, baud, drive, retries)

    async def wait(self, baud: int, for_s: float) -> None:
        self.take(Wait(baud, for_s))
        self.scanned.host.wait(for_s)

    def take(self, step: Step) -> None:
        """Note a step before it is carried out."""
        self.steps.append(step)
        self.before(step)
        self.line.host_baud = step.baud

    def read(self, step: Read) -> ReadAttempt:
        self.take(step)
        subject = self.subjects[step.drive]
        for _ in range(step.retries + 1):
            answer = self._read(subject, step)
            if answer.value is not None:
                break
        return answer

    def write(self, step: Write) -> WriteAttempt:
        self.take(step)
        host, subject = self.scanned.host, self.subjects[step.drive]
        extended = subject.form is Form.EXTENDED
        telegram = write_telegram(
            subject.address, step.code.number, step.value.raw, extended=extended
        )
        host.say(telegram)
        received = host.hear(until_s=host.now_s + PATIENCE_S)
        host.wait(PAUSE_S)
        came = "nothing" if self.lose_acks else ANSWERS.get(received, "nothing")
        return WriteAttempt(came == "done", came, "" if came == "done" else f"write: {came}")

    def _read(self, subject: Subject, step: Read) -> ReadAttempt:
        ask = Question(step.baud, subject.address, step.code, subject.form, subject.family.name)
        heard = self.scanned.hear(ask)
        if heard.kind is HeardKind.VALUE:
            return ReadAttempt(step.code, heard.value)
        refused = heard.kind is HeardKind.NO_SUCH_CODE
        kind = "no-such-code" if refused else "no-answer"
        return ReadAttempt(step.code, None, kind, str(heard.kind))


@dataclass(frozen=True, slots=True)
class StandingDrive:
    """A drive of the simulated line at one baud rate."""

    line: RebaudLine
    baud: int
    name: str
    retries: int

    async def read(self, code: Code) -> ReadAttempt:
        return self.line.read(Read(self.baud, self.name, code, self.retries))

    async def write(self, code: Code, value: Value, *, verify: bool) -> WriteAttempt:
        assert not verify
        return self.line.write(Write(self.baud, self.name, code, value))


def baud_of(name: str) -> Code:
    return Code(1411) if name == "smvector" else Code(125)
