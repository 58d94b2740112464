"""`lecombus backup` and `lecombus diff`: a drive's parameters as a file, and what two differ in.

A backup is written beside its place and then takes it, so that there is always a whole one; a file
that is no backup is never replaced. How far a restore came is kept per line and drive in the user's
state folder (XDG_STATE_HOME), and locked while a restore is under way.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote

import anyio
import click

from lecombus import __version__
from lecombus.backups import (
    Backup,
    BackupEntry,
    BackupHead,
    Comparison,
    Difference,
    Listener,
    Progress,
    ReadAttempt,
    compare,
    done_line,
    head_line,
    read_backup,
    read_progress,
    section_of,
    take,
    wanted_codes,
    write_backup,
)
from lecombus.cli.arguments import CODES, DaemonOptions, daemon_options, wait_option
from lecombus.cli.daemon_access import connected
from lecombus.cli.drive_access import HttpDrive
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.screen import counted, progress, show_rows
from lecombus.errors import ConfigError
from lecombus.fieldbus.protocols import family_of_any_protocol
from lecombus.parameters import Code, Json, Value

__all__ = [
    "Notes",
    "backup_command",
    "check_target",
    "diff_command",
    "digest_of",
    "incomplete",
    "load_backup",
    "read_drive",
    "read_text",
    "save",
]

LARGEST = 4 * 1024 * 1024
"""Bytes; a backup of a thousand codes takes under a tenth of a megabyte."""

MODE = 0o644


def read_text(path: Path) -> str:
    """Read a file that a user named.

    Raises:
        CommandError: It is too big, or no text.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise CommandError(Exit.USAGE, f"{path} is far too big for a backup")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as exc:
        raise CommandError(
            Exit.USAGE, f"{path} is no text in UTF-8", "name the file that backup wrote"
        ) from exc


def load_backup(path: Path) -> Backup:
    """Read a backup.

    Raises:
        ConfigError: Something in it cannot be.
        CommandError: It is no text.
        OSError: It cannot be read.
    """
    return read_backup(read_text(path), str(path))


def digest_of(text: str) -> str:
    """Return a digest of a backup's content."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def check_target(path: Path) -> None:
    """See before the work that a backup can be written here.

    Raises:
        CommandError: There is something else in its place, or no folder for it.
    """
    if not path.parent.is_dir():
        raise CommandError(Exit.USAGE, f"there is no folder {path.parent}", "make it first")
    if not path.exists():
        return
    try:
        load_backup(path)
    except (ConfigError, CommandError) as exc:
        raise CommandError(
            Exit.USAGE, f"{path} is there and is no backup", "name another file, or remove it"
        ) from exc


def save(path: Path, text: str) -> None:
    """Put a backup in its place, whole.

    Raises:
        OSError: It could not be written; what was there is as it was.
    """
    place = path.resolve()  # a link stays one
    descriptor, name = tempfile.mkstemp(prefix=f".{place.name}.", suffix=".new", dir=place.parent)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            os.fchmod(descriptor, MODE)
            file.write(text)
            file.flush()
            os.fsync(descriptor)
        Path(name).replace(place)
    except BaseException:  # also when interrupted: no half of a backup is left beside it
        Path(name).unlink(missing_ok=True)
        raise


class Notes:
    """The notes of one drive's restore. Make one with `opened`.

    Attributes:
        left: What an unfinished restore left behind; None where there is none.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path = path
        self._descriptor = descriptor
        self.left = read_progress(path.read_text(encoding="utf-8", errors="replace"))

    @classmethod
    @contextmanager
    def opened(cls, line: str, drive: str) -> Iterator[Notes]:
        """Open and lock the notes of a drive; empty notes are not left behind.

        Raises:
            CommandError: Another restore of this drive is under way here.
            OSError: The state folder cannot be used.
        """
        folder = state_folder()
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"restore-{quote(line, safe='')}-{quote(drive, safe='')}.jsonl"
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as exc:
                problem = f"another restore of {drive} is under way"
                raise CommandError(Exit.FAILED, problem, "wait for its end") from exc
            try:
                yield cls(path, descriptor)
            finally:
                if os.fstat(descriptor).st_size == 0:
                    path.unlink(missing_ok=True)
        finally:
            os.close(descriptor)

    def begin(self, progress: Progress) -> None:
        """Note what is restored, with what an earlier try has done already."""
        lines = [head_line(progress)]
        lines += [done_line(code, Value.parse(raw)) for code, raw in progress.done.items()]
        os.ftruncate(self._descriptor, 0)
        self._write("".join(lines))

    def done(self, code: Code, value: Value) -> None:
        """Note a code that was written and read back."""
        self._write(done_line(code, value))

    def finish(self) -> None:
        """Forget it all: the restore is done."""
        os.ftruncate(self._descriptor, 0)

    def _write(self, text: str) -> None:
        os.write(self._descriptor, text.encode())
        os.fsync(self._descriptor)


def state_folder() -> Path:
    """Return where a user's programs keep what must outlive them."""
    base = os.environ.get("XDG_STATE_HOME") or ""
    root = Path(base) if Path(base).is_absolute() else Path.home() / ".local" / "state"
    return root / "lecombus"


SUFFIXES = (".yaml", ".yml")


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
    daemon: DaemonOptions,
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
    with progress(drive, quiet=daemon.as_json) as bar:
        backup, left = anyio.run(fetch, daemon, drive, wanted, patience_s, bar)
    if left and not partial:
        raise incomplete(drive, left, output)
    text = write_backup(backup)
    if output is not None:
        save(output, text)
    if daemon.as_json:
        click.echo(json.dumps(summary(backup, output, left), ensure_ascii=False))
    elif output is None:
        click.echo(text, nl=False)
    else:
        missing = f", {len(backup.not_read)} not readable" if backup.not_read else ""
        read = len(backup.entries) - len(backup.not_read)
        click.echo(f"{drive}: {counted(read, 'code')} read{missing}, written to {output}", err=True)
    return Exit.FAILED if left else Exit.DONE


async def fetch(
    daemon: DaemonOptions,
    drive: str,
    also: Sequence[Code],
    patience_s: float,
    listener: Listener,
) -> tuple[Backup, list[ReadAttempt]]:
    """Connect and read."""
    async with connected(daemon) as line:
        return await read_drive(
            HttpDrive(line, drive), also, patience_s=patience_s, listener=listener
        )


async def read_drive(
    drive: HttpDrive, also: Iterable[Code], *, patience_s: float, listener: Listener
) -> tuple[Backup, list[ReadAttempt]]:
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
    kind = family_of_any_protocol(whose.family)
    codes = wanted_codes(kind, also)
    taken = await take(drive, codes, patience_s=patience_s, listener=listener)
    entries = {
        code: BackupEntry(code, answer.value, missing=answer.kind)
        for code, answer in taken.answers.items()
        if answer.value is not None or kind.info(code) is not None
    }
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    head = BackupHead(whose.drive, whose.line, whose.address, whose.family, now, __version__)
    return Backup(head, kind, entries, name=whose.drive), taken.unsettled


def incomplete(drive: str, left: Sequence[ReadAttempt], output: Path | None) -> CommandError:
    """Say why no backup was written."""
    first = left[0]
    codes = counted(len(left), "code")
    kept = f"; {output} is as it was" if output is not None and output.exists() else ""
    return CommandError(
        Exit.FAILED,
        f"{codes} of {drive} could not be read, the first {first.code}: {first.text}; nothing "
        f"was written{kept}",
        "again when the line is well, or with --partial for what there is",
        first.kind,
        drive,
        str(first.code),
    )


def summary(backup: Backup, output: Path | None, left: Sequence[ReadAttempt]) -> dict[str, Json]:
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


# ---- differences -----------------------------------------------------------------------------


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
                raise incomplete(name, left, None)
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
            str(each.code), each.name, shown(each.one, each.meaning_one),
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
