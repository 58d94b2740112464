"""`lecombus rebaud`: another baud rate for all drives of a line, with the daemon stopped."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import click

from lecombus.capacity.watchdog_feasibility import find_infeasible
from lecombus.cli.arguments import json_option, roster_option
from lecombus.cli.exits import CommandError, Exit, Problem, status_of_cause
from lecombus.cli.rebaud_access import Procedure, carry_out
from lecombus.cli.screen import (
    can_ask,
    forget_terminal,
    make_sure,
    on_terminal,
    progress,
    show_rows,
)
from lecombus.cli.signals import at_signals, ended_as_by_ctrl_c
from lecombus.config import DriveEntry, Roster, load_roster
from lecombus.drives import family, saving_rule
from lecombus.drives.procedures import identity_codes
from lecombus.errors import LecombusError
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.protocol.controls import BAUDS
from lecombus.fieldbus.lecom.rebaud import (
    DrivePlace,
    Rebaud,
    RebaudDrive,
    RebaudEnd,
    Subject,
    ending_of,
    situation,
    what_to_do,
)
from lecombus.line.event_loop import run
from lecombus.parameters import AddressForm, Code
from lecombus.saved_state import State

__all__ = ["rebaud_command"]

RATES = [str(baud) for baud in BAUDS]


@dataclass(frozen=True, slots=True)
class RebaudOptions:
    """What the command line asks for.

    Args:
        roster: The line and its drives.
        yes: Do not ask the user.
        back: Set the moved drives back if not every drive can be moved.
        as_json: Print one JSON document.
    """

    roster: Roster
    yes: bool
    back: bool
    as_json: bool


@click.command("rebaud")
@click.argument("rate", type=click.Choice(RATES), metavar="NEW")
@roster_option
@click.option("--from", "origin", type=click.Choice(RATES), metavar="RATE",
              help="The present rate, if it is not the roster's.")  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Ask the drives and show the plan, write nothing.")
@click.option("--yes", is_flag=True, help="Do not ask; needed without a terminal.")
@click.option("--back", is_flag=True,
              help="If a drive does not change, set the others back without asking.")  # fmt: skip
@click.option("--generic-c0125", "generic", is_flag=True,
              help="Generic drives are stopped, and their C0125 is like a 2102's.")  # fmt: skip
@json_option
def rebaud_command(
    rate: str,
    roster: Path,
    origin: str | None,
    dry_run: bool,
    yes: bool,
    back: bool,
    generic: bool,
    as_json: bool,
) -> int:
    """Give every drive of ROSTER the baud rate NEW: 1200, 2400, 4800, 9600 or 19200.

    The daemon must be stopped: all drives share one rate, and no watchdog is fed during the
    change. First every drive is asked: it must answer, have the expected identity, and be
    inhibited or in quick stop at a frequency of 0; what it reports of its motion is shown. An
    inverter does not measure whether its motor has come to rest: look at the machine. Nothing
    is written before all have passed. Then each drive in turn is written to, found again at NEW
    and confirmed. If one does not change, those that did can be set back.

    An attempt that was interrupted is run again: drives that are at NEW already are left there. The
    roster is not changed; the line to write is shown.

    With --json: {"line", "from", "to", "ending": "planned" | "moved" | "unchanged" | "mixed",
    "interrupted", "trouble", "drives": [{"drive", "address", "family", "place", "baud", "shows",
    "why", "motion", "watchdog"}], "remedies"}. Exit status 0: every drive is at NEW, and keeps it.
    """
    read = load_roster(roster)
    new, old = int(rate), int(origin) if origin else read.line.baud
    _check_words(read, old, new, generic=generic)
    _check_held(read, new)
    _see_no_daemon(read)
    subjects = _subjects(read)
    _check_rates(subjects, old, new)
    work = Rebaud(subjects, old, new)
    _ask_drives(work, read, quiet=as_json)
    options = RebaudOptions(read, yes or dry_run, back, as_json)
    if _shows_plan(work, options, dry_run=dry_run):
        show_plan(work, read, as_json=as_json)
    if work.obstacles:
        raise CommandError.of(Exit.FAILED, *_problems(work))
    return Exit.DONE if dry_run else _do(work, options)


def _shows_plan(work: Rebaud, options: RebaudOptions, *, dry_run: bool) -> bool:
    """Return whether the plan is shown: not beside the JSON document or the list of a pipe."""
    if options.as_json:
        return dry_run and not work.obstacles
    return dry_run or not options.yes or on_terminal()


def _problems(work: Rebaud) -> list[Problem]:
    return [Problem(one.problem, one.remedy, one.kind, one.drive) for one in work.obstacles]


# ---- checks before ------------------------------------------------------------------------------


def _check_words(roster: Roster, old: int, new: int, *, generic: bool) -> None:
    """Refuse what can be refused without a telegram.

    Raises:
        CommandError: It cannot be done like this.
    """
    if new == old:
        has = f"{roster.file} has" if old == roster.line.baud else "--from names"
        problem = f"{has} {new} baud already"
        remedy = "name another rate, or give with --from the present rate of the drives"
        raise CommandError(Exit.USAGE, problem, remedy)
    port = roster.line.port
    if not port.startswith("/"):
        problem = f"the baud rate of {port} is not set from here"
        remedy = "connect the drives to a serial adapter of this machine, and name it as the port"
        raise CommandError(Exit.USAGE, problem, remedy)
    unknown = [one.name for one in roster.drives if one.family == "generic"]
    if unknown and not generic:
        problem = (
            f"lecombus does not know how to set the baud rate of {', '.join(unknown)} (generic)"
        )
        remedy = "with --generic-c0125, if C0125 has a 2102's numbers there (0: 9600 .. 4: 19200)"
        raise CommandError(
            Exit.USAGE, f"{problem}, or how to see that its motor stands still", remedy
        )


def _check_held(roster: Roster, baud: int) -> None:
    """Refuse a rate at which the roster would be refused: its watchdogs could not be fed.

    Raises:
        CommandError: Some could not.
    """
    line = roster.line.model_copy(update={"baud": baud})
    wrong = find_infeasible(roster.model_copy(update={"line": line}))
    if wrong:
        problems = [
            Problem(f"{one.drive}: {one.what}", one.right, drive=one.drive) for one in wrong
        ]
        raise CommandError.of(Exit.USAGE, *problems)


def _see_no_daemon(roster: Roster) -> None:
    """Refuse while a daemon of this roster answers; a port that it has open is refused besides.

    Raises:
        CommandError: It runs.
    """
    path = roster.api.socket
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asked:
        asked.settimeout(2.0)
        asked.connect(path)
        problem = f"a daemon of line {roster.line.name} runs: it answers at {path}"
        raise CommandError(Exit.FAILED, problem, "stop it first", "daemon-runs")


def _check_rates(subjects: tuple[Subject, ...], old: int, new: int) -> None:
    for subject in subjects:
        for baud in (old, new):
            if subject.number(baud) is None:
                problem = f"{subject.name} ({subject.family.title}) knows no {baud} baud"
                raise CommandError(Exit.USAGE, problem)


def _subjects(roster: Roster) -> tuple[Subject, ...]:
    state = _recorded(roster)
    return tuple(_subject(entry, state) for entry in roster.drives)


def _subject(entry: DriveEntry, state: State) -> Subject:
    kind = family(entry.family)
    recorded = {Code.parse(code): text for code, text in state.drive(entry.name).identity.items()}
    return Subject(
        entry.name,
        entry.address,
        kind,
        form_of(entry.forms),
        identity_codes(entry.identity, kind.identity),
        {**recorded, **entry.identity},
        entry.accept_software,
    )


def form_of(forms: tuple[AddressForm, ...]) -> AddressForm:
    """Choose the addressing form that no code bank redirects, where the drive knows it."""
    return Form.EXTENDED if Form.EXTENDED in forms else forms[0]


def _recorded(roster: Roster) -> State:
    """Read what the daemon has recorded of its drives, and leave it as it is.

    Raises:
        CommandError: It is there and cannot be read: who the drives should be is not known.
    """
    if roster.state is None or not Path(roster.state).exists():
        return State()
    try:
        return State.parse(Path(roster.state).read_bytes())
    except ValueError as exc:
        remedy = "start the daemon once, which sets a damaged file aside"
        raise CommandError(Exit.FAILED, f"{roster.state}: {exc}", remedy) from exc


def _ask_drives(work: Rebaud, roster: Roster, *, quiet: bool) -> None:
    """Check every drive.

    Raises:
        CommandError: It could not be finished.
    """
    try:
        _carry(work, work.check, roster, Shown("asking drives", RebaudDrive.is_seen, quiet=quiet))
    except LecombusError as exc:
        raise CommandError(status_of_cause(exc), str(exc), "nothing was written") from exc
    if work.line.interrupted:
        raise CommandError(Exit.INTERRUPTED, "interrupted", "nothing was written")


# ---- doing it -----------------------------------------------------------------------------------


def _do(work: Rebaud, options: RebaudOptions) -> int:
    """Ask, move the drives, offer to set them back, and show the result."""
    if not options.yes:
        question = f"Change the line from {work.old} to {work.new} baud?"
        make_sure(question, as_json=options.as_json)
    trouble = _try(work, work.move, options, DrivePlace.NEW, work.new)
    went_back = False
    if (
        ending_of(work) is RebaudEnd.MIXED
        and not work.line.interrupted
        and _wants_back(work, options)
    ):
        went_back = True
        trouble = _try(work, work.back, options, DrivePlace.OLD, work.old)
    with at_signals(lambda number, frame: None):  # the report comes whole
        show_end(work, options.roster, trouble, as_json=options.as_json)
    if work.line.interrupted:
        return Exit.INTERRUPTED
    unsaved = any(drive.saved is False for drive in work.drives)
    moved = ending_of(work) is RebaudEnd.MOVED and not went_back
    return Exit.DONE if moved and not unsaved else Exit.FAILED


@dataclass(frozen=True, slots=True)
class Shown:
    """What a bar shows on a terminal.

    Args:
        title: What is going on.
        counts: Which drives are done.
        quiet: Show nothing.
    """

    title: str
    counts: Callable[[RebaudDrive], bool]
    quiet: bool


def _carry(work: Rebaud, procedure: Procedure, roster: Roster, shown: Shown) -> None:
    """Carry out a procedure and show its progress."""

    def interrupt() -> None:
        work.line.interrupted = True

    subjects = tuple(drive.subject for drive in work.drives)
    with progress(shown.title, quiet=shown.quiet) as bar:

        def watch() -> None:
            bar.advance(sum(map(shown.counts, work.drives)), len(work.drives))

        try:
            run(carry_out, procedure, roster, subjects, interrupt, watch)
        finally:
            forget_terminal()  # else the end of the bar would fail, and the report would be missing


def _try(
    work: Rebaud, procedure: Procedure, options: RebaudOptions, aim: DrivePlace, baud: int
) -> str:
    """Carry out a procedure; return what ended it early, empty where nothing did.

    After an error the user must still see where the drives are.
    """
    shown = Shown(f"to {baud} baud", lambda drive: drive.place is aim, quiet=options.as_json)
    try:
        _carry(work, procedure, options.roster, shown)
    except LecombusError as exc:
        return str(exc)
    return ""


def _wants_back(work: Rebaud, options: RebaudOptions) -> bool:
    """Ask whether drives are to be set back; without an answer they stay."""
    if options.back:
        return True
    if options.yes or options.as_json or not can_ask():
        return False
    with suppress(click.Abort, KeyboardInterrupt), ended_as_by_ctrl_c():
        for drive in work.drives:
            if drive.why:
                click.echo(f"{drive.name}: {drive.why}")
        return click.confirm(f"Not every drive was changed. Set all back to {work.old} baud?")
    return False


def show_plan(work: Rebaud, roster: Roster, *, as_json: bool) -> None:
    """Show what would be written to each drive, and what else happens."""
    if as_json:
        click.echo(json.dumps({**_head(work, roster), "ending": "planned", "remedies": []}))
        return
    rows = [
        (one.name, str(one.subject.address), one.subject.family.name, _now(one), _step(one, work),
         one.motion, one.note)
        for one in work.drives
    ]  # fmt: skip
    show_rows(("drive", "address", "family", "now", "write", "motion", "watchdog"), rows)
    if on_terminal():
        click.echo(
            "A drive that is on this line and not in the roster stays where it is, out of reach."
        )


def _now(drive: RebaudDrive) -> str:
    return f"{drive.rate} baud" if drive.rate is not None else "silent"


def _step(drive: RebaudDrive, work: Rebaud) -> str:
    if drive.place is DrivePlace.NEW or drive.rate is None:
        return ""
    subject = drive.subject
    rule = saving_rule(subject.family)
    saving = f", then {rule.codes[0]} = {rule.value}" if rule is not None else ""
    return f"{subject.spoken} = {subject.number(work.new)}{saving}"


def show_end(work: Rebaud, roster: Roster, trouble: str, *, as_json: bool) -> None:
    """Show where every drive is, and what to do.

    Args:
        work: The result.
        roster: The roster.
        trouble: What ended it early; empty where nothing did.
        as_json: Print one JSON document.
    """
    remedies = what_to_do(work, roster.file, roster.line.baud)
    if as_json:
        document = {**_head(work, roster), "ending": ending_of(work).value, "remedies": remedies}
        click.echo(json.dumps({**document, "trouble": trouble or None}))
        return
    if trouble:
        click.echo(f"ended early: {trouble}", err=True)
    if work.line.interrupted:
        click.echo("interrupted: nothing further was sent", err=True)
    rows = [
        (one.name, str(one.subject.address), situation(one, work), one.why) for one in work.drives
    ]
    show_rows(("drive", "address", "where", "why"), rows)
    for remedy in remedies:
        click.echo(remedy)


def _head(work: Rebaud, roster: Roster) -> dict[str, object]:
    return {
        "line": roster.line.name,
        "from": work.old,
        "to": work.new,
        "interrupted": work.line.interrupted,
        "trouble": None,
        "drives": [_as_json(one, work) for one in work.drives],
    }


def _as_json(drive: RebaudDrive, work: Rebaud) -> dict[str, object]:
    return {
        "drive": drive.name,
        "address": drive.subject.address,
        "family": drive.subject.family.name,
        "place": drive.place.value,
        # What it answered at before a write is not where it is.
        "baud": None if drive.place is DrivePlace.WRITTEN else drive.rate,
        "shows": situation(drive, work),
        "why": drive.why or None,
        "motion": drive.motion or None,
        "watchdog": drive.note or None,
    }
