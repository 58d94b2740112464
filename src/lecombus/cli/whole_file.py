"""Files of users, written whole or not at all: backups, rosters of a scan, drawings of a plan."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path

__all__ = ["write_whole"]


def write_whole(path: Path, text: str, *, may_replace: bool, mode: int | None = None) -> None:
    """Put a text into a file; one that is replaced keeps its mode and, if permitted, its owner.

    Args:
        path: The file; what is not a regular file, such as /dev/stdout, is written to as it is.
        text: All of it.
        may_replace: A file that is there may be replaced.
        mode: The mode of the file whether it is new or not; None for that of the old one.

    Raises:
        OSError: It could not be written; what was there is as it was.
    """
    place = path.resolve()  # a link stays one
    if place.exists() and not place.is_file():
        place.write_text(text, encoding="utf-8")
        return
    new = place.with_name(f".{place.name}.{os.getpid()}.new")
    try:
        with new.open("x", encoding="utf-8") as file:
            if place.exists():
                _keep_rights(place, file.fileno())
            if mode is not None:
                os.fchmod(file.fileno(), mode)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if not may_replace and place.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        new.replace(place)
    except BaseException as exc:  # also when interrupted: nothing is left beside it
        new.unlink(missing_ok=True)
        if isinstance(exc, OSError):
            exc.filename, exc.filename2 = str(path), None  # a full disk names no file
        raise


def _keep_rights(place: Path, descriptor: int) -> None:
    """Give a file the owner and the mode of the one whose place it takes."""
    old = place.stat()
    with suppress(PermissionError):  # the owner first: a change of it may drop bits of the mode
        os.fchown(descriptor, old.st_uid, old.st_gid)
    os.fchmod(descriptor, stat.S_IMODE(old.st_mode))
