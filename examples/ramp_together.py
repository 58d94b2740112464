"""Ramp drives together to a speed, hold it, and stop them; under a lease.

    python examples/ramp_together.py 30 feeder belt winder

**The motors turn.** The daemon is found as the commands find it (LECOMBUS_SOCKET or
LECOMBUS_URL). If this program dies or stalls, the lease lapses after 2 s, and lecombus does with
the drives what `on_lapse` of the roster says.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable

import anyio

from lecombus.client import ClientError, Drive, Line, connect

LEASE_S = 2.0
STEP_HZ = 2.5
STEP_S = 1.0
"""A step takes some exchanges with each drive."""
WITHIN_S = 5.0


async def set_all(drives: Iterable[Drive], speed_hz: float) -> None:
    """Give all drives a speed; raises an error unless all take it in time."""

    async def set_one(drive: Drive) -> None:
        (await drive.set_speed(speed_hz, "Hz", expires_s=WITHIN_S)).check()

    async with anyio.create_task_group() as tasks:
        for drive in drives:
            tasks.start_soon(set_one, drive)


async def stop_all(drives: Iterable[Drive]) -> None:
    """Stop drives, none waiting for another."""

    async def stop_one(drive: Drive) -> None:
        stopped = await drive.quick_stop()
        print(f"{drive.name}: quick stop {stopped.outcome} {stopped.reason}")

    async with anyio.create_task_group() as tasks:
        for drive in drives:
            tasks.start_soon(stop_one, drive)


async def ramp_together(
    line: Line, names: list[str], speed_hz: float, *, hold_s: float = 10.0
) -> None:
    """Ramp drives from 0 to a speed, all in the same steps; hold it, then stop them.

    Args:
        line: The line.
        names: The drives.
        speed_hz: The speed.
        hold_s: How long to hold it, seconds.
    """
    drives = [line.drive(name) for name in names]
    async with line.lease("ramp", names, LEASE_S) as lease:
        try:
            for drive in drives:
                if drive.name in lease.latched:
                    (await drive.quick_stop()).check()  # a latched drive takes a speed only stopped
                (await drive.set_speed(0, "Hz")).check()  # it must not start at an old setpoint
            for drive in drives:
                (await drive.enable()).check()
            for step in range(1, math.ceil(speed_hz / STEP_HZ) + 1):
                await set_all(drives, min(step * STEP_HZ, speed_hz))
                await anyio.sleep(STEP_S)
            await anyio.sleep(hold_s)
        finally:  # also after an error, Ctrl-C or the loss of the lease: a stop needs none
            with anyio.CancelScope(shield=True):
                await stop_all(drives)


async def main(names: list[str], speed_hz: float) -> None:
    """Ramp the drives of the line that the environment names."""
    async with connect() as line:
        await ramp_together(line, names, speed_hz)


def words() -> tuple[list[str], float]:
    """Read the command line; ends the program where it is wrong."""
    try:
        speed_hz = float(sys.argv[1])
    except (IndexError, ValueError):
        speed_hz = math.nan
    if not 0 < speed_hz < math.inf or not sys.argv[2:]:
        sys.exit("usage: ramp_together.py HERTZ DRIVE ..; such as: ramp_together.py 30 feeder belt")
    return sys.argv[2:], speed_hz


def run(names: list[str], speed_hz: float) -> None:
    """Run it, and end with what is wrong; of drives that failed together, with each."""
    problems: list[str] = []
    try:
        anyio.run(main, names, speed_hz)
    except* ClientError as group:
        problems = [str(error) for error in group.exceptions]
    if problems:
        sys.exit("\n".join(problems))


if __name__ == "__main__":
    try:
        run(*words())
    except KeyboardInterrupt:
        sys.exit(130)
