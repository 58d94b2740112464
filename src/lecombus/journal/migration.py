"""A journal's file of an older version becomes one of this version; the former stays beside it.

A copy is brought to the disk before anything is changed, and the change is one transaction: after a
crash at any point there is a file that opens, and its copy or the same file under its own name.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import apsw

__all__ = ["STEPS", "migrate"]

STEPS: Final[Mapping[int, str]] = {}
"""By version: the SQL that makes its tables those of the next version. The rows of `entries` stay
as they are, because their hashes cover every column. Version 1 is the first."""

MODE: Final = 0o640


def migrate(db: apsw.Connection, path: Path, version: int, wanted: int) -> Path:
    """Bring a file to another version; returns the copy of the former file.

    Args:
        db: The file, in use by this process alone.
        path: The file.
        version: Its version.
        wanted: The version that it gets.

    Raises:
        apsw.Error: The file or its copy cannot be written; the file is as it was.
        OSError: The same.
    """
    kept = path.with_name(f"{path.name}.version-{version}")
    if not kept.exists():
        copy = path.with_name(f".{kept.name}.new")
        copy.unlink(missing_ok=True)
        db.execute("VACUUM INTO ?1", (str(copy),))
        bring_to_disk(copy)
        copy.chmod(MODE)
        copy.replace(kept)
        bring_to_disk(path.parent)
    with db:
        for number in range(version, wanted):
            db.execute(STEPS[number])
        db.pragma("user_version", wanted)
    return kept


def bring_to_disk(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
