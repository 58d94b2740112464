"""The demo: drives of five families, simulated, run by the whole daemon, with a live view.

Nothing is staged beyond the drives: their bytes go through port, worker, schedule, store and HTTP
like those of a cabinet, paced at 9600 baud. The demo enables the drives, gives them setpoints that
change, and shows what the store says once a second.
"""

from __future__ import annotations

import itertools
import socket as sockets
import sys
import tempfile
from decimal import Decimal
from pathlib import Path

import anyio

from lecombus.config import Roster, parse_roster
from lecombus.daemon import Daemon, plain_errors
from lecombus.demo.view import View
from lecombus.errors import LecombusError, OperationError
from lecombus.line.event_loop import run as run_loop
from lecombus.parameters import Code

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

USUAL_PORT = 9740

CHANGE_EVERY = 12
"""Rounds of one second between two changes of the setpoints."""


def run_demo(seconds: float | None, http: str | None) -> int:
    """Run the demo until Ctrl-C, or for so many seconds.

    Args:
        seconds: How long; None: until Ctrl-C or SIGTERM.
        http: `HOST:PORT` for the API and `/metrics`, on loopback; port 0: any free one. None:
            `USUAL_PORT`, or any free one where that is in use.

    Returns:
        Exit status 0.

    Raises:
        RosterError: `http` is not a loopback address.
        OperationError: Nothing can listen there.
    """
    said = ""
    if http is None:
        port = free_port(USUAL_PORT)
        if port is None:
            port = free_port(0)
            said = f"port {USUAL_PORT} is in use: HTTP is served on port {port} this time"
        http = f"127.0.0.1:{port}"
    else:
        http = checked(http)
    with tempfile.TemporaryDirectory(prefix="lecombus-demo-") as folder, plain_errors():
        socket = Path(folder) / "demo.sock"
        text = ROSTER.format(watchdog=WATCHDOG, socket=socket, http=http)
        roster = parse_roster(text, "demo.yaml")
        run_loop(_main, roster, seconds, socket, said)
    return 0


def free_port(port: int) -> int | None:
    """Return a port of 127.0.0.1 that can be listened on: the one given, for 0 any; or None."""
    with sockets.socket() as trying:
        trying.setsockopt(sockets.SOL_SOCKET, sockets.SO_REUSEADDR, 1)
        try:
            trying.bind(("127.0.0.1", port))
            trying.listen()
        except OSError:
            return None
        return int(trying.getsockname()[1])


def checked(http: str) -> str:
    """Return what `--http` says with a port that is free, before anything is drawn.

    Raises:
        OperationError: The port is in use. Other mistakes are found with the roster.
    """
    host, _, port = http.rpartition(":")
    if host not in ("127.0.0.1", "localhost") or not port.isdecimal() or int(port) > 65535:
        return http
    found = free_port(int(port))
    if found is None:
        raise OperationError(
            f"cannot listen on {http}: the port is in use, or not for this user",
            kind="cannot-listen",
            remedy="name another one, such as --http 127.0.0.1:0 for any that is free",
        )
    return f"{host}:{found}"


async def _main(roster: Roster, seconds: float | None, socket: Path, said: str) -> None:
    daemon = Daemon(roster, None)
    view = View(sys.stdout, roster, socket)
    if said:
        view.say(said)
    try:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(_play, daemon, view, seconds)
            await daemon.main()
            tasks.cancel_scope.cancel()
    finally:
        view.leave()  # an error, too, is shown below the table and with the cursor shown
    view.say_goodbye()


async def _play(daemon: Daemon, view: View, seconds: float | None) -> None:
    """Show the drives every second, and move them as soon as they can be moved."""
    end_at = None if seconds is None else anyio.current_time() + seconds
    enabled: set[str] = set()
    for round_ in itertools.count():
        if daemon.runtime is not None:
            view.show(daemon.runtime)
            await _move(daemon, view, round_, enabled)
        await anyio.sleep(1.0)
        if end_at is not None and anyio.current_time() >= end_at:
            daemon.end()
            return


async def _move(daemon: Daemon, view: View, round_: int, enabled: set[str]) -> None:
    """Enable each drive once it is online, and change the setpoints every few seconds."""
    assert daemon.runtime is not None
    for name, (code, values) in SETPOINTS.items():
        state = daemon.runtime.store.drive(name).state.value
        if state != "online":
            continue
        try:
            if name not in enabled:
                enabled.add(name)
                await daemon.runtime.operations.write(name, CONTROL_WORD, "H0000")
                await daemon.runtime.operations.write(name, INHIBIT, 1)
            elif round_ % CHANGE_EVERY:
                continue
            value = values[(round_ // CHANGE_EVERY) % len(values)]
            await daemon.runtime.operations.write(name, code, Decimal(value), expires_s=5.0)
        except LecombusError as exc:
            view.say(f"{name}: {exc}")
