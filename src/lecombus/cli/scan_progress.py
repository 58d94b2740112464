"""What a person sees while a scan runs: a bar with the time it may take, and drives as they come.

On standard error, and only where that is a terminal: a pipe is left quiet.
"""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from lecombus.scanning import Finding, Scan

if TYPE_CHECKING:
    from rich.progress import Progress

__all__ = ["ScanProgress"]


MEASURED = 5
"""So many addresses tell how long one takes; before that it is computed."""


class ScanProgress:
    """Shows how far a scan has come.

    Args:
        scan: The scan.
        look_s: How long an address without a drive takes, seconds; taken until it is measured.
        shown: Whether to show anything; None: on a terminal.
    """

    def __init__(self, scan: Scan, look_s: float, *, shown: bool | None = None) -> None:
        self._scan = scan
        self._look_s = look_s
        self._told = 0
        self._bar: Progress | None = None
        self._looks, self._spent_s, self._looked = 0, 0.0, 0
        self._watched_s = time.monotonic()
        if sys.stderr.isatty() if shown is None else shown:
            self._bar = _bar()
            self._task = self._bar.add_task("listening", total=scan.looks_left)

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def watch(self) -> None:
        """Show the scan as it stands now."""
        scan, now_s = self._scan, time.monotonic()
        if scan.looks > self._looks:
            self._looks, self._looked = scan.looks, self._looked + 1
            self._spent_s += now_s - self._watched_s
        self._watched_s = now_s
        if self._bar is None:
            return
        for one in scan.found[self._told :]:
            self._bar.console.print(told(one), markup=False, highlight=False, soft_wrap=True)
        self._told = len(scan.found)
        self._bar.update(
            self._task,
            completed=scan.looks,
            total=scan.looks + scan.looks_left,
            description=f"address {scan.address} at {scan.baud} baud, {self.found()}, "
            f"{self.left()}",
        )

    def found(self) -> str:
        """Say how many drives were found."""
        count = len(self._scan.found)
        return "1 drive found" if count == 1 else f"{count or 'no'} drives found"

    def left(self) -> str:
        """Say how long it may still take: as long per address as up to now."""
        per_look_s = self._look_s if self._looked < MEASURED else self._spent_s / self._looked
        return f"about {self._scan.looks_left * per_look_s:.0f} s left"


def told(one: Finding) -> str:
    """Return a drive as one line."""
    sure = "" if one.certain or one.family == "generic" else " (probably)"
    labels = ", ".join(text for _, text in one.labels)
    return f"{one.address} at {one.baud} baud: {one.family}{sure}" + (
        f" ({labels})" if labels else ""
    )


def _bar() -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (BarColumn(bar_width=24), TextColumn("{task.description}", markup=False))
    return Progress(*columns, console=Console(stderr=True), transient=True)
