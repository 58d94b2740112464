"""The rosters of tests: one way to write them, as text or as what is read from it.

Where the reading of YAML itself is tested (`tests/config`, `lecombus check`), and in the fixed
corpus of `tests/compare`, rosters stand as texts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lecombus.config import Roster, parse_roster

__all__ = ["Wanted", "make_roster", "roster_text"]

Wanted = tuple[str, int, str]
"""A drive's name, address and family."""


def roster_text(
    drives: Iterable[Wanted],
    *,
    name: str = "test",
    port: str | Path = "sim:",
    baud: int | None = 19200,
    line: str = "",
    watchdog: str = "",
    drive: str = "",
    own: Mapping[str, str] = MappingProxyType({}),
    sections: str = "",
    folder: Path | None = None,
    http: int | None = None,
) -> str:
    """Write a roster.

    Args:
        drives: The drives.
        name: The line's name.
        port: The line's port.
        baud: Bits per second; None: not written.
        line: More keys of the line, such as `retries: 1, stall: 2s`.
        watchdog: The watchdog of every drive, such as `{time: 2s, action: inhibit}`.
        drive: More keys of every drive, such as `cyclic: []`.
        own: More keys of single drives, by name.
        sections: More sections, whole lines.
        folder: Where the API's socket and the state file are put; None: neither is written.
        http: A TCP port for the API of a line with a folder.
    """
    guard = watchdog and f"watchdog: {watchdog}"
    head = _row(f"name: {name}, port: '{port}'", baud and f"baud: {baud}", line)
    rows = [f"line: {head}", "drives:"]
    for one, address, family in drives:
        named = f"name: {one}, address: {address}, family: {family}"
        rows.append(f"  - {_row(named, guard, drive, own.get(one))}")
    if folder is not None:
        api = _row(f"socket: {folder / 'api.sock'}", http and f"http: '127.0.0.1:{http}'")
        rows += [f"api: {api}", f"state: {folder / 'state.json'}"]
    return "\n".join([*rows, sections, ""])


def make_roster(drives: Iterable[Wanted], **keys: Any) -> Roster:
    """Write a roster as `roster_text` does, and read it."""
    return parse_roster(roster_text(drives, **keys), "r.yaml")


def _row(*parts: str | int | None) -> str:
    return f"{{{', '.join(str(part) for part in parts if part)}}}"
