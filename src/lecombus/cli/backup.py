"""`lecombus backup`: a drive's parameters as a file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import anyio
import click

from lecombus import __version__
from lecombus.backups import (
    Backup,
    BackupEntry,
    Head,
    Listener,
    ReadResult,
    section_of,
    take,
    wanted_codes,
    write_backup,
)
from lecombus.cli.arguments import CODES, daemon_options, wait_option
from lecombus.cli.backup_files import check_target, save
from lecombus.cli.client import connect_async
from lecombus.cli.drive_access import HttpDrive
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.progress_bar import progress
from lecombus.cli.screen import counted
from lecombus.drives import family
from lecombus.parameters import Code
from lecombus.readings import Json

__all__ = ["backup_command", "entry_json", "read_drive"]


@click.command("backup")
@click.argument("drive")
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Write it here, whole or not at all; default: standard output.",
)
@click.option(
    "--also",
    type=CODES,
    multiple=True,
    metavar="CODES",
    help="Further codes, such as C0012 or C0010-C0050; what the drive does not know is left out.",
)
@wait_option
@click.option("--partial", is_flag=True, help="Also write what is not complete.")
@daemon_options
def backup_command(
    drive: str,
    output: Path | None,
    also: tuple[tuple[Code, ...], ...],
    patience_s: float,
    partial: bool,
    socket: str | None,
    url: str | None,
    as_json: bool,
) -> int:
    """Read every described parameter of DRIVE, of all parameter sets, into a YAML file.

    It runs in the background class: setpoints, watchdogs and cyclic reads go first. If the line
    is lost, it waits. Passwords are never read. Codes that the drive refuses stand in the file
    with the reason. If codes could not be read because the line or the drive was not available,
    the backup is incomplete: without --partial it is not written (exit status 1).

    `lecombus diff` compares such files and drives, `lecombus restore` writes one back. With --json:
    {"drive", "file", "complete", "codes": [{"code", "name", "section", "raw", "unit", "reason"}]}.
    """
    if output is not None:
        check_target(output)
    wanted = [code for codes in also for code in codes]
    with progress(drive, quiet=as_json) as bar:
        backup, left = anyio.run(fetch, socket, url, drive, wanted, patience_s, bar)
    if left and not partial:
        raise incomplete(drive, left, output)
    text = write_backup(backup)
    if output is not None:
        save(output, text)
    if as_json:
        click.echo(json.dumps(summary(backup, output, left), ensure_ascii=False))
    elif output is None:
        click.echo(text, nl=False)
    else:
        missing = f", {len(backup.not_read)} not readable" if backup.not_read else ""
        read = len(backup.entries) - len(backup.not_read)
        click.echo(f"{drive}: {counted(read, 'code')} read{missing}, written to {output}", err=True)
    return Exit.FAILED if left else Exit.DONE


async def fetch(
    socket: str | None,
    url: str | None,
    drive: str,
    also: Sequence[Code],
    patience_s: float,
    listener: Listener,
) -> tuple[Backup, list[ReadResult]]:
    """Connect and read."""
    async with connect_async(socket, url) as (client, where):
        return await read_drive(
            HttpDrive(client, where, drive), also, patience_s=patience_s, listener=listener
        )


async def read_drive(
    drive: HttpDrive, also: Iterable[Code], *, patience_s: float, listener: Listener
) -> tuple[Backup, list[ReadResult]]:
    """Read a drive whole.

    Args:
        drive: The drive.
        also: Further codes; those that neither a description nor the drive knows are left out.
        patience_s: How long to wait, each time, for a line or a drive that is away, seconds.
        listener: Shows the progress.

    Returns:
        The backup, and what is missing in it for a reason that may pass.

    Raises:
        CommandError: There is no such drive, or no daemon.
    """
    whose = await drive.whose()
    kind = family(whose.family)
    codes = wanted_codes(kind, also)
    taken = await take(drive, codes, patience_s=patience_s, listener=listener)
    entries = {
        code: BackupEntry(code, answer.value, missing=answer.kind)
        for code, answer in taken.answers.items()
        if answer.value is not None or kind.info(code) is not None
    }
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    head = Head(whose.drive, whose.line, whose.address, whose.family, now, __version__)
    return Backup(head, kind, entries, name=whose.drive), taken.unsettled


def incomplete(drive: str, left: Sequence[ReadResult], output: Path | None) -> CommandError:
    """Say why no backup was written."""
    first = left[0]
    codes = counted(len(left), "code")
    kept = f"; {output} is as it was" if output is not None and output.exists() else ""
    return CommandError(
        Exit.FAILED,
        Problem(
            f"{codes} of {drive} could not be read, the first {first.code}: {first.text}; nothing "
            f"was written{kept}",
            "again when the line is well, or with --partial for what there is",
            first.kind,
            drive,
            str(first.code),
        ),
    )


def summary(backup: Backup, output: Path | None, left: Sequence[ReadResult]) -> dict[str, Json]:
    """Return the JSON form."""
    return {
        "drive": backup.head.drive,
        "file": None if output is None else str(output),
        "complete": not left,
        "codes": [entry_json(backup, entry) for entry in backup.entries.values()],
    }


def entry_json(backup: Backup, entry: BackupEntry) -> dict[str, Json]:
    """Return the JSON form of one code."""
    info = backup.family.info(entry.code)
    return {
        "code": str(entry.code),
        "name": "" if info is None else info.name,
        "section": section_of(backup.family, entry.code).value,
        "raw": None if entry.value is None else entry.value.raw,
        "unit": None if info is None else info.unit,
        "reason": entry.missing or None,
    }
