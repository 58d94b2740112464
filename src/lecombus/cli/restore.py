"""`lecombus restore`: a backup is written back into a drive."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import anyio
import click

from lecombus.backups import (
    Backup,
    Listener,
    Progress,
    Restored,
    RestorePlan,
    RestoreStep,
    is_inhibited,
    make_plan,
    read_backup,
    restore,
    take,
)
from lecombus.backups.restore_plan import codes_to_read
from lecombus.cli.arguments import DaemonOptions, daemon_options, wait_option
from lecombus.cli.backup import Notes, digest_of, incomplete, read_text
from lecombus.cli.daemon_access import connected
from lecombus.cli.document_rows import shown_code, shown_code_and_name
from lecombus.cli.drive_access import DriveOnLine, HttpDrive, RestorePermission
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.screen import counted, make_sure, on_terminal, progress, show_rows
from lecombus.cli.signals import ended_as_by_ctrl_c
from lecombus.fieldbus.protocols import family_of_any_protocol
from lecombus.parameters import Code, Json, Value

__all__ = ["restore_command", "result_json", "show_result"]


@dataclass(frozen=True, slots=True)
class RestoreOptions:
    """What the command line asks for.

    Args:
        backup: The backup.
        digest: Its content's digest.
        drive: The drive.
        other_drive: It is known to be another one.
        yes: Do not ask the user.
        enable: Lift the inhibit at the end if it was not inhibited before.
        patience_s: How long to wait for what is away, seconds.
        daemon: The drive's daemon; whether JSON is printed.
    """

    backup: Backup
    digest: str
    drive: str
    other_drive: bool
    yes: bool
    enable: bool
    patience_s: float
    daemon: DaemonOptions


@dataclass(frozen=True, slots=True)
class Seen:
    """What a plan was made from.

    Args:
        drive: The drive.
        rights: Whether it may be restored.
        plan: The plan.
        enabled: It is not inhibited now, though a quick stop may hold it; None where it does not
            say.
    """

    drive: DriveOnLine
    rights: RestorePermission
    plan: RestorePlan
    enabled: bool | None


@click.command("restore")
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@click.argument("drive")
@click.option("--dry-run", is_flag=True, help="Show the plan, write nothing.")
@click.option("--yes", is_flag=True, help="Do not ask; needed without a terminal.")
@click.option(
    "--to-other-drive",
    "other_drive",
    is_flag=True,
    help="Also into a drive of another size, parameter version or software.",
)
@click.option(
    "--enable",
    is_flag=True,
    help="Lift the inhibit at the end if it was not inhibited before: the motor may turn.",
)
@wait_option
@daemon_options
@ended_as_by_ctrl_c()
def restore_command(
    file: Path,
    drive: str,
    dry_run: bool,
    yes: bool,
    other_drive: bool,
    enable: bool,
    patience_s: float,
    daemon: DaemonOptions,
) -> int:
    """Write the backup in FILE back into DRIVE.

    First the plan: what is written in which order, what is left out and why. Then the drive is
    inhibited and stays so; every code is written and read back; at the end everything is read
    and compared, and saved where the family needs that. A code that already has the value is
    not written.

    The roster must say `restore: true` for the drive. Run an interrupted restore again: it
    writes what is missing. Exit status 1 if not everything is as in the file.
    """
    text = read_text(file)
    backup = read_backup(text, str(file))
    options = RestoreOptions(
        backup, digest_of(text), drive, other_drive, yes or dry_run, enable, patience_s,
        daemon,
    )  # fmt: skip
    with said_when_interrupted("nothing was written"):
        seen = anyio.run(look, options)
    if dry_run:
        if daemon.as_json:
            click.echo(json.dumps(plan_json(seen.plan, drive)))
        else:
            show_plan(seen.plan, drive, enabled=seen.enabled, enable=enable)
        check(options, seen)
        return Exit.DONE
    with Notes.opened(seen.drive.line, drive) as notes:
        return carry_out(options, seen, notes)


@contextlib.contextmanager
def said_when_interrupted(what: str) -> Iterator[None]:
    """Print what was done when Ctrl-C or a signal interrupts the block."""
    try:
        yield
    except (KeyboardInterrupt, click.Abort):
        click.echo(f"\ninterrupted: {what}", err=True)
        raise


async def look(options: RestoreOptions) -> Seen:
    """Read what a plan is made from, and make it.

    Raises:
        CommandError: The drive could not be read.
    """
    async with connected(options.daemon) as line:
        drive = HttpDrive(line, options.drive)
        found, rights = await drive.ask_which(), await drive.restore_rights()
        kind = family_of_any_protocol(found.family)
        codes = codes_to_read(options.backup, rights.owned) if kind is options.backup.family else ()
        with progress(f"reading {options.drive}", quiet=options.daemon.as_json) as bar:
            taken = await take(drive, codes, patience_s=options.patience_s, listener=bar)
        if taken.unsettled:
            raise incomplete(options.drive, taken.unsettled, None, kind)
        plan = make_plan(options.backup, kind, taken.answers, owned=rights.owned,
                         other_drive=options.other_drive)  # fmt: skip
        inhibited = await is_inhibited(drive, kind)
        return Seen(found, rights, plan, None if inhibited is None else not inhibited)


def check(options: RestoreOptions, seen: Seen) -> None:
    """Refuse what must not be restored.

    Raises:
        CommandError: The plan says that it is wrong, or the roster does not permit it.
    """
    plan = seen.plan
    if plan.blockers:
        other = "add --to-other-drive if the backup is meant for this drive"
        if plan.mistakes or options.backup.family is not plan.family:
            other = ""  # it would be refused all the same
        problems = [
            Problem(
                text, "correct the file" if text in plan.mistakes else other, drive=options.drive
            )
            for text in plan.blockers
        ]
        raise CommandError.of(Exit.USAGE, *problems)
    if seen.rights.reason:
        raise CommandError(
            Exit.FORBIDDEN, seen.rights.reason, seen.rights.remedy, "not-permitted", options.drive
        )


def carry_out(options: RestoreOptions, seen: Seen, notes: Notes) -> int:
    """Show the plan, ask, and do it."""
    before = left_by(notes, options)
    plan = seen.plan
    # Also what a restore of another file wrote is in the drive, and lost without power.
    unsaved = plan.save is not None and notes.left is not None and bool(notes.left.done)
    enabled = seen.enabled is True or was_enabled(before, seen)
    if not options.daemon.as_json:
        show_plan(plan, options.drive, enabled=seen.enabled, enable=options.enable)
        show_earlier(before, notes, options)
        if options.enable and before is not None and before.enabled and not seen.enabled:
            show_enabling(options.drive, enabled=enabled)
    check(options, seen)
    # All may be written already, and only the inhibit be left of the restore that is gone on with.
    is_left_inhibited = options.enable and enabled and not seen.enabled
    if not plan.steps and not unsaved and not is_left_inhibited:
        notes.finish()
        give_result(plan, Restored(), options, lambda *_: None)
        return Exit.DONE
    if not options.yes:
        with said_when_interrupted("nothing was written"):
            make_sure(f"Restore {options.drive}?", as_json=options.daemon.as_json)
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    begun = before or Progress(options.backup.name, options.digest, now, enabled)
    notes.begin(replace(begun, enabled=enabled, stops=seen.rights.stops))
    result = Restored()
    try:
        with progress(options.drive, quiet=options.daemon.as_json) as bar:
            result, stops = anyio.run(work, options, seen, notes, unsaved, bar, result.written)
    except (KeyboardInterrupt, CommandError) as exc:  # also a drive that a reload took away
        result.stopped = str(exc.problems[0]) if isinstance(exc, CommandError) else "interrupted"
        give_result(plan, result, options, show_interrupted)
        raise
    if result.complete:
        notes.finish()
    enables = options.enable and enabled and result.complete
    enabling = enable_again(options, stops) if enables else ""
    enabled_again = enables and not enabling
    give_result(plan, result, options, partial(show_result, enabled=enabled_again))
    if enabling:
        raise CommandError(Exit.FAILED, f"{options.drive} stays inhibited: {enabling}")
    return Exit.DONE if result.complete else Exit.FAILED


def give_result(
    plan: RestorePlan,
    result: Restored,
    options: RestoreOptions,
    show: Callable[[RestorePlan, Restored, str], None],
) -> None:
    """Print what was done, as JSON or by `show`."""
    if options.daemon.as_json:
        click.echo(json.dumps(result_json(plan, result, options.drive)))
    else:
        show(plan, result, options.drive)


def left_by(notes: Notes, options: RestoreOptions) -> Progress | None:
    """Return the progress of an interrupted restore of the same backup; None for another backup."""
    left = notes.left
    return left if left is not None and left.digest == options.digest else None


def show_earlier(before: Progress | None, notes: Notes, options: RestoreOptions) -> None:
    """Show that an earlier restore was interrupted."""
    if before is not None:
        codes = counted(len(before.done), "code")
        click.echo(f"going on with a restore begun at {before.begun}: {codes} written then")
    elif notes.left is not None:
        click.echo(
            f"a restore of {notes.left.file}, begun at {notes.left.begun}, was not finished: "
            f"{options.drive} may hold a part of it"
        )


def was_enabled(before: Progress | None, seen: Seen) -> bool:
    """Whether a drive was enabled when an interrupted restore began, and was not stopped since.

    What another one has stopped does not start again because the restore is.
    """
    if before is None or not before.enabled:
        return False
    return before.stops == seen.rights.stops != ""


def show_enabling(drive: str, *, enabled: bool) -> None:
    """Say what becomes of a drive that was enabled when the restore began, and is not now."""
    if enabled:
        said = "the inhibit is lifted at the end: the motor may turn"
    else:
        said = "it was stopped since, or lecombus was started again: it stays inhibited"
    click.echo(f"{drive} was not inhibited when that began; {said}", err=True)


async def work(
    options: RestoreOptions,
    seen: Seen,
    notes: Notes,
    unsaved: bool,
    listener: Listener,
    kept: dict[Code, Value],
) -> tuple[Restored, str]:
    """Carry out the plan; `kept` gets each code that was written, also if it is interrupted.

    Returns:
        The result, and the mark that refuses an enable after a later stop.
    """
    noted = seen.rights.stops

    async with connected(options.daemon) as line:
        # A stop since the plan was made, such as while the user was asked, ends this too.
        drive = HttpDrive(line, options.drive, stops=noted)

        def written(code: Code, value: Value) -> None:
            nonlocal noted
            if drive.stops != noted:  # by our own inhibit
                notes.stops(drive.stops)
                noted = drive.stops
            notes.done(code, value)
            kept[code] = value

        result = await restore(
            drive, seen.plan, patience_s=options.patience_s, listener=listener, written=written,
            unsaved=unsaved,
        )  # fmt: skip
        return result, drive.stops


def enable_again(options: RestoreOptions, stops: str) -> str:
    """Lift the inhibit; give why it could not be, empty when it was."""
    drive = options.drive
    left = f"{drive} is restored, and stays inhibited unless `lecombus status` shows it enabled"

    async def enable() -> str:
        async with connected(options.daemon) as line:
            said = await HttpDrive(line, drive, stops=stops).enable()
            return "" if said.done else said.text or said.kind

    with said_when_interrupted(left):
        return anyio.run(enable)


def show_plan(plan: RestorePlan, drive: str, *, enabled: bool | None, enable: bool) -> None:
    """Print what would be written, what is left out, and what should be known before.

    Args:
        plan: The plan.
        drive: The drive's name.
        enabled: It is not inhibited now, though a quick stop may hold it; None where it does not
            say.
        enable: Its inhibit is lifted at the end.
    """
    if on_terminal():
        click.echo(headline(plan, drive))
    kind = plan.family.name
    rows = [
        (
            "write", *shown_code_and_name(kind, step.code, step.name),
            with_meaning(step.now, step.now_means),
            with_meaning(step.value, step.value_means), step.unit or "", step.because,
        )
        for step in plan.steps
    ]  # fmt: skip
    rows += [
        ("skip", shown_code(kind, skip.code), skip.name, "", "", "", skip.why)
        for skip in plan.skips
        if not skip.expected
    ]
    if rows:
        show_rows(("", "code", "name", "now", "then", "unit", "why"), rows)
    for remark in plan.remarks:
        click.echo(remark, err=True)
    if plan.steps and enabled:
        after = "and stays so"
        if enable:
            after = "and the inhibit is lifted at the end: the motor may turn"
        click.echo(f"{drive} is not inhibited: it will be inhibited, {after}", err=True)
    if plan.save is not None and plan.steps:
        click.echo(
            f"at the end {plan.family.spoken(plan.save[0])} = {plan.save[1]} saves it all", err=True
        )


def headline(plan: RestorePlan, drive: str) -> str:
    """Return the plan in one line."""
    expected = sum(skip.expected for skip in plan.skips)
    parts = [f"{len(plan.steps)} to write", f"{len(plan.same)} right already"]
    if others := len(plan.skips) - expected:
        parts.append(f"{others} left out")
    if expected:
        parts.append(f"{expected} process values and the like")
    return f"{drive}: " + ", ".join(parts)


def with_meaning(value: Value, meaning: str) -> str:
    """Return a value with its meaning."""
    return f"{value} ({meaning})" if meaning else value.raw


def show_result(plan: RestorePlan, result: Restored, drive: str, *, enabled: bool) -> None:
    """Print the result."""
    kind = plan.family
    rows = [
        (shown_code(kind.name, code), "refused", plan.wanted[code].raw, "", why)
        for code, why in result.refused.items()
    ]
    rows += [
        (
            shown_code(kind.name, code), "changed", value.raw,
            answer.value.raw if answer.value else "",
            answer.text or "it was changed from elsewhere, or the drive did not keep it",
        )
        for code, (value, answer) in result.changed.items()
    ]  # fmt: skip
    if rows:
        show_rows(("code", "outcome", "wanted", "reads", "why"), rows)
    if result.stopped:
        click.echo(f"stopped: {result.stopped}", err=True)
        if result.written:
            click.echo(f"written: {', '.join(map(kind.spoken, result.written))}", err=True)
    written = counted(len(result.written), "code")
    if result.complete:
        saved = " and saved" if result.saved else ""
        click.echo(f"{drive}: {written} written and read back{saved}, all as in the file")
    else:
        rest = "run it again: it goes on with what is missing"
        click.echo(f"{drive}: {written} written, not complete; {rest}", err=True)
        if result.saved is False:
            click.echo("not saved: what was written is lost at power-off", err=True)
    if enabled:
        click.echo(f"{drive} is not inhibited any more")
    elif result.inhibited_here and result.inhibited_now:
        click.echo(f"{drive} is inhibited: enable it yourself, when it may move")
    elif result.inhibited_now is not True:
        is_not = "is not" if result.inhibited_now is False else "does not say whether it is"
        click.echo(f"{drive} {is_not} inhibited now: the motor may start", err=True)


def show_interrupted(plan: RestorePlan, result: Restored, drive: str) -> None:
    """Print what a restore that was cut off, as by Ctrl-C, has done, and how to continue."""
    written = len(result.written)
    of = f"{written} of {counted(len(plan.steps), 'code')}"
    more = "" if written == len(plan.steps) else "; the one under way may have been written too"
    holds = "stays inhibited and holds" if written else "may be inhibited and hold"
    click.echo(
        f"interrupted: {of} written to {drive} and read back{more}; it {holds} a part of the "
        "backup. Run the same command again: it goes on with what is missing",
        err=True,
    )


def plan_json(plan: RestorePlan, drive: str) -> dict[str, Json]:
    """Return the plan's JSON form."""
    return {
        "drive": drive,
        "blockers": list(plan.blockers),
        "remarks": list(plan.remarks),
        "write": [step_json(step) for step in plan.steps],
        "same": [str(code) for code in plan.same],
        "skip": [{"code": str(s.code), "name": s.name, "reason": s.why} for s in plan.skips],
    }


def step_json(step: RestoreStep) -> dict[str, Json]:
    """Return the JSON form of one write."""
    return {
        "code": str(step.code),
        "name": step.name,
        "unit": step.unit,
        "now": step.now.raw,
        "then": step.value.raw,
        "reason": step.because or None,
    }


def result_json(plan: RestorePlan, result: Restored, drive: str) -> dict[str, Json]:
    """Return the result's JSON form, with the plan it came from."""
    return {
        **plan_json(plan, drive),
        "complete": result.complete,
        "written": [str(code) for code in result.written],
        "refused": [{"code": str(code), "reason": why} for code, why in result.refused.items()],
        "changed": [
            {
                "code": str(code),
                "wanted": value.raw,
                "reads": None if answer.value is None else answer.value.raw,
            }
            for code, (value, answer) in result.changed.items()
        ],
        "stopped": result.stopped or None,
        "inhibited": result.inhibited_here and result.inhibited_now is True,
        "saved": result.saved,
    }
