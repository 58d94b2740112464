"""Files of backups and restores: read, written whole, and where an unfinished restore is noted.

Strategy: a backup is written beside its place and then takes it, so that there is always a whole
one; a file that is no backup is never replaced. How far a restore came is kept per line and drive
in the user's state folder (XDG_STATE_HOME), and locked while a restore is under way.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from lecombus.backups import Backup, Progress, done_line, head_line, read_backup, read_progress
from lecombus.cli.exits import CommandError, Exit
from lecombus.errors import ConfigError
from lecombus.parameters import Code, Value

__all__ = ["Notes", "check_target", "digest_of", "load_backup", "read_text", "save"]

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
