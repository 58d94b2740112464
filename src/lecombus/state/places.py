"""Opening what stands at a place, if it is a regular file: never a pipe, a device or a folder.

Opening never waits: a pipe without a reader would block open() without end, and a device that
is given another name (`/dev/full`, as root) is gone for everybody else.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from pathlib import Path
from typing import Final

__all__ = ["MODE", "check_regular", "open_regular"]

MODE: Final = 0o640

NO_FILE: Final = "Not a regular file"


def open_regular(path: Path, flags: int) -> int:
    """Open a file and give its descriptor.

    Raises:
        OSError: It cannot be opened, or is no regular file.
    """
    with contextlib.suppress(FileNotFoundError):
        _refuse(path, path.stat().st_mode)  # opening alone does something to some devices
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, MODE)
    try:
        _refuse(path, os.fstat(descriptor).st_mode)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def check_regular(path: Path) -> None:
    """See that a place is free or holds a regular file, before its name is given to another.

    Raises:
        OSError: Something else stands there.
    """
    with contextlib.suppress(FileNotFoundError):
        _refuse(path, path.lstat().st_mode)


def _refuse(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, NO_FILE, str(path))
