"""The reports of verbs: how far one came, what the drive shows, and what to do then.

Pure: `Run` is what is known of a verb while it is carried out, the functions make reports of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from lecombus.drive_state.readings import Reading
from lecombus.drives import OperatingState, StopAction, Verb
from lecombus.drives.verb_facts import Known, rules_of
from lecombus.drives.verbs import (
    fault_number,
    has_fault,
    shown_stops,
    status_shows_quick_stop,
)
from lecombus.errors import LineError
from lecombus.fieldbus.requests import Station
from lecombus.operations.operation_reports import Proof, VerbReport, WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome

__all__ = [
    "Run",
    "cut_off",
    "enabled",
    "fault_text",
    "lifted",
    "may_have_happened",
    "not_shown",
    "still_there",
    "superseded",
    "verb_report",
    "without_fault",
]


@dataclass(slots=True)
class Run:
    """One verb under way.

    Args:
        station: The drive.
        verb: The command.
        stops: How many stops of the drive had been said when it began, its own included.
        said: How many stops had been said then, plain writes left out.
        lifts: How many plain writes that may lift an inhibit had been said when it inhibited the
            drive; None while it has not.
        expires_at_s: No write of it is begun after this.
        verify: Read back what is written.
        written: What went out.
        taken_back: It was an enable that the drive did not show, and was stopped again.
        was_inhibited: The drive was inhibited when an enable began.
    """

    station: Station
    verb: Verb
    stops: int
    said: int
    expires_at_s: float | None = None
    verify: bool = False
    lifts: int | None = None
    written: list[tuple[Code, str]] = field(default_factory=list)
    taken_back: bool = False
    was_inhibited: bool = True


def may_have_happened(report: WriteReport) -> bool:
    """Whether a step was done or may have been: its acknowledgement may be lost."""
    unheard = report.outcome is Outcome.UNKNOWN and report.kind == "no-answer"
    return report.outcome.is_good or unheard


def cut_off(run: Run, exc: Exception) -> WriteReport:
    """The report of a verb that failed after its first write."""
    name = run.station.name
    return WriteReport(
        name, None, Outcome.UNKNOWN,
        f"{run.verb} was begun and not brought to its end: {exc}",
        kind="line-lost" if isinstance(exc, LineError) else "no-answer",
        remedy=f"what was written before stands; `lecombus status {name}` says what the drive "
        "shows. Take it for one that may start",
    )  # fmt: skip


def superseded(run: Run) -> WriteReport:
    """The report of a verb that a stop ended."""
    return WriteReport(
        run.station.name, None, Outcome.SUPERSEDED,
        f"a stop came while {run.verb} was under way: nothing more was written",
        kind="superseded",
    )  # fmt: skip


def lifted(run: Run) -> WriteReport:
    """The report of a reset whose inhibit another client may have lifted."""
    return WriteReport(
        run.station.name, None, Outcome.SUPERSEDED,
        f"the control word was written while {run.verb} was under way: nothing more was written, "
        "for the drive may not be inhibited any more",
        kind="superseded",
        remedy="ask again when nobody else writes it",
    )  # fmt: skip


def enabled(known: Known) -> WriteReport:
    """The report of a drive that shows its enable."""
    rules = rules_of(known.drive, known.family, Verb.ENABLE)
    code = next(code for code in rules.enable.proofs if code in known.values)
    proof = Proof(code, known.values[code].raw, "enabled")
    text = f"{known.family.spoken(code)} reads {proof.raw}"
    if not status_shows_quick_stop(known.configured):
        text += "; a quick stop at a terminal would not show in it"
    return WriteReport(known.drive, None, Outcome.VERIFIED, text, proof=proof)


def without_fault(known: Known, reason: str) -> WriteReport:
    """The report of a drive whose status words show no fault."""
    words = (code for code in known.family.words if code in known.values)
    code = next(words, None)
    proof = Proof(code, known.values[code].raw, "no fault") if code is not None else None
    return WriteReport(known.drive, None, Outcome.VERIFIED, reason, proof=proof)


def not_shown(known: Known) -> WriteReport:
    """The report of a drive that was enabled and does not show it."""
    rules = rules_of(known.drive, known.family, Verb.ENABLE)
    stops = shown_stops(known)
    codes = tuple(dict.fromkeys(code for code, _ in stops)) or tuple(rules.enable.proofs)[:1]
    reads = ", ".join(f"{known.family.spoken(code)} reads {_raw(known, code)}" for code in codes)
    cause, remedy = f"probably {rules.enable.otherwise}", "put that in order, then enable it again"
    if stops and all(action is StopAction.QUICK_STOP for _, action in stops):
        cause = (
            f"a quick stop holds it that {rules.control} does not lift: a terminal's, or one that "
            "its watchdog set"
        )
        remedy = (
            "check the terminal for quick stop; if there is none, switch the drive off and on, "
            "then enable it again"
        )
    if has_fault(known):
        cause, remedy = "it has a fault now", f"`lecombus why {known.drive}` says which"
    return WriteReport(
        known.drive,
        rules.enable.code,
        Outcome.REFUSED,
        f"{known.drive} took the enable and does not show it: {reads}",
        cause=cause,
        kind="not-in-effect",
        remedy=remedy,
    )


def _raw(known: Known, code: Code) -> str:
    return known.values[code].raw if code in known.values else "nothing"


def fault_text(known: Known) -> str:
    """Name a fault by its number, what the keypad shows and what it means."""
    number = fault_number(known)
    if number is None:
        return "the fault"
    fault = known.family.fault(number)
    if fault is None:
        return f"fault {number}"
    return f"fault {number} ({', '.join(filter(None, (fault.keypad, str(fault.meaning))))})"


def still_there(known: Known, fault: str) -> WriteReport:
    """The report of a fault that a reset did not end."""
    return WriteReport(
        known.drive, None, Outcome.REFUSED,
        f"the reset was taken, but {fault} is still there or has come again",
        cause="its cause lasts",
        kind="not-in-effect",
        remedy=f"`lecombus why {known.drive}` says what to do about it; the drive is inhibited",
    )  # fmt: skip


def verb_report(
    run: Run,
    report: WriteReport,
    *,
    states: tuple[OperatingState, ...] = (),
    reading: Reading | None = None,
) -> VerbReport:
    """Make the report of a verb from that of its last step."""
    return VerbReport(
        run.station.name, run.verb, report.outcome, report.reason, report.cause, report.kind,
        report.remedy, states, tuple(run.written), reading, report.proof,
    )  # fmt: skip
