"""When to extend the receive time after a missing answer, to detect very slow drives.

A drive far slower than its manual is never received on a busy line: the next telegram cancels its
answer before it begins. So after a cyclic read or a probe without answer, several times in a row,
nothing is sent for up to a second. An answer that arrives in that time is never used as a value. It
only measures how slow the drive is (`drives.measured`), and the next read waits long enough.

Limits: once a minute for a line, once in five minutes for a code of a drive, and less often while
nothing arrives, because the drive is usually absent. A second time in the same minute is allowed
after a late answer, because one late answer alone proves nothing.

Pure: the time is an argument.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from lecombus.fieldbus.station import Station
from lecombus.parameters import Code
from lecombus.schedule.shares import LISTEN_EVERY_S

__all__ = ["ExtendedListen"]

CUT_S: Final = 2.0
"""After an interrupted extended listen the next one waits at least this long, seconds."""
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
    """Counts missing answers and extended listens."""

    def __init__(self) -> None:
        self._runs: dict[tuple[str, Code], _Run] = {}
        self._next_s = 0.0
        self._heard = False  # something, the last time

    def wanted(self, station: Station, code: Code, now_s: float) -> bool:
        """Count a read without answer; return whether to extend the receive time for it."""
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
        """Record that the whole extended time passed without an answer."""
        run = self._runs.get((station.name, code))
        if run is not None:
            run.next_s = now_s + run.every_s
            run.every_s = min(2.0 * run.every_s, CODE_EVERY_MOST_S)
        self._next_s = now_s + LISTEN_EVERY_S
        self._heard = False

    def cut(self, now_s: float) -> None:
        """Record that an urgent request ended the extended time."""
        self._next_s = now_s + CUT_S

    def heard(self, now_s: float) -> None:
        """Record that the late answer came."""
        if self._heard:
            self._next_s = now_s + LISTEN_EVERY_S
        self._heard = not self._heard
