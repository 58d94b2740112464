"""What can be found out about serial devices on this machine, for messages that say what to do.

Where no drive is heard, another program may read the port and take the bytes of the drives: it is
named where it can be found. Else it is what a person can check: baud rate, A and B, supply.

Here live the names a device has under `/dev`, which of them is stable, what kind of device it is,
and which process holds it. Everything reads `/dev` and `/proc` and changes nothing; what may
not be read is left out, because these are hints and never a condition for working.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

__all__ = [
    "END_IT",
    "connected",
    "holders",
    "is_pseudo",
    "others_at",
    "real_path",
    "shared",
    "stable_name",
    "unheard_remedy",
]

END_IT = "end it, for only one program can speak on a line"

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


def others_at(path: str) -> tuple[str, ...]:
    """Name the other programs that have a port open and so take bytes from its reader.

    Takes some tens of milliseconds: not for the event loop. Of a pseudo terminal the process that
    has the far end is left out: a simulator holds both ends.

    Args:
        path: Any name of the device; what is not a device is held by none.
    """
    if not path.startswith("/"):
        return ()
    found = holders(path)
    found.pop(os.getpid(), None)
    if found and is_pseudo(path):
        index = Path(real_path(path)).name
        found = {pid: name for pid, name in found.items() if not _has_far_end(pid, index)}
    return tuple(found.values())


def _processes() -> Iterator[int]:
    with contextlib.suppress(OSError):  # no /proc in this place
        yield from (int(one.name) for one in os.scandir("/proc") if one.name.isdigit())


def _has_open(pid: int, real: str) -> bool:
    names = (number for number, target in _open_files(pid) if target == real)
    return any(_is_here(pid, number, real) for number in names)


def _is_here(pid: int, number: str, real: str) -> bool:
    """Whether a pseudo terminal of this name is not that of a container, which has its own."""
    try:
        return (
            not is_pseudo(real)
            or Path(f"/proc/{pid}/fd/{number}").stat().st_dev == Path(real).stat().st_dev
        )
    except OSError:  # closed since
        return False


def _has_far_end(pid: int, index: str) -> bool:
    """Whether a process holds the far end of a pseudo terminal (proc(5), fdinfo: tty-index)."""
    for number, target in _open_files(pid):
        if target.endswith("/ptmx"):
            with contextlib.suppress(OSError):
                text = Path(f"/proc/{pid}/fdinfo/{number}").read_text(encoding="utf-8")
                if f"tty-index:\t{index}" in text.splitlines():
                    return True
    return False


def _open_files(pid: int) -> Iterator[tuple[str, str]]:
    """Return the descriptors of a process and where they lead; plain strings, there are many."""
    try:
        links = list(os.scandir(f"/proc/{pid}/fd"))
    except OSError:  # not ours to look into, or just ended
        return
    for link in links:
        with contextlib.suppress(OSError):  # closed since
            yield link.name, os.readlink(link.path)  # noqa: PTH115 - thousands of them


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return "a process"


def shared(port: str, others: Sequence[str]) -> str:
    """Say that other programs have the port open."""
    have = "has" if len(others) == 1 else "have"
    takes = "takes" if len(others) == 1 else "take"
    return f"{' and '.join(others)} {have} {port} open too and {takes} bytes from the drives"


def unheard_remedy(port: str, baud: int) -> str:
    """Say what to check where nothing is heard and no other program was found."""
    if port.startswith("socket:"):
        return (
            f"check the device server's baud rate and framing ({baud}, 8N1), A and B (swap them "
            "once), and the drives' supply"
        )
    return (
        f"check the baud rate ({baud} here; C0125 or P411 in the drives), A and B (swap them "
        "once), and the drives' supply"
    )
