"""`lecombus diff`: what two backups or drives differ in."""

from __future__ import annotations

import json
import os
from pathlib import Path

import anyio
import click

from lecombus.backups import Backup, BackupEntry, Comparison, Difference, Listener, compare
from lecombus.cli.arguments import DaemonOptions, daemon_options, wait_option
from lecombus.cli.backup import incomplete, load_backup, read_drive
from lecombus.cli.daemon_access import connected
from lecombus.cli.document_rows import shown_code_and_name
from lecombus.cli.drive_access import HttpDrive
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.screen import progress, show_rows
from lecombus.parameters import Json

__all__ = ["diff_command"]

SUFFIXES = (".yaml", ".yml")


@click.command("diff")
@click.argument("one", metavar="A")
@click.argument("other", metavar="B")
@click.option(
    "--all",
    "everything",
    is_flag=True,
    help="Also process values, addresses and what tells drives apart.",
)
@wait_option
@daemon_options
def diff_command(
    one: str,
    other: str,
    everything: bool,
    patience_s: float,
    daemon: DaemonOptions,
) -> int:
    """Show the differences of A and B; each is a backup's file, or a drive, which is read now.

    An argument with a slash, or that ends in .yaml or .yml, is a file; all others are drives.
    Numbers are compared as numbers: 35.0 is 35.

    Exit status: 0 they are equal; 1 they differ (or a drive could not be read: nothing is shown
    then). In a pipe: code, name, A, B, unit, separated by tabs. With --json: {"equal", "same",
    "left_out", "remarks", "differences": [{"code", "name", "unit", "one", "other"}]}.
    """
    with progress("reading", quiet=daemon.as_json) as bar:
        backups = anyio.run(gather, (one, other), daemon, patience_s, bar)
    found = compare(*backups, everything=everything)
    if daemon.as_json:
        click.echo(json.dumps(comparison_json(found), ensure_ascii=False))
    else:
        show(found, one, other)
    return Exit.DONE if found.equal else Exit.FAILED


async def gather(
    names: tuple[str, str],
    daemon: DaemonOptions,
    patience_s: float,
    listener: Listener,
) -> tuple[Backup, Backup]:
    """Load or read both."""
    first, second = names
    before = load_backup(Path(first)) if is_file(first) else None
    after = load_backup(Path(second)) if is_file(second) else None
    if before is not None and after is not None:
        return before, after
    async with connected(daemon) as line:
        # What the file knows beyond the descriptions is asked of the drive as well.
        also = [code for backup in (before, after) if backup for code in backup.entries]

        async def read(name: str) -> Backup:
            drive = HttpDrive(line, name)
            backup, left = await read_drive(drive, also, patience_s=patience_s, listener=listener)
            if left:
                raise incomplete(name, left, None, backup.family)
            return backup

        return before or await read(first), after or await read(second)


def is_file(name: str) -> bool:
    """Return whether a file is meant.

    Raises:
        CommandError: It can be both.
    """
    if os.sep in name or name.endswith(SUFFIXES):
        return True
    if Path(name).is_file():
        raise CommandError(
            Exit.USAGE, f"{name} is a file here and may be a drive", f"write ./{name} for it"
        )
    return False


def show(found: Comparison, one: str, other: str) -> None:
    """Print the differences as a table or as lines of cells."""
    for remark in found.remarks:
        click.echo(remark, err=True)
    rows = [
        (
            *shown_code_and_name(each.family.name, each.code, each.name),
            shown(each.one, each.meaning_one),
            shown(each.other, each.meaning_other), each.unit or "",
        )
        for each in found.differences
    ]  # fmt: skip
    if rows:
        show_rows(("code", "name", one, other, "unit"), rows)
    elif not found.same:
        click.echo("there is nothing to compare", err=True)


def shown(entry: BackupEntry | None, meaning: str) -> str:
    """Return one side of a difference."""
    if entry is None:
        return "not there"
    if entry.value is None:
        return f"not read ({entry.missing})"
    return f"{entry.value} ({meaning})" if meaning else entry.value.raw


def comparison_json(found: Comparison) -> dict[str, Json]:
    """Return the JSON form."""
    return {
        "equal": found.equal,
        "same": found.same,
        "left_out": found.left_out,
        "remarks": list(found.remarks),
        "differences": [difference_json(each) for each in found.differences],
    }


def difference_json(each: Difference) -> dict[str, Json]:
    """Return the JSON form of one difference."""

    def side(entry: BackupEntry | None) -> Json:
        return None if entry is None or entry.value is None else entry.value.raw

    return {
        "code": str(each.code),
        "name": each.name,
        "unit": each.unit,
        "one": side(each.one),
        "other": side(each.other),
    }
