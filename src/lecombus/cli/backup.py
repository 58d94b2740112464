"""`lecombus backup`: the parameters of a drive, or of every drive of a line, as files.

A backup is written beside its place and then takes it, so that there is always a whole one; a file
that is not a backup is never replaced. How far a restore came is kept per line and drive in the
user's state folder (XDG_STATE_HOME), and locked while a restore is under way.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
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
    Listener,
    Progress,
    ReadAttempt,
    done_line,
    head_line,
    read_backup,
    read_progress,
    section_of,
    stops_line,
    take,
    wanted_codes,
    write_backup,
)
from lecombus.cli.arguments import CODES, DaemonOptions, WholeNumber, daemon_options, wait_option
from lecombus.cli.daemon_access import connected
from lecombus.cli.drive_access import HttpDrive
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.screen import Bar, counted, progress
from lecombus.cli.whole_file import write_whole
from lecombus.drives import Family
from lecombus.errors import ConfigError
from lecombus.fieldbus.protocols import family_of_any_protocol
from lecombus.parameters import Code, Json, Value

__all__ = [
    "Notes",
    "backup_command",
    "check_target",
    "digest_of",
    "incomplete",
    "load_backup",
    "read_drive",
    "read_text",
]

LARGEST = 4 * 1024 * 1024
"""Bytes; a backup of a thousand codes takes under a tenth of a megabyte."""

MODE = 0o644

FILE_NAME = re.compile(r"(?P<drive>[a-z0-9_-]+)\.\d{4}-\d\d-\d\dT\d{6}Z\.yaml", re.ASCII)
"""What `--all` calls a file: its drive, and when it was taken (UTC)."""


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
        remedy = "name the file that backup wrote"
        raise CommandError(Exit.USAGE, f"{path} is not text in UTF-8", remedy) from exc


def load_backup(path: Path) -> Backup:
    """Read a backup.

    Raises:
        ConfigError: Something in it cannot be.
        CommandError: It is not text.
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
    if not path.is_file():  # reading a pipe would wait without end
        raise CommandError(Exit.USAGE, f"{path} is not a file", "name one, or leave -o out")
    try:
        load_backup(path)
    except (ConfigError, CommandError) as exc:
        remedy = "name another file, or remove it"
        raise CommandError(Exit.USAGE, f"{path} exists and is not a backup", remedy) from exc


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

    def stops(self, mark: str) -> None:
        """Note the mark of the drive's stops, which changed."""
        self._write(stops_line(mark))

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


@click.command("backup")
@click.argument("drive", required=False)
@click.option("--all", "of_all", is_flag=True, help="Every drive of the line, a file each.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write it here, whole or not at all; default: standard output. With --all: a folder.",
)
@click.option(
    "--keep",
    type=WholeNumber(min=1),
    metavar="NUMBER",
    help="With --all: delete older files of a drive, so that so many stay; default: keep all.",
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
    drive: str | None,
    of_all: bool,
    output: Path | None,
    keep: int | None,
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

    With --all every drive of the line is read, one after the other, into FOLDER/DRIVE.TIME.yaml.
    A drive that is offline is passed over. --wait holds for all drives together. Each drive that
    was not backed up is named with the reason, the others are backed up; exit status 1 then.

    `lecombus diff` compares such files and drives, `lecombus restore` writes one back. With --json:
    {"drive", "file", "complete", "codes": [{"code", "name", "section", "raw", "unit", "reason"}]};
    with --all: {"drives": [..]} of those that were read.
    """
    wanted = Wanted(tuple(code for codes in also for code in codes), patience_s, partial)
    if of_all:
        if drive is not None:
            raise CommandError(Exit.USAGE, f"--all and {drive} are both given", "give one")
        return back_up_all(daemon, folder_for(output), wanted, keep)
    if drive is None:
        raise CommandError(Exit.USAGE, "no drive is named", "name one, or give --all")
    if keep is not None:
        raise CommandError(Exit.USAGE, "--keep is for --all", "leave it out")
    return back_up_one(daemon, drive, output, wanted)


@dataclass(frozen=True, slots=True)
class Wanted:
    """How drives are read.

    Args:
        also: Further codes.
        patience_s: How long to wait for a line or a drive that is away, seconds: each time, for
            several drives in all.
        partial: Also write what is not complete.
    """

    also: tuple[Code, ...]
    patience_s: float
    partial: bool


def back_up_one(daemon: DaemonOptions, drive: str, output: Path | None, wanted: Wanted) -> int:
    """Back up one drive, and return the exit status."""
    if output is not None:
        check_target(output)

    async def fetch(listener: Listener) -> tuple[Backup, list[ReadAttempt]]:
        async with connected(daemon) as line:
            return await read_drive(
                HttpDrive(line, drive), wanted.also, patience_s=wanted.patience_s, listener=listener
            )

    with progress(drive, quiet=daemon.as_json) as bar:
        backup, left = anyio.run(fetch, bar)
    if left and not wanted.partial:
        raise incomplete(drive, left, output, backup.family)
    text = write_backup(backup)
    if output is not None:
        write_whole(output, text, may_replace=True, mode=MODE)
    if daemon.as_json:
        click.echo(json.dumps(summary(backup, output, left), ensure_ascii=False))
    elif output is None:
        click.echo(text, nl=False)
    else:
        click.echo(said_of(backup, output), err=True)
    return Exit.FAILED if left else Exit.DONE


def said_of(backup: Backup, output: Path) -> str:
    """Return the line that says what was written."""
    missing = f", {len(backup.not_read)} not readable" if backup.not_read else ""
    read = len(backup.entries) - len(backup.not_read)
    return f"{backup.head.drive}: {counted(read, 'code')} read{missing}, written to {output}"


async def read_drive(
    drive: HttpDrive, also: Iterable[Code], *, patience_s: float, listener: Listener,
    pass_over: bool = False,
) -> tuple[Backup, list[ReadAttempt]]:  # fmt: skip
    """Read a drive whole.

    Args:
        drive: The drive.
        also: Further codes; those that neither a description nor the drive knows are left out.
        patience_s: How long to wait, each time, for a line or a drive that is away, seconds.
        listener: Shows the progress.
        pass_over: Do not wait for a drive that is offline.

    Returns:
        The backup, and what is missing in it for a reason that may pass.

    Raises:
        CommandError: There is no such drive, or no daemon.
    """
    found = await drive.ask_which()
    kind = family_of_any_protocol(found.family)
    codes = wanted_codes(kind, also)
    taken = await take(drive, codes, patience_s=patience_s, listener=listener, pass_over=pass_over)
    entries = {
        code: BackupEntry(code, answer.value, missing=answer.kind)
        for code, answer in taken.answers.items()
        if answer.value is not None or kind.info(code) is not None
    }
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    head = BackupHead(found.drive, found.line, found.address, found.family, now, __version__)
    return Backup(head, kind, entries, name=found.drive), taken.unsettled


def incomplete(
    drive: str, left: Sequence[ReadAttempt], output: Path | None, kind: Family
) -> CommandError:
    """Say why no backup was written."""
    first = left[0]
    codes = counted(len(left), "code")
    kept = f"; {output} is as it was" if output is not None and output.exists() else ""
    return CommandError(
        Exit.FAILED,
        f"{codes} of {drive} could not be read, the first {kind.spoken(first.code)}: {first.text}; "
        f"nothing was written{kept}",
        "repeat it when the line works, or add --partial to write what was read",
        first.kind,
        drive,
        str(first.code),
    )


# ---- every drive of a line ------------------------------------------------------------------


def folder_for(output: Path | None) -> Path:
    """Return the folder of the files of `--all`.

    Raises:
        CommandError: There is none, or it may not be written into.
    """
    if output is None:
        raise CommandError(Exit.USAGE, "--all needs a folder", "give it with -o FOLDER")
    if not output.is_dir():
        raise CommandError(Exit.USAGE, f"there is no folder {output}", "make it first")
    if not os.access(output, os.W_OK | os.X_OK):
        raise CommandError(Exit.FORBIDDEN, f"{output} may not be written into")
    return output


def back_up_all(daemon: DaemonOptions, folder: Path, wanted: Wanted, keep: int | None) -> int:
    """Back up every drive of the line, and return the exit status.

    Raises:
        CommandError: For each drive that could not be backed up; the others were.
    """
    documents: list[dict[str, Json]] = []
    problems: list[Problem] = []

    async def fetch() -> None:
        rest = wanted
        async with connected(daemon) as line:
            for one in (await line.ask("/v1/drives")).data["drives"]:
                name = str(one["drive"])
                drive = HttpDrive(line, name)
                try:
                    with progress(name, quiet=daemon.as_json) as bar:
                        documents.append(await back_up_into(folder, drive, name, rest, keep, bar))
                except CommandError as exc:
                    problems.extend(naming(name, problem) for problem in exc.problems)
                except OSError as exc:
                    why = exc.strerror or type(exc).__name__
                    problems.append(naming(name, Problem(f"not written to {folder}: {why}")))
                left_s = rest.patience_s - drive.waited_s
                rest = replace(rest, patience_s=max(0.0, left_s))

    anyio.run(fetch)
    if daemon.as_json:
        click.echo(json.dumps({"drives": documents}, ensure_ascii=False))
    if problems:
        raise CommandError.of(Exit.FAILED, *problems)
    return Exit.DONE if all(one["complete"] for one in documents) else Exit.FAILED


async def back_up_into(
    folder: Path, drive: HttpDrive, name: str, wanted: Wanted, keep: int | None, bar: Bar
) -> dict[str, Json]:
    """Back up one of several drives, drop its oldest files, and return the JSON form.

    Raises:
        CommandError: It could not be read; its files are as they were.
        OSError: Its file could not be written.
    """
    backup, left = await read_drive(
        drive, wanted.also, patience_s=wanted.patience_s, listener=bar, pass_over=True
    )
    if left and all(entry.value is None for entry in backup.entries.values()):
        problem = f"{name} was not backed up: {left[0].text}"
        raise CommandError(Exit.FAILED, problem, kind=left[0].kind, drive=name)
    if left and not wanted.partial:
        raise incomplete(name, left, None, backup.family)
    path = folder / f"{name}.{backup.head.taken.replace(':', '')}.yaml"
    write_whole(path, write_backup(backup), may_replace=True, mode=MODE)
    bar.say(said_of(backup, path))
    if keep is not None and not left:  # what is not complete takes the place of nothing
        drop_oldest(folder, path, keep)
    return summary(backup, path, left)


def drop_oldest(folder: Path, written: Path, keep: int) -> None:
    """Delete the oldest files of a drive; the one just written stays, whatever the clock says."""
    drive = written.name.partition(".")[0]
    files = [path for path in folder.iterdir() if path != written and drive_of(path) == drive]
    for path in sorted(files, reverse=True)[keep - 1 :]:
        path.unlink(missing_ok=True)


def drive_of(path: Path) -> str:
    """Return whose backup a file is, by the name that `--all` gave it; empty: it gave none."""
    found = FILE_NAME.fullmatch(path.name)
    return "" if found is None else found["drive"]


def naming(drive: str, problem: Problem) -> Problem:
    """Return a problem that names its drive."""
    text = problem.problem if problem.drive == drive else f"{drive}: {problem.problem}"
    return replace(problem, problem=text, drive=drive)


# ---- the JSON form --------------------------------------------------------------------------


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
