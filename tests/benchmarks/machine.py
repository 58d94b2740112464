"""The machine the figures are taken on, and how quiet it was meanwhile."""

from __future__ import annotations

import os
import platform
import socket
import time
from pathlib import Path

__all__ = ["Noise", "describe", "free_port"]


def free_port() -> int:
    """A TCP port of this machine that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def describe() -> str:
    """Name the machine."""
    model = "unknown processor"
    for row in Path("/proc/cpuinfo").read_text().splitlines():
        if row.startswith("model name"):
            model = row.partition(":")[2].strip()
    return (
        f"Python {platform.python_version()}, {platform.system()} {platform.release()}, "
        f"{os.cpu_count()} cores, {model}"
    )


class Noise:
    """How much processor time others took from the first look to the last."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()
        self._busy_s, self._steal_s = self._taken()

    def report(self, children_s: float) -> str:
        """Say it; `children_s` is what our own children used."""
        passed_s = time.monotonic() - self._began_s
        busy_s, steal_s = self._taken()
        cores = os.cpu_count() or 1
        others_s = max(0.0, busy_s - self._busy_s - children_s)
        return (
            f"others took {100 * others_s / passed_s / cores:.0f} % of the processors, the "
            f"hypervisor {100 * (steal_s - self._steal_s) / passed_s / cores:.1f} %, load "
            f"{os.getloadavg()[0]:.1f}, in {passed_s:.0f} s"
        )

    @staticmethod
    def _taken() -> tuple[float, float]:
        """Seconds of all processors since boot: busy, and taken by the hypervisor."""
        ticks = [int(word) for word in Path("/proc/stat").read_text().split("\n")[0].split()[1:9]]
        user, nice, system, _idle, _wait, irq, soft, steal = ticks
        hertz = os.sysconf("SC_CLK_TCK")
        return (user + nice + system + irq + soft) / hertz, steal / hertz
