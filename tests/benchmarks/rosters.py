"""The rosters of the benchmarks: the status word of every drive, and nothing else that is fed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from support.paced_line import drives
from support.rosters import roster_text

__all__ = ["DRIVES", "write_roster"]

DRIVES = 31


def write_roster(
    folder: Path,
    port: Path,
    *,
    baud: int,
    turnaround_ms: int,
    http: int,
    every_ms: int = 500,
    codes: Sequence[str] = ("C0150",),
    journal: bool = False,
) -> Path:
    """Write a roster for 31 drives; at 500 ms and 19200 baud the line is never idle.

    Args:
        folder: Where roster and socket are put.
        port: The line's port.
        baud: Its baud rate.
        turnaround_ms: The pause between exchanges.
        http: The TCP port of the API.
        every_ms: How often each drive is asked for each code.
        codes: What it is asked for.
        journal: Whether it has one, in the same folder.
    """
    cyclic = ", ".join(f"{{code: {code}, every: {every_ms}ms}}" for code in codes)
    text = roster_text(
        drives(DRIVES), port=port, baud=baud, folder=folder, http=http,
        line=f"turnaround: {turnaround_ms}ms, echo: no", drive=f"cyclic: [{cyclic}]",
        sections=f"journal: {folder / 'journal.sqlite'}" if journal else "",
    )  # fmt: skip
    path = folder / f"roster-{baud}-{turnaround_ms}-{every_ms}.yaml"
    path.write_text(text)
    return path
