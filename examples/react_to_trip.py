"""Stop all drives of a line when one of them trips, and say why it tripped.

    python examples/react_to_trip.py

This is not a safety function: a trip is seen when the drive's status word is read, and this program
may not run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import aclosing

import anyio

from lecombus.client import ClientError, Line, connect


async def stop_all(line: Line, cause: str, say: Callable[[str], object]) -> None:
    """Stop every drive, and say what happened to each."""
    say(f"{cause}: stopping all drives")
    result = await line.stop()
    for one in result.members:
        say(f"{one.drive}: quick stop {one.outcome} {one.reason}")
    if not result.is_good:
        say("NOT all drives confirmed the stop: use the emergency stop circuit")


async def tripped(line: Line) -> list[str]:
    """Return the drives that show a fault now."""
    return [drive.name for drive in await line.drives() if drive.fault is not None]


async def react_to_trips(line: Line, say: Callable[[str], object] = print) -> None:
    """Watch for trips until the daemon is away for a minute.

    Args:
        line: The line.
        say: Gets a line of text at a time.
    """
    events = line.events(kinds=["trip"])
    async with aclosing(events):
        # What tripped before the events began, or while some were missed, has no event.
        already = await tripped(line)
        if already:
            await stop_all(line, f"{', '.join(already)} tripped already", say)
        async for event in events:
            if event.kind == "gap":
                missed = await tripped(line)
                if missed:
                    await stop_all(line, f"{', '.join(missed)} tripped while events were lost", say)
            elif event.data.get("active"):
                fault = event.data.get("fault") or {}
                await stop_all(line, f"{event.drive} tripped: {fault.get('meaning')}", say)
                say(f"remedy: {fault.get('remedy')}")


async def main() -> None:
    """Watch the line that the environment names."""
    async with connect() as line:
        await react_to_trips(line)


if __name__ == "__main__":
    try:
        anyio.run(main)
    except ClientError as exc:
        sys.exit(str(exc))
    except KeyboardInterrupt:
        sys.exit(130)
