"""Single drives without a line, and what is asked of the line because of them."""

from __future__ import annotations

from collections.abc import Callable

from lecombus.drive_state.drive_runtime import Drive
from lecombus.drives import Family, family
from lecombus.errors import LineLostError
from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.lecom.protocol.telegrams import ValueAnswer
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.fieldbus.requests import JobStep, Station, StepKind
from lecombus.line_events import ExchangeEvent
from lecombus.parameters import Code, Value
from lecombus.schedule import Priority, Settle
from support.rosters import make_roster

__all__ = ["AskedLine", "drive_of", "read_of", "stop_of_group"]


def drive_of(
    name: str = "a", kind: str = "8200vector", clock: Callable[[], float] = lambda: 0.0
) -> Drive:
    """A drive of a roster that names it alone."""
    entry = make_roster([(name, 1, kind)]).drives[0]
    described = family(kind)
    return Drive(entry, Station(name, 1, described, entry.forms), clock)


def read_of(drive: Drive, code: Code, raw: str) -> ExchangeEvent:
    """The event of a read of a drive that brought a value."""
    value = Value.parse(raw)
    result = Result(ResultKind.ANSWERED, 2.0, 3.0, ValueAnswer(b"00", value), "")
    report = ExchangeReport(
        drive.entry.name, JobStep(StepKind.READ, code), result, Priority.CYCLIC, 0.0, 0.0
    )
    return ExchangeEvent(report, (drive,), code, 3.0, "answered", read=value, answered=True)


def stop_of_group(drive: Drive, kind: ResultKind, ended_s: float) -> ExchangeEvent:
    """The event of an inhibit of a group that a drive is in."""
    code = Code(40)
    result = Result(kind, ended_s - 0.1, ended_s, None, "")
    report = ExchangeReport(
        "all", JobStep(StepKind.MULTICAST, code, Value.decimal(0)), result, Priority.STOP, 0.0, 0.0,
        (drive.name,),
    )  # fmt: skip
    return ExchangeEvent(report, (drive,), code, ended_s, "sent", to_all=kind is ResultKind.SENT)


class AskedLine:
    """Remembers what is asked of the line.

    Attributes:
        asked: Reads, as drive, code, and `soon` or `later`.
        settles: How their ends are told.
        fails: There is no line now.
        families: Configurations that drives are taken by.
        early: Whether drives acknowledge early.
        audits: Drives to be audited, with the doubt about them if there is one.
    """

    def __init__(self) -> None:
        self.asked: list[tuple[str, Code, str]] = []
        self.settles: list[Settle] = []
        self.fails = False
        self.families: list[str] = []
        self.early: list[bool | None] = []
        self.audits: list[tuple[str, str]] = []

    def read_soon(self, drive: Drive, code: Code, settle: Settle) -> None:
        self._ask(drive, code, settle, "soon")

    def read_later(self, drive: Drive, code: Code, settle: Settle) -> None:
        self._ask(drive, code, settle, "later")

    def _ask(self, drive: Drive, code: Code, settle: Settle, how: str) -> None:
        if self.fails:
            raise LineLostError("no line")
        self.asked.append((drive.name, code, how))
        self.settles.append(settle)

    def audit_soon(self, drive: Drive) -> None:
        self.audits.append((drive.name, ""))

    def doubt(self, drive: Drive, reason: str) -> None:
        self.audits.append((drive.name, reason))

    def use_family(self, drive: Drive, family: Family) -> None:
        self.families.append(family.configuration)

    def use_early_answers(self, drive: Drive, early: bool | None) -> None:
        self.early.append(early)

    def use_answer_times(self, drive: Drive) -> None:
        raise AssertionError("no event changes the answer times in use")
