"""The demo: drives of five families, simulated, run by the whole daemon, with a live view.

Nothing is staged beyond the drives: their bytes go through port, worker, schedule, store and HTTP
like those of a cabinet, paced at 9600 baud. The demo enables the drives, gives them setpoints that
change, and shows what the store says once a second.

What must not live here: anything that `run` does not do too.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from decimal import Decimal
from pathlib import Path

import anyio

from lecombus.config import Roster, parse_roster
from lecombus.daemon import Daemon, plain_errors
from lecombus.demo.view import View
from lecombus.errors import LecombusError
from lecombus.line.loop import run as run_loop
from lecombus.protocol.addressing import Code

__all__ = ["run_demo"]

ROSTER = """\
line: {{name: demo, port: 'sim:', baud: 9600}}
drives:
  - {{name: feeder, address: 11, family: 8200vector, watchdog: {watchdog}}}
  - {{name: belt, address: 12, family: 821x, watchdog: {watchdog}}}
  - {{name: pump, address: 13, family: 820x, watchdog: {watchdog}}}
  - {{name: winder, address: 21, family: 93xx, watchdog: {watchdog}}}
  - {{name: fan, address: 22, family: smvector, watchdog: {watchdog}}}
groups:
  conveyors: {{members: [feeder, belt, pump]}}
on_shutdown: inhibit
api: {{socket: {socket}, http: '{http}'}}
"""

WATCHDOG = "{time: 3s, action: quick-stop, configure: true}"

CONTROL_WORD = Code(135)
INHIBIT = Code(40)

SETPOINTS: dict[str, tuple[Code, tuple[int, ...]]] = {
    "feeder": (Code(46), (35, 20)),
    "belt": (Code(46), (25, 40)),
    "pump": (Code(46), (45, 30)),
    "winder": (Code(141), (60, 80)),
    "fan": (Code(1061), (30, 15)),
}

CHANGE_EVERY = 12
"""Rounds of one second between two changes of the setpoints."""


def run_demo(seconds: float | None, http: str) -> int:
    """Run the demo until Ctrl-C, or for so many seconds.

    Args:
        seconds: How long; None: until told to end.
        http: `HOST:PORT` for the API and `/metrics`, on loopback.

    Returns:
        Exit status 0.

    Raises:
        RosterError: `http` is not a loopback address.
        OperationError: Nothing can listen there.
    """
    with tempfile.TemporaryDirectory(prefix="lecombus-demo-") as folder, plain_errors():
        socket = Path(folder) / "demo.sock"
        text = ROSTER.format(watchdog=WATCHDOG, socket=socket, http=http)
        roster = parse_roster(text, "demo.yaml")
        run_loop(_main, roster, seconds, socket)
    return 0


async def _main(roster: Roster, seconds: float | None, socket: Path) -> None:
    daemon = Daemon(roster, None)
    view = View(sys.stdout, roster, socket)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(_play, daemon, view, seconds)
        await daemon.main()
        tasks.cancel_scope.cancel()
    view.close()


async def _play(daemon: Daemon, view: View, seconds: float | None) -> None:
    """Show the drives every second, and move them as soon as they can be moved."""
    end_at = None if seconds is None else anyio.current_time() + seconds
    enabled: set[str] = set()
    for round_ in itertools.count():
        if daemon.site is not None:
            view.show(daemon.site)
            await _move(daemon, view, round_, enabled)
        await anyio.sleep(1.0)
        if end_at is not None and anyio.current_time() >= end_at:
            daemon.end()
            return


async def _move(daemon: Daemon, view: View, round_: int, enabled: set[str]) -> None:
    """Enable each drive once it is online, and change the setpoints every few seconds."""
    assert daemon.site is not None
    for name, (code, values) in SETPOINTS.items():
        state = daemon.site.store.drive(name).state.value
        if state != "online":
            continue
        try:
            if name not in enabled:
                enabled.add(name)
                await daemon.site.operations.write(name, CONTROL_WORD, "H0000")
                await daemon.site.operations.write(name, INHIBIT, 1)
            elif round_ % CHANGE_EVERY:
                continue
            value = values[(round_ // CHANGE_EVERY) % len(values)]
            await daemon.site.operations.write(name, code, Decimal(value), expires_s=5.0)
        except LecombusError as exc:
            view.say(f"{name}: {exc}")
