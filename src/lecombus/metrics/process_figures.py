"""What the kernel says of this process, as families of the metrics page.

Names, sentences and figures are those of every Prometheus client, so that dashboards find them.
Source: "Process metrics" of Prometheus' document on writing client libraries; proc(5).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from lecombus.metrics.exposition import Block

__all__ = ["process_blocks"]

PROC: Final = Path("/proc")
_STATE_FIELD: Final = 3
"""The first field behind the name of the process, which may contain anything; proc(5) counts so."""


def process_blocks(proc: Path = PROC) -> list[Block]:
    """Read the figures; what the kernel does not give is left out."""
    blocks: list[Block] = []
    for figures in (_usage, _files):
        try:
            blocks += figures(proc)
        except (OSError, ValueError):
            continue
    return blocks


def _usage(proc: Path) -> Iterator[Block]:
    boot_s = _after(proc / "stat", b"btime ")
    field = _fields(proc)
    ticks = float(os.sysconf("SC_CLK_TCK"))
    yield _block("virtual_memory_bytes", "Virtual memory size in bytes.", field(23))
    yield _block(
        "resident_memory_bytes",
        "Resident memory size in bytes.",
        field(24) * os.sysconf("SC_PAGE_SIZE"),
    )
    yield _block(
        "start_time_seconds",
        "Start time of the process since unix epoch in seconds.",
        field(22) / ticks + boot_s,
    )
    cpu_s = field(14) / ticks + field(15) / ticks
    yield _block(
        "cpu_seconds", "Total user and system CPU time spent in seconds.", cpu_s, "counter"
    )


def _files(proc: Path) -> Iterator[Block]:
    most = _after(proc / "self" / "limits", b"Max open files")
    count = sum(1 for _ in (proc / "self" / "fd").iterdir())
    yield _block("open_fds", "Number of open file descriptors.", count)
    yield _block("max_fds", "Maximum number of open file descriptors.", most)


def _fields(proc: Path) -> Callable[[int], float]:
    """Read the numbers of `stat`; give what returns a field by its number in proc(5)."""
    parts = (proc / "self" / "stat").read_bytes().rpartition(b")")[2].split()
    return lambda number: float(parts[number - _STATE_FIELD])


def _after(path: Path, mark: bytes) -> float:
    """Read the number that follows a mark at the start of a line."""
    for line in path.read_bytes().splitlines():
        if line.startswith(mark):
            return float(line[len(mark) :].split()[0])
    raise OSError(f"{path} has no line {mark.decode()!r}")


def _block(name: str, help: str, value: float, kind: str = "gauge") -> Block:
    ending = "_total" if kind == "counter" else ""
    return Block(f"process_{name}", kind, help, [f"process_{name}{ending} {value!r}"])
