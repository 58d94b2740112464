"""`lecombus` with a wall clock that can be set: `python -m faults.shifted_clock FILE WORDS ..`.

The daemon takes the wall clock from `time.time`, and durations from the monotonic clock. A file
holds, as a double, by how much the wall clock is off; it is mapped, so that it counts immediately.
"""

from __future__ import annotations

import mmap
import struct
import sys
import time
from pathlib import Path

OFFSET = struct.Struct("d")


def main() -> None:
    """Shift the clock before anything of lecombus is imported, then run it."""
    with Path(sys.argv[1]).open("rb") as file:
        offset = mmap.mmap(file.fileno(), OFFSET.size, access=mmap.ACCESS_READ)
    real = time.time
    time.time = lambda: real() + OFFSET.unpack(offset)[0]
    sys.argv[1:2] = []
    from lecombus.__main__ import main as lecombus

    sys.exit(lecombus())


if __name__ == "__main__":
    main()
