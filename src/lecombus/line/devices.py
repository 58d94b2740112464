"""What can be found out about serial devices on this machine, for messages that say what to do.

Here live the names a device has under `/dev`, which of them is stable, what kind of device it is,
and which process holds it. Everything reads `/dev` and `/proc` and changes nothing; whatever may
not be read is left out, because these are hints and never a condition for working.

What must not live here: opening a device.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path

__all__ = ["connected", "holders", "is_pseudo", "real_path", "stable_name"]

BY_ID = Path("/dev/serial/by-id")
"""Where udev keeps names made from maker, model and serial number."""

_PTS_MAJORS = range(136, 144)
"""Device numbers of the pseudo terminals' slave ends (Unix98, Linux devices.txt)."""


def real_path(path: str) -> str:
    """Follow symbolic links.

    Returns:
        Where `path` leads, such as `/dev/ttyUSB0`; `path` itself if it leads nowhere.
    """
    return str(Path(path).resolve())


def is_pseudo(path: str) -> bool:
    """Say whether a device is a pseudo terminal, which has neither wire nor framing nor RTS."""
    try:
        status = Path(path).stat()
    except OSError:
        return False
    return stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) in _PTS_MAJORS


def connected() -> tuple[str, ...]:
    """Name the serial adapters that are plugged in now, by their stable names, sorted."""
    try:
        return tuple(sorted(str(entry) for entry in BY_ID.iterdir()))
    except OSError:
        return ()


def stable_name(path: str) -> str | None:
    """Find the name under `/dev/serial/by-id` that leads to the same device.

    Returns:
        The stable name; None if there is none.
    """
    real = real_path(path)
    return next((name for name in connected() if real_path(name) == real), None)


def holders(path: str) -> dict[int, str]:
    """Find the processes that have a device open.

    Args:
        path: Any name of the device.

    Returns:
        Process number to what to call it, such as `{812: "picocom (pid 812)"}`; only processes
        that this user may look into.
    """
    real = real_path(path)
    return {pid: f"{_command(pid)} (pid {pid})" for pid in _processes() if _has_open(pid, real)}


def _processes() -> Iterator[int]:
    with contextlib.suppress(OSError):  # no /proc in this place
        yield from (int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit())


def _has_open(pid: int, real: str) -> bool:
    try:
        return any(_target(link) == real for link in Path(f"/proc/{pid}/fd").iterdir())
    except OSError:  # not ours to look into, or just ended
        return False


def _target(link: Path) -> str | None:
    try:
        return str(link.readlink())
    except OSError:  # closed meanwhile
        return None


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return "a process"
