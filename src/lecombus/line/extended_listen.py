"""For which reads that were not answered in time the line listens longer, and how often.

A drive far slower than its manual is never heard on a busy line: its answer is cut off by the next
telegram before it begins. So now and then, after a cyclic read or a probe that stayed without any
answer several times in a row, nothing is said for up to a second. An answer that comes then is
never used as a value; it tells how slow the drive is (`drives.measured`), and the next read waits
for it.

How often is bounded: once a minute on a line, once in five minutes for a code of a drive, more and
more seldom where nothing comes, because it mostly is not there. Once a minute it may be twice, if
the first time something came: one late answer alone proves nothing.

Pure: the time is an argument. What must not live here: what cuts the listening short
  (`idle_receive`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ..protocol.addressing import Code
from ..schedule.shares import LISTEN_EVERY_S
from .station import Station

__all__ = ["ExtendedListen"]

CUT_S: Final = 2.0
"""After listening that was cut short it is not begun again sooner, seconds."""
MISSES: Final = 3
CODE_EVERY_S: Final = 300.0
CODE_EVERY_MOST_S: Final = 3600.0
MOST_RUNS: Final = 512


@dataclass(slots=True)
class _Run:
    """The misses of one code of one drive since it was last answered in time."""

    since_s: float
    misses: int = 0
    next_s: float = 0.0
    every_s: float = CODE_EVERY_S


class ExtendedListen:
    """Keeps count of what was not answered, and of what was listened to."""

    def __init__(self) -> None:
        self._runs: dict[tuple[str, Code], _Run] = {}
        self._next_s = 0.0
        self._heard = False  # something, the last time

    def wanted(self, station: Station, code: Code, now_s: float) -> bool:
        """Take note of a read without any answer; say whether to listen longer for it."""
        key = (station.name, code)
        run = self._runs.get(key)
        answered_s = station.measured.answered_s(code)
        if run is None or (answered_s is not None and answered_s > run.since_s):
            if len(self._runs) >= MOST_RUNS:
                self._runs.clear()
            run = self._runs[key] = _Run(now_s)
        run.misses += 1
        return run.misses >= MISSES and now_s >= max(run.next_s, self._next_s)

    def in_vain(self, station: Station, code: Code, now_s: float) -> None:
        """Take note that the line was listened to for as long as it may be, and nothing came."""
        run = self._runs.get((station.name, code))
        if run is not None:
            run.next_s = now_s + run.every_s
            run.every_s = min(2.0 * run.every_s, CODE_EVERY_MOST_S)
        self._next_s = now_s + LISTEN_EVERY_S
        self._heard = False

    def cut(self, now_s: float) -> None:
        """Take note that something pressed meanwhile."""
        self._next_s = now_s + CUT_S

    def heard(self, now_s: float) -> None:
        """Take note that the late answer came."""
        if self._heard:
            self._next_s = now_s + LISTEN_EVERY_S
        self._heard = not self._heard
