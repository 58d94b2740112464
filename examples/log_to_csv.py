"""Log values of drives to a CSV file, once a second.

    python examples/log_to_csv.py values.csv feeder/C0050 belt/C0051

Nothing is sent to the line: the file has what the daemon read last, so each code should be one
that the roster reads cyclically. A value that is not good leaves its cell empty, and its reason
stands in the last column: an old value must not pass for a new one.
"""

from __future__ import annotations

import csv
import os
import sys
from datetime import UTC, datetime
from pathlib import Path

import anyio

from lecombus.client import ClientError, Line, connect


async def log_to_csv(
    line: Line, wanted: list[tuple[str, str]], file: Path, *, every_s: float = 1.0, rows: int = 0
) -> None:
    """Write one row at a time, with what is known then.

    Args:
        line: The line.
        wanted: Drives and codes, such as `("feeder", "C0050")`.
        file: The file; rows are appended where its columns are those of these values.
        every_s: How long from row to row, seconds.
        rows: How many rows; 0: until it is cancelled.

    Raises:
        ValueError: The file has other columns: values would stand under the names of others.
    """
    begun_s, count = anyio.current_time(), 0
    head = ["time", *(f"{drive} {code}" for drive, code in wanted), "not good"]
    with file.open("a+", newline="") as out:
        table = csv.writer(out)
        out.seek(0)
        found = next(csv.reader(out), None)
        out.seek(0, os.SEEK_END)
        if found is None:
            table.writerow(head)
        elif found != head:
            raise ValueError(f"{file} has other columns than {', '.join(head)}; name another file")
        while not rows or count < rows:
            readings = [await line.drive(drive).value(code) for drive, code in wanted]
            reasons = [
                f"{one.drive} {one.code}: {one.quality}, {one.reason}"
                for one in readings
                if not one.is_good
            ]
            now = datetime.now(UTC).isoformat(timespec="milliseconds")
            cells = [one.value if one.is_good else "" for one in readings]
            table.writerow([now, *cells, "; ".join(reasons)])
            out.flush()
            count += 1
            await anyio.sleep_until(begun_s + count * every_s)


async def main(file: Path, wanted: list[tuple[str, str]]) -> None:
    """Log values of the line that the environment names."""
    async with connect() as line:
        await log_to_csv(line, wanted, file)


def words() -> tuple[Path, list[tuple[str, str]]]:
    """Read the command line; ends the program where it is wrong."""
    wanted = [(drive, code) for drive, _, code in (word.partition("/") for word in sys.argv[2:])]
    if not wanted or not all(drive and code for drive, code in wanted):
        sys.exit("usage: log_to_csv.py FILE DRIVE/CODE ..; such as: log_to_csv.py a.csv belt/C0050")
    return Path(sys.argv[1]), wanted


if __name__ == "__main__":
    try:
        anyio.run(main, *words())
    except (ClientError, ValueError, OSError) as exc:
        sys.exit(str(exc))
    except KeyboardInterrupt:
        sys.exit(130)
