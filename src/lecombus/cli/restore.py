"""`lecombus restore`: a backup back into a drive."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import anyio
import click

from lecombus.backups import (
    Backup,
    Listener,
    Progress,
    Restored,
    RestorePlan,
    is_inhibited,
    make_plan,
    read_backup,
    restore,
    take,
)
from lecombus.backups.plan import codes_to_read
from lecombus.cli.arguments import daemon_options, wait_option
from lecombus.cli.backup import incomplete
from lecombus.cli.backup_files import Notes, digest_of, read_text
from lecombus.cli.client import connect_async
from lecombus.cli.drive_access import HttpDrive, RestoreRights, Whose
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.progress_bar import progress
from lecombus.cli.restore_reports import (
    plan_json,
    result_json,
    show_interrupted,
    show_plan,
    show_result,
)
from lecombus.cli.screen import counted
from lecombus.drives import family
from lecombus.protocol import Code, Value

__all__ = ["command"]


@dataclass(frozen=True, slots=True)
class Wish:
    """What the command line asks for.

    Args:
        backup: The backup.
        digest: Its content's digest.
        drive: The drive.
        other_drive: It is known to be another one.
        dry_run: Only show the plan.
        yes: Nobody need be asked.
        enable: Lift the inhibit at the end if it was enabled before.
        patience_s: How long to wait for what is away, seconds.
        as_json: Print JSON.
    """

    backup: Backup
    digest: str
    drive: str
    other_drive: bool
    dry_run: bool
    yes: bool
    enable: bool
    patience_s: float
    as_json: bool


@dataclass(frozen=True, slots=True)
class Seen:
    """What a plan was made from.

    Args:
        whose: The drive.
        rights: Whether it may be restored.
        plan: The plan.
        enabled: It is enabled now; None where it does not say.
    """

    whose: Whose
    rights: RestoreRights
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
    help="Enable it at the end if it was enabled before: the motor may turn.",
)
@wait_option
@daemon_options
def command(
    file: Path,
    drive: str,
    dry_run: bool,
    yes: bool,
    other_drive: bool,
    enable: bool,
    patience_s: float,
    socket: str | None,
    url: str | None,
    as_json: bool,
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
    wish = Wish(backup, digest_of(text), drive, other_drive, dry_run, yes or dry_run, enable,
                patience_s, as_json)  # fmt: skip
    with said_when_interrupted("nothing was written"):
        seen = anyio.run(look, wish, socket, url)
    if dry_run:
        if as_json:
            click.echo(json.dumps(plan_json(seen.plan, drive)))
        else:
            show_plan(seen.plan, drive, enabled=seen.enabled, enable=enable)
        check(wish, seen)
        return Exit.DONE
    with Notes.opened(seen.whose.line, drive) as notes:
        return carry_out(wish, seen, notes, socket, url)


@contextlib.contextmanager
def said_when_interrupted(what: str) -> Iterator[None]:
    """Say what a Ctrl-C leaves behind."""
    try:
        yield
    except (KeyboardInterrupt, click.Abort):
        click.echo(f"\ninterrupted: {what}", err=True)
        raise


async def look(wish: Wish, socket: str | None, url: str | None) -> Seen:
    """Read what a plan is made from, and make it.

    Raises:
        CommandError: The drive could not be read.
    """
    async with connect_async(socket, url) as (client, where):
        drive = HttpDrive(client, where, wish.drive)
        whose, rights = await drive.whose(), await drive.restore_rights()
        kind = family(whose.family)
        codes = codes_to_read(wish.backup, rights.owned) if kind is wish.backup.family else ()
        with progress(f"reading {wish.drive}", quiet=wish.as_json) as bar:
            taken = await take(drive, codes, patience_s=wish.patience_s, listener=bar)
        if taken.unsettled:
            raise incomplete(wish.drive, taken.unsettled, None)
        plan = make_plan(wish.backup, kind, taken.answers, owned=rights.owned,
                         other_drive=wish.other_drive)  # fmt: skip
        inhibited = await is_inhibited(drive, kind)
        return Seen(whose, rights, plan, None if inhibited is None else not inhibited)


def check(wish: Wish, seen: Seen) -> None:
    """Refuse what must not be restored.

    Raises:
        CommandError: The plan says that it is wrong, or the roster does not permit it.
    """
    if seen.plan.blockers:
        strange = wish.backup.family is seen.plan.family and not wish.other_drive
        remedy = "with --to-other-drive, if it is meant for it" if strange else ""
        problems = [Problem(text, remedy, drive=wish.drive) for text in seen.plan.blockers]
        raise CommandError(Exit.USAGE, *problems)
    if seen.rights.reason:
        problem = Problem(seen.rights.reason, seen.rights.remedy, "not-permitted", wish.drive)
        raise CommandError(Exit.FORBIDDEN, problem)


def carry_out(wish: Wish, seen: Seen, notes: Notes, socket: str | None, url: str | None) -> int:
    """Show the plan, ask, and do it."""
    before = left_by(notes, wish)
    plan = seen.plan
    unsaved = plan.save is not None and before is not None and bool(before.done)
    if not wish.as_json:
        show_plan(plan, wish.drive, enabled=seen.enabled, enable=wish.enable)
        tell_before(before, notes, wish)
    check(wish, seen)
    if not plan.steps and not unsaved:
        notes.finish()
        if wish.as_json:
            click.echo(json.dumps(result_json(plan, Restored(), wish.drive)))
        return Exit.DONE
    make_sure(wish)
    enabled = seen.enabled is True or (before is not None and before.enabled)
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    begun = before or Progress(wish.backup.name, wish.digest, now, enabled)
    notes.begin(replace(begun, enabled=enabled))
    result = Restored()
    try:
        with progress(wish.drive, quiet=wish.as_json) as bar:
            result, stops = anyio.run(
                work, wish, plan, notes, unsaved, socket, url, bar, result.written
            )
    except KeyboardInterrupt:
        result.stopped = "interrupted"
        if wish.as_json:
            click.echo(json.dumps(result_json(plan, result, wish.drive)))
        else:
            show_interrupted(plan, result, wish.drive)
        raise
    if result.complete:
        notes.finish()
    enabling = ""
    if wish.enable and enabled and result.complete:
        enabling = enable_again(wish, stops, socket, url)
    if wish.as_json:
        click.echo(json.dumps(result_json(plan, result, wish.drive)))
    else:
        show_result(plan, result, wish.drive, enabled=enabled and wish.enable and not enabling)
    if enabling:
        raise CommandError(Exit.FAILED, Problem(f"{wish.drive} stays inhibited: {enabling}"))
    return Exit.DONE if result.complete else Exit.FAILED


def left_by(notes: Notes, wish: Wish) -> Progress | None:
    """Give what an earlier try of this very restore left; another file's is not taken for it."""
    left = notes.left
    return left if left is not None and left.digest == wish.digest else None


def tell_before(before: Progress | None, notes: Notes, wish: Wish) -> None:
    """Say that a restore was interrupted before."""
    if before is not None:
        codes = counted(len(before.done), "code")
        click.echo(f"going on with a restore begun at {before.begun}: {codes} written then")
    elif notes.left is not None:
        click.echo(
            f"a restore of {notes.left.file}, begun at {notes.left.begun}, was not finished: "
            f"{wish.drive} may hold a part of it"
        )


def make_sure(wish: Wish) -> None:
    """Ask, unless the command line has answered already.

    Raises:
        CommandError: Nobody can be asked, or the answer was no.
    """
    if wish.yes:
        return
    if wish.as_json or not (sys.stdin.isatty() and sys.stdout.isatty()):
        problem = Problem("nobody can be asked here; nothing was written", "repeat it with --yes")
        raise CommandError(Exit.USAGE, problem)
    with said_when_interrupted("nothing was written"):
        sure = click.confirm(f"Restore {wish.drive}?")
    if not sure:
        raise CommandError(Exit.FAILED, Problem("nothing was written"))


async def work(
    wish: Wish,
    plan: RestorePlan,
    notes: Notes,
    unsaved: bool,
    socket: str | None,
    url: str | None,
    listener: Listener,
    kept: dict[Code, Value],
) -> tuple[Restored, str]:
    """Carry out the plan; `kept` is told of each code that was written, also if it is cut short.

    Returns:
        How it ended, and what ends an enable behind it if the drive is stopped meanwhile.
    """

    def written(code: Code, value: Value) -> None:
        notes.done(code, value)
        kept[code] = value

    async with connect_async(socket, url) as (client, where):
        drive = HttpDrive(client, where, wish.drive)
        with contextlib.suppress(CommandError):  # a daemon that is away is waited for
            drive.stops = (await drive.restore_rights()).stops
        result = await restore(
            drive, plan, patience_s=wish.patience_s, listener=listener, written=written,
            unsaved=unsaved,
        )  # fmt: skip
        return result, drive.stops


def enable_again(wish: Wish, stops: str, socket: str | None, url: str | None) -> str:
    """Lift the inhibit; give why it could not be, empty when it was."""
    left = (
        f"{wish.drive} is restored, and stays inhibited unless `lecombus status` shows it enabled"
    )

    async def enable() -> str:
        async with connect_async(socket, url) as (client, where):
            said = await HttpDrive(client, where, wish.drive, stops=stops).enable()
            return "" if said.done else said.text or said.kind

    with said_when_interrupted(left):
        return anyio.run(enable)
